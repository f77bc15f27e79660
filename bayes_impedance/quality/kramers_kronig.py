r"""Do real and imaginary part belong together? The Kramers-Kronig relations in a measured-model form.

The impedance of a causal, linear, time-invariant system is analytic in the right half plane, so that each of its parts
is the Hilbert transform of the other. A band does not contain the whole integral; therefore a model is fitted that
obeys the relations by construction [1]_ [2]_, here one with resonances and with terms for what lies outside of the band
(:mod:`.causal_model`), of rising order. What should be said of which curve:

=======================================================  ===============================================================
curve                                                    finding
=======================================================  ===============================================================
networks with resonances however sharp, power laws,      none
lines; filtered; with a late channel; between two places
few points, a narrow band, noise larger than the fault   none: nothing is known
one part scaled, or shifted by rows; phase multiplied;   one, where it changes the curve by more than the noise (a part
conjugated in part of the band; drift during the sweep   that is a constant may be scaled: that is another damper)
noise that is not known: smoothed, or correlated         none
=======================================================  ===============================================================

Two misfits are compared, each a square for one degree of freedom: that of the best causal model, :math:`\chi^2_c`, and
the least of the same models with reflected poles as well, :math:`\chi^2_e`. A finding needs both

.. math:: \min_n \chi^2_c > 3 \qquad\text{and}\qquad
          \bigl(\min_n \chi^2_e < 1.5 \quad\text{or}\quad \min_n \chi^2_e < \min_n \chi^2_c / 15\bigr) .

The second condition is what makes the first reliable. A causal curve that the poles do not reach, or noise that is
larger than it seems, leaves a residual in both; only what is *not causal* disappears with the reflected poles. In
the first case, what these leave must also be white, and they may never take more than a third of the data.
``analyses/kramers_kronig`` has the rates of false and of true findings.

The same must hold of 1/z. A motion that was recorded late, or at another place, is caused by the force: then v/F is
causal, and F/v need not be.

The noise of a subject's mean is that which the recordings give, else its roughness (:mod:`.point_anomalies`). The
scatter of repetitions is no noise here: people who moved between two recordings have two causal curves, whose mean is
causal.

References
----------
.. [1] B. A. Boukamp, "A linear Kronig-Kramers transform test for immittance data validation", Journal of the
   Electrochemical Society 142(6), 1995.
.. [2] M. Schoenleber, D. Klotz, E. Ivers-Tiffee, "A method for improving the robustness of linear Kramers-Kronig
   validity tests", Electrochimica Acta 131, 2014.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.quality.causal_model import OUTSIDE, misfits
from bayes_impedance.quality.point_anomalies import deviation, noise_scale, outliers, running_median
from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray
from bayes_impedance.recordings.dataset import Subject

LEAST_POINTS = 60
"""Fewest points of a curve that is tested. Measured, without the limit to the noise's correlation: all 5 false findings
among 2500 curves of 40 points and more had 43 to 58 points and smoothed noise."""
LEAST_BAND = 6.0
"""Smallest ratio of highest to lowest frequency. By choice, in the analysis' smallest band: within less, either part is
nearly a straight line, and terms outside of the band can make it anything."""
CAUSAL_LIMIT = 3.0
"""Least misfit of the best causal model that is reported. By choice: with the other limits, twice the square that the
reflected poles leave."""
EITHER_LIMIT = 1.5
"""Largest misfit that the reflected poles may leave: noise that is known to a fifth. By choice."""
GAIN_LIMIT = 15.0
"""Ratio of the two misfits above which the other one need not be small. Measured: of 3000 causal curves z, many with
long delays, the largest was 13 with smoothed noise and below 3 with other noise."""
WHITE_LIMIT = 0.2
"""Largest correlation of neighbours in what the reflected poles leave. By choice: of 60 points of white noise it has a
standard error of 0.09, and poles that fit noise make it negative; smoothed noise, which the roughness underestimates,
has 0.6."""
FLOOR = 1e-3
"""Least noise relative to |z|, that of the estimate from roughness (``person/noise.py``): rounding and rigs."""
MOST_POINTS = 800
"""Points of a curve that are used, evenly taken, to save time: an order then takes a tenth of a second."""
MOST_SUBJECTS = 100
"""Subjects that are tested, evenly taken, to save time: a rig's fault is in all of them."""

MOST_NOISE = 0.1
"""Largest noise of each part relative to |z| (root mean square) of a curve that is tested. By choice: lines of a
spectrum with so much hold leakage and the like, which is no noise, as an analyser's export of real spectra shows."""

_MOST_DIGITS = 9
"""Digits of rounded values. By choice: with more a step is below a thousandth of :data:`FLOOR` in most of a band."""
_MULTIPLE = 1e-3
"""Distance from a whole number that is one. By choice: above the rounding of doubles of so many digits, and below what
sixty values that are not rounded have by chance."""

_ORDERS = (4, 8, 12, 16, 20, 26, 32)
"""Numbers of poles. By choice: networks of the package have up to ten, lines and delays need up to thirty."""
_SHARE = 0.4
"""Largest share of the data that may be unknowns of the causal model. By choice: more would fit the noise."""
_SHARE_EITHER = 0.35
"""The same with the reflected poles, where these are to describe the curve. Measured: with half of the data, they also
describe smoothed noise (11 of 577 curves with it)."""
_CLEARLY_CAUSAL = 1.3
"""Misfit at which no higher order is tried. By choice: such a curve is described."""


