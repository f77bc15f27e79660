"""People whose elements follow a Student t distribution, or with some far from the others, and their recordings."""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.heavy_tails import drawn_factors
from bayes_impedance.recordings.files import Recordings, Subject

NETWORK = "m1|r1|n1"
CENTRE = np.log([0.02, 2.0, 1e-3])
SCALE = np.array([0.2, 0.3, 0.25])
BETWEEN_REPETITIONS = 0.03
_AWAY = 8.0
"""Scales by which outlying people are away in each element."""


def people_with_tails(
    n: int, degrees_of_freedom: float, seed: int, *, repetitions: int = 1, outlying: int = 0, noise: float = 0.02
) -> Recordings:
    """N people at 20 frequencies; infinite degrees of freedom are the normal distribution."""
    kernel, rng, frequency = Kernel(parse(NETWORK)), np.random.default_rng(seed), np.geomspace(5, 500, 20)
    away = rng.normal(size=(n, SCALE.size)) * SCALE
    if np.isfinite(degrees_of_freedom):
        away *= drawn_factors(np.full(n, 1 / degrees_of_freedom), (n,), rng)[:, None]
    away[:outlying] += _AWAY * SCALE
    subjects = []
    for i in range(n):
        deviations = BETWEEN_REPETITIONS * rng.normal(size=(repetitions, SCALE.size)) * (repetitions > 1)
        z = kernel.impedance(CENTRE + away[i] + deviations, frequency)
        z = z * (1 + noise * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))
        names = tuple(str(j + 1) for j in range(repetitions))
        subjects.append(Subject(name=f"s{i:03d}", repetitions=names, frequency_hz=frequency, z=z, noise_sd=None))
    return Recordings(
        subjects=tuple(subjects), title="people with tails", unit="N s/m", network=NETWORK, source=None, licence=None
    )
