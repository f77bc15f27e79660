r"""Tests of normality of impedances over subjects: the paper's test at every frequency, and more powerful ones.

**The paper's claim.** "Over 75 % of the impedance values are normal distributed" counts frequencies at which a
chi-square test at 5 % does not reject, magnitude and phase apart. The count does not support the conclusion,
for two reasons.

*No rejection is not normality.* :func:`chi_square_normality` groups the values into ten bins of equal width and merges
sparse ones from the ends inwards; with 71 subjects about seven bins remain, and as the mean and the standard deviation
are estimated, four degrees of freedom (at most 10 - 3 = 7). Simulated with 71 subjects (20 000 samples, 5 % level), it
rejects a log-normal with standard deviation 0.3 of the logarithm in 28 % of samples; Shapiro and Wilk's test does in
74 %. If every magnitude were log-normal with that spread, 72 % of the frequencies would still pass. The test is also
slightly liberal, rejecting 6 % of normal samples, because the moments come from the values and not from the counts
(Chernoff and Lehmann 1954).

*A share needs a reference value.* Under normality a share of 1 - level passes: 95 %, not 75 %. That is an average over
populations. Within one population, values at neighbouring frequencies are strongly correlated, so that 401 tests amount
to few independent ones: normal values with the correlations of this package's virtual fingertips pass at 82 % to 99 %
of the frequencies (chi-square, 90 % of populations). A count that is corrected for multiple testing is that of
Benjamini and Yekutieli (2001): it bounds the false discovery rate by `level` under any dependence. It is preferred to
Holm's control of the family-wise error rate because the question is at how many frequencies normality fails, and
because Holm needs p values of :math:`10^{-4}`, where the approximations behind all three tests are least certain.

**Elements or impedances.** If elements are normal on one scale, impedances cannot be normal on another (log elements
and |z|, say). Where one element dominates,
:math:`|z| = \omega m`, :math:`r` or :math:`1/(\omega n)`, so that

.. math:: \log|z| = \pm\log\theta + \text{const}.

If the logarithms of the elements are normal, |z| is log-normal there, with skewness about :math:`3\sigma` for a small
standard deviation :math:`\sigma` of the logarithm; if |z| of a spring is normal, its compliance is the reciprocal of a
normal variable, which has no mean. Between the asymptotes z is a nonlinear function of several elements and has neither
form. A normal |z| moreover has negative values with positive probability. The two agree only as :math:`\sigma \to 0`,
where no test can distinguish them. Even if every frequency looked normal, the mean of the elements would not describe
the mean of the curves. Hence the tests of :math:`\log|z|` beside those of |z|.

**Real and imaginary part together.** Henze and Zirkler (1990) compare the characteristic function of the whitened
values y with that of a bivariate normal variable, in mean square with a normal weight of width :math:`\beta`:

.. math:: T = \frac1n\sum_{ij} e^{-\beta^2|y_i-y_j|^2/2}
          - \frac{2}{1+\beta^2}\sum_i e^{-\beta^2|y_i|^2/(2(1+\beta^2))} + \frac{n}{1+2\beta^2},
          \qquad \beta = \frac{1}{\sqrt2}\Bigl(\frac{5n}{4}\Bigr)^{1/6}.

With covariances over n it does not change under affine maps, so that units do not matter. Under normality T is nearly
log-normal, with the mean and variance of their theorem 2.2.

Sources: K. Pearson (1900), *Phil. Mag.* 50, 157; H. Chernoff and E. L. Lehmann (1954), *Ann. Math. Stat.* 25, 579;
S. S. Shapiro and M. B. Wilk (1965), *Biometrika* 52, 591; N. Henze and B. Zirkler (1990), *Comm. Stat. Theory Methods*
19, 3595; Y. Benjamini and D. Yekutieli (2001), *Ann. Stat.* 29, 1165; the documentation of MATLAB's ``chi2gof``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.special import chdtrc, ndtr

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError

MINIMUM_PEOPLE = 8
"""Smallest sample that is tested. By choice: below about 20, Henze and Zirkler's approximation already rejects too
rarely."""
TESTS = (
    "chi_square_magnitude",
    "chi_square_phase",
    "chi_square_log_magnitude",
    "shapiro_magnitude",
    "shapiro_phase",
    "shapiro_log_magnitude",
    "henze_zirkler_complex",
    "henze_zirkler_log_complex",
)

_BINS = 10
"""Bins of the chi-square test, before those that expect too few are joined: the default of Matlab's chi2gof."""

_LEAST_EXPECTED = 5.0
"""Smallest expected count of a bin: the usual rule (Cochran 1954), and that of Matlab's chi2gof."""