@dataclass(frozen=True)
class Violation:
    """A curve whose parts do not belong together.

    Attributes
    ----------
    subject : str
    misfit, noise : float
        What the best causal model leaves and the noise, relative to |z|, as :func:`disagreement` gives them.
    """

    subject: str
    misfit: float
    noise: float


def violations(subjects: Sequence[Subject]) -> tuple[list[Violation], int]:
    """Subjects whose mean recording does not obey the Kramers-Kronig relations, and how many could be tested.

    Parameters
    ----------
    subjects : sequence of Subject
        Up to `MOST_SUBJECTS` are tested.

    Returns
    -------
    list of Violation
    tested : int
    """
    if len(subjects) > MOST_SUBJECTS:
        chosen = np.unique(np.linspace(0, len(subjects) - 1, MOST_SUBJECTS).astype(int))
        subjects = [subjects[i] for i in chosen.tolist()]
    found, tested = [], 0
    for one in subjects:
        given = one.noise_sd
        sd = None if given is None else np.sqrt(np.sum(given**2, axis=0)) / len(given)
        if testable(one.frequency_hz):
            tested += 1
            sizes = disagreement(one.frequency_hz, one.mean, sd, len(one.repetitions))
            found += [] if sizes is None else [Violation(one.name, *sizes)]
    return found, tested


def testable(frequency_hz: FloatArray) -> bool:
    """Whether a curve has points and band enough."""
    return bool(frequency_hz.size >= LEAST_POINTS and frequency_hz[-1] >= LEAST_BAND * frequency_hz[0])


def disagreement(
    frequency_hz: FloatArray, z: ComplexArray, noise_sd: FloatArray | None = None, repetitions: int = 1
) -> tuple[float, float] | None:
    """What the best causal model leaves of a curve, if that is not causal.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
        In Hz, ascending.
    z : ndarray of complex, shape (F,)
    noise_sd : ndarray of float, shape (F,), optional
        Standard deviation of each of real and imaginary part; by default the roughness.
    repetitions : int
        Of which z is the mean: rounded values have a mean that is not rounded to the same step.

    Returns
    -------
    (float, float) or None
        Root mean square misfit, and the noise of both parts together (its median), each relative to |z|; None if the
        curve may be causal, or is not testable.
    """
    magnitude = np.maximum(running_median(np.abs(z), 5), np.finfo(float).tiny)
    if noise_sd is None:
        noise_sd = noise_scale(deviation(frequency_hz, z)) * magnitude
    sd = np.maximum(np.maximum(noise_sd, FLOOR * magnitude), _rounding(z, repetitions))
    used = np.flatnonzero(~outliers(frequency_hz, z[None])[0])
    if used.size > MOST_POINTS:
        used = used[np.linspace(0, used.size - 1, MOST_POINTS).astype(int)]
    frequency_hz, z, sd, magnitude = frequency_hz[used], z[used], sd[used], magnitude[used]
    if not testable(frequency_hz) or float(np.sqrt(np.mean((sd / magnitude) ** 2))) > MOST_NOISE:
        return None
    s = 1j * frequency_hz / np.sqrt(frequency_hz[0] * frequency_hz[-1])
    left = _left_by_causal(s, z, sd)
    if left is None or _left_by_causal(s, 1 / z, sd / np.abs(z) ** 2) is None:
        return None
    misfit = float(np.sqrt(np.mean((np.abs(left) * sd / magnitude) ** 2)))
    return misfit, float(np.sqrt(2) * np.median(sd / magnitude))


def _left_by_causal(s: ComplexArray, z: ComplexArray, sd: FloatArray) -> ComplexArray | None:
    """Weighted residual of the best causal model, shape (F,), if the curve is not causal."""
    causal, either, described, residual = np.inf, np.inf, False, z
    for order in _ORDERS:
        if 2 * order + OUTSIDE > _SHARE * 2 * s.size:
            break
        found = misfits(s, z, 1 / sd, order)
        if found.causal < causal:
            causal, residual = found.causal, found.residual
        if 3 * order + OUTSIDE <= _SHARE_EITHER * 2 * s.size:
            either = min(either, found.either)
            described |= found.either < EITHER_LIMIT and found.correlation < WHITE_LIMIT
        if causal < _CLEARLY_CAUSAL:
            return None
    return residual if causal > CAUSAL_LIMIT and (described or causal > GAIN_LIMIT * either) else None


def _rounding(z: ComplexArray, repetitions: int) -> float:
    """Decimal step of either part: a file of few digits is not known better. Zero if there is none.

    A smooth curve has a smallest difference as well, but only rounded values are multiples of one.
    """
    return max(_decimal_step(part * repetitions) / repetitions for part in (z.real, z.imag))


def _decimal_step(values: FloatArray) -> float:
    """Largest power of ten of which all values are multiples, with up to `_MOST_DIGITS` digits; zero if none is."""
    largest = float(np.abs(values).max())
    if not largest > 0:
        return 0.0
    first = int(np.floor(np.log10(largest)))
    for exponent in range(first, first - _MOST_DIGITS, -1):
        steps = values / 10.0**exponent
        if np.all(np.abs(steps - np.round(steps)) < _MULTIPLE):
            return float(10.0**exponent)
    return 0.0
