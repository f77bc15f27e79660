"""Which solution everybody begins from: one that the population has in common.

If persons are in different optima, the estimated population spans all of them, and its inflated dispersion then holds
each person in the optimum it is in: expectation-maximisation does not leave such an estimate, although one in which
everybody is in the same optimum may be far more probable. So common solutions are tried as populations of their own, on
thinned data, and their evidences are compared: at first those that the searches of single persons have found
(:func:`best_common`), later, if a search under the estimated population has brought some persons to another optimum,
the solutions of these (:func:`from_another`).

The best population may also be where no single person's recordings have led. What one person leaves open, an element
that is nearly rigid or hardly felt in the band, the people together determine, and where each one's search ends is
chance: of 30 virtual fingertips between 50 and 2000 Hz the spring of the skin came out a hundred times as large as it
is and its damper twice as large, at a log evidence 31 below that of the truth. So the estimated population's centre is
also tried with each such element changed to either side, as a search for one person's best optimum does
(:func:`~bayes_impedance.population.starting_fits.search_modes`). And where some people are far from most
(:mod:`bayes_impedance.population.far_people`), everybody begins under the population of the
others alone, those who are far where its median is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import methodcaller

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import mode_at
from bayes_impedance.population.e_step import PersonFit
from bayes_impedance.population.em_state import State
from bayes_impedance.population.far_people import far_from_most
from bayes_impedance.population.order import Order, arranged
from bayes_impedance.population.starting_fits import FirstFits
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.sharded import Kept

ALIGNED = (2, 5)
"""Rounds after which recordings are searched one by one where linear steps have not described them. By choice: such
steps need two rounds where they suffice."""
APART = 0.3
"""Difference in some log element from which two solutions are not the same one. By choice: a third, which no iteration
of a population near its rest changes."""
_TRIAL_ROUNDS, _TRIAL_POINTS = 10, 100
"""Iterations and frequencies per person in comparing modes. By choice: few, as their evidences differ by much."""
_MORE_PROBABLE = 1.0
"""Gain in log evidence from which a population counts as another one. By choice: a factor e says nothing yet, and after
so few iterations two that began apart and go to one mode still differ by half of it."""
_MOST_TRIED, _FIRST_ROUNDS, _FOLLOWED = 6, 3, 3
"""Most persons whose solutions are tried for everybody; iterations after which the best few of all solutions alone go
on, and how many do. By choice: the first iteration leaves the common point, and two more order populations that differ
by tens of nats."""
_KICKS = (2.0, 4.0)
"""Changes of a log element, to either side. By choice: the first is that of a single person's search; by the second a
population came back from a hundred times an element's value, and by the first it did not."""
_OPEN = 0.3
"""Standard deviation by the median person's recordings from which these leave a log element open: a smaller or larger
value than that of the search's end is then less than three of them away. Of populations that every person determines
better, none of eight went elsewhere."""
_FEW, _MANY = 24, 200
"""Persons, spread evenly, with whom all other solutions than the estimated one are tried, and the best few. By choice:
what is more probable by tens of nats for all shows in a few; what decides must not be a whim of theirs."""
_COMPARED = 400
"""Most persons, spread evenly, by whom the first common solutions are compared. By choice: they decide for good, and of
four thousand persons five solutions tried with everybody took more time than the whole estimate from the best one."""

StateFrom = Callable[[np.ndarray, Kept, np.ndarray], State]
"""Makes the state of an estimation from the log elements (n, P) of some persons, their data and their numbers (n,)."""


@dataclass(frozen=True)
class _Trial:
    """A population that began from one solution: its state, and whether its centres are in the order of the prior."""

    state: State
    ordered: bool

    @classmethod
    def made(cls, kernel: Kernel, order: Order, state: State, rounds: range) -> _Trial:
        for k in rounds:
            state.iterate(None)
            if k in ALIGNED:
                state.align()
        middle = np.median(state.theta, axis=0)
        best = arranged(order, kernel, middle, np.ones(middle.size))
        return cls(state, bool(order.obeyed(middle[best])))


def best_common(
    kernel: Kernel, order: Order, state_from: StateFrom, data: Kept, first: FirstFits, progress: Progress
) -> tuple[np.ndarray, tuple[float, ...]]:
    """Each person's starting point, (N, P), and the differences in log evidence of the alternatives.

    Each common solution is tried, and the one with the highest evidence is taken: of those that are in the order of the
    prior, if any of them is. Of more than :data:`_COMPARED` people so many compare, theirs are the differences, and
    everybody begins where the population of all has gone from the one that is taken.

    Parameters
    ----------
    kernel : Kernel
    order : Order
    state_from : callable
    data : Kept of Likelihood
    first : FirstFits
    progress : callable
    """
    n, thinned = len(first.theta), _thinned(data)

    def tried(common: np.ndarray, people: np.ndarray, recordings: Kept) -> _Trial:
        state = state_from(common[people], recordings, people)
        return _Trial.made(kernel, order, state, range(1, _TRIAL_ROUNDS + 1))

    comparing = _some(thinned, n, _COMPARED)
    found, ends, ordered = [], [], []
    for c, common in enumerate(first.common):
        trial = tried(common, *comparing)
        found.append(trial.state.log_evidence())
        ends.append(trial.state.theta)
        ordered.append(trial.ordered)
        progress("common solutions", c + 1, len(first.common))
    ranked = [k for k in np.argsort(found)[::-1] if ordered[k] or not any(ordered)]
    middles = [_by_kind(kernel.elements, np.median(end, axis=0)) for end in ends]
    others = [k for k in ranked[1:] if np.abs(middles[k] - middles[ranked[0]]).max() > APART]
    rivals = tuple(float(found[ranked[0]] - found[k]) for k in others)
    begun = ends[ranked[0]]
    return begun if len(begun) == n else tried(first.common[ranked[0]], np.arange(n), thinned).state.theta, rivals


