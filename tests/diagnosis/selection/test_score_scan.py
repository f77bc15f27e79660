"""The score scan of all candidates: calibrated when nothing is missing, equal to the scores computed by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from experiments import TOY, Serial, concealing, entry, recovered, residuals_of, screened, toy

from bayes_impedance.diagnosis.catalogue.effect import Coefficient, Effect, registered
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.fit.normal_equations import owners
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.score_scan import Screening, _effective, candidates_for, screen
from bayes_impedance.network.kernel import Kernel

N_POPULATIONS = 24

HANDFUL = (
    ("rig.delay", "port"),
    ("rig.highpass", "port"),
    ("rig.damping", "port"),
    ("rig.series_compliance", "port"),
    ("body.hysteresis", "n1"),
    ("body.hysteresis", "n3"),
    ("body.reflex", "skin"),
)
"""Visible, and not the same: their signatures are less than 90 % alike."""


def columns(screening: Screening) -> list[int]:
    keys = [(c.effect.id, c.place) for c in screening.candidates]
    return [keys.index(key) for key in HANDFUL]


def within_chance(squares: float, freedom: int) -> bool:
    from scipy.stats import chi2

    return bool(chi2.ppf(0.001, freedom) < squares < chi2.ppf(0.999, freedom))


# When nothing is missing


@pytest.fixture(scope="module")
def null() -> list[tuple[Refit, Screening]]:
    """Small populations (16 people, 2 repetitions, 61 points) with nothing missing."""
    result = []
    for seed in range(N_POPULATIONS):
        fit = concealing("none", None, 0.0, seed).fit()
        assert fit.settled
        result.append((fit, screened(fit)))
    return result


def test_scores_have_the_variance_and_the_correlations_that_they_say(null: list[tuple[Refit, Screening]]) -> None:
    z = np.array([s.z[columns(s)] for _, s in null])
    assert np.all(np.isfinite(z))
    for k in range(len(HANDFUL)):
        assert within_chance(float(np.sum(z[:, k] ** 2)), N_POPULATIONS), HANDFUL[k]
    joint = 0.0
    for own, (_, s) in zip(z, null, strict=True):
        cosine = s.cosine[np.ix_(columns(s), columns(s))]
        assert np.linalg.eigvalsh(cosine)[0] > 0.01
        joint += float(own @ np.linalg.solve(cosine, own))
    assert within_chance(joint, z.size)
    # No population leans to one side: the sum of each population's scores over its variance is a square of its own.
    assert np.all(np.abs(z.mean(axis=0)) < 3.6 / np.sqrt(N_POPULATIONS))


def test_corrected_p_values_are_honest(null: list[tuple[Refit, Screening]]) -> None:
    """The smallest of hundreds of candidates, corrected for their number, is uniform or larger."""
    from scipy.stats import binom

    largest = np.array([np.exp(s.log_p(np.nanmax(np.abs(s.z)))) for _, s in null])
    spread = np.array([np.exp(np.min(s.log_p_spread)) for _, s in null])
    for p in (largest, spread):
        for level in (0.01, 0.05, 0.1, 0.3):
            assert np.sum(p < level) <= binom.ppf(0.999, N_POPULATIONS, level)
    assert np.sum(largest < 0.7) >= binom.ppf(0.001, N_POPULATIONS, 0.3)  # and not absurdly cautious


def test_the_price_of_many_is_that_of_their_largest(null: list[tuple[Refit, Screening]]) -> None:
    """With scores drawn from the screening's own correlations."""
    screening = null[0][1]
    seen = np.isfinite(screening.z)
    assert 0.02 * seen.sum() < screening.effective < seen.sum()
    values, vectors = np.linalg.eigh(screening.cosine[np.ix_(seen, seen)])
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    rng, n = np.random.default_rng(7), 4000
    largest = np.concatenate([np.abs(factor @ rng.normal(size=(seen.sum(), 500))).max(axis=0) for _ in range(8)])
    p = np.exp(screening.log_p(largest))
    for level in (0.005, 0.02, 0.05):
        # Up to the error of the draws behind it (120 of 6000 beyond its level) and of these.
        error = 4 * level * np.hypot(1 / np.sqrt(120), 1 / np.sqrt(level * n))
        assert np.mean(p < level) == pytest.approx(level, abs=error)
    assert np.mean(p < 0.2) < 0.2 + 4 * np.sqrt(0.16 / n)


