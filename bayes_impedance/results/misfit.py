"""Criteria and wording for a network that does not describe the recordings.

Every sentence on whether the network fits uses :func:`network_misfits`, so that no two of them disagree.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_impedance.units import NORMAL_Q95

MISFIT_SCALE = 1.5
"""Above this ratio of residual to noise, the network is reported to misfit a person's recordings: the unexplained part,
the square root of 1.5 squared minus 1, is then about as large as the noise."""

MISFIT_SHARE = 0.1
"""If the network misfits more than this share of the people, it is reported not to describe the recordings. By choice:
fewer are named one by one as outliers."""


def noise_scale_summary(noise_scale: np.ndarray) -> dict[str, Any]:
    """Residuals over noise for ``summary.json``.

    Parameters
    ----------
    noise_scale : ndarray, shape (N,)
        Ratio for each person.

    Returns
    -------
    dict
        Median and maximum of all; ``affected``, the number of those above :data:`MISFIT_SCALE`, and their median.
    """
    affected = noise_scale[noise_scale > MISFIT_SCALE]
    return {
        "median": float(np.median(noise_scale)),
        "max": float(np.max(noise_scale)),
        "affected": int(affected.size),
        "affected_median": float(np.median(affected)) if affected.size else None,
    }


def network_misfits(summary: Mapping[str, Any]) -> bool:
    """Whether, by its summary, the network does not describe the recordings."""
    return bool(summary["noise_scale"]["affected"] > MISFIT_SHARE * summary["subjects"])


def misfit_words(scale: Mapping[str, Any], subjects: int, who: str) -> str:
    """Size of the residuals of the persons whom the network does not describe, in words.

    Parameters
    ----------
    scale : mapping
        Result of :func:`noise_scale_summary`, with at least one person affected.
    subjects : int
    who : str
        Noun for the subjects.
    """
    times = f"{scale['affected_median']:.1f} times the noise"
    if subjects == 1:
        return times
    return f"{times} (median of the {scale['affected']} of {subjects} {who} where it is above {MISFIT_SCALE:g})"


def coverage_by_frequency(coverage: Mapping[str, np.ndarray]) -> dict[str, list[float]]:
    """Smallest and largest share of people inside each band, over frequencies and over magnitude and phase.

    Parameters
    ----------
    coverage : mapping of str to ndarray, shape (2, F)
        By the nominal share in per cent; NaN at frequencies without data.
    """
    return {level: [float(np.nanmin(share)), float(np.nanmax(share))] for level, share in coverage.items()}


def range_by_chance(nominal: float, people: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """90 % range of the share of people inside a band with correct coverage (normal approximation of the binomial).

    Parameters
    ----------
    nominal : float
        Nominal coverage of the band, between 0 and 1.
    people : ndarray
        Number of people.

    Returns
    -------
    low, high : ndarray, shape of `people`
    """
    chance = NORMAL_Q95 * np.sqrt(nominal * (1 - nominal) / np.maximum(people, 1))
    return np.maximum(nominal - chance, 0.0), np.minimum(nominal + chance, 1.0)
