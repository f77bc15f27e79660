"""Which central values are below which others: what a user knows of elements that could be mistaken for each other.

Two branches that are written alike can be exchanged without changing the impedance. The posterior then has a mirror
image, and which one a chain sees is chance. ``order = [["n1", "n2"]]`` in a prior says which: the population's central
value of n1 is below that of n2. It says nothing about a single person, in whom n1 may be the larger one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.symmetry import exchanges
from bayes_impedance.runtime.user_table import hint, shown

_CONTRADICTED = 4.0
"""Standard errors by which two central values may be in the wrong order where the order is still taken as possible. By
choice: the normal approximation, from which they are, is off by one; beyond four it is the other way round."""
_GAP = 0.1
"""Least distance of two ordered central values where sampling starts, in standard errors. By choice: inside what is
allowed, and nowhere else."""
_MOST_ARRANGEMENTS = 5040
"""Most arrangements of equal parts that are looked at: those of seven, 7!. By choice: no recordings tell more apart."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """Lists of parameters whose central values increase.

    Attributes
    ----------
    chains : tuple of tuple of int
        Positions of the parameters, the lowest first; a position occurs once.
    names : tuple of tuple of str
        The same by name.
    where : str
        Where it was given, for messages.
    """

    chains: tuple[tuple[int, ...], ...] = ()
    names: tuple[tuple[str, ...], ...] = ()
    where: str = "prior"

    def __bool__(self) -> bool:
        return bool(self.chains)

    def of(self, columns: np.ndarray) -> Order:
        """The order of some of the parameters, whatever the others are: positions are those in `columns`."""
        there = {int(column): k for k, column in enumerate(np.flatnonzero(columns) if _mask(columns) else columns)}
        kept = [
            [(there[k], name) for k, name in zip(chain, names, strict=True) if k in there]
            for chain, names in zip(self.chains, self.names, strict=True)
        ]
        kept = [own for own in kept if len(own) > 1]
        return Order(
            chains=tuple(tuple(k for k, _ in own) for own in kept),
            names=tuple(tuple(name for _, name in own) for own in kept),
            where=self.where,
        )

    def obeyed(self, centres: np.ndarray) -> np.ndarray:
        """Whether central values (..., P) are in this order: bool, shape (...)."""
        result = np.ones(centres.shape[:-1], dtype=bool)
        for chain in self.chains:
            result &= np.all(np.diff(centres[..., list(chain)], axis=-1) > 0, axis=-1)
        return result

    def violation(self, centres: np.ndarray, sds: np.ndarray) -> float:
        """How far central values (P,) are from this order, in their standard errors (P,); zero if they are in it."""
        return float(sum(max(0.0, apart) for apart, *_ in self._apart(centres, sds)))

    def _apart(self, centres: np.ndarray, sds: np.ndarray) -> list[tuple[float, str, str]]:
        """For each pair of a list: by how many standard errors the lower one is above the other, and both names."""
        found = []
        for chain, names in zip(self.chains, self.names, strict=True):
            for i, low in enumerate(chain):
                for j in range(i + 1, len(chain)):
                    high = chain[j]
                    error = float(np.hypot(sds[low], sds[high]))
                    found.append((float(centres[low] - centres[high]) / error, names[i], names[j]))
        return found

    def nearest(self, centres: np.ndarray, sds: np.ndarray) -> np.ndarray:
        """Central values in this order that are nearest to those of an estimate: where sampling starts.

        Parameters
        ----------
        centres, sds : ndarray, shape (P,)
            The estimate and its standard errors.

        Raises
        ------
        InputError
            If the estimate contradicts the order.
        """
        from scipy.optimize import isotonic_regression

        wrong, low, high = max(self._apart(centres, sds), default=(0.0, "", ""))
        if wrong > _CONTRADICTED:
            raise InputError(
                f"{self.where}: the recordings contradict the order {low} below {high}: {low} lies {wrong:.3g} "
                "standard errors above it, and this network is another one with the two exchanged; take them out of "
                "the order, or exchange their names in it"
            )
        result = centres.copy()
        for chain in self.chains:
            own = list(chain)
            steps = np.hypot(sds[own][1:], sds[own][:-1]) * _GAP
            gaps = np.concatenate([[0.0], np.cumsum(steps)])
            result[own] = isotonic_regression(centres[own] - gaps, weights=sds[own] ** -2.0).x + gaps
        return result


def order_in(given: Sequence[Sequence[str]], kernel: Kernel, where: str) -> Order:
    """The order of a user in the parameters of a network.

    Raises
    ------
    InputError
        If a name is no parameter of the network, or two of a list cannot be compared.
    """
    chains = []
    for names in given:
        for name in names:
            if name not in kernel.elements:
                raise InputError(
                    f"order: {shown(name)} is not an element of the fitted network ({hint(name, kernel.elements)}); "
                    "leave it out, or give the network"
                )
        chain = tuple(kernel.elements.index(name) for name in names)
        parameters = [kernel.parameters[k] for k in chain]
        first = parameters[0]
        for other in parameters:
            if other.shared:
                raise InputError(
                    f"order: {other.name} is the same for all (*), but an order is of what differs between "
                    "subjects; leave it out"
                )
            if other.letter != first.letter:
                raise InputError(
                    f"order: {first.name} is a {first.quantity.name} and {other.name} a {other.quantity.name}, which "
                    "cannot be compared; give elements of one kind in each list"
                )
        chains.append(chain)
    return Order(chains=tuple(chains), names=tuple(tuple(names) for names in given), where=where)


def arranged(order: Order, kernel: Kernel, centres: np.ndarray, sds: np.ndarray) -> np.ndarray:
    """The arrangement of equal parts of a network in which an estimate comes nearest to the order.

    Parameters
    ----------
    order : Order
        Of the P parameters of the network.
    kernel : Kernel
    centres, sds : ndarray, shape (P,)
        The estimate and its standard errors.

    Returns
    -------
    ndarray of int, shape (P,)
        Parameter k takes the value of parameter ``result[k]``: every parameter its own, if no arrangement is better.
    """
    same = tuple(range(len(kernel.elements)))
    best, least = same, order.violation(centres, sds)
    if not least > 0:
        return np.array(same)
    steps = []
    for exchange in exchanges(kernel.network):
        position = {name: k for k, name in enumerate(kernel.elements)}
        steps.append([position[exchange.get(name, name)] for name in kernel.elements])
    seen, waiting = {same}, [same]
    while waiting and len(seen) < _MOST_ARRANGEMENTS and least > 0:
        here = waiting.pop(0)
        for step in steps:
            there = tuple(here[k] for k in step)
            if there in seen:
                continue
            seen.add(there)
            waiting.append(there)
            rows = list(there)
            violation = order.violation(centres[rows], sds[rows])
            if violation < least:
                best, least = there, violation
    return np.array(best)


def _mask(columns: np.ndarray) -> bool:
    return np.asarray(columns).dtype == bool
