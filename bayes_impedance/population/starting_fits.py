"""First fits: starting points of the search for each person's mode, and the size of the noise.

An objective has many local optima (for one of the paper's published curves the best one is reached from one random
start in two hundred), so random starts are made for a few persons with thinned data, where they cost microseconds.
The optima found are tried for all persons, and the solution that is best for the population is preferred: persons of
one population are similar, and equal parts of a network that can be exchanged should have the same names for all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import bounded_search, modes_from
from bayes_impedance.person.heavy_noise import WORKING_DEGREES
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import all_modes
from bayes_impedance.person.noise import (
    FLOOR_WITH_REPETITIONS,
    FLOOR_WITHOUT,
    NoiseModel,
    Scatter,
    pool,
    scatter_of_repetitions,
    scatter_of_roughness,
)
from bayes_impedance.population.common_ends import REGRET, common_solutions_of
from bayes_impedance.population.equal_parts import named_alike, steps_of
from bayes_impedance.population.noise_tails import estimated_tail
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.recording_noise import noise_of
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.checkpoint import forget_pieces, in_pieces, load_arrays, save_arrays
from bayes_impedance.runtime.executors import map_persons
from bayes_impedance.runtime.progress import Progress

Result = TypeVar("Result")


PROVISIONAL_NOISE = 0.05
"""Relative noise assumed in the searches. By choice: larger than in most recordings, so that optima are wide enough to
be found."""
_THINNED_POINTS = 64
"""Frequencies that a search from many starts uses. By choice: eight per element of the paper's network."""
_SEARCHED_PERSONS = 8
"""Persons searched from random starts; the optima found are tried for all persons. By choice: more cost time."""
_RANDOM_STARTS = 768
"""Total number, divided between the persons searched: 96 each for eight persons, all for one. The best optimum may be
reached from only one start in two hundred."""
_START_SPREAD = 2.5
"""Standard deviation of the starts' log elements. By choice: somewhat less than the prior's 3."""
_KEPT = 4
"""Optima of each search that are tried for the other persons. By choice: more cost time."""
_FIRST_STEPS, _FOLLOWED, _APART = 15, 24, 1.0
"""First steps of all starts; number of end points that are followed; least difference between these in some log
element. Without that difference 14 of the 71 single curves of ``data/fingertip_71`` ended in a local optimum, with it
none (measured)."""
_KICK, _KICKS, _BETTER = 2.0, 3, 0.1
"""Change of one log element of the best end, to either side, from which the search goes on; how often at most, as long
as a better one is found; and what is better, in nats. By choice: a wrong value of a weakly determined element is off by
a factor of several. The right valley may be reached from less than one random start in a thousand, and from a
neighbouring one by changing one element: of 24 populations of 10 people and 30 frequencies, 5 ended in the wrong one
without it."""
_COMPARED, _SAME = 12, 0.1
"""Largest number of ends that are compared, and largest difference of two ends, in any log element, that are the same.
By choice."""
_REPOSITIONED = 0.3
"""Prior standard deviation of a recording's log elements about the person's, for the noise: several times what
repositioning changes. By choice."""
_NEARLY = 8.0
"""Regret up to which a person has the common solution's end instead of the best one. By choice: what the population
may well make up for."""
_WHOLE = "first_fits.npz"


