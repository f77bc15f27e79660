"""Which solution everybody begins from: one that the population has in common.

If persons are in different optima, the estimated population spans all of them, and its inflated dispersion then holds
each person in the optimum it is in: expectation-maximisation does not leave such an estimate, although one in which
everybody is in the same optimum may be far more probable. So common solutions are tried as populations of their own, on
thinned data, and their evidences are compared: at first those that the searches of single persons have found
(:func:`best_common`), later, if a search under the estimated population has brought some persons to another optimum,
the solutions of these (:func:`from_one_person`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import methodcaller

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.population.em_state import State
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
_MOST_TRIED, _FIRST_ROUNDS = 6, 3
"""Most persons whose solutions are tried for everybody, and iterations after which the best of them alone goes on. By
choice: the first iteration leaves the common point, and two more order populations that differ by tens of nats."""

StateFrom = Callable[[np.ndarray, Kept], State]
"""Makes the state of an estimation from everybody's log elements (N, P) and data."""


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
    prior, if any of them is.

    Parameters
    ----------
    kernel : Kernel
    order : Order
    state_from : callable
    data : Kept of Likelihood
    first : FirstFits
    progress : callable
    """
    thinned = _thinned(data)
    found, ends, ordered = [], [], []
    for c, theta in enumerate(first.common):
        trial = _Trial.made(kernel, order, state_from(theta, thinned), range(1, _TRIAL_ROUNDS + 1))
        found.append(trial.state.log_evidence())
        ends.append(trial.state.theta)
        ordered.append(trial.ordered)
        progress("common solutions", c + 1, len(first.common))
    ranked = [k for k in np.argsort(found)[::-1] if ordered[k] or not any(ordered)]
    middles = [_by_kind(kernel.elements, np.median(end, axis=0)) for end in ends]
    others = [k for k in ranked[1:] if np.abs(middles[k] - middles[ranked[0]]).max() > APART]
    return ends[ranked[0]], tuple(float(found[ranked[0]] - found[k]) for k in others)


def from_one_person(
    kernel: Kernel,
    order: Order,
    state_from: StateFrom,
    data: Kept,
    theta: np.ndarray,
    jumped: np.ndarray,
    progress: Progress,
) -> tuple[np.ndarray | None, float]:
    """Everybody's log elements (N, P) in a population that began from one person's solution, if that is more probable.

    Parameters
    ----------
    kernel : Kernel
    order : Order
    state_from : callable
    data : Kept of Likelihood
    theta : ndarray, shape (N, P)
        Everybody's log elements now.
    jumped : ndarray of bool, shape (N,)
        Persons whose solutions are tried: as many as differ, of which those that differ most.
    progress : callable

    Returns
    -------
    theta : ndarray or None
        None if the population is more probable as it is.
    gain : float
        In log evidence.
    """
    thinned, tried = _thinned(data), _farthest(theta[jumped])
    begun = []
    for c, own in enumerate(tried):
        state = state_from(np.tile(own, (len(theta), 1)), thinned)
        begun.append(_Trial.made(kernel, order, state, range(1, _FIRST_ROUNDS + 1)))
        progress("solutions of single persons", c + 1, len(tried) + 1)
    best = max(begun, key=lambda trial: trial.state.log_evidence())
    rest = range(_FIRST_ROUNDS + 1, _TRIAL_ROUNDS + 1)
    best = _Trial.made(kernel, order, best.state, rest)
    now = _Trial.made(kernel, order, state_from(theta, thinned), range(1, _TRIAL_ROUNDS + 1))
    progress("solutions of single persons", len(tried) + 1, len(tried) + 1)
    gain = float(best.state.log_evidence() - now.state.log_evidence())
    better = gain > _MORE_PROBABLE and (best.ordered or not now.ordered)
    return (best.state.theta, gain) if better else (None, gain)


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
