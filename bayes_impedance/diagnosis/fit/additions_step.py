r"""A step of shared parameters and mean coefficients, to which everybody's elements respond.

The objective F is the data's misfit with the prior of the additions and with everybody's deviation from the mean
(:mod:`.normal_equations`). The last two are quadratic, so F changes along a step by what the quadratic expansion says,
give or take the error of what that says of the misfit. That the misfit falls would be too much to ask: near the end it
grows along the way to the optimum, and the additions would be left where they are. What the expansion leaves out of the
marginal likelihood is :mod:`.shape_force`.

Dispersions of coefficients are a share of the mean, and are held in a step. Afterwards they go half of the way to the
share of the new mean: where the mean is smaller the wider people differ, it would go to and fro otherwise, a standard
deviation each way without end beside a delay of the rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model, with_dispersions
from bayes_impedance.diagnosis.fit.normal_equations import Population, Stack, equations_at, marginal, quadratic
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.rounds import Layout, State, log_misfit, means_of
from bayes_impedance.diagnosis.fit.shape_force import shape_force
from bayes_impedance.person.likelihood import Likelihood

_LONGEST_STEP, _LONGEST_SHARE = 1.0, 0.3
"""Largest step of the additions, in prior standard deviations or units of the coefficient, and as a share of it if that
is more: a filter in the middle of the band has 100 units. By choice."""

_TRIES, _SHORTER = 6, 0.3
"""Lengths that are tried, and the factor between them. By choice: the last is 0.2 % of the first."""

_DESCENT = 0.25
"""Share of the promised descent that a step must bring. By choice: a step that is twice too long brings none, and would
be taken to and fro without end."""

_ROUNDING = 1e-3
"""Log likelihood by which the objective may grow in a step. By choice: no finding depends on it."""

_LONGEST_RESPONSE = 1.0
"""Largest change of an element's logarithm in a step. By choice."""

_BEGINS = 5.0
"""Factor between dispersions from which the whole way is gone at once. By choice: a coefficient that begins at zero
does not differ between people."""


def move_additions(
    data: Sequence[Likelihood],
    layout: Layout,
    stack: Stack,
    executor: Executor,
    model: Model,
    state: State,
    share: float,
) -> tuple[State, float, float]:
    """One step, shortened until the objective descends.

    Parameters
    ----------
    data : sequence of Likelihood
        One per person.
    layout : Layout
    stack : Stack
        Of the data, or of recordings that are summed up.
    executor : Executor
    model : Model
    state : State
    share : float
        Of the whole step, to be tried first: the last one that descended.

    Returns
    -------
    state : State
    share : float
        To be tried first in the next step.
    length : float
        Of the step that leads to the optimum, in standard deviations, or the change of a dispersion's logarithm that
        is left, if that is more; 0 if no step descends.
    """
    u, population, n = state.u, state.population, len(data)
    e, a = slice(0, model.n_elements), slice(model.n_elements, None)
    varying = ~model.shared[a]
    h, d, response = quadratic(model, data, u, state.equations, population.covariance)
    now, tau = _central(model, u, population), _dispersion(model, population)
    target = marginal(model, h, d, tau)
    y = means_of(u[:, a], layout.owner, n)
    beside = shape_force(model, h, d, y, tau, now, target.precision)
    whole = target.mean - now + np.linalg.solve(target.precision, beside)
    force = target.precision @ whole
    prior = np.array([p.prior_sd for p in model.parameters])
    linear = np.array([p.is_coefficient for p in model.parameters])
    longest = np.maximum(_LONGEST_STEP * np.minimum(prior, 1.0), _LONGEST_SHARE * np.abs(now) * linear)
    part = begun = share / max(1.0, float(np.abs(whole / longest).max()))
    follows = _follows(d, tau, varying)
    pull = h - np.einsum("nab,nb->na", d, y)
    for _ in range(_TRIES):
        step = part * whole
        own = np.tile(step, (n, 1))
        own[:, varying] = follows @ step[varying]
        trial = _moved(u, own[layout.owner], response)
        equations = equations_at(model, stack, trial, executor)
        said = float(np.sum(0.5 * np.einsum("na,nab,nb->n", own, d, own) - np.sum(pull * own, axis=1)))
        misfit = float(np.sum(log_misfit(layout, equations.chi) - log_misfit(layout, state.equations.chi)))
        change = misfit - said - float(force @ step) + 0.5 * float(step @ target.precision @ step)
        promised = part * (1 - 0.5 * part) * float(force @ whole)
        if change <= _ROUNDING - _DESCENT * promised:
            mu = population.mu.copy()
            mu[a] += step[varying]
            persons = state.persons.copy()
            persons[:, a] += own[:, varying]
            persons[:, e] += means_of(trial[:, e] - u[:, e], layout.owner, n)
            covariance, left = _half_way(model, population.covariance, mu)
            shifted = replace(population, mu=mu, covariance=covariance)
            state = replace(state, u=trial, persons=persons, population=shifted, equations=equations)
            length = max(left, float(np.sqrt(max(whole @ target.precision @ whole, 0.0))))
            share = share / _SHORTER if part == begun else share * part / begun
            return state, min(1.0, share), length
        part *= _SHORTER
    return state, 1.0, 0.0


