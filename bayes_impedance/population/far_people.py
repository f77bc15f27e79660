"""Who is far from most people: perhaps only in another valley of the likelihood.

A person's likelihood may have a second optimum, nearly as good, at quite different elements. A few whose fits ended
there stretch the dispersions between people until nothing holds them back.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.units import MAD_TO_SD

LEAST_DISPERSION = 0.1
"""Least standard deviation of a log element between people. By choice: a few people who happen to be alike must not
exclude others; people differ by 0.2 to 0.5."""

_FAR = 5.0
"""Distance of an element from everybody's median, in standard deviations (from the median of absolute distances). By
choice: it costs time only, and no normal population has one so far."""

_MOST = 0.4
"""Largest share of people who may be far: of more it cannot be said which the others are. By choice."""


def far_from_most(elements: np.ndarray) -> np.ndarray:
    """Who has an element far from most people's, bool (N,), of log elements (N, P); nobody if they are too many.

    >>> far_from_most(np.array([[0.1], [0.0], [0.3], [0.2], [9.0]]))
    array([False, False, False, False,  True])
    """
    offset = np.abs(elements - np.median(elements, axis=0))
    sd = np.maximum(MAD_TO_SD * np.median(offset, axis=0), LEAST_DISPERSION)
    far = np.any(offset > _FAR * sd, axis=1)
    return far if far.sum() <= _MOST * far.size else np.zeros_like(far)
