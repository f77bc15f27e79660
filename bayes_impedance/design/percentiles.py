"""Percentiles of curves over users."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bayes_impedance.design.users import Users

PERCENTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
"""Percentiles of the exported curves. By choice: median, quartiles and the usual 5 % and 1 % tails."""


def percentile_curves(
    users: Users, frequency_hz: npt.ArrayLike, probabilities: Sequence[float] = PERCENTILES
) -> tuple[np.ndarray, np.ndarray]:
    """Pointwise percentiles of magnitude and of phase in degrees over users, each of shape (len(probabilities), F)."""
    z = users.impedance(frequency_hz)
    magnitude = np.quantile(np.abs(z), probabilities, axis=0)
    return np.asarray(magnitude), np.asarray(np.quantile(np.angle(z, deg=True), probabilities, axis=0))
