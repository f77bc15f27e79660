"""People whose frequencies are the first of everybody else's: a sweep that was stopped, or a file that was cut.

Such a recording can be used, and its band is narrower than that of the others, which nobody may have noticed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from bayes_impedance.recordings.csv_table import FloatArray

LEAST_OTHERS = 2
"""Fewest recordings that share the longer grid. By choice: of two nobody knows which grid was meant."""
MOST = 0.5
"""Share of the recordings that must have the longer grid. By choice: the usual one is that of more than half."""


def shorter_grids(grids: Sequence[tuple[str, FloatArray]]) -> list[tuple[str, str]]:
    """Recordings with a proper prefix of the usual grid.

    Parameters
    ----------
    grids : sequence of (str, ndarray of float)
        Names and frequencies in Hz.

    Returns
    -------
    list of (str, str)
        Name, and a clause of what is short and what to do.
    """
    if not grids:
        return []
    ((usual, count),) = Counter(grid.tobytes() for _, grid in grids).most_common(1)
    if count < LEAST_OTHERS or count <= MOST * len(grids):
        return []
    whole = np.frombuffer(usual)
    return [
        (
            name,
            f"the frequencies end at {grid[-1]:g} Hz after {grid.size}, where {count} others have the same and go on, "
            f"{whole.size} to {whole[-1]:g} Hz; if the file was cut, export or copy it again",
        )
        for name, grid in grids
        if grid.size < whole.size and np.array_equal(grid, whole[: grid.size])
    ]
