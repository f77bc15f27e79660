"""Elements that a fit has lost, searched with everything else held.

A model that lacks a standing wave describes people without the weak branch that they have: its elements go to zero or
infinity, where the impedance no longer depends on them. Once the wave is there, the branch could come back, but does
not from where it is; a relaxation takes its place, which is the same curve by another name. And a cold start of *all*
elements loses the resonances that were found. So before an addition is believed, the lost elements alone are searched
in its place, with all others where they are beside it: on a grid around the values at which their impedance has the
recordings' magnitude in the middle of the band, and by descents from its best points, the same for everybody. The fit
begins at what describes people best.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from bayes_impedance.diagnosis.fit.cold_start import TYPICAL, TYPICAL_REPETITIONS, driven_away
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.normal_equations import counts, equations_at, weights_of
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.elements import KINDS, band_scale
from bayes_impedance.person.likelihood import SCALE_SHAPE

_REACH = 8.0
"""Logarithm of the largest factor from the middle of the band's magnitude. By choice: at the ends of a wide band the
magnitude is another one by factors of a thousand."""

_POINTS = {1: 25, 2: 15, 3: 6}
"""Points of the grid for each of so many lost elements. By choice: about two hundred in all, a factor of 3 apart for
two. With more lost elements there is nothing left that holds the others."""

_DESCENTS, _STEPS, _DAMPING = 3, 12, 0.01
"""Best points of the grid from which a search descends, its largest number of steps, and its first damping. By choice:
the grid is coarser than a valley."""

_PEOPLE = 8
"""People with whom the elements are searched, spread over all. By choice: values that are the same for everybody need
no more, and the fit that begins there is of all."""

_FELT = 1.0
"""Information of a person's recordings on a log element below which they do not feel it: a factor of e is not told."""

_WORTH = 3.0
"""Gain of log likelihood at the best point from which a fit begins there: what decides between explanations."""


def lost_elements(fit: Refit) -> np.ndarray:
    """Which elements of the network a fit has driven away, or to where most people's recordings do not feel them.

    Parameters
    ----------
    fit : Refit

    Returns
    -------
    ndarray of bool, shape (n_elements,)
    """
    n, people = fit.model.n_elements, len(fit.data)
    weight = weights_of(fit.owner, counts(fit.data), fit.equations.chi)[fit.owner]
    felt = np.zeros((people, n))
    np.add.at(felt, fit.owner, weight[:, None] * np.einsum("mpp->mp", fit.equations.information)[:, :n])
    known = np.array([name[:1] in KINDS for name in fit.model.network.elements])
    return driven_away(fit) | (known & (np.median(felt, axis=0) < _FELT))


def with_lost_elements(refitter: Refitter, fit: Refit, begin: np.ndarray, lost: np.ndarray, rounds: int) -> Refit:
    """The fit, or one that begins where lost elements describe people best, if that has more evidence.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    begin : ndarray, shape (M, P)
        Parameters that are held while the lost elements are searched.
    lost : ndarray of bool, shape (n_elements,)
        Elements of the network that may have been lost.
    rounds : int
        Of the new fit.
    """
    which = np.flatnonzero(lost)
    if which.size not in _POINTS or refitter.one_person:
        return fit
    scales, names = fit.model.scales, fit.model.network.elements
    centre = np.array([band_scale(names[k], scales.z_middle, scales.middle / (2 * np.pi)) for k in which])
    steps = np.linspace(-_REACH, _REACH, _POINTS[which.size])
    some = np.unique(np.linspace(0, len(refitter.data) - 1, _PEOPLE).round().astype(int))
    few, rows = refitter.subset(some), np.flatnonzero(np.isin(fit.owner, some))
    least = _misfit(few, fit.model, begin[rows])[0] - _WORTH
    points = [_set(begin[rows], which, centre + offset) for offset in product(steps, repeat=which.size)]
    order = np.argsort([_misfit(few, fit.model, u)[0] for u in points])
    value, values = min(
        (_descended(few, fit.model, points[k], which) for k in order[:_DESCENTS]), key=lambda end: end[0]
    )  # fmt: skip
    if not value < least:
        return fit
    start = _set(begin, which, values)
    mu, covariance, rho = (x.copy() for x in (fit.population.mu, fit.population.covariance, fit.population.rho))
    mu[which], rho[which] = values, TYPICAL_REPETITIONS
    covariance[which], covariance[:, which] = 0.0, 0.0
    covariance[which, which] = TYPICAL**2
    found = refitter.fit(fit.model, start, replace(fit.population, mu=mu, covariance=covariance, rho=rho), rounds)
    return found if found.evidence.sum() > fit.evidence.sum() else fit


def _set(u: np.ndarray, which: np.ndarray, values: np.ndarray) -> np.ndarray:
    u = u.copy()
    u[:, which] = values
    return u


def _descended(refitter: Refitter, model: Model, u: np.ndarray, which: np.ndarray) -> tuple[float, np.ndarray]:
    """Least misfit, and the values of some elements there, the same for everybody, by damped Gauss-Newton steps."""
    value, slope, curvature = _misfit(refitter, model, u, which)
    damping = _DAMPING
    for _ in range(_STEPS):
        diagonal = np.diag(curvature)
        step = np.linalg.solve(curvature + np.diag(damping * diagonal + np.finfo(float).tiny), -slope)
        tried = _set(u, which, u[0, which] + np.clip(step, -1.0, 1.0))
        end = _misfit(refitter, model, tried, which)
        if end[0] < value:
            (value, slope, curvature), u, damping = end, tried, 0.1 * damping
        else:
            damping *= 10.0
    return value, u[0, which]


def _misfit(
    refitter: Refitter, model: Model, u: np.ndarray, which: np.ndarray | None = None
) -> tuple[float, np.ndarray, np.ndarray]:
    """Negative log likelihood of all people at u (M, P), scales integrated out; slope and curvature of some."""
    which = np.arange(0) if which is None else which
    equations, n = equations_at(model, refitter.stack, u, refitter.executor), counts(refitter.data)
    own = np.bincount(refitter.owner, equations.chi, minlength=n.size)
    value = float(np.sum((SCALE_SHAPE + n) * np.log(SCALE_SHAPE + 0.5 * own)))
    weight = weights_of(refitter.owner, n, equations.chi)[refitter.owner]
    curvature = np.einsum("m,mpq->pq", weight, equations.information[:, which][:, :, which])
    return value if np.isfinite(value) else np.inf, weight @ equations.gradient[:, which], curvature
