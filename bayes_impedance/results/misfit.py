"""What is said of a network that does not describe the recordings: the limits, and the numbers that go with the words.

Every sentence that says "it fits" or "it does not" asks :func:`network_misfits`, so that no two of them disagree.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

MISFIT_SCALE = 1.5
"""Above this ratio of residual to noise, the network is said to miss something in a person's recordings: what is
unexplained is then as large as the noise."""

MISFIT_SHARE = 0.1
"""Above this part of the people in whom it misses something, the network is said not to describe the recordings. By
choice: fewer are named one by one as those who stand out."""


def noise_scale_summary(noise_scale: np.ndarray) -> dict[str, Any]:
    """Residuals over noise for ``summary.json``.

    Parameters
    ----------
    noise_scale : ndarray, shape (N,)
        Of everybody.

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
    """Whether a summary is of a network that does not describe the recordings."""
    return bool(summary["noise_scale"]["affected"] > MISFIT_SHARE * summary["subjects"])


def misfit_words(scale: Mapping[str, Any], subjects: int, who: str) -> str:
    """How large the residuals are in those whom the network does not describe.

    Parameters
    ----------
    scale : mapping
        Of :func:`noise_scale_summary`, with somebody affected.
    subjects : int
    who : str
        What a number of them is called.
    """
    times = f"{scale['affected_median']:.1f} times the noise"
    if subjects == 1:
        return times
    return f"{times} (median of the {scale['affected']} of {subjects} {who} in whom it is above {MISFIT_SCALE:g})"


def coverage_by_frequency(coverage: Mapping[str, np.ndarray]) -> dict[str, list[float]]:
    """Least and largest share at a frequency, in magnitude or phase, of the people inside of each band.

    Parameters
    ----------
    coverage : mapping of str to ndarray, shape (2, F)
        By the nominal share in per cent; NaN where nobody was measured.
    """
    return {level: [float(np.nanmin(share)), float(np.nanmax(share))] for level, share in coverage.items()}


def range_by_chance(nominal: float, people: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Between which shares of people a band that is right contains nine times out of ten (normal approximation).

    Parameters
    ----------
    nominal : float
        Share that the band is made for, between 0 and 1.
    people : ndarray
        How many there are.

    Returns
    -------
    low, high : ndarray, shape of `people`
    """
    chance = 1.645 * np.sqrt(nominal * (1 - nominal) / np.maximum(people, 1))
    return np.maximum(nominal - chance, 0.0), np.minimum(nominal + chance, 1.0)
