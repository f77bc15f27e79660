"""Hits of an impact hammer: found in a record, and left out if the hammer hit twice or a channel was overloaded.

A hit begins where the force first exceeds :data:`TRIGGER` of its largest value in the record, and ends where it has
fallen below :data:`PULSE_END` of its own peak. Any later excursion above :data:`SECOND` of the peak within the hit's
record is a second hit. A channel is overloaded where :data:`CLIPPED` neighbouring samples have the same extreme value,
which noise makes impossible for a channel within its range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.intake.ratio import FloatArray

TRIGGER = 0.2
"""Share of the largest force of a record at which a hit begins. By choice: soft hits of an operator have half of the
hardest one's force."""
PULSE_END, SECOND = 0.05, 0.1
"""Of the hit's peak: below the first the pulse has ended, above the second a later excursion is a second hit. By
choice: a twentieth is above a sensor's noise, and a second hit of a tenth of the force changes the response by a
tenth."""
CLIPPED = 3
"""Samples. As in the package pyFRF."""
BEFORE = 0.01
"""Part of a hit's record that lies before the trigger, so that the pulse is complete."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Hits:
    """Usable hits of one record.

    Attributes
    ----------
    force, motion : ndarray of float, shape (H, N)
    doubles, overloads, incomplete : int
        Hits that were left out.
    """

    force: FloatArray
    motion: FloatArray
    doubles: int = 0
    overloads: int = 0
    incomplete: int = 0


def is_overloaded(signal: FloatArray) -> bool:
    """Whether the extreme value stands in :data:`CLIPPED` neighbouring samples or more."""
    for extreme in (signal.max(), signal.min()):
        at = signal == extreme
        run = np.convolve(at, np.ones(CLIPPED), mode="valid")
        if extreme != 0 and run.size and run.max() >= CLIPPED:
            return True
    return False


def is_double(force: FloatArray) -> bool:
    """Whether the force rises again after its pulse."""
    size = np.abs(force - np.median(force))
    peak = int(np.argmax(size))
    first = int(np.argmax(size > SECOND * size[peak]))
    after = np.flatnonzero(size[first:] < PULSE_END * size[peak])
    # The peak of a double hit may be its second pulse: what counts is the end of the first one.
    end = first + int(after[0]) if after.size else size.size
    return bool((size[end:] > SECOND * size[peak]).any())


def starts_of(force: FloatArray, length: int) -> list[int]:
    """First sample of the record of every hit; hits closer than a record belong to one."""
    size = np.abs(force - np.median(force))
    above = np.flatnonzero(size > TRIGGER * size.max())
    before, starts = round(BEFORE * length), list[int]()
    for sample in above.tolist():
        if not starts or sample - before >= starts[-1] + length:
            starts.append(max(0, sample - before))
    return starts


def hits_of(force: FloatArray, motion: FloatArray, length: int | None = None) -> Hits:
    """Cut a record into hits and leave out what cannot be used.

    Parameters
    ----------
    force, motion : ndarray of float, shape (N,)
    length : int, optional
        Samples of each hit's record; by default the whole record is one hit.
    """
    size = force.size if length is None else length
    starts = [0] if length is None else starts_of(force, size)
    kept, doubles, overloads, incomplete = [], 0, 0, 0
    for start in starts:
        f, x = force[start : start + size], motion[start : start + size]
        if f.size < size:
            incomplete += 1
        elif is_overloaded(f) or is_overloaded(x):
            overloads += 1
        elif is_double(f):
            doubles += 1
        else:
            kept.append((f, x))
    shape = (len(kept), size)
    return Hits(
        force=np.array([f for f, _ in kept]).reshape(shape),
        motion=np.array([x for _, x in kept]).reshape(shape),
        doubles=doubles,
        overloads=overloads,
        incomplete=incomplete,
    )
