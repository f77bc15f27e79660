"""Force and motion of a known load, exact or with noise, for tests of the intake."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import dlsim, dlti

MASS, DAMPING, STIFFNESS = 2e-3, 3.0, 2000.0


@dataclass(frozen=True)
class Multisine:
    """Displacement with random phases at some lines of a period, and the force that makes it."""

    samples: int = 1000
    rate_hz: float = 2000.0
    lines: tuple[int, ...] = tuple(range(5, 101, 2))
    amplitude: float = 1e-3

    def periods(
        self, count: int, seed: int, cubic: float = 0.0, square: float = 0.0, noise: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Force in N and displacement in m of shape (count, samples); `noise` is relative, on both."""
        rng = np.random.default_rng(seed)
        lines = np.array(self.lines)
        spectrum = np.zeros(self.samples // 2 + 1, dtype=complex)
        spectrum[lines] = self.amplitude * self.samples * np.exp(2j * np.pi * rng.random(lines.size)) / lines
        x = np.fft.irfft(spectrum)
        w = 2j * np.pi * np.arange(spectrum.size) * self.rate_hz / self.samples
        force = np.fft.irfft(spectrum * (MASS * w**2 + DAMPING * w + STIFFNESS)) + cubic * x**3 + square * x**2
        shape = (count, self.samples)
        return (
            force + noise * force.std() * rng.normal(size=shape),
            x + noise * x.std() * rng.normal(size=shape),
        )

    def impedance(self) -> np.ndarray:
        """Of the linear part, at the lines."""
        s = 2j * np.pi * np.array(self.lines) * self.rate_hz / self.samples
        return MASS * s + DAMPING + STIFFNESS / s


def random_response(count: int, rate_hz: float, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """White force and the velocity of a sampled first-order load with noise (part of its own size)."""
    rng = np.random.default_rng(seed)
    force = rng.normal(size=count)
    numerator, denominator = sampled_mobility(rate_hz)
    velocity = dlsim(dlti(numerator, denominator, dt=1 / rate_hz), force)[1][:, 0]
    return force, velocity + noise * velocity.std() * rng.normal(size=count)


def sampled_mobility(rate_hz: float) -> tuple[list[float], list[float]]:
    """Mobility of mass and damper by the bilinear transform: numerator and denominator in z."""
    a, b = 2 * MASS * rate_hz, DAMPING
    return [1.0, 1.0], [a + b, b - a]


def mobility_at(frequency_hz: np.ndarray, rate_hz: float) -> np.ndarray:
    """Its frequency response."""
    z = np.exp(2j * np.pi * frequency_hz / rate_hz)
    numerator, denominator = sampled_mobility(rate_hz)
    return np.polyval(numerator, z) / np.polyval(denominator, z)


def share_within(estimate: np.ndarray, truth: np.ndarray, sd: np.ndarray, degrees: float, level: float = 0.95) -> float:
    """Share of real and imaginary parts whose interval at a level holds the truth."""
    from scipy.stats import t

    error = np.concatenate([(estimate - truth).real / sd, (estimate - truth).imag / sd])
    return float(np.mean(np.abs(error) < t.ppf((1 + level) / 2, degrees)))
