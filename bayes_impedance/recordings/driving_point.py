r"""Whether a curve can be of a driving point: force and velocity of one place.

Of a passive load the velocity at the place of the force is nowhere against it, :math:`\operatorname{Re} z \ge 0`, and
resonances and antiresonances alternate, so that the phase goes to and fro within half a turn. Of a **transfer**
function, with the velocity of another place, antiresonances are missing: each further resonance turns the phase half a
turn further, and the magnitude with it. Two numbers are looked at, and both must be large, or the first very large, or
larger than a filter of second order can make it while the phase belongs to the magnitude:

**The turn** is how far the phase goes from one end to the other that belongs to the *magnitude* by Bode's relation
(:func:`.phase_relation.bode_phase`, here of a band extended by straight lines in log-log through its outer parts, and
averaged over a Gaussian of the logarithm of frequency, which leaves 180 degrees what they are). It does not depend on
signs, on a lag, on products with s (accelerance, dynamic stiffness), on which way the measured phase jumps where it
turns by nearly half a turn between two points, and hardly on noise. At a driving point it is at most 180 degrees, and
with a filter of first order in one channel at most 270.

**The share against the force** is the share of points at which Re z of the measured values is clearly negative,
:math:`\operatorname{Re} z < -0.3\,|z|`, whatever sign, product with s and lag are assumed. It is zero at a driving
point, up to noise, and where noise alone has made the magnitude turn.

Measured with 400 random chains of 2 to 6 masses, some with springs across (loss factors 0.003 to 0.3, 40 to 300
frequencies in linear or equal ratios, noise of up to 5 % of each value or of the median;
`tests/recordings/test_driving_point.py`), in per cent:

=================================  ==========  ==============
curves                             refused as  refused, or
                                   transfer    "may be"
=================================  ==========  ==============
driving points                     0           0.3
the same, late or negative         0           0.5
accelerance, receptance            0           0.8
a mass subtracted in excess        0           0.5
a low-pass in one channel          0.8         3.8
a high-pass in one channel         0.8         2.5
a low-pass and a lag               0.5         3.5
with a reflex                      0.5         0.8
transfer between neighbours        23          49
transfer between others            72          82
=================================  ==========  ==============

What is not found has one resonance in the band, or one whose half turn falls between two points, and is the curve of a
lag or a filter on a driving point: it cannot be told by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray
from bayes_impedance.recordings.phase_relation import comparable, excess_phase
from bayes_impedance.runtime.user_table import shown

TURN_DEG, LARGE_TURN_DEG = 270.0, 300.0
"""Turns of the phase above which a curve may be, or is, no driving point: derived above."""
AGREEING_DEG = 420.0
"""Turn above which a curve is no driving point if its measured phase turns as its magnitude does, up to a lag
(:func:`.phase_relation.excess_phase`), and Re z is negative at :data:`_NEGATIVE` of the points. A driving point behind
a filter of second order turns by 360 degrees; by choice, measured with limits from 360 to 450."""
_NEGATIVE = 0.1
"""By choice: Re z of a driving point is negative by noise alone."""
ANY_FILTER_DEG = 540.0
"""Turn above which a curve is no driving point however small the share is, as of lightly damped structures, whose z is
nearly imaginary between resonances: half a turn of a driving point, and a whole one of a filter of fourth order in one
channel. By choice: steeper filters are those of analysers against aliasing, which both channels have."""
CLEARLY, SHARE = 0.3, 0.04
"""Re z below this share of -abs z is clearly negative, 17 degrees beyond a quarter of a turn, and the share of such
points above which a curve is no driving point. By choice: noise of 5 % reaches three degrees; and measured above."""
LEAST_POINTS = 20
"""Fewest points of such a curve. By choice: with fewer a resonance is a point or two."""
_POINTS, _REACH = 400, 5.0
"""Points of the grid of ln f, and the extension of the band on either side. By choice: finer than `phase_relation`."""
_OUTER, _AVERAGED = 0.3, 0.25
"""Part of the band by which it is extended, and the standard deviation of the average over ln f. By choice: measured
with 0.1 to 0.35; noise at the ends is extended far, and with less a deep minimum in noise turns the phase."""
_ENDS = 0.05
"""Part of the points at both ends of the phases' order that the turn leaves out. By choice."""
_LAGS, _LONGEST = 60, 3.0
"""Lags of each sign, and the longest in periods of the highest frequency, as in `phase_relation`. By choice: steps of a
twentieth of a turn at the highest frequency."""

Verdict = Literal["driving", "maybe", "transfer"]


