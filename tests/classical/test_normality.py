"""Tests of normality: by hand, by a direct formula, by their size and power, and what may and may not change them."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist, fmean, stdev

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from strategies import repeatable

from bayes_impedance.classical.normality import (
    MINIMUM_PEOPLE,
    TESTS,
    Normality,
    chi_square_normality,
    henze_zirkler_normality,
    normality,
    shapiro_normality,
)
from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import read_recordings
from bayes_impedance.results.curve_errors import common_grid, on_grid

FINGERTIPS = Path(__file__).parents[2] / "data" / "fingertip_71"
N = 71
SAMPLES = 4000
REAL_TESTS = (chi_square_normality, shapiro_normality)


def normal(samples=SAMPLES, n=N, seed=0):
    return np.random.default_rng(seed).normal(size=(n, samples))


def bivariate(samples=SAMPLES, n=N, seed=0):
    x, y = np.random.default_rng(seed).normal(size=(2, n, samples))
    return x + 1j * (0.3 * y - 0.8 * x)


def limits(probability, samples=SAMPLES, sigmas=4.0):
    """Binomial limits of a share."""
    half = sigmas * math.sqrt(probability * (1 - probability) / samples)
    return probability - half, probability + half


def within(share, probability, samples=SAMPLES):
    low, high = limits(probability, samples)
    return low < share < high


# ---------------------------------------------------------------- chi-square by hand


def test_chi_square_by_hand() -> None:
    """From 0 to 10 the bins are unit intervals; 3.0 lies on an edge and belongs to the bin above it, 10 to the last."""
    parts = ((0.0, 2), (1.5, 4), (2.5, 8), (3.0, 4), (3.5, 10), (4.5, 18), (5.5, 20), (6.5, 13), (7.5, 9), (8.5, 5))
    values = [value for value, count in (*parts, (10.0, 3)) for _ in range(count)]
    below = NormalDist(fmean(values), stdev(values)).cdf
    # The outer bins expect 2.5 and 3.0 people, the next ones 4.3 and 4.9: both ends are merged once.
    assert [96 * below(1), 96 * (below(2) - below(1))] == pytest.approx([2.461, 4.302], abs=0.001)
    assert [96 * (1 - below(9)), 96 * (below(9) - below(8))] == pytest.approx([2.987, 4.940], abs=0.001)
    edges = [-math.inf, 2, 3, 4, 5, 6, 7, 8, math.inf]
    observed = [6, 8, 14, 18, 20, 13, 9, 8]
    expected = [96 * (below(high) - below(low)) for low, high in pairwise(edges)]
    assert min(expected) > 5
    statistic = sum((o - e) ** 2 / e for o, e in zip(observed, expected, strict=True))
    p = stats.chi2(8 - 1 - 2).sf(statistic)
    assert chi_square_normality(np.array(values)[:, None])[0] == pytest.approx(p, rel=1e-12)
    assert chi_square_normality(-np.array(values)[:, None])[0] != pytest.approx(p, rel=1e-3)  # 3.0 changes its bin


def test_chi_square_merges_thin_neighbours_of_the_ends() -> None:
    """Bins expect 7.8, 4.6, 5.4, 5.7, 5.3, 4.3, 3.1, 1.9, 1.1 and 0.9 people: five and two of them become one.

    The right end reaches five with four bins, but its neighbour and the left end's do not expect five yet.
    """
    counts = (13, 3, 2, 3, 6, 4, 4, 2, 1)
    values = [0.0, *(k + 0.5 for k, count in enumerate(counts) for _ in range(count)), 10.0]
    below = NormalDist(fmean(values), stdev(values)).cdf
    edges, observed = [-math.inf, 2, 3, 4, 5, math.inf], [17, 2, 3, 6, 12]
    expected = [40 * (below(high) - below(low)) for low, high in pairwise(edges)]
    statistic = sum((o - e) ** 2 / e for o, e in zip(observed, expected, strict=True))
    p = math.exp(-statistic / 2)  # two degrees of freedom
    assert chi_square_normality(np.array(values)[:, None])[0] == pytest.approx(p, rel=1e-12)


def test_chi_square_needs_four_bins() -> None:
    """Three bins leave no degree of freedom after the mean and the standard deviation."""
    assert np.isnan(chi_square_normality(normal(3, MINIMUM_PEOPLE))).all()
    far = np.concatenate([normal(1, 60)[:, 0], [1000.0]])
    assert np.isnan(chi_square_normality(far[:, None])[0])
    assert np.isfinite(chi_square_normality(normal(3, 60))).all()


# ---------------------------------------------------------------- Henze and Zirkler by a direct formula


def direct_henze_zirkler(points: np.ndarray) -> float:
    """P value of points (n, d) by the formula as it is printed, for any number of variables."""
    n, d = points.shape
    inverse = np.linalg.inv(np.cov(points.T, ddof=0))
    mean = points.mean(axis=0)
    beta2 = (((2 * d + 1) * n / 4) ** (1 / (d + 4)) / math.sqrt(2)) ** 2
    pairs = sum(math.exp(-beta2 / 2 * float((x - y) @ inverse @ (x - y))) for x in points for y in points)
    single = sum(math.exp(-beta2 / (2 * (1 + beta2)) * float((x - mean) @ inverse @ (x - mean))) for x in points)
    hz = pairs / n - 2 * (1 + beta2) ** (-d / 2) * single + n * (1 + 2 * beta2) ** (-d / 2)
    a, w = 1 + 2 * beta2, (1 + beta2) * (1 + 3 * beta2)
    mu = 1 - a ** (-d / 2) * (1 + d * beta2 / a + d * (d + 2) * beta2**2 / (2 * a**2))
    variance = (
        2 * (1 + 4 * beta2) ** (-d / 2)
        + 2 * a**-d * (1 + 2 * d * beta2**2 / a**2 + 3 * d * (d + 2) * beta2**4 / (4 * a**4))
        - 4 * w ** (-d / 2) * (1 + 3 * d * beta2**2 / (2 * w) + d * (d + 2) * beta2**4 / (2 * w**2))
    )
    scale = math.sqrt(mu**4 / (variance + mu**2))
    return float(stats.lognorm.sf(hz, s=math.sqrt(math.log((variance + mu**2) / mu**2)), scale=scale))


@pytest.mark.parametrize("n", [MINIMUM_PEOPLE, 30, N])
def test_henze_zirkler_equals_the_double_sum(n: int) -> None:
    rng = np.random.default_rng(n)
    z = rng.normal(size=(n, 3)) + 1j * rng.normal(size=(n, 3)) ** np.arange(1, 4)
    expected = [direct_henze_zirkler(np.column_stack([column.real, column.imag])) for column in z.T]
    np.testing.assert_allclose(henze_zirkler_normality(z), expected, rtol=1e-8)


@repeatable
@given(
    st.floats(-3, 3),
    st.floats(0.01, 100),
    st.floats(-5, 5),
    st.floats(0.01, 100),
    st.complex_numbers(max_magnitude=100),
)
def test_henze_zirkler_is_affine_invariant(turn, stretch, shear, scale, shift) -> None:
    z = bivariate(2, 25)
    x, y = z.real, z.imag
    moved = scale * np.exp(1j * turn) * (x + shear * y + 1j * stretch * y) + shift
    np.testing.assert_allclose(henze_zirkler_normality(moved), henze_zirkler_normality(z), rtol=1e-6)


# ---------------------------------------------------------------- size and power


@pytest.mark.parametrize(
    ("test", "sizes"),
    [
        (
            chi_square_normality,
            (0.011, 0.059, 0.12),
        ),  # liberal: its moments are not those of the counts
        (shapiro_normality, (0.01, 0.05, 0.1)),
        (henze_zirkler_normality, (0.01, 0.05, 0.1)),
    ],
)
def test_size_under_normality(test, sizes) -> None:
    p = test(bivariate() if test is henze_zirkler_normality else normal())
    for level, size in zip((0.01, 0.05, 0.1), sizes, strict=True):
        assert within(np.mean(p <= level), size)


def test_power_against_a_log_normal() -> None:
    """The figures of the module's docstring: standard deviation 0.3 of the logarithm, 71 people, 5 % level."""
    x = np.exp(0.3 * normal(seed=1))
    chi_square, shapiro = (float(np.mean(test(x) <= 0.05)) for test in REAL_TESTS)
    assert within(chi_square, 0.28)
    assert within(shapiro, 0.74)


