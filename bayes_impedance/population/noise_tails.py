r"""Noise with heavier tails than the normal, of all recordings of a population.

Everybody's recordings are fitted with Student t noise of a usual number of degrees of freedom
(:func:`~bayes_impedance.person.heavy_noise.own_fits`), each with the scale of its own person. The residuals then say
which number all of them have in common: its log likelihood is a sum over people, computed for a grid of its
reciprocal. The interval holds what is less probable than the best by no more than half of the 90 % quantile of
chi-square. If the best is zero, the noise is normal, and the fit is that of normal noise.

The number is held at its best value in the fit, as the noise's shape over frequency is: thousands of points determine
it far better than anything that follows depends on it.
"""

from __future__ import annotations

from concurrent.futures import Executor
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.heavy_noise import (
    TAILS,
    WORKING_DEGREES,
    log_likelihoods_of_tails,
    own_fits,
    reweighted,
)
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.noise import NoiseModel
from bayes_impedance.population.heavy_tails import NORMAL, STUDENT_T
from bayes_impedance.population.recording_noise import initial_likelihoods, noise_of
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.executors import map_persons
from bayes_impedance.runtime.sharded import Kept

if TYPE_CHECKING:
    from bayes_impedance.population.em import Estimate
    from bayes_impedance.population.starting_fits import FirstFits

NOISE_DISTRIBUTIONS = (NORMAL, STUDENT_T)
"""Of the noise, the default first."""
_WITHIN = 1.3528
"""Half of the 90 % quantile of chi-square with one degree of freedom."""


def estimated_tail(
    kernel: Kernel, recordings: Recordings, theta: np.ndarray, model: NoiseModel | None, executor: Executor
) -> np.ndarray:
    """Reciprocal degrees of freedom of the noise: most probable, and both ends of the 90 % interval, shape (3,).

    Parameters
    ----------
    kernel : Kernel
    recordings : Recordings
        N people.
    theta : ndarray, shape (N, P)
        First fits.
    model : NoiseModel or None
        Of recordings without a noise of their own.
    executor : Executor
    """
    total = np.zeros(TAILS.size)
    for own in map_persons(executor, partial(_of_person, kernel, model), recordings.subjects, theta):
        total += own
    best = int(np.argmax(total))
    behind = total[best] - total - _WITHIN
    inside = np.flatnonzero(behind <= 0)
    ends = (_crossing(behind, int(inside[0]), -1), _crossing(behind, int(inside[-1]), 1))
    return np.array([TAILS[best], *ends])


def _crossing(behind: np.ndarray, last: int, step: int) -> float:
    """Where a function that is at most zero at `last`, and above it one step further, is zero on the straight line."""
    beyond = last + step
    if not 0 <= beyond < TAILS.size:
        return float(TAILS[last])
    share = behind[last] / (behind[last] - behind[beyond])
    return float(TAILS[last] + share * (TAILS[beyond] - TAILS[last]))


def likelihoods_of(
    kernel: Kernel, recordings: Recordings, first: FirstFits, n_elements: int, executor: Executor
) -> Kept:
    """Everybody's likelihood with the noise of the first fits, and deviations between repetitions of zero.

    Parameters
    ----------
    kernel : Kernel
    recordings : Recordings
    first : FirstFits
    n_elements : int
        Number of elements that differ between people.
    executor : Executor
    """
    if not np.isfinite(first.degrees):
        return initial_likelihoods(recordings, first.model, n_elements, executor)
    made = partial(_likelihood, kernel, first.model, n_elements, first.degrees)
    return Kept.of(executor, recordings.subjects).each(made, first.theta)


def weights_kept(degrees: float, point: Estimate) -> tuple[np.ndarray, ...] | None:
    """Weights of everybody's points, shape (J, F) each; None where the noise is normal."""
    if not np.isfinite(degrees):
        return None
    return tuple(own.weight if own.plain is None else own.weight / own.plain for own in point.likelihoods)


def drawn_stretch(tail: np.ndarray | None, repetitions: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    """Factors by which noise of means over repetitions is larger than its scale, for new recordings.

    Parameters
    ----------
    tail : ndarray, shape (3,), or None
        As in :class:`~bayes_impedance.population.fit.PopulationFit`.
    repetitions : ndarray of int, shape (n,)
        Over how many repetitions each recording is a mean.
    size : int
        Number of values of each.
    rng : Generator

    Returns
    -------
    ndarray, shape (n, size), or (1, 1) of ones for normal noise
    """
    if tail is None or tail[0] == 0:
        return np.ones((1, 1))
    degrees, result = 1 / tail[0], np.empty((repetitions.size, size))
    for j in np.unique(repetitions):
        rows = np.flatnonzero(repetitions == j)
        each = degrees / rng.chisquare(degrees, (rows.size, int(j), size))
        result[rows] = np.sqrt(each.mean(axis=1))
    return result


def _normal(model: NoiseModel | None, n_elements: int, subject: Subject) -> Likelihood:
    nothing = np.zeros((len(subject.repetitions), n_elements))
    return Likelihood.make(subject.frequency_hz, subject.z, noise_of(subject, model), nothing)


def _of_person(kernel: Kernel, model: NoiseModel | None, subject: Subject, theta: np.ndarray) -> np.ndarray:
    square, _ = own_fits(kernel, _normal(model, theta.size, subject), theta, WORKING_DEGREES)
    return log_likelihoods_of_tails(square, float(theta.size * len(square)))


def _likelihood(
    kernel: Kernel, model: NoiseModel | None, n_elements: int, degrees: float, subject: Subject, theta: np.ndarray
) -> Likelihood:
    _, weights = own_fits(kernel, _normal(model, theta.size, subject), theta, degrees)
    return reweighted(_normal(model, n_elements, subject), weights, degrees)
