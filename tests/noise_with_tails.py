"""People whose recordings have Student t noise, and recordings with points far off."""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.files import Recordings, Subject

NETWORK = "m1|r1|n1"
CENTRE = np.log([0.02, 2.0, 1e-3])
BETWEEN_PERSONS = np.array([0.2, 0.3, 0.25])
BETWEEN_REPETITIONS = 0.03


def people_with_noise(
    n: int,
    degrees_of_freedom: float,
    seed: int,
    *,
    repetitions: int = 2,
    points: int = 30,
    noise: float = 0.02,
    known: bool = False,
) -> tuple[Recordings, np.ndarray]:
    """N people with noise of these degrees of freedom, infinite of normal noise, and the mean log elements of each.

    Parameters
    ----------
    known : bool
        Whether the recordings come with the scale of their noise.
    """
    kernel, rng, frequency = Kernel(parse(NETWORK)), np.random.default_rng(seed), np.geomspace(5, 500, points)
    persons, subjects = CENTRE + BETWEEN_PERSONS * rng.normal(size=(n, 3)), []
    for i in range(n):
        own = persons[i] + BETWEEN_REPETITIONS * rng.normal(size=(repetitions, 3)) * (repetitions > 1)
        persons[i] = own.mean(axis=0)
        z = kernel.impedance(own, frequency)
        sd = noise * np.abs(z)
        stretch = np.ones(z.shape)
        if np.isfinite(degrees_of_freedom):
            stretch = np.sqrt(degrees_of_freedom / rng.chisquare(degrees_of_freedom, z.shape))
        z = z + sd * stretch * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
        names = tuple(str(j + 1) for j in range(repetitions))
        given = sd if known else None
        subjects.append(Subject(name=f"s{i:03d}", repetitions=names, frequency_hz=frequency, z=z, noise_sd=given))
    recordings = Recordings(
        subjects=tuple(subjects), title="noise", unit="N s/m", network=NETWORK, source=None, licence=None
    )
    return recordings, persons
