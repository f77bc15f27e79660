"""What a summary says of the distribution of people: nothing of a normal one, else its name and what it has besides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_impedance.population.heavy_tails import HEAVIEST, STUDENT_T
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.two_components import LEAST_SHARE, MIXTURE, SEPARATION
from bayes_impedance.units import INTERVAL, who

TWO_PEAKS = 2.0
"""Distance of two equal groups, in standard deviations within a group, from which on their density has two peaks."""


def interval(values: np.ndarray, known: bool = True) -> dict[str, float | None]:
    """Median and 90 % interval, or nulls."""
    if not known or not np.all(np.isfinite(values)):
        return {"median": None, "q05": None, "q95": None}
    low, middle, high = np.quantile(values, INTERVAL)
    return {"median": float(middle), "q05": float(low), "q95": float(high)}


def distribution_summary(
    p: PopulationParameters, elements: Sequence[str], identified: np.ndarray, *, known: bool
) -> dict[str, Any] | None:
    """Entry ``distribution`` of the summary; None of a normal population.

    Parameters
    ----------
    p : PopulationParameters
        W sets.
    elements : sequence of str, length P
    identified : ndarray of bool, shape (P,)
        Which of them have numbers.
    known : bool
        Whether numbers may be reported.
    """
    if p.tail is not None:
        return {
            "name": STUDENT_T,
            "degrees_of_freedom": interval(1 / p.tail, known),
            "dispersion_between_persons_is": "scale of the Student t distribution of the natural logarithm",
            "prior": f"1/degrees_of_freedom uniform on (0, {HEAVIEST:g})",
        }
    if p.groups is None:
        return None
    difference = p.groups.difference(p.covariance_cholesky)
    each = zip(elements, difference.T, identified, strict=True)  # zero of what is the same for everybody
    return {
        "name": MIXTURE,
        "second_group_share": interval(p.groups.share, known),
        "distance": interval(p.groups.distance, known),
        "difference": {name: interval(own, known and bool(seen)) for name, own, seen in each if np.any(own != 0)},
        "dispersion_between_persons_is": "standard deviation of the natural logarithm in both groups together",
        "prior": f"share uniform on ({LEAST_SHARE:g}, {1 - LEAST_SHARE:g}); distance times sqrt(share (1 - share)) has "
        f"a root mean square of {SEPARATION:g}, and no direction",
    }


def noise_summary(tail: np.ndarray | None) -> dict[str, Any] | None:
    """Entry ``noise_distribution`` of the summary; None of noise that is taken as normal.

    Parameters
    ----------
    tail : ndarray, shape (3,), or None
        Reciprocal degrees of freedom: the most probable, and the ends of the 90 % interval.
    """
    if tail is None:
        return None
    best, low, high = (float(1 / t) if t else None for t in tail)  # null is infinite: normal noise
    return {
        "name": STUDENT_T,
        "degrees_of_freedom": {"most_probable": best, "q05": high, "q95": low},
        "noise_is": "scale of the Student t distribution of real and imaginary part",
    }


def noise_remark(tail: np.ndarray | None) -> str | None:
    """The same as sentences for the user; None of noise that is taken as normal."""
    if tail is None:
        return None
    if tail[0] == 0:
        return "Noise with heavier tails than the normal was looked for, and there is none: it is taken as normal."
    best, low, high = ("infinitely many" if t == 0 else f"{1 / t:.3g}" for t in tail)
    return (
        f"The noise follows a Student t distribution with {best} degrees of freedom ({high} to {low}); above 30 it is "
        "close to a normal one. Points far off count little. 'compare --noise-distributions normal student_t' says "
        "whether it predicts those left out better."
    )


def is_student_t(summary: Mapping[str, Any]) -> bool:
    """Whether dispersions between persons are scales of a Student t distribution, not standard deviations."""
    return (summary.get("distribution") or {}).get("name") == STUDENT_T


def distribution_remark(p: PopulationParameters, unit: str) -> str | None:
    """The same as sentences, in the words of the impedance's unit; None of a normal population."""
    subjects = who(unit)
    if p.tail is not None:
        low, middle, high = np.quantile(1 / p.tail, INTERVAL)
        return (
            f"{subjects.capitalize()} follow a Student t distribution with {middle:.3g} degrees of freedom "
            f"({low:.3g} to {high:.3g}); above 30 it is close to a normal one. The dispersions between {subjects} are "
            f"its scales, not standard deviations; central values depend less on {subjects} far from the others."
        )
    if p.groups is None:
        return None
    (low, middle, high), share = np.quantile(p.groups.distance, INTERVAL), np.quantile(p.groups.share, INTERVAL)
    return (
        f"{subjects.capitalize()} are described as two groups, the second with {100 * share[1]:.0f} % of them "
        f"({100 * share[0]:.0f} to {100 * share[2]:.0f} %), whose centres are {middle:.2g} standard deviations within "
        f"a group apart ({low:.2g} to {high:.2g}); below {TWO_PEAKS:g} there are hardly two. They are described so "
        "whether there are groups or not: 'compare --distributions normal mixture' says whether groups predict those "
        f"left out better. Central values are geometric means of all {subjects}, and dispersions and correlations "
        "those of all."
    )
