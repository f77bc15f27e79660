"""Eq. 5 against loops in plain Python, and what goes with it."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import repeatable

from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.results.curve_errors import (
    common_grid,
    coverage,
    error_curves,
    lookup_table,
    on_grid,
    relative_rms,
    wrapped_deg,
)


def curves(n=7, points=5, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, points)) + 1j * rng.normal(size=(n, points))


def recordings(*grids, repetitions=2):
    subjects = []
    for i, grid in enumerate(grids):
        frequency = np.asarray(grid, dtype=float)
        z = (1 + np.arange(repetitions)[:, None]) * (2 + i + 1j * np.log(frequency))
        subjects.append(
            Subject(
                name=f"S{i}",
                frequency_hz=frequency,
                z=z,
                repetitions=tuple(map(str, range(repetitions))),
                noise_sd=None,
                covariates={},
            )
        )
    return Recordings(title="Title", unit="N s/m", network=None, source="", licence="", subjects=tuple(subjects))


def angle_between(a, b):
    """The smaller angle between two phases in degrees, by turning one unit vector back by the other."""
    return abs(math.degrees(cmath.phase(cmath.rect(1, math.radians(a)) / cmath.rect(1, math.radians(b)))))


def test_eq5_equals_a_loop():
    z = curves()
    magnitude, phase = np.linspace(0.5, 2.5, 5), np.linspace(-170, 170, 5)
    errors = error_curves(magnitude, phase, z)
    for k in range(5):
        total_magnitude = total_phase = 0.0
        for person in z[:, k].tolist():
            total_magnitude += math.sqrt((magnitude[k] - abs(person)) ** 2)
            total_phase += angle_between(phase[k], math.degrees(cmath.phase(person)))
        assert errors.magnitude[k] == pytest.approx(total_magnitude / 7, rel=1e-12)
        assert errors.phase_deg[k] == pytest.approx(total_phase / 7, rel=1e-12)


def test_eq5_is_averaged_over_frequency():
    z = curves()
    errors = error_curves(np.ones(5), np.zeros(5), z)
    summary = errors.summary()
    for key, curve in (("delta_magnitude", errors.magnitude), ("delta_phase_deg", errors.phase_deg)):
        values = curve.tolist()
        mean = sum(values) / 5
        assert summary[key] == pytest.approx(mean, rel=1e-12)
        assert summary[f"{key}_sd"] == pytest.approx(math.sqrt(sum((v - mean) ** 2 for v in values) / 5), rel=1e-12)


def test_people_without_data_are_left_out():
    z = curves()
    z[2, 1:3] = np.nan
    errors = error_curves(np.ones(5), np.full(5, 30.0), z)
    rest = np.delete(z, 2, axis=0)
    expected = error_curves(np.ones(5), np.full(5, 30.0), rest)
    np.testing.assert_allclose(errors.magnitude[1:3], expected.magnitude[1:3], rtol=1e-14)
    np.testing.assert_allclose(errors.phase_deg[1:3], expected.phase_deg[1:3], rtol=1e-14)
    assert np.all(errors.magnitude[[0, 3, 4]] != expected.magnitude[[0, 3, 4]])
    assert np.isfinite(list(errors.summary().values())).all()


def test_leading_axes_are_kept():
    z = np.array([curves(seed=1), curves(seed=2)])
    errors = error_curves(np.ones(5), np.zeros(5), z)
    for i in range(2):
        one = error_curves(np.ones(5), np.zeros(5), z[i])
        np.testing.assert_array_equal(errors.magnitude[i], one.magnitude)
        np.testing.assert_array_equal(errors.phase_deg[i], one.phase_deg)


@repeatable
@given(st.floats(-2000, 2000), st.integers(-3, 3))
def test_phase_differences_wrap(difference, turns):
    wrapped = float(wrapped_deg(np.array(difference)))
    assert -180 <= wrapped < 180
    assert angle_between(wrapped, difference) == pytest.approx(0, abs=1e-9)
    turned = float(wrapped_deg(np.array(difference + 360.0 * turns)))
    assert angle_between(turned, wrapped) == pytest.approx(0, abs=1e-9)


def test_phase_error_across_the_cut_is_small():
    z = np.exp(1j * np.radians([[179.0], [-179.0]]))
    assert error_curves(np.ones(1), np.array([-178.0]), z).phase_deg[0] == pytest.approx(2.0, rel=1e-9)


# Look-up tables


@pytest.mark.parametrize("n", [6, 7])
def test_median_is_the_best_single_curve(n):
    """No other curve has a smaller magnitude error at any frequency; the mean has the smallest mean square."""
    z = curves(n, 40)
    median, phase = lookup_table(z, "median")
    least = error_curves(median, phase, z).magnitude
    mean, _ = lookup_table(z, "mean")
    rng = np.random.default_rng(1)
    rivals = [mean, *np.abs(z), *(median * rng.uniform(0.5, 1.5, (200, 40)))]
    for rival in rivals:
        assert np.all(error_curves(rival, phase, z).magnitude >= least - 1e-14)
        assert np.all(np.mean((np.abs(z) - rival) ** 2, axis=0) >= np.mean((np.abs(z) - mean) ** 2, axis=0) - 1e-14)
    assert error_curves(mean, phase, z).magnitude.sum() > least.sum()


def test_lookup_tables_take_magnitude_and_phase_apart():
    z = np.array([[1.0 + 0j, 2j], [3j, 4.0]])
    for statistic in ("mean", "median"):
        magnitude, phase = lookup_table(z, statistic)
        np.testing.assert_allclose(magnitude, [2.0, 3.0])
        np.testing.assert_allclose(phase, [45.0, 45.0])
    z[0, 0] = np.nan
    assert lookup_table(z, "mean")[0][0] == 3.0


# Grids


def test_shared_grid_is_used_as_it_is():
    grid = [1.0, 2.0, 5.0]
    np.testing.assert_array_equal(common_grid(recordings(grid, grid)), grid)


def test_different_grids_give_a_logarithmic_one():
    grid = common_grid(recordings([1.0, 2.0, 5.0], [3.0, 80.0], [2.0, 50.0]))
    assert grid[0] == pytest.approx(1.0, rel=1e-12)
    assert grid[-1] == pytest.approx(80.0, rel=1e-12)
    np.testing.assert_allclose(np.diff(np.log(grid)), np.log(80) / (grid.size - 1), rtol=1e-9)


def test_own_grid_gives_the_mean_recording():
    data = recordings([1.0, 2.0, 5.0, 9.0])
    np.testing.assert_allclose(on_grid(data, data.subjects[0].frequency_hz)[0], data.subjects[0].z.mean(axis=0))


def test_interpolation_is_linear_over_log_frequency():
    """The recordings of this test are linear in log frequency, so every point in between is exact."""
    data = recordings([1.0, 3.0, 40.0])
    frequency = np.array([1.0, 1.7, 8.0, 39.0, 40.0])
    np.testing.assert_allclose(on_grid(data, frequency)[0], 1.5 * (2 + 1j * np.log(frequency)), rtol=1e-12)


def test_nothing_is_extrapolated():
    data = recordings([1.0, 3.0, 10.0], [5.0, 80.0])
    values = on_grid(data, np.array([0.99, 1.0, 4.0, 5.0, 10.0, 10.1, 80.0, 81.0]))
    expected = [[False, True, True, True, True, False, False, False], [False] * 3 + [True] * 4 + [False]]
    np.testing.assert_array_equal(np.isfinite(values), expected)
    grid = common_grid(data)
    ends = on_grid(data, grid)
    assert np.isfinite(ends[0, 0])  # rounding of the grid's ends does not count as outside
    assert np.isfinite(ends[1, -1])


# Other measures


def test_relative_rms_equals_a_loop():
    z, model = curves(3, 4), curves(1, 4, seed=5)[0]
    z[1, 2] = np.nan
    result = relative_rms(model, z)
    assert result.shape == (3,)
    for i in range(3):
        squares = [abs((model[k] - z[i, k]) / z[i, k]) ** 2 for k in range(4) if not np.isnan(z[i, k])]
        assert result[i] == pytest.approx(math.sqrt(sum(squares) / len(squares)), rel=1e-12)


def test_coverage_counts_people_inside():
    values = np.array([[1.0, 5.0, np.nan], [2.0, 6.0, np.nan], [3.0, np.nan, np.nan], [4.0, 7.0, np.nan]])
    np.testing.assert_allclose(coverage(values, np.array([2.0, 5.5, 0]), np.array([3.0, 6.5, 1])), [0.5, 1 / 3, 0])


def test_coverage_of_a_normal_band():
    values = np.random.default_rng(2).normal(size=(20000, 3))
    share = coverage(values, np.full(3, -1.6449), np.full(3, 1.6449))
    np.testing.assert_allclose(share, 0.9, atol=5 * np.sqrt(0.09 / 20000))
