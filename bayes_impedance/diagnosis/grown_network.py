"""One network instead of a sum of names: the claimed one, grown branch by branch and pruned back.

If structure remains after the effects that a search has named, several names may stand for one thing, or the claimed
network may simply lack elements. Then the claimed network is grown: the small branch of masses, springs and dampers
that improves the prediction of held-out people most (:mod:`bayes_impedance.diagnosis.selection.unnamed`) becomes part
of the network, what remains is looked at again, and so on. Branches are then pruned back: an element is removed if the
network without it predicts held-out people as well. A removed part of a parallel group lets go, a removed part of a
series connection is rigid.

Growing takes many refits, and is done with some of the people and frequencies; the network that results is fitted to
all.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import build
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.multiple_testing import STRUCTURE_ALPHA
from bayes_impedance.diagnosis.residuals.locate import locate
from bayes_impedance.diagnosis.residuals.missing_impedance import missing_one_ports
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, SCATTERS
from bayes_impedance.diagnosis.selection.cross_validation import people_gain
from bayes_impedance.diagnosis.selection.unnamed import stand_in_network
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.tree import Parallel, Series
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population.starting_fits import thinned_points

_PEOPLE = 24
"""People with whom a network is grown. By choice: standard errors over people are then known to 15 %."""

_MOST_BRANCHES = 4
"""Largest number of branches that are added. By choice: up to 16 elements before pruning, twice those of a finger."""

_OVERSHOOT = 2
"""Number of elements before pruning, over the largest allowed, from which no branch is added. By choice: pruning more
than half of the elements would be a search of its own."""

_NEW_SPREAD = 0.1
"""Standard deviation between people at which an element that was the same for all starts to differ. By choice: a third
of a typical one, because an element cannot start to differ from a dispersion of zero."""

_ROUNDS = 40
"""Largest number of rounds of a refit, which begins at the fit with one branch less or one element more."""

_RANKING_ROUNDS = 8
"""Rounds after which the element whose removal costs least is chosen. By choice: only that one is fitted to rest."""


def grown_network(
    refitter: Refitter, base: Refit, names: Sequence[str], seed: int, executor: Executor, most: int | None = None
) -> Refit | None:
    """The fit, to all people, of the claimed network with more elements; None if no element improves predictions.

    Parameters
    ----------
    refitter : Refitter
    base : Refit
        Of the claimed network alone.
    names : sequence of str
        Of the people.
    seed : int
    executor : Executor
    most : int, optional
        Largest number of elements that the network may have more than the claimed one.
    """
    n = len(refitter.data)
    if n < FEWEST_PEOPLE or base.model.additions:
        return None
    some = np.unique(np.linspace(0, n - 1, min(n, _PEOPLE)).round().astype(int))
    rows = np.isin(base.owner, some)
    small = Refitter([_thinned(refitter.data[i]) for i in some], executor)
    fit = small.settle(small.fit(base.model, base.u[rows], base.population, _ROUNDS), seed, tries=3, rounds=1)
    start = fit
    for _ in range(_MOST_BRANCHES):
        # With a further branch, elements that the claimed network has driven to nothing come back.
        residuals = person_residuals(fit, [names[i] for i in some], executor, returning=True)
        if fit is not start and locate(residuals, seed).p_value >= STRUCTURE_ALPHA:
            break
        branch = stand_in_network(small, fit, residuals, missing_one_ports(fit, residuals), seed, executor)
        if branch is None or (most is not None and _more(fit, start) > _OVERSHOOT * most):
            break
        fit = small.settle(_as_elements(small, branch.trial.fit), seed, tries=3, rounds=1)
    if fit is start:
        return None
    fit = _pruned(small, fit, seed)
    if set(fit.model.network.elements) <= set(start.model.network.elements):
        return None
    if most is not None and _more(fit, start) > most:
        return None
    # Everybody starts at the centre of the people with whom the network was grown.
    whole = refitter.fit(fit.model, np.tile(fit.population.mu, (len(base.u), 1)), fit.population, 2 * _ROUNDS)
    return refitter.settle(whole, seed)


def _more(fit: Refit, start: Refit) -> int:
    return len(fit.model.kernel.elements) - len(start.model.kernel.elements)


def _thinned(d: Likelihood) -> Likelihood:
    """A person's recordings at a few dozen frequencies."""
    return d.at(thinned_points(d.omega.size))


def _as_elements(refitter: Refitter, fit: Refit) -> Refit:
    """The same fit with its branches as elements of the network, which differ between people like all others."""
    return _refitted(refitter, fit, parse(fit.model.notation))


def _refitted(refitter: Refitter, fit: Refit, network: Network, rounds: int = _ROUNDS) -> Refit:
    """Refit of a network of elements that `fit` has as well, from its values."""
    model = build(network, (), fit.model.scales, ())
    own = list(fit.model.kernel.elements)
    columns = [own.index(e) for e in network.elements]
    varying = np.flatnonzero(~fit.model.shared)
    spread = np.full(len(own), _NEW_SPREAD)
    rho = np.zeros(len(own))
    rho[varying] = fit.population.rho
    covariance = np.diag(spread**2)
    covariance[np.ix_(varying, varying)] = fit.population.covariance
    mean = fit.u.mean(axis=0)
    mean[varying] = fit.population.mu
    population = Population(mean[columns], covariance[np.ix_(columns, columns)], np.maximum(rho[columns], 1e-3))
    return refitter.fit(model, fit.u[:, columns], population, rounds)


def _pruned(refitter: Refitter, fit: Refit, seed: int) -> Refit:
    """The network without elements that do not improve the prediction of held-out people."""
    while len(fit.model.network.elements) > 2:
        smaller = [
            _refitted(refitter, fit, rest, _RANKING_ROUNDS)
            for e in fit.model.network.elements
            if (rest := without_element(fit.model.network, e)) is not None
        ]
        smaller = [s for s in smaller if np.isfinite(s.evidence).all()]
        if not smaller:
            return fit
        best = max(smaller, key=lambda s: float(s.evidence.sum()))
        best = refitter.settle(refitter.fit(best.model, best.u, best.population, _ROUNDS), seed, tries=2, rounds=1)
        loss, se = people_gain(refitter, best, fit, seed)
        if loss > SCATTERS * (se or 0.0):
            return fit
        fit = best
    return fit


def without_element(network: Network, element: str) -> Network | None:
    """A network without one element; None if nothing would be left.

    Parameters
    ----------
    network : Network
    element : str
    """
    if not network.parts:
        return None if element in network.elements else network
    parts = [part for part in (without_element(p, element) for p in network.parts) if part is not None]
    if len(parts) == len(network.parts):
        return network.with_parts(parts)
    if not isinstance(network, (Parallel, Series)):  # what wraps nothing is nothing
        return None
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else network.with_parts(parts)
