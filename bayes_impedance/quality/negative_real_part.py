r"""What makes the real part of an impedance negative, in words.

A passive load has Re z >= 0. Recordings of one need not: a lag or a filter of a channel turns the phase of an inertial
load beyond 90 degrees, at nearly all frequencies, and is what a diagnosis is to find. A sentence says which causes
the curve allows, by :mod:`bayes_impedance.recordings.phase_relation`:

=====================================  ==================================================================
recordings                             what is said
=====================================  ==================================================================
sign of force or motion turned         turned by 180 degrees at every frequency: correct the sign
lag, visible beyond the noise of       an angle that grows with frequency, and the lag; keep the points,
Bode's relation                        a diagnosis measures it
error of the phase                     the same angle at every frequency; correct the phase
low-pass or high-pass of a channel,    phase and magnitude belong together, so the sign is right: a filter, a
small lag, mass subtracted in excess   small lag or an excess of mass correction; keep the points
accelerance, dynamic stiffness, ...    the same, and that another quantity would be passive
force and motion exchanged             the same, and that they are passive multiplied or divided by s twice
part of the band only, noise           what to check there
=====================================  ==================================================================

**Exchanged** channels give :math:`s^2/z` of an acceleration and :math:`1/(s^2 z)` of a displacement (of a velocity the
mobility, which is passive). That is passive without :math:`s^{\pm2}`, and nothing but a filter of second order turns an
impedance so far: it is named where no filter of first order, with a lag, makes the curve passive. Of 100 random chains
(those of :mod:`bayes_impedance.recordings.driving_point`) 42 are named; of 1650 driving points, late, negative, or
behind a filter of first order, none, and behind one of second order 5 %, which the sentence says.

An error of the gain and noise around Re z = 0 are not reported at all, conjugated recordings by
:func:`~bayes_impedance.quality.curve_anomalies.suspect_units`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.quality.point_anomalies import not_passive
from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray
from bayes_impedance.recordings.files import Subject
from bayes_impedance.recordings.phase_relation import excess_phase
from bayes_impedance.recordings.plausibility import is_clearly_negative
from bayes_impedance.units import number_with_unit

_HARDLY_NEGATIVE, _MUCH_NEGATIVE = 0.05, 0.2
"""Fraction of points with Re < 0 up to which a quantity counts as passive (noise around zero at an end of the band),
and from which the recorded one may be another quantity. By choice."""

_NEARLY_ALL, _FEW, _PASSIVE = 0.9, 0.02, 0.1
"""Fraction of points with Re < 0 of exchanged channels, and the largest with Re of the other sign beyond a part of
abs z (6 degrees). By choice: noise."""
_LAGS, _CORNERS, _REACH, _ANGLE = 20, 40, 10.0, 0.17
"""Lags of each sign up to a period of the highest frequency, corners of filters up to a decade beyond the band, and the
part of abs z that counts as negative behind them (10 degrees: they lie on a grid). By choice."""

_QUANTITIES = {
    True: "apparent mass (force per acceleration) and receptance (displacement per force) are",
    False: "accelerance (acceleration per force) and dynamic stiffness (force per displacement) are",
}
"""Which quantities are passive if multiplied by jw, and if divided: z/s and 1/(s z), and s/z and s z."""

_DIAGNOSE = "keep the points, they take part in fits, and 'bayes-impedance diagnose'"


@dataclass(frozen=True)
class Explanation:
    """Cause of negative real parts of one recording.

    Attributes
    ----------
    cause : str
        ``sign``, ``lag``, ``angle``, ``conjugation``, ``filter``, ``quantity``, ``exchange``, or nothing if the curve
        does not say.
    size : float
        Of a lag in s, positive if the motion is late; of an angle in degrees. Of another quantity above zero if it is
        passive multiplied by jw, and below if divided; of an exchange, by its square.
    """

    cause: str
    size: float = 0.0


def explain(frequency_hz: FloatArray, z: ComplexArray) -> Explanation:
    """Find the cause for one recording.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
    z : ndarray of complex, shape (F,)
    """
    found = excess_phase(frequency_hz, z)
    if found is None or found.cause is None:
        return Explanation("")
    if found.cause != "none":
        return Explanation(found.cause, found.size)
    s = 1j * frequency_hz
    divided, multiplied = float(np.mean((z / s).real < 0)), float(np.mean((z * s).real < 0))
    if np.mean(z.real < 0) > _MUCH_NEGATIVE and min(divided, multiplied) < _HARDLY_NEGATIVE:
        return Explanation("quantity", 1.0 if multiplied < divided else -1.0)
    if (
        np.mean(z.real < 0) > _NEARLY_ALL
        and _clearly_negative(-z, _PASSIVE) < _FEW
        and not _is_filtered(frequency_hz, z)
    ):
        return Explanation("exchange", -float(np.sign(np.polyfit(np.log(frequency_hz), np.log(np.abs(z)), 1)[0])))
    return Explanation("filter")


def other_quantity(subject: Subject) -> Explanation | None:
    """Why a subject's recordings look like another quantity; None if they do not.

    Re z must be negative beyond its scatter: that of a load without losses is so at every other point by noise.
    """
    f, z = subject.frequency_hz, subject.mean
    if not (is_clearly_negative(subject) and any(not_passive(f, z[None]))):
        return None
    found = explain(f, z)
    return found if found.cause == "quantity" else None


def _is_filtered(frequency_hz: FloatArray, z: ComplexArray) -> bool:
    """Whether a passive load behind a filter of first order in one channel and a lag may have this phase."""
    omega = 2 * np.pi * frequency_hz
    lags = np.geomspace(0.01, 1.0, _LAGS) * 2 * np.pi / omega[-1]
    corners = np.geomspace(omega[0] / _REACH, omega[-1] * _REACH, _CORNERS)
    turns = np.arctan(omega / corners[:, None])
    # A low-pass of the force takes its angle, a high-pass adds the rest of a quarter turn; of the motion the reverse.
    turns = np.concatenate([turns, np.pi / 2 - turns, [np.zeros(omega.size), np.full(omega.size, np.pi / 2)]])
    for lag in (0.0, *lags, *-lags):
        turned = np.exp(1j * (np.angle(z) - lag * omega + np.concatenate([turns, -turns])))
        if _clearly_negative(turned, _ANGLE).min() < 2 * _FEW:
            return True
    return False


def _clearly_negative(z: ComplexArray, part: float) -> FloatArray:
    """Share of points with Re z below -part of abs z, over the last axis."""
    share: FloatArray = np.mean(z.real < -part * np.abs(z), axis=-1)
    return share


def sentence(whose: str, where: str, depth: str, explanations: Sequence[Explanation]) -> str:
    """What is reported of recordings with negative real parts.

    Parameters
    ----------
    whose, where : str
        The recordings and the band.
    depth : str
        Smallest real part, as a fraction of the magnitude.
    explanations : sequence of Explanation
        Of each recording; the most frequent cause is reported.
    """
    cause = Counter(e.cause for e in explanations).most_common(1)[0][0]
    size = float(np.median([e.size for e in explanations if e.cause == cause]))
    late, other = ("motion", "force") if size > 0 else ("force", "motion")
    because = {
        "sign": "the phase is turned by 180 degrees at every frequency, as by a wrong sign of force or motion: correct "
        "the sign of these recordings",
        "lag": "the phase is off by an angle that grows with frequency, as by a delay between the channels: the "
        f"{late} is about {number_with_unit(abs(size), 's', 2)} later than the {other}; {_DIAGNOSE} measures it",
        "angle": f"the phase is off by about {size:.0f} degrees at every frequency, as by an error of calibration: "
        "correct the phase",
        "conjugation": "the phase belongs to the magnitude only with the opposite sign, as in complex conjugates: "
        "change the sign of the imaginary part",
        "filter": "phase and magnitude belong together, so that the sign is right: a low-pass or high-pass of one "
        "channel, a small delay between the channels, or a mass correction in excess does this to an inertial or "
        f"elastic load; {_DIAGNOSE} says which",
        "quantity": "phase and magnitude belong together, so that the sign is right, and they are those of a passive "
        f"load if {'multiplied' if size > 0 else 'divided'} by jw, as {_QUANTITIES[size > 0]}; 'check' decides it with "
        f"--network, and 'import' takes them with that --form; if it is a velocity behind a filter, {_DIAGNOSE} finds "
        "that",
        "exchange": "phase and magnitude belong together, and they are those of a passive load if "
        f"{'multiplied' if size > 0 else 'divided'} by the square of jw, as where force and "
        f"{'displacement' if size > 0 else 'acceleration'} are exchanged: import signals with --force and --motion the "
        f"other way, and spectra with the inverse --form; a filter of second order in one channel does it too, and "
        "'bayes-impedance diagnose' may find that",
        "": "check the delay between the channels, the mass correction and the sign there",
    }[cause]
    return (
        f"{whose}: Re z is negative {where} beyond its scatter (down to {depth} of |z|), which a passive load cannot "
        f"have; {because}"
    )
