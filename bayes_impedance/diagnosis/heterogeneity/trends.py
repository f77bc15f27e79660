r"""Slopes of elements on something that differs between persons or repetitions, and their tests.

A covariate x that is positive enters as ln x. Elements are positive and their logarithms normal, so the simplest law
between two positive quantities is a power, :math:`\text{element} \propto x^b`: stiffness and damping of a fingertip
grow with contact force as :math:`F^{0.35}`. Its exponent has no unit. Covariates that are not positive or take two
values (a code, where ln is the same test in an odd unit), temperatures in Celsius, whose zero is arbitrary, and
decibels, which are logarithms, enter linearly. Two drive levels are no code: only their ratio has a meaning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.heterogeneity.reml import Fit
from bayes_impedance.diagnosis.multiple_testing import holm
from bayes_impedance.recordings.circumstances import is_amplitude

ALPHA = 0.005
"""Corrected p-value below which a covariate is added to the model in which the others are tested. By choice."""

MINIMUM_PERSONS = 5
"""With fewer persons a slope has hardly any degrees of freedom, and nothing is tested. By choice."""

_NO_RATIOS = ("_c", "_degc", "_celsius", "_db", "_dbv", "_dbu", "_dbm", "_dbfs")
"""Endings of the names of covariates whose ratios mean nothing, as the zero is arbitrary: no logarithm is taken."""

LARGEST_SLOPE_SD = 1.0
"""Largest standard error with which a slope is tested, in log elements per standard deviation of the covariate (per
repetition for a drift): with an error by a factor e the element is undetermined."""

LARGEST_COVARIATE = 1e150
"""Largest value of a covariate that is not taken as its logarithm: squares and their sums must be finite."""

COLLINEAR = 0.1
"""Smallest singular value of the standardised covariates, per root of the persons: below, a covariate is a
combination of the others to within 10 %, and their effects cannot be separated."""


@dataclass(frozen=True, kw_only=True)
class Trend:
    """The slope of one element.

    Attributes
    ----------
    element : str
    covariate : str
        ``repetition`` for a drift.
    transform : str
        ``log``: the slope is an exponent. ``linear``: it is the change of the log element per unit of the covariate.
    estimate, q05, q95 : float
        Slope and its 90 % interval.
    statistic : float
        Slope over its standard error.
    degrees_of_freedom : float
        Of Student's t.
    p_value : float
        Two-sided.
    p_corrected : float
        For all elements and covariates that were tried (Holm).
    persons : int
        Number of persons used.
    """

    element: str
    covariate: str
    transform: str
    estimate: float
    q05: float
    q95: float
    statistic: float
    degrees_of_freedom: float
    p_value: float
    p_corrected: float
    persons: int


@dataclass(frozen=True)
class Trends:
    """All slopes that were tested.

    Attributes
    ----------
    trends : tuple of Trend
        Smallest p first.
    tried : int
        How many were tested, for which p is corrected.
    beside : tuple of str
        Covariates in the model in which the others were tested, in the order in which they were found.
    reason : str
        Why nothing was tested; empty if something was.
    remarks : tuple of str
        What was left out, and why.
    """

    trends: tuple[Trend, ...]
    tried: int
    beside: tuple[str, ...] = ()
    reason: str = ""
    remarks: tuple[str, ...] = ()


def trends_of(fit: Fit, wanted: Mapping[int, str], covariate: str, transform: str, unit: float) -> list[Trend]:
    """Trends of some coefficients (number: element), with `unit` of the covariate to one of the regressor."""
    from scipy.stats import t as student

    variances, freedom = fit.small_sample()
    found = []
    for c, element in wanted.items():
        sd, df = float(np.sqrt(variances[c])), float(freedom[c])
        statistic = float(fit.coefficients[c]) / sd
        half = float(student.ppf(0.95, df)) * sd / unit
        estimate = float(fit.coefficients[c]) / unit
        p_value = float(2 * student.sf(abs(statistic), df))
        found.append(
            Trend(
                element=element,
                covariate=covariate,
                transform=transform,
                estimate=estimate,
                q05=estimate - half,
                q95=estimate + half,
                statistic=statistic,
                degrees_of_freedom=df,
                p_value=p_value,
                p_corrected=p_value,
                persons=fit.pull.shape[0],
            )
        )
    return found


def corrected(found: Sequence[Trend]) -> tuple[Trend, ...]:
    """Trends with p-values corrected for all of them (Holm), the smallest first."""
    p_values = holm(np.array([t.p_value for t in found]))
    pairs = [replace(t, p_corrected=float(p)) for t, p in zip(found, p_values, strict=True)]
    return tuple(sorted(pairs, key=lambda t: (t.p_value, -abs(t.statistic))))


def others(elements: tuple[str, ...], kept: np.ndarray) -> list[str]:
    """Elements that are not kept."""
    return [e for k, e in enumerate(elements) if k not in kept]


def regressors_of(
    covariates: Mapping[str, np.ndarray], remarks: list[str], of: str = "persons"
) -> dict[str, tuple[np.ndarray, str]]:
    """Covariates as they enter the model, with the name of the transform; unusable ones are listed in `remarks`."""
    found = {}
    for name, raw in covariates.items():
        values = np.where(np.isfinite(np.asarray(raw, dtype=float)), raw, np.nan)
        known = values[np.isfinite(values)]
        if known.size < MINIMUM_PERSONS:
            remarks.append(f"covariate '{name}' is known for {known.size} {of} only")
        elif np.ptp(known) <= 1e-9 * np.abs(known).max():
            remarks.append(f"covariate '{name}' is the same for all {of}")
        elif known.min() > 0 and not _is_code(name, known) and not name.lower().endswith(_NO_RATIOS):
            found[name] = np.log(values), "log"
        elif np.abs(known).max() > LARGEST_COVARIATE:
            remarks.append(f"covariate '{name}' has a value of {known[np.argmax(np.abs(known))]:g}: correct it")
        else:
            found[name] = values, "linear"
        if name in found and known.size < values.size:
            remarks.append(f"covariate '{name}' is unknown for {values.size - known.size} {of}, which were left out")
    return found


def _is_code(name: str, known: np.ndarray) -> bool:
    """Whether the values may stand for two groups."""
    return np.unique(known).size == 2 and not is_amplitude(name)
