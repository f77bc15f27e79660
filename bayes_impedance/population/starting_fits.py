"""First fits: where the search for every person's mode begins, and the size of the noise.

An impedance has many local optima (in one of the paper's published curves the best one is reached from one random
start in two hundred), so random starts are spent on a few persons with thinned data, where they cost microseconds.
What they find is tried on everybody, and the solution that serves the population best is preferred: persons of one
population are alike, and parts of a network that could change places should be called the same in everybody.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bayes_impedance.network.elements import band_scale
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import all_modes, find_mode
from bayes_impedance.person.noise import (
    FLOOR_WITH_REPETITIONS,
    FLOOR_WITHOUT,
    NoiseModel,
    Scatter,
    pool,
    scatter_of_repetitions,
    scatter_of_roughness,
)
from bayes_impedance.population.parameters import Prior
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.checkpoint import forget_pieces, in_pieces, load_arrays, save_arrays
from bayes_impedance.runtime.executors import map_persons
from bayes_impedance.runtime.progress import Progress

Result = TypeVar("Result")


_PROVISIONAL_NOISE = 0.05
"""Relative noise of the searches: larger than most recordings have, so that optima are wide enough to be found."""
_THINNED_POINTS = 64
"""Frequencies that a search from many starts uses: eight to an element of the paper's network."""
_SEARCHED_PERSONS = 8
"""Persons searched from random starts; what they find is tried on everybody."""
_RANDOM_STARTS = 768
"""In total, shared between the persons searched: 96 each for eight, all for one, whose best optimum may be reached from
one start in two hundred."""
_START_SPREAD = 2.5
"""Standard deviation of the starts' logarithms, somewhat less than the prior's 3."""
_KEPT = 4
"""Optima of each search that are tried on others."""
_FIRST_STEPS, _FOLLOWED, _APART = 15, 24, 1.0
"""All starts go so many steps; so many ends are followed, which differ by a factor e in some element. Without that
difference 14 of the 71 single curves of ``data/fingertip_71`` ended in a local optimum, with it none (measured)."""
_COMMON = 5
"""Solutions for the whole population that are compared, the best on average first."""

_WHOLE = "first_fits.npz"


@dataclass(frozen=True)
class FirstFits:
    """What is known before the population is looked at.

    Attributes
    ----------
    theta : ndarray, shape (N, P)
        Everybody's log elements in the common solution.
    alternatives : ndarray, shape (N, A, P)
        Everybody's best other solutions.
    common : ndarray, shape (C, N, P)
        Solutions that everybody could share, the most promising first: in each, all searches began at one point.
    model : NoiseModel or None
        The common noise; None if every recording came with its own. :func:`noise_of` has that of one person.
    """

    theta: np.ndarray
    alternatives: np.ndarray
    common: np.ndarray
    model: NoiseModel | None

    def save(self, file: Path) -> None:
        """Keep for a run that is resumed."""
        model = {} if self.model is None else {f"noise_{name}": value for name, value in vars(self.model).items()}
        save_arrays(file, {"theta": self.theta, "alternatives": self.alternatives, "common": self.common, **model})

    @classmethod
    def load(cls, file: Path) -> FirstFits | None:
        """What was kept; None if there is nothing, or it is damaged."""
        kept = load_arrays(file)
        if kept is None:
            return None
        model = None
        if "noise_sd" in kept:
            relative, floor = bool(kept["noise_relative"]), float(kept["noise_floor"])
            model = NoiseModel(kept["noise_frequency_hz"], kept["noise_sd"], relative, floor)
        return cls(kept["theta"], kept["alternatives"], kept["common"], model)


def default_prior(elements: Sequence[str], recordings: Recordings) -> Prior:
    """The scale-free prior: each element centred where its impedance meets the data's magnitude in mid-band."""
    log_magnitude = np.median([np.mean(np.log(np.abs(s.mean))) for s in recordings.subjects])
    log_frequency = np.median([np.mean(np.log(s.frequency_hz)) for s in recordings.subjects])
    scale = [band_scale(e, float(np.exp(log_magnitude)), float(np.exp(log_frequency))) for e in elements]
    return Prior(np.array(scale))


