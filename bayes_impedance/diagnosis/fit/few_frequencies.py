"""Recordings of a population that are summed up at a few frequencies while a fit is on its way.

A fit takes dozens of rounds, and hundreds of frequencies say in each of them what a few dozen say: what a step changes
is smooth in frequency (:mod:`bayes_impedance.person.condensed`). Recordings are summed up around the place where the
fit begins; where that is far from where it ends the sums are only approximate, so that no fit is at rest before it is
with all frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.normal_equations import Stack
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.condensed import NODES_PER_DECADE, interpolation_of, summed_up
from bayes_impedance.runtime.broadcast import Lent

_Block = tuple[np.ndarray, np.ndarray, np.ndarray]


def few_frequencies(model: Model, stack: Stack, u: np.ndarray, executor: Executor) -> Stack | None:
    """The recordings summed up around the model at u (M, P); None where it is not worth it, or the model has no value.

    Parameters
    ----------
    model : Model
    stack : Stack
        All recordings.
    u : ndarray, shape (M, P)
    executor : Executor
    """
    u = stack.felt(u)
    tasks = [(lent, (model.kernel, u[rows])) for rows, lent in stack.pieces]
    pieces, rest = [], np.empty(len(u))
    for (rows, _), found in zip(stack.pieces, Lent.ask(executor, _summed, tasks), strict=True):
        if found is None:
            return None
        blocks, rest[rows] = found
        pieces.append((rows, Lent(blocks)))
    return Stack(stack.owner, tuple(pieces), rest, stack.silent)


def worth_it(stack: Stack) -> bool:
    """Whether there are so many frequencies that summing them up saves work."""
    grids = {omega.tobytes(): omega for _, lent in stack.pieces for omega, _, _ in lent.data}
    return all(interpolation_of(omega, NODES_PER_DECADE[0]) is not None for omega in grids.values())


def _summed(blocks: Sequence[_Block], task: tuple[Kernel, np.ndarray]) -> tuple[tuple[_Block, ...], np.ndarray] | None:
    """The blocks of a piece summed up around the model at u, in the order of their rows, and what is to be added."""
    kernel, u = task
    found, rests, begin = [], [], 0
    for omega, z, weight in blocks:
        interpolation = interpolation_of(omega, NODES_PER_DECADE[0])
        if interpolation is None:
            return None
        z0 = kernel.impedance(u[begin : begin + len(z)], omega / (2 * np.pi))
        there = summed_up(interpolation, z, weight, z0)
        if there is None:
            return None
        found.append((np.ascontiguousarray(omega[interpolation.nodes]), *there[:2]))
        rests.append(there[2])
        begin += len(z)
    return tuple(found), np.concatenate(rests)
