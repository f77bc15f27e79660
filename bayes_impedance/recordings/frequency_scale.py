r"""Frequencies in rad/s or kHz that are read as Hz.

Nothing in the values of an impedance shows the unit of its frequencies: multiplied by a factor, they are those of
another load. The numbers show what people chose.

**rad/s**: who sets a band sets round numbers of Hz, and lines of a spectrum are as far apart as the sampling rate over
the number of samples. Divided by :math:`2\pi`, the numbers of a file in rad/s become such numbers, which they are not
themselves. Three questions are asked, each of which chance answers with yes less often than once in a thousand bands:

- Are both ends :math:`2\pi` times a number of **two digits**, to their rounding or 2e-4, as 31.42 and 31416? Of numbers
  without any such meaning 1.6 % are round to 2e-4, of pairs one in four thousand.
- Are both :math:`2\pi` times a number of **three digits**, to the rounding of the numbers, where these have six digits
  or more? 0.4 % of numbers of six digits are, of pairs one in sixty thousand.
- Is the **distance of neighbours** of an evenly spaced grid of ten digits or more :math:`2\pi` times a number of three
  digits over a power of two, as 51.2 kHz over 4096 samples? Of numbers without meaning one in ten thousand is.

(The rounding may be that of 3.1416 for pi.) Measured with 40 000 grids as people and instruments choose them, of 4 to
16 digits: of those in Hz 3 are named (of two digits to 2e-4 alone 13). Of the same in rad/s 82 % are where ends have
three digits, 59 % of lines of a spectrum, and few of others; with 7 and 12 digits nearly all of the first two.

Numbers that are as simple in Hz are Hz. What no question reaches, as evenly spaced lines in five digits whose ends are
not round, cannot be told.

**kHz**: persons are hardly moved with 0.005 Hz, of which a period takes 200 s. Recordings of forces whose band ends
below :data:`SLOW_HZ` and begins at a period longer than :data:`LONGEST_PERIOD_S` may be in kHz. Specimens are measured
as slowly on purpose, so that this is a remark and no reason to refuse them. Of electrical ones nothing is said:
batteries are measured for hours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bayes_impedance.recordings.csv_table import FloatArray

TWO_DIGITS = 2e-4
"""Largest relative distance from a number of two digits. By choice: half a unit of the fourth digit, that of 31.42."""
_SIX_DIGITS, _TEN_DIGITS = 5e-6, 5e-10
"""Largest rounding, of either end and of evenly spaced lines, with which three digits say anything: derived above."""
_OF_PI = 3e-6
"""Least relative rounding: that of pi as 3.1416."""
EVEN = 1e-9
"""Largest deviation from even spacing, over the highest frequency, and of a distance from a simple number. By choice:
the rounding of ten digits."""
_POWERS = 21
"""Powers of two that are tried, up to a million samples. By choice."""
SURELY = frozenset({"rad/s"})
"""Units of which the numbers leave no other explanation; the other, kHz, is told and not refused."""
LEAST_POINTS = 8
"""Fewest frequencies of which this is asked. By choice: with fewer a band is hardly set by its ends."""
LONGEST_PERIOD_S, SLOW_HZ = 20.0, 20.0
"""Periods and band of recordings of forces that seem to be in kHz. By choice: drifts of a held finger take seconds, and
mechanical impedances of persons are recorded to 50 Hz and more, or, of slow movements, from 0.1 Hz upwards."""


class Band(NamedTuple):
    """What of a grid of frequencies is looked at.

    Attributes
    ----------
    points : int
        Number of frequencies.
    low, high : float
        Ends, as if in Hz.
    step : float
        Distance of neighbours if they are evenly spaced to :data:`EVEN`, else zero.
    """

    points: int
    low: float
    high: float
    step: float = 0.0


def band_of(frequency_hz: FloatArray) -> Band:
    """Of ascending frequencies, shape (F,)."""
    low, high, n = float(frequency_hz[0]), float(frequency_hz[-1]), frequency_hz.size
    step = (high - low) / max(n - 1, 1)
    even = n > 1 and float(np.abs(np.diff(frequency_hz) - step).max()) <= EVEN * high
    return Band(n, low, high, step if even else 0.0)


def seems(band: Band, unit: str) -> str | None:
    """The unit, ``rad/s`` or ``kHz``, in which frequencies seem to be; None if Hz is as good.

    Parameters
    ----------
    band : Band
    unit : str
        Of the impedance.
    """
    points, low, high, step = band
    if points < LEAST_POINTS:
        return None
    if all(_is_round(f, 2 * np.pi) and not _is_round(f) for f in (low, high)):
        return "rad/s"
    if all(_is_three_digits(f, 2 * np.pi) and not _is_three_digits(f, 1.0) for f in (low, high)):
        return "rad/s"
    if _is_sampled(step, high, 2 * np.pi) and not _is_sampled(step, high, 1.0):
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


def _is_round(value: float, factor: float = 1.0) -> bool:
    digits = float(f"{value / factor:.1e}")
    return abs(value / factor - digits) <= min(TWO_DIGITS, max(_rounding(value), _OF_PI)) * digits


def _rounding(value: float) -> float:
    """Largest relative error of a number by the rounding of its decimal digits."""
    return 0.5 * 10.0 ** -(len(f"{value:.14e}".partition("e")[0].rstrip("0").replace(".", "")) - 1)


def _is_three_digits(value: float, factor: float) -> bool:
    """Whether a number of enough digits is `factor` times one of three, to its rounding."""
    tolerance = max(_rounding(value), _OF_PI)
    divided = value / factor
    digits = float(f"{divided:.2e}")
    return tolerance <= _SIX_DIGITS and abs(divided - digits) <= tolerance * digits


def _is_sampled(step: float, high: float, factor: float) -> bool:
    """Whether a distance between lines is `factor` times three digits over a power of two.

    Its rounding is that of the highest frequency, the line with the most digits.
    """
    if step <= 0 or _rounding(high) > _TEN_DIGITS:
        return False
    rates = step / factor * 2.0 ** np.arange(_POWERS)
    digits = np.array([float(f"{rate:.2e}") for rate in rates])
    return bool(np.any(np.abs(rates - digits) <= EVEN * digits))
