"""Causal curves drawn at random, noise of several kinds, and the faults that are planted into them.

Nothing of the check that is measured is used here. All are drawn from a generator alone: 50 to 400 points (evenly
spaced in log frequency or in frequency) over 0.8 to 3.2 decades, noise of 0.1 to 5 %.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "other_worlds"))

from tree_networks import elements, impedance, random_tree

KINDS = ("network", "power law", "line")
BEHIND = ("nothing", "late force", "late motion", "low-pass", "high-pass")
NOISES = ("relative", "absolute", "corner", "heavy tails", "smoothed", "rounded")

Impedance = Callable[[np.ndarray], np.ndarray]
"""Relative change of one element at each frequency, shape (F,), to the impedance, complex, shape (F,)."""


def draw_band(rng: np.random.Generator) -> np.ndarray:
    points = int(np.exp(rng.uniform(np.log(50), np.log(400))))
    decades = rng.uniform(0.8, 3.2)
    low = 10 ** rng.uniform(-1, 2.5)
    if rng.random() < 0.7:
        return np.geomspace(low, low * 10**decades, points)
    return np.linspace(low, low * 10 ** min(decades, 2), points)


def draw_noise_level(rng: np.random.Generator) -> float:
    return float(10 ** rng.uniform(-3, np.log10(0.05)))


def draw_curve(rng: np.random.Generator, f: np.ndarray, kind: str, behind: str) -> Impedance:
    """A causal curve of a kind, seen through a channel."""
    s = 2j * np.pi * f
    corner = np.exp(rng.uniform(np.log(abs(s[0])), np.log(abs(s[-1])), 20))
    if kind == "network":
        node = random_tree(rng)
        names = elements(node)
        # Elements meet at corners within the band, with quality factors from a hundredth to a hundred and more.
        size = np.exp(rng.normal(0, 1.5, len(names)))
        values = {n: {"m": x / w, "n": 1 / (x * w), "r": x}[n[0]] for n, x, w in zip(names, size, corner, strict=False)}
        moved = names[int(rng.integers(len(names)))]

        def curve(drift: np.ndarray) -> np.ndarray:
            return impedance(node, s, {**values, moved: values[moved] * (1 + drift)}, {})
    elif kind == "power law":
        exponent = rng.uniform(-0.9, 0.9, 2)
        second, mass = float(rng.random() < 0.5), rng.exponential() * float(rng.random() < 0.5)

        def curve(drift: np.ndarray) -> np.ndarray:
            first = (s / corner[0]) ** exponent[0] * (1 + drift)
            return first + second * (s / corner[1]) ** exponent[1] + mass * s / corner[2]
    else:
        losses, pad, open_end = rng.uniform(0.5, 30), 0.3 * rng.exponential(), rng.random() < 0.5

        def curve(drift: np.ndarray) -> np.ndarray:
            length = np.tanh(np.sqrt(s / corner[0] + losses * (s / corner[1]) ** 2) * (1 + drift))
            return (1 / length if open_end else length) + pad

    lag = s * rng.uniform(0.05, 1.5) / abs(s[-1])
    seen = {
        "nothing": s**0,
        "late force": np.exp(-lag),
        "late motion": np.exp(lag),
        "low-pass": 1 / (1 + s / corner[10]),
        "high-pass": s / (s + corner[11]),
    }[behind]
    return lambda drift: curve(drift) * seen


def with_noise(rng: np.random.Generator, f: np.ndarray, z: np.ndarray, level: float, kind: str) -> np.ndarray:
    """A recording: noise relative to |z| unless the kind says otherwise."""
    size, e = np.abs(z), rng.normal(size=f.size) + 1j * rng.normal(size=f.size)
    if kind == "absolute":
        return z + level * np.median(size) * e
    if kind == "corner":
        return z + level * size * np.sqrt(1 + (f[f.size // 5] / f) ** 4) * e
    if kind == "heavy tails":
        return z + level * size * (rng.standard_t(4, f.size) + 1j * rng.standard_t(4, f.size))
    if kind == "smoothed":
        window = np.hanning(int(rng.integers(3, 10)) + 2)
        return z + level * size * np.convolve(e, window / np.linalg.norm(window), "same")
    if kind == "rounded":
        step = 10 ** (np.floor(np.log10(np.median(size))) - 2)
        return np.round((z + level * size * e) / step) * step
    return z + level * size * e


def faulty(f: np.ndarray, curve: Impedance) -> dict[str, np.ndarray]:
    """Curves with one fault each, without noise."""
    progress = np.log(f / f[0]) / np.log(f[-1] / f[0])
    z = curve(0 * progress)
    phase = np.unwrap(np.angle(z))
    return {
        "Re z times 1.1": 1.1 * z.real + 1j * z.imag,
        "Re z times 1.5": 1.5 * z.real + 1j * z.imag,
        "Im z times 1.1": z.real + 1.1j * z.imag,
        "Im z times 1.5": z.real + 1.5j * z.imag,
        "Re z one row later": np.roll(z.real, 1) + 1j * z.imag,
        "Im z three rows later": z.real + 1j * np.roll(z.imag, 3),
        "phase times 1.1": np.abs(z) * np.exp(1.1j * phase),
        "phase times 0.8": np.abs(z) * np.exp(0.8j * phase),
        "conjugated in the upper half": np.where(progress > 0.5, z.conj(), z),
        "z drifts by 20 %": z * (1 + 0.2 * progress),
        "z drifts by 50 %": z * (1 + 0.5 * progress),
        "one element drifts by 50 %": curve(0.5 * progress),
    }
