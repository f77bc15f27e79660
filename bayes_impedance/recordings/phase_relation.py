r"""Whether the phase of a curve belongs to its magnitude, and what turns it if it does not.

The phase of a passive one-port follows from the slope of its magnitude (:func:`bode_phase`), to a few degrees within a
band. So does that of a passive one-port behind a low-pass or high-pass filter of first order, whose phase leaves
:math:`\pm 90` degrees, and of its reciprocal or its product with s: another quantity (accelerance, dynamic stiffness)
has Re z < 0 and a phase that belongs to its magnitude. What is left, the **excess phase**

.. math:: \delta(f) = \arg z(f) - \varphi_\text{Bode}(f) ,

is caused by what does not change the magnitude, and tells causes apart. What each hypothesis predicts, and its rms
misfit in simulated recordings of six networks (5 to 5000 Hz) and of batteries, where the smallest is that of the cause:

==========================  ====================================  ==============================================
cause                       excess                                measured
==========================  ====================================  ==============================================
none; gain; low-pass,       0                                     0.5 to 4 degrees; a motor of two sharp
high-pass; other quantity                                         resonances in 1.4 decades 12 to 21 degrees
sign of force or motion     180 degrees at every point            0.5 to 4 (0.5 to 21), without turning 165 to 180
lag of a channel            :math:`\omega\tau`                    1 to 4, none 48 to 53 (7 to 13 for a small lag)
error of the phase          the same angle at every point         1 to 4, none 28 to 31
conjugation                 :math:`-2\varphi_\text{Bode}`         1 to 4, none 56 to 152
==========================  ====================================  ==============================================

Noise around Re z = 0, as on a mass, has an excess of zero, however many points are negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray

BODE_MINIMUM_DEG = 8.0
"""Smallest rms difference between measured and computed phase that is reported. By choice: within a limited band a few
degrees are usual."""
BODE_CONTRAST = 2.5
"""Smallest ratio of this difference before and after conversion of the unit. By choice: the conversion must explain the
difference."""
LEAST_BAND = 4.0
"""Smallest ratio of highest to lowest frequency at which a slope says anything about a phase."""
LEAST_POINTS = 8
"""Fewest points of such a curve. By choice."""

_POINTS = 60
"""Points of the grid of ln f for Bode's relation. By choice: a sixth of an octave for three decades."""
_REACH = 5.0
"""Range of integration on either side, in ln f: it contains 99.7 % of the kernel's integral."""
_LAGS = 240
"""Lags of each sign that are tried, from a hundredth to three periods of the highest frequency. By choice."""

Cause = Literal["none", "sign", "lag", "angle", "conjugation"]
"""Of an excess phase: see the table of the module's docstring."""


@dataclass(frozen=True)
class ExcessPhase:
    """What turns a curve's phase away from that of its magnitude.

    Attributes
    ----------
    cause : {"none", "sign", "lag", "angle", "conjugation"} or None
        None if no cause is clearly better than none, and the phase does not belong to the magnitude either.
    size : float
        Of a lag in s, positive if the motion is late; of an angle in degrees; else 0.
    """

    cause: Cause | None
    size: float = 0.0


def excess_phase(frequency_hz: FloatArray, z: ComplexArray) -> ExcessPhase | None:
    """Find what turns the phase of a curve.

    A cause is named if it explains the phase :data:`BODE_CONTRAST` times better than none does, and none if it does so
    against a turned sign.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
        In Hz, ascending.
    z : ndarray of complex, shape (F,)

    Returns
    -------
    ExcessPhase or None
        None for curves of few points or a narrow band.
    """
    if not comparable(frequency_hz):
        return None
    grid = _grid(frequency_hz)
    step = float(grid[1] - grid[0])
    log_f, omega = np.log(frequency_hz), 2 * np.pi * np.exp(grid)
    magnitude = np.log(np.maximum(np.abs(z), np.finfo(float).tiny))
    phase = np.interp(grid, log_f, np.unwrap(np.angle(z)))
    belonging = bode_phase(np.interp(grid, log_f, magnitude), step)
    turned = np.exp(1j * (phase - belonging))
    angle = float(np.angle(turned.mean()))
    lags = np.geomspace(0.01, 3.0, _LAGS) * 2 * np.pi / omega[-1]
    lags = np.concatenate([-lags, lags])
    by_lag = _rms_angle(turned * np.exp(-1j * lags[:, None] * omega))
    best = int(np.argmin(by_lag))
    none, sign = float(_rms_angle(turned)), float(_rms_angle(-turned))
    misfit: dict[Cause, float] = {
        "sign": sign,
        "lag": float(by_lag[best]),
        "angle": float(_rms_angle(turned * np.exp(-1j * angle))),
        "conjugation": float(_rms_angle(np.exp(-1j * (phase + belonging)))),
    }
    size: dict[Cause, float] = {"lag": float(lags[best]), "angle": float(np.rad2deg(angle))}
    # Half a turn is an angle too, which fits a little better than exactly half a turn.
    cause = min(misfit, key=lambda c: misfit[c] * (1.5 if c in size else 1.0))
    # A wrong sign beside a small angle, as of a delay that no calibration has removed, is a wrong sign.
    if cause == "angle" and 180.0 - abs(size["angle"]) < BODE_MINIMUM_DEG:
        cause = "sign"
    if none > max(BODE_MINIMUM_DEG, BODE_CONTRAST * misfit[cause]):
        return ExcessPhase(cause, size.get(cause, 0.0))
    return ExcessPhase("none" if sign > BODE_CONTRAST * none else None)


def comparable(frequency_hz: FloatArray) -> bool:
    """Whether a curve has points and band enough for Bode's relation."""
    return bool(frequency_hz.size >= LEAST_POINTS and frequency_hz[-1] >= LEAST_BAND * frequency_hz[0])


def _grid(frequency_hz: FloatArray) -> FloatArray:
    """Equal steps of ln f over a band."""
    return np.linspace(np.log(frequency_hz[0]), np.log(frequency_hz[-1]), _POINTS)


def _rms_angle(turned: ComplexArray) -> FloatArray:
    """Root mean square of the angles of complex numbers over the last axis, in degrees."""
    angles: FloatArray = np.rad2deg(np.sqrt(np.mean(np.angle(turned) ** 2, axis=-1)))
    return angles


def bode_phase(log_magnitude: FloatArray, step: float) -> FloatArray:
    r"""Return the phase that belongs to a magnitude by Bode's relation.

    .. math:: \varphi(u_0) = \frac1\pi \int \frac{d \ln|z|}{du} \ln\coth\frac{|u - u_0|}2\,du,
              \qquad u = \ln f

    Outside the band the slope is extrapolated as constant.

    Parameters
    ----------
    log_magnitude : ndarray of float, shape (F,)
        ln|z| at equal steps of ln f.
    step : float
        Step of ln f.

    Returns
    -------
    ndarray of float, shape (F,)
        Phase in radians.

    References
    ----------
    H. W. Bode, Network Analysis and Feedback Amplifier Design, Van Nostrand, 1945, chapter 14.
    """
    half = max(1, round(_REACH / step))
    distance = np.abs(np.arange(-half, half + 1)) * step
    # The kernel has an integrable singularity at the centre: that cell uses its value at a quarter of the step.
    distance[half] = step / 4
    kernel = -np.log(np.tanh(distance / 2))
    kernel *= np.pi / 2 / kernel.sum()
    slope = np.pad(np.gradient(log_magnitude, step), half, "edge")
    phase: FloatArray = np.convolve(slope, kernel, "valid")
    return phase
