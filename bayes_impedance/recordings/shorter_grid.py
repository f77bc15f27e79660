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
    count = sum(grid.size == size and _same(grid, whole, whole) for _, grid in grids)
    if count < LEAST_OTHERS or count <= MOST * len(grids):
        return []
    found = []
    for name, grid in grids:
        ends = ends_early(grid, whole, name in downwards)
        if ends is not None:
            clause = f"the frequencies end at {ends[0]:g} Hz after {grid.size}, where {count} others have the same and "
            found.append(
                (name, f"{clause}go on, {size} to {ends[1]:g} Hz; if the file was cut, export or copy it again")
            )
    return found


def ends_early(grid: FloatArray, whole: FloatArray, downwards: bool = False) -> tuple[float, float] | None:
    """Where a grid ends that is a first part of a whole one, and where that ends, in Hz; else None.

    Parameters
    ----------
    grid, whole : ndarray of float, shapes (F,) and (G,)
        Ascending, in Hz.
    downwards : bool
        Whether the file of the grid goes from the highest frequency to the lowest, and was cut at its lowest.
    """
    if grid.size >= whole.size:
        return None
    if _same(grid, whole[: grid.size], whole):
        return float(grid[-1]), float(whole[-1])
    if downwards and _same(grid, whole[-grid.size :], whole):
        return float(grid[0]), float(whole[0])
    return None


def _same(grid: FloatArray, part: FloatArray, whole: FloatArray) -> bool:
    """Whether two grids have the same lines, as far as the lines of the whole one are apart."""
    return bool(np.abs(np.log(grid / part)).max() <= SAME * np.diff(np.log(whole)).min())