def from_another(
    kernel: Kernel,
    order: Order,
    state_from: StateFrom,
    data: Kept,
    state: State,
    jumped: np.ndarray,
    progress: Progress,
) -> tuple[State | None, float]:
    """A population that is more probable than the estimated one, if one is found.

    Parameters
    ----------
    kernel : Kernel
    order : Order
    state_from : callable
    data : Kept of Likelihood
    state : State
        Of the estimated population.
    jumped : ndarray of bool, shape (N,)
        Persons whom a search has brought to another optimum. Their solutions are tried: as many as differ, of which
        those that differ most.
    progress : callable

    Returns
    -------
    state : State or None
        With everybody in it; None if the population is more probable as it is, or the other one is the same with
        nobody elsewhere.
    gain : float
        In log evidence, of at most :data:`_MANY` people.
    """
    theta, centre = state.theta, state.pooling.whole(state.mu, state.phi)

    def begun_at(own: np.ndarray, among: tuple[np.ndarray, Kept]) -> State:
        people, recordings = among
        return state_from(np.broadcast_to(own, theta.shape)[people], recordings, people)

    persons = _farthest(theta[jumped]) if np.any(jumped) else theta[:0]
    changes = [sign * size * own for own in _left_open(state) for size in _KICKS for sign in (1, -1)]
    solutions = [*persons, *(centre + change for change in changes)]
    far = far_from_most(theta[:, state.pooling.varying])
    if not solutions and not far.any():
        return None, 0.0
    thinned = _thinned(data)
    few, many = (_some(thinned, len(theta), most) for most in (_FEW, _MANY))
    found = []
    for c, own in enumerate(solutions):
        trial = _Trial.made(kernel, order, begun_at(own, few), range(1, _FIRST_ROUNDS + 1))
        found.append(trial.state.log_evidence())
        progress("other common solutions", c + 1, len(solutions) + 1)
    rounds = range(1, _TRIAL_ROUNDS + 1)
    best_few = np.argsort(-np.nan_to_num(found, nan=-np.inf), kind="stable")[:_FOLLOWED]
    followed = [_Trial.made(kernel, order, begun_at(solutions[k], many), rounds) for k in best_few]
    if far.any():
        gathered = begun_at(np.where(far[:, None], np.median(theta, axis=0), theta), many)
        gathered.take_population_of(theta[~far][:, state.pooling.varying])
        gathered.iterate(None)
        gathered.align()  # while the population is still that of the others
        followed.append(_Trial.made(kernel, order, gathered, rounds))
    best = max(followed, key=lambda trial: float(np.nan_to_num(trial.state.log_evidence(), nan=-np.inf)))
    as_it_is = begun_at(theta, many)
    as_it_is.take_population(state)
    now = _Trial.made(kernel, order, as_it_is, rounds)
    progress("other common solutions", len(solutions) + 1, len(solutions) + 1)
    gain = float(best.state.log_evidence() - now.state.log_evidence())
    middle, here = (np.median(trial.state.theta, axis=0) for trial in (best, now))
    elsewhere = bool(np.any(jumped) or far.any()) or float(np.abs(middle - here).max()) > APART
    better = gain > _MORE_PROBABLE and elsewhere and (best.ordered or not now.ordered)
    if not better:
        return None, gain
    everybody = best.state.n_persons == len(theta)
    begun = state_from(best.state.theta if everybody else np.tile(middle, (len(theta), 1)), data, np.arange(len(theta)))
    begun.take_population(best.state)
    return begun, gain


def _some(data: Kept, n: int, most: int) -> tuple[np.ndarray, Kept]:
    """Numbers of at most so many of n persons, spread evenly, and their data."""
    if n <= most:
        return np.arange(n), data  # where they are
    people = np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))
    return people, data.of_some(people)


def _left_open(state: State) -> np.ndarray:
    """Unit vectors (n, P) of the elements that the median person's recordings leave open."""
    own = partial(_standard_deviations, state.pooling.at(state.phi), np.diag(state.prior.local_sds(state.mu) ** -2.0))
    sd = np.median(state.data.each(own, state.fits).gathered(), axis=0)
    return np.asarray(np.eye(state.pooling.whole(state.mu, state.phi).size)[state.pooling.varying[sd > _OPEN]])


def _standard_deviations(kernel: Kernel, precision: np.ndarray, likelihood: Likelihood, fit: PersonFit) -> np.ndarray:
    """Of a person's log elements (P,), by the own recordings and a prior of that precision."""
    mode = mode_at(kernel, likelihood.moved(fit.deviations), fit.theta, fit.theta, precision, 0.0)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(mode.precision))))


def _farthest(theta: np.ndarray) -> np.ndarray:
    """A few different rows of theta (n, P), each the farthest from those before; the first is nearest to the median."""
    distance = np.abs(theta - np.median(theta, axis=0)).max(axis=1)
    chosen = [int(np.argmin(distance))]
    while len(chosen) < _MOST_TRIED:
        apart = np.abs(theta[:, None] - theta[chosen]).max(axis=2).min(axis=1)
        if apart.max() <= APART:
            break
        chosen.append(int(np.argmax(apart)))
    return theta[chosen]


def _thinned(data: Kept) -> Kept:
    return data.each(methodcaller("thinned", _TRIAL_POINTS))


def _by_kind(elements: Sequence[str], theta: np.ndarray) -> np.ndarray:
    """Log elements sorted within each kind, so that exchanging equal parts of a network changes nothing."""
    return np.asarray(theta[np.lexsort((theta, np.array([ord(e[0]) for e in elements])))])
