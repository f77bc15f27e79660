r"""Raw signals of a virtual rig like the paper's: voltages of force and acceleration in a stepped sine.

A shaker drives an impedance head, on whose force sensor a load of impedance z sits. The rig's errors are the six of
:mod:`.smooth_rig`: the ratio of force to velocity as the channels see it is

.. math:: h = g e^{-s\tau}\left(\frac{z}{1 + s n z} + s m_0 + r_0 + \frac{k_0}{s}\right).

At each frequency the force has a given amplitude, or less if the velocity would be too large for the shaker, and the
acceleration's amplitude is that of the force times s/h. The frequency goes from step to step without a jump of the
phase; the acceleration begins each step with the amplitude of the one before and approaches its own,
:math:`A(t) = A_k + (A_{k-1} - A_k)\,e^{-t/T}`. Both channels have white noise. So noise of z is largest where the
acceleration is small, at low frequencies, and, with fewer samples in a period, at high ones.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np

from bayes_impedance.intake.smooth_rig import SmoothRig
from bayes_impedance.intake.spectrum import ComplexArray, FloatArray
from bayes_impedance.intake.stepped_sine import SETTLE

AVERAGED = 5
"""Periods of each step to average, as in the paper."""
_BOUNDARY = 3
"""Periods more, because the estimator leaves out those in which a step begins or ends."""
_SETTLING = 0.4
"""T in periods. By choice: a load with little damping; after five periods 4e-6 of the difference are left."""


@dataclass(frozen=True, kw_only=True)
class SimulatedRig:
    """A virtual rig; its numbers are by choice, of a size that such rigs have, except where a source is named.

    Attributes
    ----------
    gain : float
        Of the force channel: six per cent, as of an old calibration.
    delay_s : float
        By which force is later than acceleration: a quarter of a sample.
    mass_kg, damper, stiffness : float
        Between force sensor and mount, in kg, N s/m and N/m: plate, and cables.
    mount : float
        Compliance in m/N, as of a layer of glue.
    rate_hz : float
        The paper's.
    force_n : float
        Peak force: a tenth of the shaker's largest.
    velocity_m_s : float
        Largest peak velocity: 1.6 mm at 5 Hz.
    force_sensitivity, acceleration_sensitivity : float
        V/N, and V/(m/s^2).
    noise_v : float
        Standard deviation of each sample of both channels.
    masses_kg : tuple of float
        Of the runs with known loads.
    """

    gain: float = 1.06
    delay_s: float = 5e-6
    mass_kg: float = 3e-3
    damper: float = 0.05
    stiffness: float = 5.0
    mount: float = 1.5e-7
    rate_hz: float = 51_200.0
    force_n: float = 1.0
    velocity_m_s: float = 0.05
    force_sensitivity: float = 0.1
    acceleration_sensitivity: float = 0.01
    noise_v: float = 2e-3
    masses_kg: tuple[float, ...] = (0.01, 0.03)

    def measured(self, frequency_hz: FloatArray, z: ComplexArray) -> ComplexArray:
        """Force over velocity as the channels see them, without noise, shape (F,)."""
        values = np.array([self.gain, self.delay_s, self.mass_kg, self.damper, self.stiffness, self.mount])
        return SmoothRig(values=values, covariance=np.zeros((6, 6)), misfit=None).at(frequency_hz).measured(z)

    def samples(self, frequency_hz: FloatArray) -> int:
        """Number of samples of a recording."""
        return int(np.sum(self._lengths(frequency_hz)))

    def signals(self, frequency_hz: FloatArray, z: ComplexArray, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Voltages of a recording.

        Parameters
        ----------
        frequency_hz : ndarray of float, shape (F,)
            Of the steps, below half the sampling rate.
        z : ndarray of complex, shape (F,)
            Impedance of the load in N s/m; zero without one.
        rng : Generator

        Returns
        -------
        dict of str to ndarray of float, shape (N,)
            ``force`` and ``acceleration`` in volts, and ``drive``, the signal that was sent to the shaker.
        """
        h = self.measured(frequency_hz, z)
        force = self.gain * np.minimum(self.force_n, self.velocity_m_s * np.abs(h) / self.gain)
        acceleration = force * 2j * np.pi * frequency_hz / h
        lengths = self._lengths(frequency_hz)
        of_sample = np.repeat(np.arange(frequency_hz.size), lengths)
        turn = frequency_hz / self.rate_hz
        phase = 2 * np.pi * (np.cumsum(turn[of_sample]) - turn[0])
        periods = (np.arange(of_sample.size) - (np.cumsum(lengths) - lengths)[of_sample]) * turn[of_sample]
        left = np.exp(-periods / _SETTLING)
        before = np.concatenate([[0.0], acceleration[:-1]])
        amplitude = acceleration[of_sample] + left * (before - acceleration)[of_sample]
        wave = np.exp(1j * phase)
        noise = self.noise_v * rng.normal(size=(2, of_sample.size))
        return {
            "force": self.force_sensitivity * force[of_sample] * wave.imag + noise[0],
            "acceleration": self.acceleration_sensitivity * (amplitude * wave).imag + noise[1],
            "drive": np.asarray(wave.imag),
        }

    def _lengths(self, frequency_hz: FloatArray) -> np.ndarray:
        """Samples of each step, shape (F,)."""
        return np.ceil((SETTLE + AVERAGED + _BOUNDARY) * self.rate_hz / frequency_hz).astype(int)

    def file(self, signals: dict[str, FloatArray]) -> bytes:
        """A NumPy archive of the signals in single precision, with the sampling rate."""
        stream = io.BytesIO()
        force, acceleration, drive = (signals[n].astype(np.float32) for n in ("force", "acceleration", "drive"))
        np.savez(stream, force=force, acceleration=acceleration, drive=drive, fs=self.rate_hz)
        return stream.getvalue()

    def options(self) -> list[str]:
        """Arguments that describe the channels to ``import``."""
        return [
            *("--force", f"force@{1e3 * self.force_sensitivity:g} mV/N"),
            *("--motion", f"acceleration@{1e3 * self.acceleration_sensitivity:g} mV/(m/s^2)"),
            *("--reference", "drive"),
            *("--excitation", "stepped sine"),
        ]
