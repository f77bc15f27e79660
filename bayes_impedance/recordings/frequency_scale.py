r"""Frequencies in rad/s or kHz that are read as Hz.

Nothing in the values of an impedance shows the unit of its frequencies: multiplied by a factor, they are those of
another load. The numbers show what people chose.

**rad/s**: who sets a band sets round numbers of Hz. Both ends are then :math:`2\pi` times a round number and no round
number themselves. A number counts as round if it is two significant digits to 2e-4, as 31.42 and 31416 over
:math:`2\pi`. Of numbers without any such meaning 1.6 % are round, of pairs one in four thousand. Grids whose ends are
not round in Hz, as lines of a spectrum, cannot be told.

**kHz**: persons are hardly moved with 0.005 Hz, of which a period takes 200 s. Recordings of forces whose band ends
below :data:`SLOW_HZ` and begins at a period longer than :data:`LONGEST_PERIOD_S` may be in kHz. Specimens are measured
as slowly on purpose, so that this is a remark and no reason to refuse them. Of electrical ones nothing is said:
batteries are measured for hours.
"""

from __future__ import annotations

import numpy as np

TWO_DIGITS = 2e-4
"""Largest relative distance from a number of two digits. By choice: half a unit of the fourth digit, that of 31.42."""
SURELY = frozenset({"rad/s"})
"""Units of which the numbers leave no other explanation; the other, kHz, is told and not refused."""
LEAST_POINTS = 8
"""Fewest frequencies of which this is asked. By choice: with fewer a band is hardly set by its ends."""
LONGEST_PERIOD_S, SLOW_HZ = 20.0, 20.0
"""Periods and band of recordings of forces that seem to be in kHz. By choice: drifts of a held finger take seconds, and
mechanical impedances of persons are recorded to 50 Hz and more, or, of slow movements, from 0.1 Hz upwards."""


def seems(points: int, low: float, high: float, unit: str) -> str | None:
    """The unit, ``rad/s`` or ``kHz``, in which frequencies seem to be; None if Hz is as good.

    Parameters
    ----------
    points : int
        Number of frequencies.
    low, high : float
        Ends of the band, as if in Hz.
    unit : str
        Of the impedance.
    """
    if points < LEAST_POINTS:
        return None
    if all(_is_round(f / (2 * np.pi)) and not _is_round(f) for f in (low, high)):
        return "rad/s"
    return "kHz" if unit.startswith("N ") and low <= 1 / LONGEST_PERIOD_S and high <= SLOW_HZ else None


def sentence(found: str, low: float, high: float) -> str:
    """Why frequencies seem to be in another unit, without what to do."""
    if found == "rad/s":
        why = f"divided by 2 pi they go from {low / (2 * np.pi):.4g} to {high / (2 * np.pi):.4g}"
    else:
        why = f"one period of the lowest would take {1 / low:.3g} s"
    seem = "seem to" if found in SURELY else "may"
    return f"the frequencies go from {low:.4g} to {high:.4g} Hz, and {why}: these {seem} be in {found}"


def _is_round(value: float) -> bool:
    digits = float(f"{value:.1e}")
    return abs(value - digits) <= TWO_DIGITS * digits
