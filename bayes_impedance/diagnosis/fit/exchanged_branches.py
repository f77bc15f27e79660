r"""Refits with the values of two branches exchanged: of the network's own, or of one of its own and one that was added.

Two branches of the same kinds of elements resonate at two frequencies, and which of them at the lower one is a choice
that is the same for everybody: each choice is a valley of the whole population's. Without what is missing the network
may describe the recordings better in the wrong one. Beside the right effect everybody stays there, because nobody's own
search moves two branches at once and everybody's starts lie around the population: of 61 people with a second path to
the ground, whose branches m2-n1 and m3-n3 had changed places, residuals were 1.1 to 1.2 times the noise, and two
resonators were added beside the path. Exchanged, the path alone is 52 units of log evidence ahead of all three.

A branch that was added is one more: a resonator is written m-(n|r), and of a network with such a branch it is a choice
too which of the two is the resonance of the rig, the same for everybody, and which that of the body. With the lower one
beside the network and the higher one, of the rig, in its branch, a resonance of the rig was 10 960 units behind in 63
people, and was called a resonator of the body. What the addition's parameters x are in the elements e of its branch is
known (:attr:`~bayes_impedance.network.operation_traits.Traits.read`); they are products of powers, so that

.. math:: \ln x = A \ln e + b

with constants A and b, and can be solved for e.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from string import Formatter

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.cold_start import TYPICAL, TYPICAL_REPETITIONS
from bayes_impedance.diagnosis.fit.extend import names_of, starts_of
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Model, build
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.rounds import means_of
from bayes_impedance.network.elements import KINDS
from bayes_impedance.network.notation import Network, Parallel, Series, parse
from bayes_impedance.network.symmetry import branch_exchanges, corresponding

_LEAST = 0.05
"""Least part of the median coefficient with which a person's branch begins, where it is zero or less. By choice."""


def with_branches_exchanged(refitter: Refitter, fit: Refit, rounds: int) -> Refit:
    """The fit, or a better one with the values of two branches exchanged.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    rounds : int
        Of each refit.
    """
    names, shared = fit.model.network.elements, fit.model.shared
    place = np.cumsum(~shared) - 1  # in the population, of parameters that vary
    for taken in branch_exchanges(fit.model.network):
        columns = np.arange(shared.size)
        for name, other in taken.items():
            columns[names.index(name)] = names.index(other)
        population, order = fit.population, place[columns[~shared]]  # branches that are alike are shared alike
        exchanged = replace(
            population,
            mu=population.mu[order],
            covariance=population.covariance[np.ix_(order, order)],
            rho=population.rho[order],
        )
        found = refitter.fit(fit.model, fit.u[:, columns], exchanged, rounds)
        fit = found if found.evidence.sum() > fit.evidence.sum() else fit
    for addition, branch, own in _additions_alike(fit.model):
        start = _exchanged(fit, addition, branch, own)
        if start is not None:
            found = refitter.fit(*start, rounds)
            fit = found if found.evidence.sum() > fit.evidence.sum() else fit
    return fit


@dataclass(frozen=True)
class _Branch:
    """The branch that an effect adds.

    Attributes
    ----------
    network : Network
    names : tuple of str
        Of its elements.
    powers, constant : ndarray, shape (k, k) and (k,)
        A and b of ln x = A ln e + b, with e in the order of `names`, and x of the effect's parameters.
    """

    network: Network
    names: tuple[str, ...]
    powers: np.ndarray
    constant: np.ndarray


def _added(effect: Effect) -> _Branch | None:
    """The branch of elements that an effect puts beside its place or in series with it; None if it is none."""
    if not effect.operation:
        network = parse(effect.branch)
        names = tuple(names_of(effect))
        elementary = all(name[0] in KINDS for name in names)
        return _Branch(network, names, np.eye(len(names)), np.zeros(len(names))) if elementary else None
    written = effect.traits.written
    letters = [field for _, field, _, _ in Formatter().parse(written) if field and field != "z"]
    if not written.startswith(("({z})|", "({z})-")) or not letters or not set(letters) <= set(KINDS):
        return None
    names = tuple(f"{letter}1" for letter in letters)
    network = parse(written.removeprefix("({z})")[1:].format(**dict(zip(letters, names, strict=True))))

    def read(logs: np.ndarray) -> np.ndarray:
        return np.log([float(x) for x in effect.traits.read(dict(zip(letters, np.exp(logs), strict=True)))])

    constant = read(np.zeros(len(letters)))
    powers = np.array([read(one) - constant for one in np.eye(len(letters))]).T
    return _Branch(network, names, powers, constant)


def _additions_alike(model: Model) -> Iterator[tuple[int, _Branch, list[int]]]:
    """Additions that are branches, with the columns of the elements of each branch of the network that is alike."""
    names = model.network.elements
    for i, addition in enumerate(model.additions):
        branch = _added(addition.effect)
        if branch is None:
            continue
        for _, node in model.network.walk():
            there = corresponding(branch.network, node) if isinstance(node, Parallel | Series) else None
            if there and set(there.values()) <= set(names):
                yield i, branch, [names.index(there[name]) for name in branch.names]


def _exchanged(
    fit: Refit, addition: int, branch: _Branch, own: Sequence[int]
) -> tuple[Model, np.ndarray, Population] | None:
    """Start of a refit with the values of an addition and of the network's elements in some columns exchanged.

    What is the same for everybody becomes the median recording's, and the network's elements begin with a typical
    dispersion. None if nobody has the addition.
    """
    model, effect = fit.model, fit.model.additions[addition].effect
    columns, u = model.columns(addition), fit.u.copy()
    scale = np.ones(len(columns))
    linear = np.zeros(len(columns), dtype=bool)
    for k, coefficient in enumerate(effect.coefficients):
        if coefficient.link == "linear":
            linear[k], scale[k] = True, coefficient.scale(model.scales)
    x = u[:, columns]
    typical = np.median(x, axis=0)
    if np.any(typical[linear] <= 0):
        return None
    x[:, linear] = np.log(np.maximum(x, _LEAST * typical)[:, linear] * scale[linear])
    new = u[:, own] @ branch.powers.T + branch.constant
    u[:, own] = np.linalg.solve(branch.powers, (x - branch.constant).T).T
    shapes = np.exp(np.median(new, axis=0))
    new[:, linear] = np.exp(new[:, linear]) / scale[linear]
    u[:, columns] = np.where(model.shared[columns], np.median(new, axis=0), new)
    starts = starts_of(model)
    starts[addition] = dict(zip(names_of(effect), shapes.tolist(), strict=True))
    population, varying = fit.population, ~model.shared
    mu = means_of(u[:, varying], fit.owner, len(fit.data)).mean(axis=0)
    covariance, rho = population.covariance.copy(), population.rho.copy()
    covariance[own], covariance[:, own] = 0.0, 0.0
    covariance[own, own], rho[own] = TYPICAL**2, TYPICAL_REPETITIONS
    return build(model.network, model.additions, model.scales, starts), u, Population(mu, covariance, rho)
