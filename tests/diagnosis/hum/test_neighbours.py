"""A point against its neighbours: alignment, mean squares, p-values, and noise predicted from the neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, f, kstest

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.hum.neighbours import Neighbourhood, around, excess, predicted, projected

GRID = np.geomspace(10, 1000, 601)
MIDDLE = 240
CENTRE = float(GRID[MIDDLE])
NEAR = 0.01


def person(rng: np.random.Generator, grid: np.ndarray = GRID, repetitions: int = 2, columns: int = 0):
    """White noise of one per cent of an impedance of one, and a random basis of what the elements absorb."""
    shape = (repetitions, grid.size)
    basis = np.zeros((repetitions, 2 * grid.size, 1))
    if columns:
        basis = np.linalg.qr(rng.normal(size=(repetitions, 2 * grid.size, columns)))[0]
    white = rng.normal(size=(repetitions, 2 * grid.size))
    ones = np.ones(shape)
    return PersonResiduals(name="P", frequency_hz=grid, model=ones + 0j, sd=0.01 * ones, white=white, basis=basis)


def people(seed: int, count: int, **settings: int) -> list[PersonResiduals]:
    rng = np.random.default_rng(seed)
    return [person(rng, **settings) for _ in range(count)]


def table_of(persons: list[PersonResiduals], frequency: float = CENTRE) -> Neighbourhood:
    found = around(persons, [projected(p) for p in persons], frequency, NEAR, np.array([frequency]))
    assert found is not None
    return found


def meant(table: Neighbourhood) -> np.ndarray:
    return np.arange(table.frequency_hz.shape[1]) == table.middle


def louder(table: Neighbourhood, columns: np.ndarray | list[int], factor: float) -> Neighbourhood:
    value = table.value.copy()
    value[:, columns] *= factor
    return replace(table, value=value)


def test_projection_removes_what_the_elements_absorb_and_leaves_its_leverage() -> None:
    p = person(np.random.default_rng(1), columns=6)
    value, left = projected(p)
    stacked = np.concatenate([value.real, value.imag], axis=1)
    np.testing.assert_allclose(np.einsum("jfp,jf->jp", p.basis, stacked), 0.0, atol=1e-12)
    assert left.sum() == pytest.approx(2 * (2 * GRID.size - 6))


def test_recordings_are_aligned_at_the_nearest_point() -> None:
    rng = np.random.default_rng(2)
    persons = [person(rng), person(rng, np.geomspace(20, 800, 300), 3), person(rng, np.geomspace(10, CENTRE * 0.8, 90))]
    table = table_of(persons)
    assert table.owner.tolist() == [0, 0, 1, 1, 1]  # the third ends before it
    assert np.all(np.abs(table.frequency_hz[:, table.middle] / CENTRE - 1) < NEAR)
    np.testing.assert_array_equal(table.value[0, table.middle], projected(persons[0])[0][0, MIDDLE])
    known = np.isfinite(table.frequency_hz)
    assert not np.any(table.neighbour & ~known)
    assert np.all(np.isnan(table.value[~known]))
    assert not table.neighbour[:, table.middle].any()
    # Half an octave on either side, which has enough points.
    assert np.all(np.abs(np.log2(table.frequency_hz[table.neighbour] / CENTRE)) <= 0.5)


def test_excluded_points_are_no_neighbours_and_few_points_reach_further() -> None:
    p = person(np.random.default_rng(3), np.geomspace(10, 1000, 31))
    frequency = float(p.frequency_hz[12])
    excluded = np.array([frequency, p.frequency_hz[14]])
    table = around([p], [projected(p)], frequency, NEAR, excluded)
    assert table is not None
    used = table.frequency_hz[0][table.neighbour[0]]
    assert np.all(np.abs(used[:, None] / excluded - 1) > NEAR)
    assert np.abs(np.log2(used / frequency)).max() > 0.5
    assert around([p], [projected(p)], 1.5 * float(p.frequency_hz[-1]), NEAR, excluded) is None


def test_mean_squares_are_means_over_the_degrees_of_freedom_that_are_left() -> None:
    table = table_of(people(4, 3, columns=5))
    everything = np.isfinite(table.frequency_hz)
    x, n = table.mean_square(everything, together=False)
    k = table.middle + 3
    assert n[k] == pytest.approx(table.left[:, :, k].sum())
    assert x[k] == pytest.approx(np.sum(np.abs(table.value[:, k]) ** 2) / table.left[:, :, k].sum())
    x, n = table.mean_square(everything, together=True)
    assert n[k] == 2
    assert x[k] == pytest.approx(np.abs(table.value[:, k].sum()) ** 2 / table.left[:, :, k].sum())


@pytest.mark.parametrize("together", [False, True])
def test_p_values_are_uniform_where_a_point_is_like_its_neighbours(together: bool) -> None:
    p_values = []
    for seed in range(150):
        table = table_of(people(seed, 6))
        p_values.append(excess(table, table.middle, meant(table), together).p_value)
    p = np.array(p_values)
    assert np.sum(p < 0.05) <= binom.isf(1e-3, p.size, 0.05)
    # One flank in a hundred is taken to stand out by chance, which makes p one.
    assert kstest(p[p < 1], "uniform").pvalue > 1e-3


def test_a_narrow_excess_has_the_p_value_of_an_f_ratio() -> None:
    table = table_of(people(6, 8))
    loud = louder(table, [table.middle], 2.0)
    found = excess(loud, loud.middle, meant(loud), together=False)
    at, n = loud.mean_square(np.isfinite(loud.frequency_hz), together=False)
    assert found.p_value == pytest.approx(f.sf(at[loud.middle] / found.level, n[loud.middle], found.freedom))
    assert found.p_value < 1e-5
    assert found.level == pytest.approx(1.0, abs=0.15)
    # The neighbours alone decide on the level.
    quiet = excess(table, table.middle, meant(table), together=False)
    assert (found.level, found.freedom) == (quiet.level, quiet.freedom)


def test_an_excess_that_reaches_to_the_next_points_is_none() -> None:
    table = table_of(people(7, 8))
    wide = louder(table, np.arange(table.middle - 2, table.middle + 3), 2.0)
    assert excess(wide, wide.middle, meant(wide), together=False).p_value == 1.0
    # If the points beside it are meant as well, only those further out are its flanks.
    columns = np.abs(np.arange(wide.frequency_hz.shape[1]) - wide.middle) <= 2
    assert excess(wide, wide.middle, columns, together=False).p_value < 0.02


def test_what_is_the_same_in_all_repetitions_of_a_person_is_no_scatter() -> None:
    table = table_of(people(8, 12, repetitions=3))
    own = np.random.default_rng(9).normal(0, 6, 12)
    value = table.value.copy()
    value[:, table.middle] += own[table.owner]
    shifted = replace(table, value=value)
    found = shifted.between_repetitions(shifted.middle)
    assert found is not None
    contrast, freedom = found
    assert freedom == pytest.approx(2 * 24)  # two contrasts of twelve people, two parts each
    assert contrast == pytest.approx(1.0, abs=4 * np.sqrt(2 / 48))
    assert excess(shifted, shifted.middle, meant(shifted), together=False).p_value > 1e-3
    # Where people's means are no larger than chance makes them, they count as well.
    assert table.between_repetitions(table.middle) is None
    few = table_of(people(8, 4, repetitions=3))
    assert few.between_repetitions(few.middle) is None


def test_noise_is_predicted_from_the_neighbours_by_a_parabola() -> None:
    table = table_of(people(10, 3))
    u = np.log(table.frequency_hz / CENTRE)
    smooth = 0.01 * np.exp(0.4 * u - 0.3 * u**2)
    bumped = smooth.copy()
    bumped[:, table.middle] *= 3  # what an estimated noise shape makes of hum
    given = replace(table, sd=bumped)
    found = predicted(given, CENTRE)
    near = table.neighbour | meant(table)
    np.testing.assert_allclose(found.sd[near], smooth[near], rtol=1e-9)
    np.testing.assert_allclose(found.value[:, table.middle], 3 * table.value[:, table.middle], rtol=1e-9)
    # Its error at the point is the leverage of a parabola there, with the neighbours' number of points.
    x = u[0][table.neighbour[0]]
    design = np.stack([np.ones_like(x), x, x**2], axis=1)
    assert found.level_error == pytest.approx(np.linalg.inv(design.T @ design)[0, 0])


def test_noise_follows_the_magnitude_where_that_is_the_smoother_description() -> None:
    table = table_of(people(11, 3))
    rough = np.exp(np.sin(40 * np.log(np.nan_to_num(table.frequency_hz, nan=1.0))))
    found = predicted(replace(table, sd=0.02 * rough, magnitude=rough), CENTRE)
    near = table.neighbour | meant(table)
    np.testing.assert_allclose(found.sd[near], 0.02 * rough[near], rtol=1e-9)
