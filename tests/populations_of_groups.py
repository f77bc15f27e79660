"""People of two groups, and their recordings."""

from __future__ import annotations

import numpy as np
from populations_with_tails import CENTRE, NETWORK, SCALE

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.two_components import Groups
from bayes_impedance.recordings.files import Recordings, Subject


def groups_apart(share: float, distance: float, direction: tuple[float, float, float] = (0.6, -0.8, 0.0)) -> Groups:
    """Groups at a distance in standard deviations within a group."""
    return Groups(np.array([share]), distance * np.sqrt(share * (1 - share)) * np.array([direction]))


def people_of_groups(
    n: int, groups: Groups, seed: int, *, repetitions: int = 1, noise: float = 0.02
) -> tuple[Recordings, np.ndarray]:
    """N people at 20 frequencies with total dispersions `SCALE` and no correlations, and who is of the second group."""
    kernel, rng, frequency = Kernel(parse(NETWORK)), np.random.default_rng(seed), np.geomspace(5, 500, 20)
    second = rng.random(n) < groups.share[0]
    inside = rng.normal(size=(n, SCALE.size)) @ np.linalg.cholesky(groups.within[0]).T
    away = SCALE * (inside + groups.offsets[0, second.astype(int)])
    subjects = []
    for i in range(n):
        deviations = 0.03 * rng.normal(size=(repetitions, SCALE.size)) * (repetitions > 1)
        z = kernel.impedance(CENTRE + away[i] + deviations, frequency)
        z = z * (1 + noise * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))
        names = tuple(str(j + 1) for j in range(repetitions))
        subjects.append(Subject(name=f"s{i:03d}", repetitions=names, frequency_hz=frequency, z=z, noise_sd=None))
    recordings = Recordings(
        subjects=tuple(subjects), title="two groups", unit="N s/m", network=NETWORK, source=None, licence=None
    )
    return recordings, second
