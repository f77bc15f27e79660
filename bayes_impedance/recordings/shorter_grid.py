"""People whose frequencies are the first of everybody else's: a sweep that was stopped, or a file that was cut.

Such a recording can be used, and its band is narrower than that of the others, which nobody may have noticed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from bayes_impedance.recordings.dataset import Subject

LEAST_OTHERS = 2
"""Fewest people who share the longer grid. By choice: of two people nobody knows which grid was meant."""
MOST = 0.5
"""Share of the people who must have the longer grid. By choice: the usual one is that of more than half."""


def shorter_grids(subjects: Sequence[Subject]) -> list[tuple[str, str]]:
    """Subjects with a proper prefix of the usual grid.

    Returns
    -------
    list of (str, str)
        Name, and a clause of what is short and what to do.
    """
    grids = [subject.frequency_hz for subject in subjects]
    if not grids:
        return []
    ((usual, count),) = Counter(grid.tobytes() for grid in grids).most_common(1)
    if count < LEAST_OTHERS or count <= MOST * len(grids):
        return []
    whole = np.frombuffer(usual)
    return [
        (
            subject.name,
            f"the frequencies end at {grid[-1]:g} Hz after {grid.size}, where {count} others have the same and go on, "
            f"{whole.size} to {whole[-1]:g} Hz; if the file was cut, export or copy it again, and if the sweep was "
            "stopped there, keep it",
        )
        for subject, grid in zip(subjects, grids, strict=True)
        if grid.size < whole.size and np.array_equal(grid, whole[: grid.size])
    ]
