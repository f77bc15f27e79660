"""Simulated recordings into which faults are planted, and the warnings about them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from bayes_impedance.quality.checks import check_recordings
from bayes_impedance.quality.findings import Finding
from bayes_impedance.recordings.files import Recordings, Subject

Complex = npt.NDArray[np.complex128]
Float = npt.NDArray[np.float64]


def fingertip(f: Float, scale: Float) -> Complex:
    """Two-mass chain behind a skin layer; `scale` multiplies the eight elements."""
    m1, m2, n1, n2, n3, r1, r2, r3 = np.array([0.1, 2e-3, 1e-3, 2e-3, 1e-4, 1.0, 2.0, 1.5]) * scale
    s = 2j * np.pi * f
    limb = 1 / (1 / (s * m1) + 1 / (1 / (s * n2) + r2))
    z: Complex = 1 / (1 / (1 / (s * n3) + r3) + 1 / (s * m2 + r1 + 1 / (s * n1) + limb))
    return z


def gaussian(rng: np.random.Generator, *shape: int) -> Complex:
    """Complex noise with unit standard deviation of each part."""
    return np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape), dtype=np.complex128)


def simulate(
    seed: int = 0, *, subjects: int = 12, repetitions: int = 3, points: int = 201, noise: float = 0.01
) -> Recordings:
    """Smooth curves, 30 % variation between subjects, noise four times as large at 5 Hz as above 10 Hz."""
    rng = np.random.default_rng(seed)
    f = np.geomspace(5.0, 5000.0, points)
    made = []
    for i in range(subjects):
        z = fingertip(f, np.exp(0.3 * rng.normal(size=8)))
        sd = noise * np.abs(z) * (1 + 3 * np.clip(np.log2(10 / f), 0, 1))
        made.append(
            Subject(
                name=f"S{i:02d}",
                frequency_hz=f,
                z=z + sd * gaussian(rng, repetitions, points),
                repetitions=tuple(str(j + 1) for j in range(repetitions)),
            )
        )
    return Recordings(title="simulated", unit="N s/m", network=None, source="", licence="", subjects=tuple(made))


def change(data: Recordings, index: int, edit: Callable[[Complex], None]) -> Recordings:
    """Return recordings in which the z of one subject was edited in place."""
    subjects = list(data.subjects)
    z = subjects[index].z.copy()
    edit(z)
    subjects[index] = replace(subjects[index], z=z)
    return replace(data, subjects=tuple(subjects))


def warnings(data: Recordings) -> list[Finding]:
    return [finding for finding in check_recordings(data) if finding.severity == "warning"]


def only(data: Recordings, kind: str) -> Finding:
    (finding,) = warnings(data)
    assert finding.id == kind
    assert "\n" not in finding.message
    return finding