def test_henze_zirkler_sees_what_the_margins_hide() -> None:
    """Two normal variables, of which the second is the first with a random sign: normal each, but not together."""
    rng = np.random.default_rng(2)
    x = rng.normal(size=(N, 200))
    y = x * rng.choice([-1.0, 1.0], size=x.shape)
    assert np.mean(shapiro_normality(y) <= 0.05) < 0.12
    assert np.mean(henze_zirkler_normality(x + 1j * y) <= 0.05) > 0.95


# ---------------------------------------------------------------- missing values and few people


@pytest.mark.parametrize("test", [*REAL_TESTS, henze_zirkler_normality])
def test_missing_values_are_left_out(test) -> None:
    z = bivariate(4, 40)
    values = z if test is henze_zirkler_normality else z.real
    expected = test(values[10:])
    values = values.copy()
    values[:10] = np.nan
    values[: 40 - MINIMUM_PEOPLE + 1, 3] = np.nan
    p = test(values)
    np.testing.assert_array_equal(p[:3], expected[:3])
    assert np.isnan(p[3])


@pytest.mark.parametrize("test", [*REAL_TESTS, henze_zirkler_normality, normality])
def test_few_people_are_refused(test) -> None:
    with pytest.raises(InputError, match="7 people cannot be tested: record at least 8"):
        test(normal(5, 7))
    with pytest.raises(InputError, match=r"shape \(9,\)"):
        test(np.ones(9))