def sentence(surely: bool) -> str:
    """What is said of such recordings, without who they are of and what to do."""
    start = "the phase turns" if surely else "the phase seems to turn"
    return (
        f"{start} on by more than a driving point's can, and Re z is negative whatever sign, lag or quantity is "
        f"assumed: {'these are' if surely else 'these may be'} transfer functions, with force and motion of two "
        "different places, of which no network is fitted"
    )


def doubts(verdicts: Mapping[str, Verdict]) -> str | None:
    """Who is surely of no driving point and who may be of none, without what to do; None if nobody.

    Parameters
    ----------
    verdicts : mapping of str to {"driving", "maybe", "transfer"}
        Of every subject by its name.
    """
    sure = [name for name, verdict in verdicts.items() if verdict == "transfer"]
    unsure = [name for name, verdict in verdicts.items() if verdict == "maybe"]
    first = sure or unsure
    if not first:
        return None
    who = f"subject {shown(first[0])}" if len(first) == 1 else f"{len(first)} of {len(verdicts)} subjects"
    rest = f"; {len(unsure)} of the other {len(verdicts) - len(sure)} may be of this kind too"
    return f"{who}: {sentence(bool(sure))}{rest if sure and unsure else ''}"


def verdict_of(frequency_hz: FloatArray, z: ComplexArray) -> Verdict:
    """Whether a curve is no driving point (``transfer``), may be none (``maybe``), or nothing speaks against it.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
        Ascending.
    z : ndarray of complex, shape (F,)
    """
    if z.size < LEAST_POINTS or not comparable(frequency_hz) or np.any(z == 0):
        return "driving"
    share = share_against_force(frequency_hz, z)
    if share <= 0 and np.mean(z.real < 0) < _NEGATIVE:
        return "driving"
    turned = turn_deg(frequency_hz, z)
    surely = share > 0 and (turned > ANY_FILTER_DEG or (share > SHARE and turned > LARGE_TURN_DEG))
    if surely or (turned > AGREEING_DEG and _turns_as_magnitude(frequency_hz, z)):
        return "transfer"
    return "maybe" if share > 0 and turned > TURN_DEG else "driving"


def _turns_as_magnitude(frequency_hz: FloatArray, z: ComplexArray) -> bool:
    """Whether the phase is that of the magnitude, up to a lag, at points of which enough have Re z below zero."""
    if np.mean(z.real < 0) < _NEGATIVE:
        return False
    found = excess_phase(frequency_hz, z)
    return found is not None and found.cause in ("none", "lag")


def share_against_force(frequency_hz: FloatArray, z: ComplexArray) -> float:
    """Share of points with Re z clearly negative whatever sign, product with s and lag are assumed."""
    if not np.any(z.real < -CLEARLY * np.abs(z)):
        return 0.0
    omega = 2 * np.pi * frequency_hz
    lags = np.linspace(-_LONGEST, _LONGEST, 2 * _LAGS + 1) * 2 * np.pi / omega[-1]
    best = 1.0
    for lag in lags.tolist():
        here = np.exp(1j * (np.angle(z) + lag * omega))
        for parts in (here.real, here.imag):  # the imaginary part is the real part of z times or over j
            best = min(best, float(np.mean(parts < -CLEARLY)), float(np.mean(parts > CLEARLY)))
    return best


def turn_deg(frequency_hz: FloatArray, z: ComplexArray) -> float:
    """How far the phase that belongs to the magnitude goes, in degrees."""
    u = np.log(frequency_hz)
    grid = np.linspace(u[0], u[-1], _POINTS)
    step = float(grid[1] - grid[0])
    magnitude = np.interp(grid, u, np.log(np.abs(z)))
    outer, half = int(_OUTER * _POINTS), int(_REACH / step)
    low, high = (np.polyfit(grid[part], magnitude[part], 1) for part in (slice(outer), slice(-outer, None)))
    beyond = step * np.arange(1, half + 1)
    whole = [np.polyval(low, grid[0] - beyond[::-1]), magnitude, np.polyval(high, grid[-1] + beyond)]
    slope = np.gradient(np.concatenate(whole), step)
    distance = np.abs(np.arange(-half, half + 1)) * step
    distance[half] = step / 4  # the singularity, as in `bode_phase`
    kernel = -np.log(np.tanh(distance / 2))
    phase = np.convolve(slope, kernel * (np.pi / 2 / kernel.sum()), "valid")
    width = int(4 * _AVERAGED / step)
    gauss = np.exp(-0.5 * (np.arange(-width, width + 1) * step / _AVERAGED) ** 2)
    phase = np.convolve(np.pad(phase, width, "edge"), gauss / gauss.sum(), "valid")
    first, last = np.quantile(phase, [_ENDS, 1 - _ENDS])
    return float(np.rad2deg(last - first))