def mean_square_outside(fits: Sequence[Refit]) -> tuple[float, float]:
    """Of the whitened residuals outside of the elements, and how many degrees of freedom there are."""
    total = freedom = 0.0
    for fit in fits:
        for person in residuals_of(fit):
            total += float(np.sum(person.outside(person.white) ** 2))
            freedom += person.white.size - float(np.sum(person.basis**2))
    return total / freedom, freedom


def test_whitened_residuals_have_unit_variance_outside_of_the_elements(null: list[tuple[Refit, Screening]]) -> None:
    mean, freedom = mean_square_outside([fit for fit, _ in null])
    # The scale of a person's noise has a prior centred at one, worth four numbers among 244.
    assert mean == pytest.approx(1, abs=4 * np.sqrt(2 / freedom))


def test_a_person_with_more_noise_weighs_less() -> None:
    """Stated noise is multiplied by a scale that is the person's own: residuals over it are the same for everybody."""
    experiment = concealing("none", None, 0.0, 3)
    loud = tuple(
        replace(d, weight=d.weight * (25.0 if i % 2 else 1.0)) for i, d in enumerate(experiment.data)
    )  # stated five times too small
    fit = Refitter(loud, Serial()).fit(experiment.model, experiment.u, experiment.population, 80)
    plain = experiment.fit()
    found, expected = screened(fit, HANDFUL_EFFECTS), screened(plain, HANDFUL_EFFECTS)
    # The prior of the scale, centred on what is stated, is worth 4 numbers among 244.
    np.testing.assert_allclose(found.information[::2], expected.information[::2], rtol=0.02)
    np.testing.assert_allclose(found.information[1::2], expected.information[1::2], rtol=0.05)
    np.testing.assert_allclose(found.z, expected.z, atol=0.25)


HANDFUL_EFFECTS = tuple(e for e in registered() if e.id in dict(HANDFUL))


@pytest.mark.parametrize(
    ("effect", "strength", "pooling"),
    [(entry("rig.delay"), 0.3, "shared"), (entry("body.mass"), 1.0, "varying")],
    ids=lambda v: getattr(v, "id", str(v)),
)
def test_what_was_added_leaves_nothing_behind(effect: Effect, strength: float, pooling: str) -> None:
    """With the concealed effect in the model the scores of all others are those of noise again."""
    squares, handful = [], [key for key in HANDFUL if key[0] != effect.id]
    n = 10
    for seed in range(40, 40 + n):
        fit = recovered(concealing(effect.id, "port", strength, seed), effect, "port", pooling)
        screening = screened(fit, HANDFUL_EFFECTS)
        keys = [(c.effect.id, c.place) for c in screening.candidates]
        assert (effect.id, "port") not in keys
        squares.append([screening.z[keys.index(key)] ** 2 for key in handful])
    for total, key in zip(np.sum(squares, axis=0), handful, strict=True):
        assert within_chance(float(total), n), key


# The algebra


def test_scores_by_hand() -> None:
    """Two candidates in a toy network, from the Kernel's derivatives and least squares."""
    experiment = toy(*TOY, seed=5, n=4)
    fit = experiment.fit()
    effects = [entry("rig.delay"), entry("rig.mass")]
    screening, residuals = screened(fit, effects), residuals_of(fit)
    b, m = np.zeros((4, 2)), np.zeros((4, 2))
    for row, i in enumerate(fit.owner):
        d = fit.data[i]
        s, frequency = 1j * d.omega, d.omega / (2 * np.pi)
        z, dz = Kernel(fit.model.network).derivative(fit.u[row], frequency)
        sd = residuals[i].sd[row % 2]
        white = [
            np.concatenate([v.real / sd, v.imag / sd])
            for v in (*dz, -s * z, s, d.z[row % 2, 0] + 1j * d.z[row % 2, 1] - z)
        ]
        *tangent, delay, mass, residual = white
        t = np.array(tangent).T
        for k, g in enumerate((delay, mass)):
            left = g - t @ np.linalg.lstsq(t, g, rcond=None)[0]
            b[i, k] += left @ residual
            m[i, k] += left @ left
    np.testing.assert_allclose(screening.score, b, rtol=1e-6, atol=1e-9 * np.abs(b).max())
    np.testing.assert_allclose(screening.information, m, rtol=1e-8)
    np.testing.assert_allclose(screening.z, b.sum(axis=0) / np.sqrt(m.sum(axis=0)), rtol=1e-6)
    np.testing.assert_allclose(screening.size, b.sum(axis=0) / m.sum(axis=0), rtol=1e-6)
    expected = (np.sum((b - m * screening.size) ** 2, axis=0) - m.sum(axis=0)) / np.sqrt(2 * np.sum(m**2, axis=0))
    np.testing.assert_allclose(screening.spread, expected, rtol=1e-6)


