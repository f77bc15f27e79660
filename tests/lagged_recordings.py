"""Loads of several networks behind a faulty measurement chain."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from faulty_recordings import Complex, Float, gaussian

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.files import Recordings, Subject

Chain = Callable[[Complex, Complex], Complex]
"""The recorded z from s = jw, shape (F,), and the load's z."""

LOADS = {
    "finger": "(n3|r3)-(m2|r1|n1|(m1-(n2|r2)))",
    "oscillator": "m1|r1|n1",
    "two inertias": "m1|r1|(m2-(n2|r2))",
    "skin": "(n3|r3)-(m2|r1)",
    "mass": "m1|r1",
    "spring": "n1|r1",
}


def delayed(tau: float) -> Chain:
    """The motion is late by tau in s."""
    return lambda s, z: z * np.exp(s * tau)


def filtered_motion(corner_hz: float) -> Chain:
    """The motion is low-passed."""
    return lambda s, z: z * (1 + s / (2 * np.pi * corner_hz))


def recorded(
    load: str,
    chain: Chain,
    seed: int = 1,
    *,
    subjects: int = 6,
    repetitions: int = 2,
    points: int = 101,
    noise: float = 0.01,
) -> Recordings:
    """People around a random centre of unit magnitude in the middle of 5 to 5000 Hz, with relative noise."""
    network, f = LOADS[load], np.geomspace(5.0, 5000.0, points)
    kernel, rng = Kernel(parse(network)), np.random.default_rng(seed)
    middle = 2 * np.pi * 158.0
    begin = {"m": np.log(1 / middle), "n": np.log(1 / middle), "r": np.log(0.3)}
    centre = np.array([begin[e[0]] for e in kernel.elements]) + rng.normal(size=len(kernel.elements))
    u = centre + 0.25 * rng.normal(size=(subjects, centre.size))
    made = []
    for i, z in enumerate(kernel.impedance(np.ascontiguousarray(u), f)):
        changed = chain(2j * np.pi * f, z)[None] * (1 + noise * gaussian(rng, repetitions, f.size))
        names = tuple(str(j + 1) for j in range(repetitions))
        made.append(Subject(name=f"S{i}", frequency_hz=f, z=changed, repetitions=names))
    return Recordings(title="lagged", unit="N s/m", network=network, source="", licence="", subjects=tuple(made))


def drive(chain: Chain, points: int = 120, noise: float = 0.01, seed: int = 3) -> Recordings:
    """One recording of two inertias on a shaft, mostly inertia from 10 to 250 Hz, with two resonances."""
    f: Float = np.linspace(11.0, 250.0, points)
    kernel = Kernel(parse("m1|r1|((m2|r2)-(n1|r3))"))
    values = {"m1": 5e-3, "r1": 0.03, "m2": 5e-3, "r2": 0.1, "n1": 1.8e-3, "r3": 0.01}
    u = np.log([values[e] for e in kernel.elements])
    z = chain(2j * np.pi * f, kernel.impedance(np.ascontiguousarray(u[None]), f)[0])
    z = z[None] * (1 + noise * gaussian(np.random.default_rng(seed), 1, points))
    person = Subject(name="drive", frequency_hz=f, z=z, repetitions=("1",))
    return Recordings(
        title="drive", unit="N m s/rad", network=str(kernel.network), source="", licence="", subjects=(person,)
    )
