"""People whose frequencies are the first of everybody else's: a sweep that was stopped, or a file that was cut.

Such a recording can be used, and its band is narrower than that of the others, which nobody may have noticed. A file
that lists a sweep downwards is cut at the lowest frequencies. Instruments note the frequency that they have reached, so
that grids count as the same where each line is much nearer to its place than to its neighbour.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from bayes_impedance.recordings.csv_table import FloatArray

LEAST_OTHERS = 2
"""Fewest recordings that share the longer grid. By choice: of two nobody knows which grid was meant."""
MOST = 0.5
"""Share of the recordings that must have the longer grid. By choice: the usual one is that of more than half."""


SAME = 0.1
"""Largest distance of two frequencies of one line, over the distance of neighbours, in logarithms. By choice."""


def shorter_grids(
    grids: Sequence[tuple[str, FloatArray]], downwards: Collection[str] = frozenset()
) -> list[tuple[str, str]]:
    """Recordings that have a first part of the usual grid only.

    Parameters
    ----------
    grids : sequence of (str, ndarray of float)
        Names and frequencies in Hz, ascending.
    downwards : collection of str
        Names of recordings whose file goes from the highest frequency to the lowest.

    Returns
    -------
    list of (str, str)
        Name, and a clause of what is short and what to do.
    """
    if not grids:
        return []
    ((size, count),) = Counter(grid.size for _, grid in grids).most_common(1)
    if size < 2 or count < LEAST_OTHERS:
        return []
    whole = np.median([grid for _, grid in grids if grid.size == size], axis=0)
    nearest = SAME * np.diff(np.log(whole)).min()

    def same(grid: FloatArray, part: FloatArray) -> bool:
        return bool(np.abs(np.log(grid / part)).max() <= nearest)

    count = sum(grid.size == size and same(grid, whole) for _, grid in grids)
    if count < LEAST_OTHERS or count <= MOST * len(grids):
        return []
    found = []
    for name, grid in grids:
        if grid.size >= size:
            continue
        if same(grid, whole[: grid.size]):
            ends, goes_on = f"end at {grid[-1]:g}", whole[-1]
        elif name in downwards and same(grid, whole[-grid.size :]):
            ends, goes_on = f"end at {grid[0]:g}", whole[0]
        else:
            continue
        clause = f"the frequencies {ends} Hz after {grid.size}, where {count} others have the same and go on, "
        found.append((name, f"{clause}{size} to {goes_on:g} Hz; if the file was cut, export or copy it again"))
    return found
