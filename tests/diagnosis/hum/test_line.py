"""Hum of the mains: found where it hides in the noise as estimated, and not where something else is odd."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import binom

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.hum.line import NEAR, Hum, affected_points, find_mains
from bayes_impedance.errors import InputError

GRID = np.geomspace(5, 5000, 401)
COARSE = np.geomspace(5, 5000, 201)


@dataclass(frozen=True)
class Rig:
    """How recordings are made: noise is one per cent of |z| times `step` below 12 Hz."""

    line_hz: float = 50.0
    harmonics: tuple[int, ...] = ()
    hum: float = 0.005
    coherent: bool = False
    absorbed: bool = True
    step: float = 1.0
    resonance_hz: float = 0.0
    misfit: float = 0.0


def people(seed: int, rig: Rig, persons: int, repetitions: int, grid: np.ndarray) -> list[PersonResiduals]:
    """Persons with |z| about 1, so that 1 % of it is about 0.01; hum at the nearest points, of one amplitude."""
    rng = np.random.default_rng(seed)
    n, x = grid.size, np.log(grid)
    u = (x - x[0]) / (x[-1] - x[0])
    shape = 0.01 * np.where(grid < 12, rig.step, 1.0)
    nearest = [int(np.argmin(np.abs(x - np.log(k * rig.line_hz)))) for k in rig.harmonics]
    found = []
    for i in range(persons):
        scale = np.exp(0.15 * rng.normal())
        z = (0.8 + 0.4 * u) * np.exp(1j * u)
        peak = np.zeros(n, dtype=complex)
        if rig.resonance_hz:
            own = rig.resonance_hz * np.exp(0.1 * rng.normal())
            peak = 1 / (1 + 40j * (grid / own - own / grid))
        model = np.tile(z + 8 * peak, (repetitions, 1))
        base = scale * shape * np.abs(model)
        raw = base * (rng.normal(size=model.shape) + 1j * rng.normal(size=model.shape) + rig.misfit * peak)
        variance = base**2
        for k in nearest:
            turn = np.full(repetitions, 0.7) if rig.coherent else rng.uniform(0, 2 * np.pi, repetitions)
            raw[:, k] += rig.hum * np.sqrt(2) * np.exp(1j * turn)
            variance[:, k] += rig.hum**2
        sd = np.sqrt(variance) if rig.absorbed else base
        centre = np.arange(6) / 6
        g = np.exp(-0.5 * ((u[:, None] - centre) / 0.15) ** 2 + 1j * (np.arange(6) + 3 * u[:, None]))
        basis = np.array([np.linalg.qr(np.concatenate([(g.T * w).T.real, (g.T * w).T.imag]))[0] for w in 1 / sd])
        white = np.concatenate([raw.real, raw.imag], axis=1) / np.tile(sd, 2)
        white = PersonResiduals(name="", frequency_hz=grid, model=model, sd=sd, white=white, basis=basis).outside(white)
        found.append(PersonResiduals(name=f"P{i}", frequency_hz=grid, model=model, sd=sd, white=white, basis=basis))
    return found


def points(grid: np.ndarray, frequencies: Sequence[float]) -> list[float]:
    """Nearest points of a grid."""
    return [float(grid[np.argmin(np.abs(np.log(grid / f)))]) for f in frequencies]


def test_hum_of_half_the_noise_that_the_noise_has_absorbed_is_found() -> None:
    # Each of three harmonics has 213 x 2 parts with 1.25 times the variance: 3.3 standard deviations.
    hums = [find_mains(people(seed, Rig(harmonics=(1, 2, 3)), 71, 3, GRID)) for seed in range(5)]
    found = [hum for hum in hums if hum is not None]
    assert len(found) >= binom.ppf(1e-3, 5, 0.9)
    for hum in found:
        assert hum.line_hz == 50
        assert set(hum.harmonics) <= {1, 2, 3}
        assert not hum.coherent
        assert hum.p_value < 0.01
        assert set(hum.frequencies_hz) == set(points(GRID, [50 * k for k in hum.harmonics]))
        assert hum.q05 < hum.amplitude < hum.q95
        np.testing.assert_array_equal(GRID[affected_points(GRID, hum)], hum.frequencies_hz)


def test_hum_that_the_noise_has_absorbed_is_invisible_after_whitening() -> None:
    recordings = people(4, Rig(harmonics=(1,), hum=0.01), 40, 2, COARSE)
    assert find_mains(recordings, absolute=False) is None
    assert find_mains(recordings) is not None
    assert find_mains(people(4, Rig(harmonics=(1,), hum=0.01, absorbed=False), 40, 2, COARSE), absolute=False)


@pytest.mark.parametrize(("persons", "repetitions"), [(40, 2), (71, 1)])
@pytest.mark.parametrize(("line", "harmonics"), [(60.0, (1,)), (50.0, (3,)), (60.0, (1, 5))])
def test_the_line_and_its_harmonics_are_told(
    persons: int, repetitions: int, line: float, harmonics: tuple[int, ...]
) -> None:
    hum = find_mains(people(5, Rig(line, harmonics, 0.02), persons, repetitions, COARSE))
    assert hum is not None
    assert (hum.line_hz, hum.harmonics) == (line, harmonics)


@pytest.mark.parametrize("line", [50.0, 60.0])
@pytest.mark.parametrize("far_off", [(12,), (3, 12, 40)])
def test_a_point_of_a_few_people_that_is_far_off_is_no_hum(line: float, far_off: tuple[int, ...]) -> None:
    """As beside a pole that nothing damps: of 53 people nobody else has it."""
    some = people(9, Rig(), 53, 1, COARSE)
    column = int(np.argmin(np.abs(np.log(COARSE / line))))
    for i in far_off:
        white = some[i].white.copy()
        white[0, [column, column + COARSE.size]] = 12.0
        some[i] = replace(some[i], white=white)
    assert find_mains(some) is None
    everybody = people(9, Rig(line, (1,), 0.02), 53, 1, COARSE)
    assert find_mains(everybody) is not None


@pytest.mark.long
@pytest.mark.parametrize("coherent", [False, True])
def test_interval_of_the_amplitude_covers_the_truth(coherent: bool) -> None:
    true = 0.012
    found = [find_mains(people(s, Rig(harmonics=(1,), hum=true, coherent=coherent), 30, 2, COARSE)) for s in range(14)]
    hums = [h for h in found if h is not None]
    assert len(hums) == 14
    assert all(h.coherent == coherent for h in hums)
    # 90 % intervals; a fixed amplitude scatters less than the Gaussian one of the likelihood.
    covered = sum(h.q05 < true < h.q95 for h in hums)
    assert covered >= binom.ppf(1e-3, 14, 0.9)
    error = np.std([h.amplitude for h in hums]) / np.sqrt(14)
    assert np.mean([h.amplitude for h in hums]) == pytest.approx(true, abs=4 * error)


def test_synchronised_hum_of_a_quarter_of_the_noise_is_found() -> None:
    hum = find_mains(people(6, Rig(harmonics=(1,), hum=0.0035, coherent=True), 71, 3, GRID))
    assert hum is not None
    assert hum.coherent
    assert hum.frequencies_hz == tuple(points(GRID, [50]))


@pytest.mark.parametrize(
    "rig",
    [Rig(), Rig(step=3.0), Rig(resonance_hz=55, misfit=5.0)],
    ids=["nothing", "noise below 12 Hz", "resonance"],
)
def test_nothing_else_is_hum(rig: Rig) -> None:
    found = [find_mains(people(s, rig, 15, 2, COARSE), alpha=0.05) for s in range(16)]
    assert sum(h is not None for h in found) <= binom.isf(1e-3, 16, 0.05)


@pytest.mark.parametrize(("persons", "repetitions"), [(1, 1), (1, 4), (12, 1)])
def test_few_recordings_raise_no_more_false_alarms(persons: int, repetitions: int) -> None:
    found = [find_mains(people(s, Rig(), persons, repetitions, COARSE), alpha=0.05) for s in range(16)]
    assert sum(h is not None for h in found) <= binom.isf(1e-3, 16, 0.05)


@pytest.mark.parametrize("width", [0.02, 0.05])
def test_a_shared_misfit_of_a_few_points_at_the_line_is_not_hum(width: float) -> None:
    # A resonance of the rig at 50 Hz, the same in all recordings; the grid's spacing is 0.017.
    for person in (recordings := people(7, Rig(), 40, 2, GRID)):
        peak = 1.5 * np.exp(-0.5 * (np.log(GRID / 50) / width) ** 2)
        person.white[:] += person.outside(np.tile(np.concatenate([peak, 0 * peak]), (2, 1)))
    assert find_mains(recordings) is None


def test_a_grid_without_points_near_any_harmonic_has_no_hum() -> None:
    everything = np.geomspace(5, 5000, 301)
    harmonics = np.concatenate([50.0 * np.arange(1, 11), 60.0 * np.arange(1, 11)])
    far = np.abs(everything[:, None] / harmonics - 1).min(axis=1) > NEAR
    assert find_mains(people(8, Rig(harmonics=(1,), hum=1.0), 20, 2, everything[far])) is None
    assert find_mains(people(8, Rig(harmonics=(1,), hum=1.0), 20, 2, everything)) is not None


@pytest.mark.parametrize("step", [1.0, 6.0])
def test_the_second_point_of_a_coarse_grid_has_neighbours(step: float) -> None:
    """Lines of an analyser 34 Hz apart: one point lies below 50 Hz, with more noise, and few above are near."""
    grid = np.r_[11.0, 50.27 + 34.03 * np.arange(59)]
    hum = find_mains(people(3, Rig(harmonics=(1,), hum=0.02 * step, step=step), 53, 3, grid))
    assert hum is not None
    assert (hum.line_hz, hum.harmonics) == (50, (1,))
    assert all(find_mains(people(seed, Rig(step=step), 53, 3, grid)) is None for seed in range(10))


def test_grids_may_differ() -> None:
    grids = [np.geomspace(5 + k, 5000 - 50 * k, 190 + 3 * k) for k in range(4)]
    rig = Rig(60.0, (1, 2), 0.02)
    hum = find_mains([p for k, grid in enumerate(grids) for p in people(k, rig, 10, 1 + k % 2, grid)])
    assert hum is not None
    assert (hum.line_hz, hum.harmonics) == (60.0, (1, 2))
    assert set(hum.frequencies_hz) == {f for grid in grids for f in points(grid, [60, 120])}


def test_affected_points_are_as_near_as_those_where_hum_was_found() -> None:
    hum = Hum(
        line_hz=50.0,
        harmonics=(1, 3),
        frequencies_hz=(49.5, 151.0),
        near=0.01,
        amplitude=1.0,
        q05=0.9,
        q95=1.1,
        coherent=False,
        p_value=1e-6,
    )
    grid = np.array([49.4, 49.5, 50.0, 50.6, 100.0, 148.6, 151.4, 152.0])
    assert affected_points(grid, hum).tolist() == [False, True, True, False, False, True, True, False]


def test_nobody_is_refused() -> None:
    with pytest.raises(InputError, match="at least one subject"):
        find_mains([])