def central_values(fit: Refit) -> np.ndarray:
    """Shared parameters and means of varying ones of the additions, shape (A,)."""
    return _central(fit.model, fit.u, fit.population)


def following(fit: Refit, step: np.ndarray) -> Refit:
    """Parameters and population where they are expected after a step of the central values (A,), to fit from there."""
    model, population = fit.model, fit.population
    varying = ~model.shared[model.n_elements :]
    _, d, response = quadratic(model, fit.data, fit.u, fit.equations, population.covariance)
    own = np.tile(step, (len(fit.data), 1))
    own[:, varying] = _follows(d, _dispersion(model, population), varying) @ step[varying]
    mu = population.mu.copy()
    mu[model.n_elements :] += step[varying]
    return replace(fit, u=_moved(fit.u, own[fit.owner], response), population=replace(population, mu=mu))


def _central(model: Model, u: np.ndarray, population: Population) -> np.ndarray:
    now = u[0, model.n_elements :].copy()
    now[~model.shared[model.n_elements :]] = population.mu[model.n_elements :]
    return now


def _dispersion(model: Model, population: Population) -> np.ndarray:
    """Standard deviations of the additions' parameters between people, zero of shared ones, shape (A,)."""
    tau = np.zeros(len(model.parameters))
    tau[~model.shared[model.n_elements :]] = np.sqrt(np.diag(population.covariance)[model.n_elements :])
    return tau


def _follows(d: np.ndarray, tau: np.ndarray, varying: np.ndarray) -> np.ndarray:
    """How each person's coefficients follow the population's means, shape (N, C, C).

    A well-determined coefficient does not: dc_i/dmu = (1 + T D_cc)^-1.
    """
    inside = np.eye(int(varying.sum())) + np.diag(tau[varying] ** 2) @ d[:, varying][:, :, varying]
    return np.asarray(np.linalg.inv(inside))


def _half_way(model: Model, covariance: np.ndarray, mu: np.ndarray) -> tuple[np.ndarray, float]:
    """The covariance with dispersions half of the way to their share of the mean, and the largest log change left."""
    wanted = with_dispersions(model, covariance, mu)
    change = 0.5 * np.log(np.diag(wanted) / np.diag(covariance))
    left = np.where(np.abs(change) > np.log(_BEGINS), 0.0, 0.5 * change)
    shorter = np.exp(-left)
    return wanted * np.outer(shorter, shorter), float(np.abs(left).max())


def _moved(u: np.ndarray, own: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Parameters after a step (M, A) of the additions', to which the elements respond."""
    size = response.shape[1]
    trial = u.copy()
    trial[:, size:] += own
    trial[:, :size] += np.clip(np.einsum("mea,ma->me", response, own), -_LONGEST_RESPONSE, _LONGEST_RESPONSE)
    return trial