def first_fits(
    kernel: Kernel,
    recordings: Recordings,
    prior: Prior,
    seed: np.random.SeedSequence,
    executor: Executor,
    progress: Progress,
    checkpoint: Path | None = None,
) -> FirstFits:
    """Fit everybody under the broad prior and estimate the noise.

    Parameters
    ----------
    kernel : Kernel
    recordings : Recordings
        N persons.
    prior : Prior
    seed : SeedSequence
        Of the random starts.
    executor : Executor
        Runs what can be done person by person.
    progress : callable
    checkpoint : Path, optional
        Folder where everybody's fits are kept as they come, and from which they are taken up.
    """
    if checkpoint is not None and (whole := FirstFits.load(checkpoint / _WHOLE)) is not None:
        return whole
    subjects = recordings.subjects
    n_elements = len(kernel.elements)
    precision = np.eye(n_elements) / prior.centre_sd**2
    searched = np.unique(np.linspace(0, len(subjects) - 1, _SEARCHED_PERSONS).round().astype(int))
    n_starts = _RANDOM_STARTS // len(searched)
    spread = np.random.default_rng(seed).normal(0, _START_SPREAD, (n_starts, n_elements))
    random_starts = np.vstack([np.zeros(n_elements), spread]) + prior.centre

    def everybody(
        stage: str, function: Callable[..., tuple[np.ndarray, ...]], persons: Sequence[Any], *others: np.ndarray
    ) -> list[tuple[np.ndarray, ...]]:
        """One column for each array that the function returns, worked out or taken up."""

        def rows_from(first: int) -> Iterator[tuple[np.ndarray, ...]]:
            return map_persons(executor, function, persons[first:], *(other[first:] for other in others))

        rows = in_pieces(checkpoint, stage.replace(" ", "_"), len(persons), rows_from)
        return list(_watched(rows, stage, len(persons), progress))

    search = partial(_searched, kernel, random_starts, prior)
    found = everybody("searching", search, [_thinned(subjects[i], n_elements) for i in searched])
    candidates = np.vstack([own for (own,) in found])
    tried = everybody("first fits", partial(_try_all, kernel, candidates, prior.centre, precision), subjects)
    ends, objectives, alternatives = (np.array(column) for column in zip(*tried, strict=True))
    regret = objectives - objectives.min(axis=1, keepdims=True)
    common = int(np.argmin(np.minimum(regret, 50).sum(axis=0)))  # capped: one odd person must not decide
    own = np.where(regret[:, common] < 8, common, np.argmin(regret, axis=1))
    start = ends[np.arange(len(subjects)), own]

    provisional = everybody("noise", partial(_provisional, kernel, prior.centre, precision), subjects, start)
    theta = np.array([own for (own,) in provisional])
    model = None
    if any(subject.noise_sd is None for subject in subjects):
        unknown = [i for i, subject in enumerate(subjects) if subject.noise_sd is None]
        model = _noise(kernel, [subjects[i] for i in unknown], theta[unknown], executor)
    fits = FirstFits(theta, alternatives, _common_solutions(ends, regret), model)
    if checkpoint is not None:
        fits.save(checkpoint / _WHOLE)
        forget_pieces(checkpoint, "searching", "first_fits", "noise")
    return fits


def _searched(kernel: Kernel, starts: np.ndarray, prior: Prior, likelihood: Likelihood) -> tuple[np.ndarray]:
    return (search_modes(kernel, likelihood, starts, prior, _KEPT),)


