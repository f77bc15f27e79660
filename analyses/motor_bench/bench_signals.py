r"""Raw signals of the motor bench, and recordings made of them.

The current ``iq_adx`` of a servo motor is proportional to its torque and takes the place of the force; the motion comes
from the motor's own velocity channel ``omega_max`` or from its encoder ``theta_mx``. The excitation is periodic, 2500
samples of 2.5 kHz, so that the discrete Fourier transform of one whole period has the excited lines at whole
frequencies and no leakage between them.

The angle also drifts from period to period. A drift is not periodic and would leak into all lines, so the straight
line from the beginning of each period to the beginning of the next is subtracted; it has no part in the lines of a
motion that repeats.

Each period is one repetition, except the first, in which the motion has not settled. The noise differs between
periods: a few are disturbed, by ten times the usual. Its standard deviation at a line is therefore the root mean square
deviation of this period from the median of all periods over the neighbouring lines,

.. math:: \sigma_{jk}^2 = \frac{J}{J-1} \frac1{2K} \sum_{|l - k| \le h} |z_{jl} - \tilde z_l|^2 ,

with :math:`\tilde z` the median of real and imaginary part over J periods and K the number of lines in the sum.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.io

from bayes_impedance.recordings.dataset import Recordings, Subject

RATE_HZ = 2500.0
PERIOD = 2500
"""Samples of a period of the excitation."""
NEIGHBOURS = 5
"""Lines on either side over which the noise is pooled. By choice: 11 lines are 22 values, which know a standard
deviation to 15 %."""
CHANNELS = ("velocity", "encoder")
NETWORK = "m1|r1|((m2|r2)-(n1|r3))"
"""Motor with its bearing, shaft, load with its bearing. Without r2, ``m1|r1|(m2-(n2|r2))``, the shaft's damper has to
stand in for the bearing of the load, and beside the lag 15 % of z remain instead of 5 (type B, encoder)."""
_EXCITED = 1e-3
"""Smallest share of the largest line of the reference that counts as excited; the others are at 1e-9 or below."""


def spectra(file: Path, channel: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines of current and velocity.

    Parameters
    ----------
    file : Path
        ``MultisineTypeA.mat`` or ``MultisineTypeB.mat``.
    channel : str
        One of `CHANNELS`: where the velocity is from.

    Returns
    -------
    frequency_hz : ndarray, shape (F,)
        The excited lines.
    current : ndarray of complex, shape (J, F)
        In A, by period without the first.
    velocity : ndarray of complex, shape (J, F)
        In rad/s.
    """
    names = ["iq_refx", "iq_adx", "omega_max", "theta_mx"]
    signals = scipy.io.loadmat(file, variable_names=names)
    reference, current, omega, angle = (signals[name].ravel().reshape(-1, PERIOD) for name in names)
    lines = np.abs(np.fft.rfft(reference[1]))
    lines[0] = 0.0
    excited = np.flatnonzero(lines > _EXCITED * lines.max())
    frequency = excited * RATE_HZ / PERIOD

    def transform(signal: np.ndarray) -> np.ndarray:
        return np.asarray(np.fft.rfft(signal, axis=1)[:, excited])

    if channel == "velocity":
        motion = transform(omega)
    else:
        begins = angle[:, 0]
        drift = np.append(np.diff(begins), begins[-1] - begins[-2])[:, None] * np.arange(PERIOD) / PERIOD
        motion = 2j * np.pi * frequency * transform(angle - drift)
    return frequency, transform(current)[1:], motion[1:]


def recordings_of(file: Path, channel: str) -> Recordings:
    """One "person", the motor, with every settled period as a repetition."""
    frequency, current, velocity = spectra(file, channel)
    z = current / velocity
    centre = np.median(z.real, axis=0) + 1j * np.median(z.imag, axis=0)
    square = np.abs(z - centre) ** 2 * len(z) / (len(z) - 1)
    window = np.ones(2 * NEIGHBOURS + 1)
    count = np.convolve(np.ones(frequency.size), window, "same")
    pooled = np.array([np.convolve(row / np.abs(centre) ** 2, window, "same") for row in square]) / count
    motor = Subject(
        name="motor",
        frequency_hz=frequency,
        z=z,
        repetitions=tuple(f"period {j + 2}" for j in range(len(z))),
        noise_sd=np.sqrt(pooled / 2) * np.abs(centre),
    )
    return Recordings(
        title=f"Motor bench, {file.stem}, current over {channel}",
        unit="N m s/rad",
        network=NETWORK,
        source="HoriFujimotoLab/FdiTools, commit 5925fae; torque in units of the motor's torque constant",
        licence="MIT",
        subjects=(motor,),
    )


def averaged(recordings: Recordings) -> Recordings:
    """The same with one repetition: the mean over the periods, weighted by their noise."""

    def mean_of(subject: Subject) -> Subject:
        assert subject.noise_sd is not None
        weight = subject.noise_sd**-2.0
        total = weight.sum(axis=0, keepdims=True)
        z = np.sum(weight * subject.z, axis=0, keepdims=True) / total
        return replace(subject, z=z, repetitions=("mean",), noise_sd=total**-0.5)

    return replace(recordings, subjects=tuple(mean_of(subject) for subject in recordings.subjects))
