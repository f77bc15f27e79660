"""Where structure is left: calibrated on populations with nothing missing, and recovered where something was put in."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2, f, norm

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.residuals.locate import Location, locate, residual_maps
from bayes_impedance.diagnosis.residuals.nodes import contrast_matrix, pool, turn
from bayes_impedance.diagnosis.residuals.windows import Null, normal_score, scatter_ratios, windows
from bayes_impedance.errors import InputError

GRID = np.geomspace(5, 5000, 101)
Structure = Callable[[int, np.ndarray, np.random.Generator, int], np.ndarray]


def person(
    rng: np.random.Generator, name: str, frequency_hz: np.ndarray, repetitions: int, columns: int = 8
) -> PersonResiduals:
    """Nothing but noise, and a basis of smooth functions that is slightly different in each recording."""
    x = np.log(frequency_hz)
    u, n = (x - np.log(5)) / np.log(1000), frequency_hz.size
    model = np.empty((repetitions, n), dtype=complex)
    basis = np.empty((repetitions, 2 * n, columns))
    shift = 0.03 * rng.normal() + 0.005 * rng.normal(size=repetitions)
    centre = (np.arange(columns) + 0.5) / columns
    for j in range(repetitions):
        v = u + shift[j]
        model[j] = np.exp(0.5j * np.pi * np.sin(3 * v)) * (1 + 50 * (v - 0.3) ** 2)
        g = np.exp(-0.5 * ((v[:, None] - centre) * columns / 0.8) ** 2 + 1j * (np.arange(columns) + 6 * v[:, None]))
        basis[j] = np.linalg.qr(np.concatenate([g.real, g.imag]))[0]
    return noisy(
        PersonResiduals(
            name=name,
            frequency_hz=frequency_hz,
            model=model,
            sd=0.01 * np.abs(model),
            white=basis[:, :, 0],
            basis=basis,
        ),
        rng,
    )


def noisy(
    p: PersonResiduals, rng: np.random.Generator, added: np.ndarray | None = None, factor: np.ndarray | float = 1.0
) -> PersonResiduals:
    """New noise, in units of the assumed one, and structure (J, F): real along |z|, imaginary across it, over sd."""
    noise = factor * (rng.normal(size=p.model.shape) + 1j * rng.normal(size=p.model.shape))
    if added is not None:
        noise = noise + added * p.model / np.abs(p.model)
    return replace(p, white=p.outside(np.concatenate([noise.real, noise.imag], axis=1)))


def population(
    seed: int,
    structure: Structure | None = None,
    persons: int = 40,
    repetitions: int = 2,
    factor: np.ndarray | float = 1.0,
    grid: np.ndarray = GRID,
) -> list[PersonResiduals]:
    rng = np.random.default_rng(seed)
    people = [person(rng, f"P{i}", grid, repetitions) for i in range(persons)]
    added = [None if structure is None else structure(i, grid, rng, repetitions) for i in range(persons)]
    return [noisy(p, rng, a, factor) for p, a in zip(people, added, strict=True)]


def bump(frequency_hz: np.ndarray, centre: float, width: float) -> np.ndarray:
    """A bell over log frequency."""
    return np.exp(-0.5 * (np.log(frequency_hz / centre) / width) ** 2)


def box(frequency_hz: np.ndarray, low: float, high: float) -> np.ndarray:
    return ((frequency_hz > low) & (frequency_hz < high)).astype(float)


def same(pattern: Callable[[np.ndarray], np.ndarray]) -> Structure:
    """The same structure in all recordings of everybody."""
    return lambda i, frequency_hz, rng, j: np.tile(pattern(frequency_hz), (j, 1))


def test_pooled_covariance_is_the_sum_of_the_turned_projections() -> None:
    people = population(1, persons=3)
    pooled = pool(people)
    n = GRID.size
    expected = np.zeros((2 * n, 2 * n))
    for p in people:
        for j in range(2):
            unit = p.model[j] / np.abs(p.model[j])
            turning = np.block([[np.diag(unit.real), np.diag(unit.imag)], [-np.diag(unit.imag), np.diag(unit.real)]])
            expected += turning @ (np.eye(2 * n) - p.basis[j] @ p.basis[j].T) @ turning.T
    np.testing.assert_allclose(pooled.covariance(), expected, atol=1e-12)
    template = np.random.default_rng(1).normal(size=(2 * n, 3))
    np.testing.assert_allclose(pooled.variance(template).sum(axis=0), np.diag(template.T @ expected @ template))
    np.testing.assert_allclose(pooled.node_variance().sum(axis=0), np.diag(expected), atol=1e-12)


def test_an_error_of_magnitude_is_turned_into_the_first_half() -> None:
    p = person(np.random.default_rng(1), "P", GRID, 2)
    error = 0.02 * p.model
    white = np.concatenate([error.real, error.imag], axis=1) / np.tile(p.sd, 2)
    np.testing.assert_allclose(turn(p, white), np.tile([2.0] * GRID.size + [0.0] * GRID.size, (2, 1)), atol=1e-12)


def test_what_was_absorbed_is_gone_and_the_rest_keeps_its_covariance() -> None:
    people = population(2, persons=4)
    pooled = pool(people)
    template = np.random.default_rng(3).normal(size=(2 * GRID.size, 2))
    left = pooled.without(template)
    np.testing.assert_allclose(left.scores @ template, 0, atol=1e-9)
    np.testing.assert_allclose(left.variance(template), 0, atol=1e-9)
    # Removing a direction is a projection: the mean square of what is left is the trace of what is left.
    assert np.trace(left.covariance()) == pytest.approx(np.trace(pooled.covariance()) - 2 * 8, rel=1e-9)


def test_contrasts_are_free_of_a_persons_mean() -> None:
    matrix = contrast_matrix(np.array([0, 0, 0, 1, 4, 4]))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix @ np.array([7.0, 7.0, 7.0, 1.0, -3.0, -3.0]), 0, atol=1e-12)


def test_normal_score_agrees_with_the_f_distribution() -> None:
    for n1, n2 in ((39.0, 80.0), (70.0, 2000.0), (20.0, np.inf)):
        ratio = np.array([0.8, 1.0, 1.5, 2.0, 2.5])
        tail = chi2.sf(ratio * n1, n1) if np.isinf(n2) else f.sf(ratio, n1, n2)
        np.testing.assert_allclose(normal_score(ratio, np.array(n1), np.array(n2)), norm.isf(tail), atol=0.04)


def test_tail_of_the_null_is_smooth_and_bounded_by_bonferroni() -> None:
    maxima = np.sort(np.abs(np.random.default_rng(1).normal(size=(4000, 50))).max(axis=1))
    null = Null(maxima, 2, 50)
    z = np.array([1.0, 2.0, 3.0, 4.0, 6.0, 10.0, 30.0])
    p = np.array([null.p_value(float(v)) for v in z])
    assert np.all(np.diff(p) < 0)
    assert p[-1] > 0
    exact = -np.expm1(50 * np.log1p(-2 * norm.sf(z)))
    # 200 of the draws are beyond the knot: 7 % of chance, three times.
    np.testing.assert_allclose(p, exact, rtol=0.22)
    assert null.p_value(null.threshold(0.003)) == pytest.approx(0.003, rel=1e-6)


@pytest.mark.long
def test_false_alarms_are_as_rare_as_promised() -> None:
    rng = np.random.default_rng(11)
    people = population(11)
    p = np.array([locate([noisy(q, rng) for q in people], seed, draws=200).p_value for seed in range(200)])
    assert np.sum(p <= 0.05) <= binom.isf(1e-3, p.size, 0.05)
    assert np.sum(p <= 0.01) <= binom.isf(1e-3, p.size, 0.01)
    # Half of it is the union bound over two kinds; it must not be more cautious than that by an order of magnitude.
    assert np.mean(p <= 0.5) > 0.15


@pytest.mark.parametrize(("persons", "repetitions"), [(1, 3), (3, 3), (10, 1)])
def test_few_persons_raise_no_more_false_alarms(persons: int, repetitions: int) -> None:
    rng = np.random.default_rng(12)
    people = population(12, persons=persons, repetitions=repetitions)
    p = np.array([locate([noisy(q, rng) for q in people], seed, draws=200).p_value for seed in range(25)])
    assert np.sum(p <= 0.05) <= binom.isf(1e-3, p.size, 0.05)


@pytest.mark.parametrize(("repetitions", "factor"), [(2, 1.4), (1, 1.1)])
def test_noise_that_was_taken_too_small_is_not_structure(repetitions: int, factor: float) -> None:
    # With repetitions any error of the noise's shape is harmless, without them one of 10 %.
    rng = np.random.default_rng(13)
    people = population(13, repetitions=repetitions)
    shape = 1 + (factor - 1) * box(GRID, 100, 300)
    p = np.array([locate([noisy(q, rng, None, shape) for q in people], s, draws=200).p_value for s in range(15)])
    assert np.sum(p <= 0.05) <= binom.isf(1e-3, p.size, 0.05)


def only_band(location: Location) -> tuple[float, float, str, str]:
    assert location.p_value < 0.01
    (band,) = location.bands
    return band.low_hz, band.high_hz, band.part, band.kind


def test_a_narrow_bump_far_below_one_persons_noise_is_located() -> None:
    location = locate(population(1, same(lambda x: 0.6 * bump(x, 200, 0.1))), seed=1)
    low, high, part, kind = only_band(location)
    assert (part, kind, location.part, location.subjects) == ("magnitude", "coherent", "magnitude", "all")
    assert 120 < low < 200 < high < 330  # 5 widths
    assert location.bands[0].statistic > 0


def test_structure_in_phase_alone_is_called_phase() -> None:
    location = locate(population(2, same(lambda x: -0.4j * box(x, 700, 9e9))), seed=1)
    low, high, part, kind = only_band(location)
    assert (part, kind, location.part) == ("phase", "coherent", "phase")
    assert 500 < low < 950
    assert high == pytest.approx(5000)
    assert location.bands[0].statistic < 0
    assert location.magnitude_share < 0.2


def test_two_structures_are_two_bands() -> None:
    location = locate(population(3, same(lambda x: bump(x, 50, 0.2) + 1j * bump(x, 1000, 0.3))), seed=1)
    found = sorted((b.part, b.low_hz, b.high_hz) for b in location.bands)
    assert [b[0] for b in found] == ["magnitude", "phase"]
    assert 25 < found[0][1] < 50 < found[0][2] < 100
    assert 400 < found[1][1] < 1000 < found[1][2] < 2500
    assert location.part == "both"


def test_huge_structure_stays_where_it_entered() -> None:
    # The elements' freedom smears 20 standard deviations over all frequencies.
    location = locate(population(4, same(lambda x: 20 * bump(x, 200, 0.3))), seed=1)
    low, high, part, _ = only_band(location)
    assert part == "magnitude"
    assert 60 < low < 150
    assert 270 < high < 660  # 4 widths


@pytest.mark.parametrize("repetitions", [1, 3])
def test_structure_of_random_sign_is_incoherent(repetitions: int) -> None:
    def structure(i: int, x: np.ndarray, rng: np.random.Generator, j: int) -> np.ndarray:
        return np.tile(rng.choice([-1.2, 1.2]) * box(x, 300, 600), (j, 1))

    location = locate(population(5, structure, repetitions=repetitions), seed=1)
    low, high, part, kind = only_band(location)
    assert (part, kind, location.subjects) == ("magnitude", "incoherent", "all")
    assert 200 < low < 400
    assert 450 < high < 900


def test_a_resonance_at_everybodys_own_frequency_is_incoherent() -> None:
    def structure(i: int, x: np.ndarray, rng: np.random.Generator, j: int) -> np.ndarray:
        centre = np.exp(rng.uniform(np.log(300), np.log(1500)))
        return np.tile(5 * np.exp(2j * np.pi * rng.uniform()) * bump(x, centre, 0.08), (j, 1))

    location = locate(population(6, structure), seed=1)
    assert {b.kind for b in location.bands} == {"incoherent"}
    assert any(b.low_hz < 700 < b.high_hz for b in location.bands)
    assert location.p_value < 1e-10


@pytest.mark.parametrize("few", [1, 6, 12])
def test_the_few_who_have_it_are_named(few: int) -> None:
    pattern = same(lambda x: (4.0 if few == 1 else 2.5) * box(x, 100, 300))
    people = population(7, lambda i, x, rng, j: (i % 3 == 0) * (i < 3 * few) * pattern(i, x, rng, j))
    location = locate(people, seed=1)
    assert location.subjects == tuple(f"P{3 * i}" for i in range(few))
    assert location.subjects_p_value < 0.01


@pytest.mark.parametrize("seed", range(4))
def test_amplitudes_that_vary_are_no_reason_to_name_anybody(seed: int) -> None:
    def structure(i: int, x: np.ndarray, rng: np.random.Generator, j: int) -> np.ndarray:
        size = np.exp(0.7 * rng.normal()) if seed % 2 else 1 + 0.5 * rng.normal()
        return np.tile(1.5 * size * box(x, 100, 300), (j, 1))

    location = locate(population(seed, structure), seed=1)
    assert location.bands
    assert location.subjects == "all"
    assert location.subjects_p_value == 1.0


def test_where_nothing_is_missing_there_is_no_band() -> None:
    location = locate(population(9, repetitions=1), seed=1)
    assert location.bands == ()
    assert np.isnan(location.magnitude_share)


def test_grids_and_repetitions_may_differ() -> None:
    rng = np.random.default_rng(21)
    people = []
    for i in range(40):
        grid = np.geomspace(5 + i % 5, 5000 - 300 * (i % 4), 90 + i % 7)
        p = person(rng, f"P{i}", grid, 1 + i % 3)
        people.append(noisy(p, rng, np.tile(0.7j * box(grid, 300, 700), (1 + i % 3, 1))))
    location = locate(people, seed=1)
    low, high, part, kind = only_band(location)
    assert (part, kind) == ("phase", "coherent")
    assert 220 < low < 400
    assert 550 < high < 950
    p = [locate([noisy(q, rng) for q in people], s, draws=200).p_value for s in range(10)]
    assert np.sum(np.array(p) <= 0.05) <= binom.isf(1e-3, len(p), 0.05)


def test_ratios_are_one_on_average_where_nothing_is_missing() -> None:
    rng = np.random.default_rng(22)
    people = population(22, persons=10, repetitions=3)
    scan = windows(GRID)
    ratios = [scatter_ratios(pool([noisy(q, rng) for q in people]), scan, use_contrasts=True) for _ in range(20)]
    whole = int(np.argmax(scan.high - scan.low)) - scan.low.size  # the whole band's phase
    excess = np.array([r.excess[whole] for r in ratios])
    error = np.sqrt((2 / ratios[0].freedom[whole] + 2 / ratios[0].noise_freedom[whole]) / len(ratios))
    assert scan.inside[:, whole].all()
    assert abs(excess.mean() - 1) < 4 * error
    # 9 of 10 persons' scatter and 20 contrasts, on 101 points less half of the 8 elements' freedom.
    assert ratios[0].freedom[whole] == pytest.approx(9 * 97, rel=0.02)
    assert ratios[0].noise_freedom[whole] == pytest.approx(20 * 97, rel=0.02)


def test_the_seed_decides_everything() -> None:
    people = population(23, same(lambda x: 0.3 * bump(x, 200, 0.1)))  # not beyond all draws
    assert locate(people, 5).p_value == locate(people, 5).p_value
    assert locate(people, 5).p_value != locate(people, 6).p_value


def test_maps_have_unit_variance_and_end_with_the_range() -> None:
    people = population(24, persons=60, repetitions=3)
    magnitude, phase = residual_maps(people, GRID)
    assert magnitude.shape == phase.shape == (60, GRID.size)
    for values in (magnitude, phase):
        # 60 x 101 values that the projection correlates a little: 2 / 6000 is the variance of their variance.
        assert values.var() == pytest.approx(1, abs=4 * np.sqrt(2 / values.size))
    p = people[7]
    score = turn(p, p.outside(p.white)).sum(axis=0)
    left = (1 - np.sum(turn(p, p.basis) ** 2, axis=2)).sum(axis=0)
    np.testing.assert_allclose(np.concatenate([magnitude[7], phase[7]]), score / np.sqrt(left))

    wide, _ = residual_maps(people[:2], np.geomspace(2, 9000, 300))
    outside = (np.geomspace(2, 9000, 300) < 5) | (np.geomspace(2, 9000, 300) > 5000)
    assert np.isnan(wide[:, outside]).all()
    assert set(wide[0, ~outside]) <= set(magnitude[0])


def test_unusable_input_is_refused() -> None:
    with pytest.raises(InputError, match="at least one subject"):
        locate([], 1)