def _try_all(
    kernel: Kernel, candidates: np.ndarray, centre: np.ndarray, precision: np.ndarray, subject: Subject
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where a person's search from every candidate ends, the objectives there, and the best that differ."""
    ends, objectives, _ = all_modes(kernel, _thinned(subject, centre.size), candidates, centre, precision, 40)
    return ends, objectives, best_distinct(ends, objectives, _KEPT)


def _provisional(
    kernel: Kernel, centre: np.ndarray, precision: np.ndarray, subject: Subject, start: np.ndarray
) -> tuple[np.ndarray]:
    likelihood = _averaged(subject, centre.size, slice(None))
    return (find_mode(kernel, likelihood, start[None], centre, precision).theta,)


def search_modes(kernel: Kernel, likelihood: Likelihood, starts: np.ndarray, prior: Prior, n: int) -> np.ndarray:
    """Where the best of many starts end.

    A start's rank shows after a few Gauss-Newton steps; only the best are followed to where exact second derivatives
    are needed, which cost ten times as much. They differ by a factor e in some element: two dozen in one valley, whose
    end may be a local optimum, would all end there.

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
    precision = np.eye(prior.centre.size) / prior.centre_sd**2
    ends, objectives, _ = all_modes(kernel, likelihood, starts, prior.centre, precision, _FIRST_STEPS)
    followed = np.array(_distinct(ends, objectives, max(_FOLLOWED, 2 * n), _APART))
    ends, objectives, _ = all_modes(kernel, likelihood, followed, prior.centre, precision, 40)
    return best_distinct(ends, objectives, n)


def _common_solutions(ends: np.ndarray, regret: np.ndarray) -> np.ndarray:
    """The best few columns of everybody's fits, ends (N, C, P) and regret (N, C), that differ as populations."""
    cost = np.minimum(regret, 50).sum(axis=0)
    kept: list[int] = []
    for column in np.argsort(cost):
        middle = np.median(ends[:, column], axis=0)
        if all(np.abs(middle - np.median(ends[:, k], axis=0)).max() > 0.3 for k in kept):
            kept.append(int(column))
        if len(kept) == _COMMON:
            break
    return np.swapaxes(ends[:, kept], 0, 1)


def _averaged(subject: Subject, n_elements: int, points: slice | np.ndarray) -> Likelihood:
    """The person's mean recording with provisional noise."""
    z = subject.mean[None, points]
    return Likelihood.make(subject.frequency_hz[points], z, _PROVISIONAL_NOISE * np.abs(z), np.zeros((1, n_elements)))


def _thinned(subject: Subject, n_elements: int) -> Likelihood:
    return _averaged(subject, n_elements, thinned_points(subject.frequency_hz.size))


def thinned_points(n: int) -> np.ndarray:
    """Evenly spread indices of n frequencies, few enough for a search from many starts."""
    return np.unique(np.linspace(0, n - 1, min(n, _THINNED_POINTS)).round().astype(int))


def best_distinct(ends: np.ndarray, objectives: np.ndarray, n: int) -> np.ndarray:
    """The n best end points that differ by more than rounding; the best one is repeated if there are fewer."""
    kept = _distinct(ends, objectives, n, 0.1)
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


def _noise(kernel: Kernel, subjects: Sequence[Subject], theta: np.ndarray, executor: Executor) -> NoiseModel:
    repeated = [i for i, subject in enumerate(subjects) if len(subject.repetitions) > 1]
    if not repeated:
        scatters = list(map_persons(executor, partial(_roughness, kernel), subjects, theta))
        return pool(scatters, FLOOR_WITHOUT)
    model: NoiseModel | None = None
    for _ in range(2):
        scatter = partial(_disagreement, kernel, model)
        scatters = list(map_persons(executor, scatter, [subjects[i] for i in repeated], theta[repeated]))
        model = pool(scatters, FLOOR_WITH_REPETITIONS)
    assert model is not None  # two rounds were made
    return model


def _roughness(kernel: Kernel, subject: Subject, theta: np.ndarray) -> Scatter:
    frequency = subject.frequency_hz
    return scatter_of_roughness(frequency, subject.mean, kernel.impedance(theta, frequency))


def _disagreement(kernel: Kernel, known: NoiseModel | None, subject: Subject, theta: np.ndarray) -> Scatter:
    frequency = subject.frequency_hz
    sd = None if known is None else known.at(frequency, np.abs(subject.mean))
    return scatter_of_repetitions(frequency, subject.z, kernel.derivative(theta, frequency)[1], sd)


def noise_of(subject: Subject, model: NoiseModel | None) -> np.ndarray:
    """Standard deviation of the noise of a person's recordings, before the person's own scale, shape (J, F)."""
    if subject.noise_sd is not None:
        return subject.noise_sd
    assert model is not None  # made whenever someone needs it
    magnitude = np.exp(np.mean(np.log(np.abs(subject.z)), axis=0))
    return np.tile(model.at(subject.frequency_hz, magnitude), (len(subject.repetitions), 1))


def _watched(results: Iterable[Result], stage: str, total: int, progress: Progress) -> Iterator[Result]:
    """Pass results on, reporting progress."""
    for i, result in enumerate(results):
        progress(stage, i + 1, total)
        yield result