def test_values_without_scatter_are_not_tested() -> None:
    z = (1e3 + np.linspace(0, 1, 20)[:, None]) * np.exp(1j * np.array([0.0, 0.3, -1.5]))
    assert np.isnan(henze_zirkler_normality(z)).all()
    for test in REAL_TESTS:
        assert np.isnan(test(np.full((20, 1), 0.1 + 0.2))).all()
        assert np.isnan(test(np.angle(z))).all()


# ---------------------------------------------------------------- impedances


def spring(compliance, points=30):
    return 1 / (1j * np.geomspace(1, 100, points) * compliance[:, None])


def test_a_spring_with_log_normal_compliance() -> None:
    """Normal in the logarithm and so not in the magnitude, at all frequencies alike; the phase does not vary at all."""
    rng = np.random.default_rng(4)
    result = normality(spring(np.exp(0.6 * rng.normal(size=N))))
    summary = result.summary()
    assert summary["shapiro_log_magnitude"] == 1
    assert summary["shapiro_magnitude"] == 0
    assert summary["shapiro_magnitude_rejected"] == summary["shapiro_magnitude_tested"] == 30
    np.testing.assert_allclose(result.shapiro_magnitude, result.shapiro_magnitude[0], rtol=1e-6)
    for name in ("chi_square_phase", "shapiro_phase", "henze_zirkler_complex", "henze_zirkler_log_complex"):
        assert math.isnan(summary[name])
        assert summary[f"{name}_tested"] == summary[f"{name}_rejected"] == 0


def test_tests_are_those_of_their_quantities() -> None:
    z = np.exp(0.2 * bivariate(6) - 0.4j)
    result = normality(z)
    for name, test in zip(("chi_square", "shapiro"), REAL_TESTS, strict=True):
        for quantity, values in (
            ("magnitude", np.abs(z)),
            ("phase", np.angle(z, deg=True)),
            ("log_magnitude", np.log10(np.abs(z))),
        ):
            np.testing.assert_allclose(getattr(result, f"{name}_{quantity}"), test(values), rtol=1e-6)
    np.testing.assert_allclose(result.henze_zirkler_complex, henze_zirkler_normality(1e6j * z + 3), rtol=1e-6)
    np.testing.assert_allclose(result.henze_zirkler_log_complex, henze_zirkler_normality(np.log(z)), rtol=1e-6)
    assert [field.name for field in dataclasses.fields(Normality)] == [*TESTS, "level"]


@repeatable
@given(st.floats(-math.pi, math.pi), st.floats(1e-6, 1e6))
def test_no_unit_and_no_cut_of_the_phase_matters(turn: float, unit: float) -> None:
    z = np.exp(0.4 * bivariate(2, 30))
    for name in ("shapiro_phase", "chi_square_phase", "shapiro_log_magnitude", "henze_zirkler_log_complex"):
        turned = getattr(normality(unit * z * np.exp(1j * turn)), name)
        # A value on the edge of a bin may change sides by rounding, which no value of this sample does.
        np.testing.assert_allclose(turned, getattr(normality(z), name), rtol=1e-6)