def test_what_was_added_is_taken_out_of_the_scores() -> None:
    """A high-pass is in the model, held at nothing although there is one: the score of a loss does without it."""

    def hidden(s: np.ndarray, z: np.ndarray, _: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return z * s / (s + 0.6), np.full(len(z), 0.6)

    experiment = toy(*TOY, seed=6, n=5, repetitions=1, hidden=hidden)
    model = experiment.grown(Addition(effect=entry("rig.highpass"), place="port", pooling="shared"))
    u = np.column_stack([experiment.u, np.zeros(5)])
    fit = experiment.refitter.fit(model, u, experiment.population, 80, hold_additions=True)
    assert fit.shared_value == 0
    screening = screened(fit, [entry("body.hysteresis")])
    b, gram = np.zeros(2), np.zeros((2, 2))
    for person, row in zip(residuals_of(fit), fit.u, strict=True):
        s = 2j * np.pi * person.frequency_hz
        pair = [1j / (s * np.exp(row[0])), -person.model[0] / s]  # of a loss factor and of a corner in rad/s
        g = np.array([np.concatenate([v.real, v.imag]) / np.tile(person.sd[0], 2) for v in pair])
        dz = Kernel(experiment.model.network).derivative(row[:2], person.frequency_hz)[1] / person.sd[0]
        t = np.concatenate([dz.real, dz.imag], axis=1).T
        g -= (t @ np.linalg.lstsq(t, g.T, rcond=None)[0]).T
        b += g @ person.white[0]
        gram += g @ g.T
    net, information = b[0] - gram[0, 1] / gram[1, 1] * b[1], gram[0, 0] - gram[0, 1] ** 2 / gram[1, 1]
    assert abs(b[1]) / np.sqrt(gram[1, 1]) > 10  # there is much to be taken out
    assert abs(b[0]) / np.sqrt(gram[0, 0]) > 5
    assert abs(net) / np.sqrt(information) < 4
    assert screening.z[0] == pytest.approx(net / np.sqrt(information), rel=1e-5)
    assert screening.size[0] == pytest.approx(net / information, rel=1e-5)


def test_cosines_are_correlations(null: list[tuple[Refit, Screening]]) -> None:
    screening = null[1][1]
    seen = np.isfinite(screening.z)
    cosine = screening.cosine[np.ix_(seen, seen)]
    np.testing.assert_allclose(np.diag(cosine), 1, rtol=1e-9)
    np.testing.assert_allclose(cosine, cosine.T, atol=1e-9)
    assert np.abs(cosine).max() < 1 + 1e-9
    keys = [c.effect.id for c in screening.candidates]
    delay, lowpass, mass = (keys.index(name) for name in ("rig.delay", "rig.lowpass", "rig.mass"))
    assert abs(screening.cosine[delay, lowpass]) > 0.999  # to first order they are the same
    assert abs(screening.cosine[delay, mass]) < 0.999


def test_what_the_elements_can_do_is_invisible(null: list[tuple[Refit, Screening]]) -> None:
    screening = null[0][1]
    keys = [(c.effect.id, c.place) for c in screening.candidates]
    for place in ("tissue", "n2|r2"):  # there is a mass already, or one in series
        k = keys.index(("body.mass", place))
        assert screening.visible[k] < 1e-3
        assert np.isnan(screening.z[k])
    k = keys.index(("rig.highpass", "port"))
    assert 0.1 < screening.visible[k] <= 1
    assert np.nanmax(screening.visible) <= 1 + 1e-9


def test_unsigned_coefficients_must_be_positive(null: list[tuple[Refit, Screening]]) -> None:
    for _, screening in null[:3]:
        for candidate, size, physical in zip(screening.candidates, screening.size, screening.physical, strict=True):
            assert physical == (candidate.effect.signed or size > 0)


def part(fit: Refit, people_: Sequence[int]) -> Refit:
    """The same fit, of some of the people."""
    rows = np.flatnonzero(np.isin(fit.owner, people_))
    equations = replace(fit.equations, chi=fit.equations.chi[rows])
    return replace(fit, data=tuple(fit.data[i] for i in people_), u=fit.u[rows], equations=equations)


def test_people_are_screened_one_by_one(null: list[tuple[Refit, Screening]]) -> None:
    fit, screening = null[2]
    few = screened(part(fit, [0, 5, 11]))
    np.testing.assert_allclose(few.score, screening.score[[0, 5, 11]], rtol=1e-9)
    np.testing.assert_allclose(few.information, screening.information[[0, 5, 11]], rtol=1e-9)


def test_grids_may_differ_between_people() -> None:
    first = toy(*TOY, seed=1, n=3)
    second = toy(*TOY, seed=2, n=3, frequency_hz=np.geomspace(3, 900, 29), repetitions=3)
    data, u = (*first.data, *second.data), np.vstack([first.u, second.u])
    fit = Refitter(data, Serial()).fit(first.model, u, first.population, 80)
    together = screened(fit)
    assert owners(data).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5, 5]
    for people_ in ([0, 1, 2], [3, 4, 5]):
        alone = screened(part(fit, people_))
        np.testing.assert_allclose(alone.score, together.score[people_], rtol=1e-9)
        np.testing.assert_allclose(alone.information, together.information[people_], rtol=1e-9)


