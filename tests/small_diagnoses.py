"""Small recordings that lead to a verdict of every kind, in a second or a few each.

All people have the network ``m1|r1|n1`` and two repetitions; few candidates are allowed, so that the search is short.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from conftest import THREE_ELEMENTS

from bayes_impedance.diagnosis import Diagnosis, diagnose, registered
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import Recordings

LINE_HZ = 50.0
FREQUENCY = np.unique(np.append(np.geomspace(5, 5000, 41), LINE_HZ))

Curves = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Case:
    """Recordings, the candidates that may explain them, and how they are diagnosed."""

    change: Curves | None = None
    population: VirtualPopulation = THREE_ELEMENTS
    people: int = 10
    repetitions: int = 2
    candidates: tuple[str, ...] = ("rig.delay", "rig.mass")
    quick: bool = True
    diagonal: bool = False
    simulated: bool = False
    drift: float = 0.0
    covariate: bool = False
    given: Recordings | None = None

    def recordings(self) -> Recordings:
        if self.given is not None:
            return self.given
        given = simulate_recordings(self.population, self.people, self.repetitions, FREQUENCY, 4).recordings
        rng, subjects = np.random.default_rng(2), []
        for subject in given.subjects:
            z = subject.z if self.change is None else self.change(2j * np.pi * subject.frequency_hz, subject.z, rng)
            subjects.append(replace(subject, z=z))
        if not self.covariate:
            subjects = [replace(subject, covariates={}) for subject in subjects]
        return replace(given, subjects=tuple(subjects))

    def diagnosed(self) -> Diagnosis:
        allowed = [effect for effect in registered() if effect.id in self.candidates]
        plain = replace(self, change=None, population=THREE_ELEMENTS).recordings() if self.simulated else None
        return diagnose(
            self.recordings(),
            simulation=plain,
            effects=allowed,
            quick=self.quick,
            diagonal=self.diagonal,
            workers=1,
            seed=1,
        )


def _delay(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(z * np.exp(-s * 2e-5))


def _relaxation(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(z + np.exp(0.3 * rng.normal()) / (1 / 3.0 + s * 1e-4))


def _drift(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(z * np.exp(0.2 * np.arange(len(z)))[:, None])


def _hum(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    hit = np.argmin(np.abs(s.imag / (2 * np.pi) - LINE_HZ))
    z = z.copy()
    z[:, hit] += 0.3 * np.abs(z[:, hit]) * np.exp(2j * np.pi * rng.random(len(z)))
    return z


def _group(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(z + (15.0 if rng.random() < 0.3 else 0.0))


TOGETHER = replace(THREE_ELEMENTS, correlation={("r1", "n1"): -0.97})
FORCED = replace(THREE_ELEMENTS, force_exponent={"r1": 6.0}, between_persons={"m1": 0.1, "r1": 0.02, "n1": 0.1})

CASES = {
    "nothing": Case(),
    "shared": Case(change=_delay, quick=False),
    "varying": Case(change=_relaxation, people=16, candidates=("body.relaxation", "body.springpot")),
    "two": Case(
        change=lambda s, z, rng: _delay(s, _relaxation(s, z, rng), rng),
        people=16,
        candidates=("rig.delay", "body.relaxation"),
    ),
    "one person": Case(change=_delay, people=1, repetitions=1),
    "unknown": Case(change=_relaxation, people=12, candidates=("rig.stiffness",)),
    "hum": Case(change=_hum),
    "covariate": Case(population=FORCED, people=16, covariate=True),
    "drift": Case(change=_drift),
    "subgroup": Case(change=_group, people=40, candidates=("rig.delay",)),
    "correlation": Case(population=TOGETHER, people=30, diagonal=True),
    "simulation": Case(
        simulated=True, population=replace(THREE_ELEMENTS, central={**THREE_ELEMENTS.central, "r1": 4.5})
    ),
}


@cache
def diagnosis_of(name: str) -> Diagnosis:
    return CASES[name].diagnosed()