_ROUNDING = 1e-12
"""Relative difference below which values count as equal. By choice: some thousand machine epsilons."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Normality(Brief):
    """P values of every test at every frequency; NaN where a test is impossible.

    Attributes
    ----------
    chi_square_magnitude, chi_square_phase : ndarray, shape (F,)
        The paper's tests.
    chi_square_log_magnitude : ndarray, shape (F,)
    shapiro_magnitude, shapiro_phase, shapiro_log_magnitude : ndarray, shape (F,)
    henze_zirkler_complex : ndarray, shape (F,)
        Joint test of real and imaginary part.
    henze_zirkler_log_complex : ndarray, shape (F,)
        Joint test of log magnitude and phase.
    level : float
        Probability of rejecting a normal sample.
    """

    chi_square_magnitude: np.ndarray
    chi_square_phase: np.ndarray
    chi_square_log_magnitude: np.ndarray
    shapiro_magnitude: np.ndarray
    shapiro_phase: np.ndarray
    shapiro_log_magnitude: np.ndarray
    henze_zirkler_complex: np.ndarray
    henze_zirkler_log_complex: np.ndarray
    level: float

    def summary(self) -> dict[str, float]:
        """Shares and numbers of frequencies that pass or fail each test.

        Returns
        -------
        dict of str to float
            For each name in :data:`TESTS`: under the name the share of the tested frequencies that pass, NaN if none
            was tested; under ``<name>_rejected`` the number rejected after Benjamini and Yekutieli's correction for
            multiple testing; under ``<name>_tested`` how many frequencies could be tested. ``expected_share`` is the
            share that passes on average where everything is normal.
        """
        result = {"expected_share": 1.0 - self.level}
        for name in TESTS:
            p = getattr(self, name)
            p = p[np.isfinite(p)]
            result[name] = float(np.mean(p > self.level)) if p.size else math.nan
            adjusted = stats.false_discovery_control(p, method="by") if p.size else p
            result[f"{name}_rejected"] = float(np.sum(adjusted <= self.level))
            result[f"{name}_tested"] = float(p.size)
        return result


def normality(z: np.ndarray, level: float = 0.05) -> Normality:
    """Test impedances for normality over subjects at every frequency.

    Parameters
    ----------
    z : ndarray, complex, shape (N, F)
        Any unit; NaN where data are missing. A frequency with fewer than :data:`MINIMUM_PEOPLE` values gets NaN.
    level : float
        Significance level of each single test.

    Returns
    -------
    Normality

    Raises
    ------
    InputError
        If there are fewer than :data:`MINIMUM_PEOPLE` people, an impedance is 0 or infinite, or the level is not
        between 0 and 1.
    """
    z = np.asarray(z, dtype=complex)
    _check_people(z)
    if not 0 < level < 1:
        raise InputError(f"The level {level} of the tests of normality is not between 0 and 1: use 0.05, for instance.")
    wrong = np.argwhere((z == 0) | np.isinf(z))
    if wrong.size:
        person, point = wrong[0].tolist()
        raise InputError(
            f"The impedance of person {person + 1} at frequency {point + 1} is {z[person, point]}, which has no "
            "logarithm: replace it by NaN if it was not measured."
        )
    magnitude, phase = np.abs(z), _phase(z)
    log_magnitude = np.log(magnitude)
    return Normality(
        chi_square_magnitude=chi_square_normality(magnitude),
        chi_square_phase=chi_square_normality(phase),
        chi_square_log_magnitude=chi_square_normality(log_magnitude),
        shapiro_magnitude=shapiro_normality(magnitude),
        shapiro_phase=shapiro_normality(phase),
        shapiro_log_magnitude=shapiro_normality(log_magnitude),
        henze_zirkler_complex=henze_zirkler_normality(z),
        henze_zirkler_log_complex=henze_zirkler_normality(log_magnitude + 1j * phase),
        level=level,
    )


def chi_square_normality(values: np.ndarray) -> np.ndarray:
    """Pearson's chi-square test of normality with the defaults of MATLAB's ``chi2gof``.

    Ten bins of equal width lie between the smallest and the largest value, the outer two open. While one of the two
    outermost bins at either end expects fewer than five values, the end that expects less is merged into its
    neighbour. Mean and standard deviation are those of the values, and cost two of the bins - 1 degrees of freedom.

    Parameters
    ----------
    values : ndarray, real, shape (N, F)
        NaN where missing.

    Returns
    -------
    ndarray, shape (F,)
        P values; NaN where fewer than :data:`MINIMUM_PEOPLE` values or four bins are left, or all values are equal.

    Raises
    ------
    InputError
        If there are fewer than :data:`MINIMUM_PEOPLE` people.
    """
    return _at_each_frequency(_chi_square, np.asarray(values, dtype=float))


def shapiro_normality(values: np.ndarray) -> np.ndarray:
    """Test of Shapiro and Wilk, the most powerful general one for samples of this size.

    Parameters
    ----------
    values : ndarray, real, shape (N, F)
        NaN where missing.

    Returns
    -------
    ndarray, shape (F,)
        P values; NaN where there are fewer than :data:`MINIMUM_PEOPLE` values or all are equal.

    Raises
    ------
    InputError
        If there are fewer than :data:`MINIMUM_PEOPLE` people.
    """
    return _at_each_frequency(_shapiro, np.asarray(values, dtype=float))


def henze_zirkler_normality(values: np.ndarray) -> np.ndarray:
    """Henze and Zirkler's test of bivariate normality of real and imaginary part.

    Parameters
    ----------
    values : ndarray, complex, shape (N, F)
        Two real variables of comparable scale as one complex number, NaN where missing.

    Returns
    -------
    ndarray, shape (F,)
        P values; NaN where there are fewer than :data:`MINIMUM_PEOPLE` values or all lie on a line.

    Raises
    ------
    InputError
        If there are fewer than :data:`MINIMUM_PEOPLE` people.
    """
    return _at_each_frequency(_henze_zirkler, np.asarray(values, dtype=complex))


def _check_people(values: np.ndarray) -> None:
    if values.ndim != 2:
        raise InputError(f"Values of shape {values.shape} cannot be tested for normality: give people by frequencies.")
    if values.shape[0] < MINIMUM_PEOPLE:
        raise InputError(
            f"Normality of {values.shape[0]} people cannot be tested: record at least {MINIMUM_PEOPLE}, better 50."
        )


def _phase(z: np.ndarray) -> np.ndarray:
    """Phase in radians relative to the circular mean, so that the cut at 180 degrees splits no sample."""
    phase = np.angle(z)
    mean = np.arctan2(np.nansum(np.sin(phase), axis=0), np.nansum(np.cos(phase), axis=0))
    return np.asarray(mean + (phase - mean + np.pi) % (2 * np.pi) - np.pi)


def _at_each_frequency(test: Callable[[np.ndarray], float], values: np.ndarray) -> np.ndarray:
    """Apply a test of a sample (n,) to the values present in every column of (N, F)."""
    _check_people(values)
    result = np.full(values.shape[1], np.nan)
    for k, column in enumerate(values.T):
        present = column[np.isfinite(column)]
        if present.size >= MINIMUM_PEOPLE:
            result[k] = test(present)
    return result


def _constant(x: np.ndarray) -> bool:
    return bool(np.ptp(x) <= _ROUNDING * np.max(np.abs(x)))


def _shapiro(x: np.ndarray) -> float:
    return math.nan if _constant(x) else float(stats.shapiro(x).pvalue)


def _chi_square(x: np.ndarray) -> float:
    if _constant(x):
        return math.nan
    counts, edges = np.histogram(x, _BINS)
    below = ndtr((edges[1:-1] - np.mean(x)) / np.std(x, ddof=1))
    observed = [float(count) for count in counts]
    expected = (x.size * np.diff(below, prepend=0.0, append=1.0)).tolist()
    while len(expected) > 2 and min(*expected[:2], *expected[-2:]) < _LEAST_EXPECTED:
        end, neighbour = (0, 1) if expected[0] < expected[-1] else (-1, -2)
        for bins in (observed, expected):
            bins[neighbour] += bins[end]
            del bins[end]
    freedom = len(expected) - 3
    if freedom < 1:
        return math.nan
    return float(chdtrc(freedom, sum((o - e) ** 2 / e for o, e in zip(observed, expected, strict=True))))


def _henze_zirkler(x: np.ndarray) -> float:
    n = x.size
    centred = np.column_stack([x.real, x.imag])
    size = float(np.sqrt(np.mean(centred**2)))
    centred = centred - centred.mean(axis=0)
    # Singular vectors are the whitened values; for nearly equal values they are more accurate than eigenvectors.
    whitened, lengths, _ = np.linalg.svd(centred, full_matrices=False)
    if lengths[1] <= _ROUNDING * math.sqrt(n) * size:
        return math.nan
    y = math.sqrt(n) * whitened
    squared_norm = np.sum(y**2, axis=1)
    squared_distance = squared_norm[:, None] + squared_norm - 2 * y @ y.T
    beta2 = 0.5 * (1.25 * n) ** (1 / 3)
    statistic = (
        np.sum(np.exp(-0.5 * beta2 * squared_distance)) / n
        - 2 / (1 + beta2) * np.sum(np.exp(-0.5 * beta2 / (1 + beta2) * squared_norm))
        + n / (1 + 2 * beta2)
    )
    mean, variance = _henze_zirkler_moments(beta2)
    log_variance = math.log1p(variance / mean**2)
    log_mean = math.log(mean) - log_variance / 2
    return float(ndtr((log_mean - math.log(statistic)) / math.sqrt(log_variance)))


def _henze_zirkler_moments(beta2: float) -> tuple[float, float]:
    """Mean and variance of the statistic under normality: theorem 2.2 for two variables."""
    a, w = 1 + 2 * beta2, (1 + beta2) * (1 + 3 * beta2)
    mean = 1 - (1 + 2 * beta2 / a + 4 * beta2**2 / a**2) / a
    variance = (
        2 / (1 + 4 * beta2)
        + 2 / a**2 * (1 + 4 * beta2**2 / a**2 + 6 * beta2**4 / a**4)
        - 4 / w * (1 + 3 * beta2**2 / w + 4 * beta2**4 / w**2)
    )
    return mean, variance