def test_a_mixture_of_threads_changes_nothing(null: list[tuple[Refit, Screening]]) -> None:
    from concurrent.futures import ThreadPoolExecutor

    fit, screening = null[0]
    with ThreadPoolExecutor(3) as executor:
        again = screen(fit, residuals_of(fit), registered(), 1, executor)
    np.testing.assert_array_equal(again.z, screening.z)
    assert again.effective == screening.effective


def test_what_was_added_is_not_a_candidate_any_more() -> None:
    experiment = toy(*TOY, seed=1, n=3)
    model = build(
        experiment.model.network,
        [Addition(effect=entry("body.mass"), place="port", pooling="shared")],
        experiment.model.scales,
        [{}],
    )
    u = np.column_stack([experiment.u, np.zeros(len(experiment.u))])
    fit = experiment.refitter.fit(model, u, experiment.population, 5)
    before = {(c.effect.id, c.effect.operation, c.place) for c in candidates_for(experiment.fit(), registered())}
    after = {(c.effect.id, c.effect.operation, c.place) for c in candidates_for(fit, registered())}
    assert before - after == {("body.mass", "add", "port")}


def test_effective_number_of_candidates() -> None:
    """One if all are the same, all of them if they are independent; 120 draws beyond the level: 9 % either way."""
    error = 3.5 / np.sqrt(120)
    assert _effective(np.ones((40, 40)), 1) == pytest.approx(1, abs=error)
    assert _effective(np.eye(1), 2) == pytest.approx(1, abs=error)
    for n in (5, 60, 400):
        assert _effective(np.eye(n), 3) == pytest.approx(n, rel=error)
    blocks = np.kron(np.eye(10), np.ones((7, 7)))
    assert _effective(blocks, 4) == pytest.approx(10, rel=error)
    assert _effective(np.zeros((0, 0)), 1) == 1.0
    assert _effective(blocks, 4) == _effective(blocks, 4)


def test_p_values_in_closed_form(null: list[tuple[Refit, Screening]]) -> None:
    from scipy.stats import norm

    one = replace(null[0][1], effective=1.0)
    z = np.array([0.5, 2.0, -3.0, 8.0])
    np.testing.assert_allclose(np.exp(one.log_p(z)), 2 * norm.sf(np.abs(z)), rtol=1e-12)
    np.testing.assert_allclose(np.exp(one.log_p(z, two_sided=False)), norm.sf(np.abs(z)), rtol=1e-12)
    many = replace(one, effective=100.0)
    np.testing.assert_allclose(np.exp(many.log_p(z)), np.minimum(200 * norm.sf(np.abs(z)), 1), rtol=1e-12)
    assert np.isfinite(many.log_p(60.0))  # far beyond what a p-value itself can hold
    assert many.log_p(60.0) == pytest.approx(np.log(100 * 2) + norm.logsf(60.0))


def test_user_effect_with_shapes_is_scanned_over_its_grid() -> None:
    experiment = toy(*TOY, seed=1, n=2)
    effect = Effect(
        id="body.test",
        name="test",
        side="body",
        pooling="varying",
        places=("port",),
        formula="f",
        story="s",
        look_for="l",
        separates="s",
        source="ours",
        operation="relaxation",
        coefficients=(Coefficient("damping", "r"), Coefficient("time_constant", "s", "log", (1e-3, 1e-2, 1e-1))),
    )
    screening = screened(experiment.fit(), [effect])
    assert [c.shape for c in screening.candidates] == [{"time_constant": t} for t in (1e-3, 1e-2, 1e-1)]