@dataclass(frozen=True)
class FirstFits:
    """Fits of each person before the population is estimated.

    Attributes
    ----------
    theta : ndarray, shape (N, P)
        Each person's log elements in the common solution.
    alternatives : ndarray, shape (N, A, P)
        Each person's best other solutions.
    common : ndarray, shape (C, N, P)
        Candidate common solutions, the most promising first: in each, the searches of all persons began at one point.
    model : NoiseModel or None
        The common noise model; None if every recording has its own noise. Noise of single recordings follows from it
        (:mod:`~bayes_impedance.population.recording_noise`).
    tail : ndarray, shape (3,), or None
        Reciprocal degrees of freedom of the noise, most probable, least and largest; None if it is taken as normal.
    """

    theta: np.ndarray
    alternatives: np.ndarray
    common: np.ndarray
    model: NoiseModel | None
    tail: np.ndarray | None = None

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the noise, infinite of normal noise."""
        return np.inf if self.tail is None or self.tail[0] == 0 else float(1 / self.tail[0])

    def save(self, file: Path) -> None:
        """Save for a run that is resumed."""
        model = {} if self.model is None else {f"noise_{name}": value for name, value in vars(self.model).items()}
        tail = {} if self.tail is None else {"tail": self.tail}
        own = {"theta": self.theta, "alternatives": self.alternatives, "common": self.common}
        save_arrays(file, {**own, **model, **tail})

    @classmethod
    def load(cls, file: Path) -> FirstFits | None:
        """Read what was saved; None if there is no file, or it is damaged."""
        kept = load_arrays(file)
        if kept is None:
            return None
        model = None
        if "noise_sd" in kept:
            relative, floor = bool(kept["noise_relative"]), float(kept["noise_floor"])
            model = NoiseModel(kept["noise_frequency_hz"], kept["noise_sd"], relative, floor)
        return cls(kept["theta"], kept["alternatives"], kept["common"], model, kept.get("tail"))


def first_fits(
    kernel: Kernel,
    recordings: Recordings,
    prior: Prior,
    seed: np.random.SeedSequence,
    executor: Executor,
    progress: Progress,
    checkpoint: Path | None = None,
    heavy: bool = False,
    start: np.ndarray | None = None,
) -> FirstFits:
    """Fit each person under the broad prior and estimate the noise.

    Parameters
    ----------
    kernel : Kernel
    recordings : Recordings
        N persons.
    prior : Prior
    seed : SeedSequence
        For the random starts.
    executor : Executor
        Runs the computations for single persons.
    progress : callable
    checkpoint : Path, optional
        Folder where the fits are saved as they are computed, and from which an interrupted run continues.
    heavy : bool
        Whether the noise may have heavier tails than the normal.
    start : ndarray, shape (N, P), optional
        Another common solution; its median is a candidate for everybody too.
    """
    if checkpoint is not None and (whole := FirstFits.load(checkpoint / _WHOLE)) is not None:
        return whole
    subjects = recordings.subjects
    n_elements = len(kernel.elements)
    precision = np.eye(n_elements) / prior.starting_sds**2
    searched = np.unique(np.linspace(0, len(subjects) - 1, _SEARCHED_PERSONS).round().astype(int))
    n_starts = _RANDOM_STARTS // len(searched)
    # Each person's own: a valley that one set of starts misses would be missed for everybody.
    random_starts = np.random.default_rng(seed).normal(0, _START_SPREAD, (len(searched), n_starts + 1, n_elements))
    random_starts[:, 0] = 0.0
    random_starts += prior.centre

    def everybody(
        stage: str, function: Callable[..., tuple[np.ndarray, ...]], persons: Sequence[Any], *others: np.ndarray
    ) -> list[np.ndarray]:
        """One column for each array that the function returns, computed or read from the checkpoint."""

        def rows_from(first: int) -> Iterator[tuple[np.ndarray, ...]]:
            return map_persons(executor, function, persons[first:], *(other[first:] for other in others))

        rows = in_pieces(checkpoint, stage.replace(" ", "_"), len(persons), rows_from)
        columns: list[np.ndarray] = []
        for i, row in enumerate(_watched(rows, stage, len(persons), progress)):
            columns = columns or [np.empty((len(persons), *own.shape), own.dtype) for own in row]
            for column, own in zip(columns, row, strict=True):
                column[i] = own
        return columns

    search = partial(_searched, kernel, prior)
    (found,) = everybody("searching", search, [thinned(subjects[i], n_elements) for i in searched], random_starts)
    given = [] if start is None else [np.median(start, axis=0)[None]]
    candidates = np.vstack([*found, *given])
    trying = partial(_try_all, kernel, candidates, prior.centre, precision)
    ends, objectives, alternatives = everybody("first fits", trying, subjects)
    regret = np.minimum(objectives - objectives.min(axis=1, keepdims=True), REGRET)
    everyone = np.arange(len(subjects))
    common = common_solutions_of(ends, regret, candidates)
    own = np.where(regret[everyone, common[0]] < _NEARLY, common[0], np.argmin(regret, axis=1))
    exchanged = steps_of(kernel, prior)
    best = named_alike(ends[everyone, own], exchanged)

    (theta,) = everybody("noise", partial(_provisional, kernel, prior.centre, precision), subjects, best)
    unknown = [i for i, subject in enumerate(subjects) if subject.noise_sd is None]
    tail, degrees = None, np.inf
    shaped = partial(_noise, kernel, [subjects[i] for i in unknown], theta[unknown], executor)
    if heavy:
        model = shaped(WORKING_DEGREES) if unknown else None
        tail = estimated_tail(kernel, recordings, theta, model, executor)
        degrees = 1 / tail[0] if tail[0] else np.inf
    model = shaped(degrees) if unknown else None
    solutions = [named_alike(ends[everyone, chosen], exchanged) for chosen in common]
    solutions += [] if start is None else [start]
    fits = FirstFits(theta, alternatives, np.array(solutions), model, tail)
    if checkpoint is not None:
        fits.save(checkpoint / _WHOLE)
        forget_pieces(checkpoint, "searching", "first_fits", "noise")
    return fits


def _searched(kernel: Kernel, prior: Prior, likelihood: Likelihood, starts: np.ndarray) -> tuple[np.ndarray]:
    return (search_modes(kernel, likelihood, starts, prior, _KEPT),)


def _try_all(
    kernel: Kernel, candidates: np.ndarray, centre: np.ndarray, precision: np.ndarray, subject: Subject
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """End points of a person's searches from every candidate, the objectives there, and the best distinct ends.

    Few points with provisional noise do not tell valleys apart that differ near one resonance, so the ends of these
    searches go on with all points, and are compared there.
    """
    few, whole = thinned(subject, centre.size), typical(subject, centre.size, slice(None))
    ends, objectives = modes_from(kernel, few, candidates, centre, precision, 40)
    promising = np.where(objectives < objectives.min() + REGRET, objectives, np.inf)
    kept = np.array(_distinct(ends, promising, _COMPARED, _SAME))
    better, values = modes_from(kernel, whole, kept, centre, precision, 40)
    apart = np.abs(ends[:, None] - kept).max(axis=2)
    nearest = np.argmin(apart, axis=1)
    found = apart.min(axis=1) <= _SAME
    ends = np.where(found[:, None], better[nearest], ends)
    objectives = np.where(found, values[nearest], np.inf)
    return ends, objectives, best_distinct(ends, objectives, _KEPT)


def _provisional(
    kernel: Kernel, centre: np.ndarray, precision: np.ndarray, subject: Subject, start: np.ndarray
) -> tuple[np.ndarray]:
    likelihood = typical(subject, centre.size, slice(None))
    return (modes_from(kernel, likelihood, start[None], centre, precision)[0][0],)


def search_modes(kernel: Kernel, likelihood: Likelihood, starts: np.ndarray, prior: Prior, n: int) -> np.ndarray:
    """End points of the best of many starts.

    The rank of a start is visible after a few Gauss-Newton steps; half of the starts take as many by a bounded error
    before (:mod:`bayes_impedance.person.bounded_search`). Only the best are continued to convergence, which
    needs exact second derivatives at ten times the cost. They must differ by a factor e in some element: otherwise all
    of them might lie in one valley and end in the same local optimum. The search goes on from the best end with each
    element changed by a factor e^2 to either side.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        Few frequencies are enough.
    starts : ndarray, shape (S, P)
    prior : Prior
    n : int

    Returns
    -------
    ndarray, shape (n, P)
        The best first; the best repeated if fewer ends differ.
    """
    precision = np.eye(prior.centre.size) / prior.starting_sds**2
    starts = starts.copy()
    starts[::2] = bounded_search(kernel, likelihood, starts[::2], prior.centre, precision)
    ends, objectives, _ = all_modes(kernel, likelihood, starts, prior.centre, precision, _FIRST_STEPS)
    followed = np.array(_distinct(ends, objectives, max(_FOLLOWED, 2 * n), _APART))
    ends, objectives, _ = all_modes(kernel, likelihood, followed, prior.centre, precision, 40)
    for _ in range(_KICKS):
        best = int(np.argmin(objectives))
        kicked = ends[best] + _KICK * np.concatenate([np.eye(ends.shape[1]), -np.eye(ends.shape[1])])
        others, values, _ = all_modes(kernel, likelihood, kicked, prior.centre, precision, 40)
        ends, objectives = np.concatenate([ends, others]), np.concatenate([objectives, values])
        if not values.min() < objectives[best] - _BETTER:
            break
    return best_distinct(ends, objectives, n)


def typical(subject: Subject, n_elements: int, points: slice | np.ndarray) -> Likelihood:
    """The recording that is nearest to the person's others, with provisional noise.

    The mean of recordings whose resonances differ is not that of any elements.
    """
    z = subject.z
    apart = np.abs(z[:, None] - z) ** 2 / np.maximum(np.abs(z[:, None] * z), np.finfo(float).tiny)
    z = z[[int(np.argmin(apart.sum(axis=(1, 2))))]][:, points]
    return Likelihood.make(subject.frequency_hz[points], z, PROVISIONAL_NOISE * np.abs(z), np.zeros((1, n_elements)))


def thinned(subject: Subject, n_elements: int) -> Likelihood:
    """The same at few frequencies, for a search from many starts."""
    return typical(subject, n_elements, thinned_points(subject.frequency_hz.size))


def thinned_points(n: int) -> np.ndarray:
    """Evenly spread indices of n frequencies, few enough for a search from many starts."""
    return np.unique(np.linspace(0, n - 1, min(n, _THINNED_POINTS)).round().astype(int))


def best_distinct(ends: np.ndarray, objectives: np.ndarray, n: int) -> np.ndarray:
    """The n best end points that differ by more than rounding; the best is repeated if there are fewer."""
    kept = _distinct(ends, objectives, n, _SAME)
    return np.array(kept + [kept[0]] * (n - len(kept)))


def _distinct(ends: np.ndarray, objectives: np.ndarray, n: int, apart: float) -> list[np.ndarray]:
    """At most n end points, the best first, that differ by more than `apart` in some element; at least one."""
    kept: list[np.ndarray] = []
    for i in np.argsort(objectives):
        if np.isfinite(objectives[i]) and all(np.abs(ends[i] - k).max() > apart for k in kept):
            kept.append(ends[i])
        if len(kept) == n:
            break
    return kept or [ends[0]]


def _noise(
    kernel: Kernel, subjects: Sequence[Subject], theta: np.ndarray, executor: Executor, degrees: float
) -> NoiseModel:
    repeated = [i for i, subject in enumerate(subjects) if len(subject.repetitions) > 1]
    if not repeated:
        scatters = list(map_persons(executor, partial(_roughness, kernel), subjects, theta))
        return pool(scatters, FLOOR_WITHOUT, degrees)
    model = NoiseModel(np.ones(1), np.full(1, PROVISIONAL_NOISE), relative=True, floor=0.0)
    some = [subjects[i] for i in repeated]
    own = list(map_persons(executor, partial(_own_elements, kernel), some, theta[repeated]))
    for _ in range(2):
        scatters = list(map_persons(executor, partial(_disagreement, kernel, model), some, own))
        model = pool(scatters, FLOOR_WITH_REPETITIONS, degrees)
    return model


def _roughness(kernel: Kernel, subject: Subject, theta: np.ndarray) -> Scatter:
    model, derivative = kernel.derivative(theta, subject.frequency_hz)
    return scatter_of_roughness(subject.frequency_hz, subject.mean, model, derivative)


def _disagreement(kernel: Kernel, known: NoiseModel, subject: Subject, own: np.ndarray) -> Scatter:
    frequency = subject.frequency_hz
    model, slope = (np.array(part) for part in zip(*(kernel.derivative(u, frequency) for u in own), strict=True))
    return scatter_of_repetitions(frequency, subject.z, slope, noise_of(subject, known), model)


def _own_elements(kernel: Kernel, subject: Subject, theta: np.ndarray) -> np.ndarray:
    """Log elements of each recording, near the person's, shape (J, P)."""
    precision = np.eye(theta.size) / _REPOSITIONED**2
    own = []
    for z in subject.z:
        sd = PROVISIONAL_NOISE * np.abs(z)
        likelihood = Likelihood.make(subject.frequency_hz, z[None], sd[None], np.zeros((1, theta.size)))
        own.append(modes_from(kernel, likelihood, theta[None], theta, precision)[0][0])
    return np.array(own)


def _watched(results: Iterable[Result], stage: str, total: int, progress: Progress) -> Iterator[Result]:
    """Pass results on, reporting progress."""
    for i, result in enumerate(results):
        progress(stage, i + 1, total)
        yield result
