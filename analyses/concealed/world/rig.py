r"""The rig: mechanical chain, electronics, duration of a sweep, and subtraction of the unloaded rig.

Between gauge and finger stand two-ports (``tissue.py``): the seismic mass of the sensor, its stiffness, the contactor,
and if it gives way the adhesive with a light cap beyond it. With the finger, and without it (load 0), the gauge sees

.. math:: z_g = \frac{A z + B}{C z + D}, \qquad z_u = \frac BD, \qquad
          z_g - z_u = \frac{z}{D\,(C z + D)} \quad\text{because } AD - BC = 1 .

So subtracting the unloaded rig, as the paper does, is exact only for a rigid chain (C = 0, D = 1).
Both are recorded through a force and an acceleration channel, whose ratio is multiplied by

.. math:: H = e^{-s\tau}\,\frac{s + \omega_a}{s + \omega_f}\,\frac{1 + s/\Omega_a}{1 + s/\Omega_f}

for a skew tau between them, charge-amplifier corners w and anti-alias corners Omega; equal ones cancel.

**Stepped sine.** At each frequency 5 periods to settle, then 5 to average: 10/f and a dead time. A lock-in over K
periods,

.. math:: X = \frac{2}{T}\int_0^T x(t)\,e^{-j\omega t}\,dt, \qquad T = 2\pi K/\omega,

gives for a hum a cos(w_h t + phi)

.. math:: a\,\bigl[e^{j\phi} g((\omega_h - \omega) T) + e^{-j\phi} g(-(\omega_h + \omega) T)\bigr],
          \qquad g(x) = (e^{jx} - 1)/(jx),

which is a line of the width f/K with skirts, and not a narrow band. Quantisation in steps q with noise as dither is
white: the lock-in over n samples leaves q/sqrt(6 n) in each of real and imaginary part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from world.tissue import TwoPort, common_force, common_velocity

SETTLING_PERIODS = 5
AVERAGED_PERIODS = 5
SAMPLE_RATE_HZ = 100e3


@dataclass(frozen=True)
class Rig:
    """The measurement chain; deviations from the calibration have fields of their own.

    Attributes
    ----------
    sensor_mass, contactor_mass : float
        kg.
    sensor_compliance : float
        m/N.
    suspension : (float, float)
        Damping in N s/m and stiffness in N/m beside the contactor, in the calibration too.
    added_mass, added_damping, added_stiffness : float
        Beside the contactor since the calibration (or away from it, if negative).
    adhesive_compliance, cap_mass : float
        Compliance under the finger, m/N, and the light cap beyond it, kg.
    mode : (float, float, float)
        Mass in kg, frequency in Hz and damping ratio of a part that has come to hang on the contactor since.
    pad : (float, float, float)
        A soft pad under the finger: mass in kg, compliance in m/N, loss factor; none if the mass is 0.
    skew_s : float
        Force channel behind the acceleration channel.
    highpass_hz, lowpass_hz : (float, float)
        Corners of force and of acceleration channel.
    hum_n, line_hz : float
        Amplitude of the hum in the force channel in N, with harmonics that fall as 1/k, and its frequency.
    quantum_n, quantum_m_s2 : float
        Steps of the converters.
    shaker : (float, float, float, float)
        Force of the coil in N, moving mass in kg, damping in N s/m and stiffness in N/m of its suspension.
    dead_time_s, pause_s : float
        At each frequency, and between sweeps.
    calibration_sweeps : int
        Averaged for the unloaded rig.
    calibration_noise : float
        Relative, of one such sweep.
    """

    sensor_mass: float = 1e-3
    contactor_mass: float = 2e-3
    sensor_compliance: float = 1e-12
    suspension: tuple[float, float] = (0.05, 40.0)
    added_mass: float = 0.0
    added_damping: float = 0.0
    added_stiffness: float = 0.0
    adhesive_compliance: float = 0.0
    cap_mass: float = 2e-5
    mode: tuple[float, float, float] = (0.0, 1000.0, 0.05)
    pad: tuple[float, float, float] = (0.0, 1e-6, 0.2)
    skew_s: float = 0.0
    highpass_hz: tuple[float, float] = (0.05, 0.05)
    lowpass_hz: tuple[float, float] = (1e5, 1e5)
    hum_n: float = 0.0
    line_hz: float = 50.0
    quantum_n: float = 2e-6
    quantum_m_s2: float = 2e-4
    shaker: tuple[float, float, float, float] = (0.3, 0.02, 1.0, 500.0)
    dead_time_s: float = 0.1
    pause_s: float = 20.0
    calibration_sweeps: int = 400
    calibration_noise: float = 1e-3

    def chain(self, s: np.ndarray, loaded: bool) -> TwoPort:
        """Everything between the gauge and the finger."""
        damping, stiffness = self.suspension
        beside = s * self.contactor_mass + damping + stiffness / s
        if loaded:
            beside = beside + s * self.added_mass + self.added_damping + self.added_stiffness / s
            mass, frequency, ratio = self.mode
            if mass > 0:
                w0 = 2 * np.pi * frequency
                beside = beside + 1 / (1 / (s * mass) + 1 / (2 * ratio * w0 * mass + mass * w0**2 / s))
        chain = common_velocity(s * self.sensor_mass) @ common_force(s * self.sensor_compliance)
        chain = chain @ common_velocity(beside)
        if self.adhesive_compliance > 0:
            chain = chain @ common_force(s * self.adhesive_compliance) @ common_velocity(s * self.cap_mass)
        if loaded and self.pad[0] > 0:
            from world.tissue import shear_layer

            mass, compliance, loss = self.pad
            # A hysteretic modulus, constant over the band; the deviation that causality demands is negligible here.
            chain = chain @ shear_layer(s, mass, (1 + 1j * loss) / (s * compliance))
        return chain

    def electronics(self, s: np.ndarray) -> np.ndarray:
        """Transfer function of the ratio of the channels."""
        (w_f, w_a), (o_f, o_a) = (2 * np.pi * np.array(pair) for pair in (self.highpass_hz, self.lowpass_hz))
        return np.asarray(np.exp(-s * self.skew_s) * (s + w_a) / (s + w_f) * (1 + s / o_a) / (1 + s / o_f))

    def raw(self, s: np.ndarray, z: np.ndarray | float, loaded: bool) -> np.ndarray:
        """Reading of the rig for a load z, before the unloaded rig is subtracted."""
        return np.asarray(self.electronics(s) * self.chain(s, loaded).seen(np.asarray(z) + 0 * s))

    def measured(self, s: np.ndarray, z: np.ndarray) -> np.ndarray:
        """The load as the paper reports it, without noise: loaded less unloaded."""
        return np.asarray(self.raw(s, z, True) - self.raw(s, 0.0, False))

    def drive_velocity(self, s: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Amplitude of the contactor's velocity, in m/s: the shaker's force over the total impedance that it drives."""
        force, mass, damping, stiffness = self.shaker
        return np.asarray(force / np.abs(s * mass + damping + stiffness / s + self.chain(s, True).seen(z)))

    def calibration_error(self, s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Error of the unloaded rig after averaging, shape (F,); it is common to all recordings."""
        size = np.abs(self.raw(s, 0.0, False)) * self.calibration_noise / np.sqrt(self.calibration_sweeps)
        return np.asarray(size * (rng.normal(size=s.shape) + 1j * rng.normal(size=s.shape)))

    def quantisation_sd(self, s: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Of real and imaginary part of z each, in N s/m."""
        samples = np.maximum(SAMPLE_RATE_HZ * AVERAGED_PERIODS * 2 * np.pi / s.imag, 16)
        velocity = self.drive_velocity(s, z)
        of_velocity = self.quantum_m_s2 / s.imag * np.abs(z)
        return np.asarray(np.sqrt((self.quantum_n**2 + of_velocity**2) / (6 * samples)) / velocity)

    def hum(self, s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Contribution of mains hum to z (..., F); its phase is random at each frequency of each recording."""
        total = np.zeros(z.shape, dtype=complex)
        for k in range(1, 11):
            phase = rng.uniform(0, 2 * np.pi, size=z.shape)
            total += leakage(s.imag, 2 * np.pi * k * self.line_hz, phase) / k
        return np.asarray(self.hum_n * total / self.drive_velocity(s, z))


def leakage(omega: np.ndarray, hum_rad_s: float, phase: np.ndarray) -> np.ndarray:
    """Output of a lock-in at omega for cos(w_h t + phase), by the formula of the module's docstring."""
    time = 2 * np.pi * AVERAGED_PERIODS / omega

    def g(x: np.ndarray) -> np.ndarray:
        small = np.abs(x) < 1e-9
        safe = np.where(small, 1.0, x)
        return np.asarray(np.where(small, 1.0 + 0j, (np.exp(1j * safe) - 1) / (1j * safe)))

    own, mirror = g((hum_rad_s - omega) * time), g(-(hum_rad_s + omega) * time)
    return np.asarray(np.exp(1j * phase) * own + np.exp(-1j * phase) * mirror)


def measured_at(frequency_hz: np.ndarray, dead_time_s: float) -> np.ndarray:
    """Time in s at which each average is centred, from the start of a sweep from low to high, shape (F,)."""
    settling, averaged = SETTLING_PERIODS / frequency_hz, AVERAGED_PERIODS / frequency_hz
    ends = np.cumsum(settling + averaged + dead_time_s)
    return np.asarray(ends - averaged / 2)


def sweep_seconds(frequency_hz: np.ndarray, dead_time_s: float) -> float:
    """Duration of one sweep."""
    return float(np.sum((SETTLING_PERIODS + AVERAGED_PERIODS) / frequency_hz + dead_time_s))