def test_missing_people_in_impedances() -> None:
    z = np.exp(0.2 * bivariate(4))
    expected = normality(z[:, :2])
    z[5:, 2] = np.nan
    z[:, 3] = np.nan
    result = normality(z)
    for name in TESTS:
        p = getattr(result, name)
        np.testing.assert_array_equal(p[:2], getattr(expected, name))
        assert np.isnan(p[2:]).all()
        assert result.summary()[f"{name}_tested"] == 2


@pytest.mark.parametrize("wrong", [0.0, complex(np.inf, 0.0)])
def test_impedances_without_a_logarithm_are_refused(wrong: complex) -> None:
    z = np.exp(0.2 * bivariate(4))
    z[5, 2] = wrong
    with pytest.raises(InputError, match="person 6 at frequency 3"):
        normality(z)


@pytest.mark.parametrize("level", [0.0, 1.0, 5.0, math.nan])
def test_levels_are_probabilities(level: float) -> None:
    with pytest.raises(InputError, match="not between 0 and 1"):
        normality(np.exp(bivariate(1)), level)


# ---------------------------------------------------------------- looking many times


def made(p: np.ndarray, level: float = 0.05) -> dict[str, float]:
    return Normality(**dict.fromkeys(TESTS, p), level=level).summary()


def test_shares_and_corrected_counts_equal_a_loop() -> None:
    p = np.concatenate([np.random.default_rng(5).uniform(size=60), np.geomspace(1e-6, 0.02, 20), [np.nan] * 5])
    summary = made(p, 0.1)
    tested = sorted(x for x in p.tolist() if not math.isnan(x))
    assert summary["expected_share"] == pytest.approx(0.9)
    harmonic = sum(1 / k for k in range(1, 81))
    named = max(k for k in range(81) if k == 0 or tested[k - 1] <= 0.1 * k / (80 * harmonic))
    assert 0 < named < 20
    for name in TESTS:
        assert summary[name] == pytest.approx(sum(x > 0.1 for x in tested) / 80)
        assert summary[f"{name}_rejected"] == named
        assert summary[f"{name}_tested"] == 80


def test_the_correction_holds_under_any_dependence() -> None:
    """Where all is normal a frequency is named in at most 5 % of populations, whether frequencies agree or not."""
    independent = [normal(10, 40, seed) for seed in range(250)]
    for populations in (independent, [3 * x[:, :1] + x for x in independent]):
        counts = [made(shapiro_normality(x))["shapiro_phase_rejected"] for x in populations]
        assert np.mean(np.array(counts) > 0) < limits(0.05, 250)[1]


def test_one_population_says_less_than_its_frequencies_are_many() -> None:
    """Normal values as correlated as impedances: the share that passes scatters far more than if they were not."""
    recordings = read_recordings(FINGERTIPS)
    x = np.abs(on_grid(recordings, common_grid(recordings)))[:, ::8]
    x = (x - x.mean(axis=0)) / x.std(axis=0)
    rng = np.random.default_rng(6)
    shares = [np.mean(chi_square_normality(rng.normal(size=(N, N)) @ x / math.sqrt(N)) > 0.05) for _ in range(80)]
    assert np.mean(shares) == pytest.approx(0.94, abs=0.025)
    assert np.std(shares) > 1.5 * math.sqrt(0.06 * 0.94 / x.shape[1])


def test_virtual_fingertips() -> None:
    """Their elements are log-normal: logarithms pass more often than magnitudes, and single variables than pairs."""
    recordings = read_recordings(FINGERTIPS)
    summary = normality(on_grid(recordings, common_grid(recordings))).summary()
    assert summary["expected_share"] == 0.95
    assert summary["shapiro_log_magnitude"] > summary["shapiro_magnitude"]
    assert summary["henze_zirkler_log_complex"] > summary["henze_zirkler_complex"]
    assert summary["shapiro_phase"] < summary["chi_square_phase"] < summary["expected_share"]
