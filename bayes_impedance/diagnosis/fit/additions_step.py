r"""A step of shared parameters and mean coefficients, to which everybody's elements respond.

The objective F is the data's misfit with the prior of the additions and with everybody's deviation from the mean
(:mod:`.normal_equations`). The last two are quadratic, so F changes along a step by what the quadratic expansion says,
give or take the error of what that says of the misfit. That the misfit falls would be too much to ask: near the end it
grows along the way to the optimum, and the additions would be left where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model, with_dispersions
from bayes_impedance.diagnosis.fit.normal_equations import Stack, equations_at, marginal, quadratic
from bayes_impedance.diagnosis.fit.rounds import Layout, State, log_misfit, means_of
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
        Of the step that leads to the optimum, in standard deviations; 0 if no step descends.
    """
    u, population, n = state.u, state.population, len(data)
    e, a = slice(0, model.n_elements), slice(model.n_elements, None)
    varying = ~model.shared[a]
    h, d, response = quadratic(model, data, u, state.equations, population.covariance)
    now = u[0, a].copy()
    now[varying] = population.mu[a]
    tau = np.zeros(now.size)
    tau[varying] = np.sqrt(np.diag(population.covariance)[a])
    target = marginal(model, h, d, tau)
    whole = target.mean - now
    force = target.precision @ whole
    prior = np.array([p.prior_sd for p in model.parameters])
    linear = np.array([p.is_coefficient for p in model.parameters])
    longest = np.maximum(_LONGEST_STEP * np.minimum(prior, 1.0), _LONGEST_SHARE * np.abs(now) * linear)
    part = begun = share / max(1.0, float(np.abs(whole / longest).max()))
    # A well-determined coefficient does not follow the population's mean: dc_i/dmu = (1 + T D_cc)^-1.
    follows = np.linalg.inv(np.eye(int(varying.sum())) + np.diag(tau[varying] ** 2) @ d[:, varying][:, :, varying])
    pull = h - np.einsum("nab,nb->na", d, means_of(u[:, a], layout.owner, n))
    for _ in range(_TRIES):
        step = part * whole
        own = np.tile(step, (n, 1))
        own[:, varying] = follows @ step[varying]
        trial = u.copy()
        trial[:, a] += own[layout.owner]
        moved = np.einsum("mea,ma->me", response, own[layout.owner])
        trial[:, e] += np.clip(moved, -_LONGEST_RESPONSE, _LONGEST_RESPONSE)
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
            shifted = replace(population, mu=mu, covariance=with_dispersions(model, population.covariance, mu))
            state = replace(state, u=trial, persons=persons, population=shifted, equations=equations)
            length = float(np.sqrt(max(whole @ target.precision @ whole, 0.0)))
            share = share / _SHORTER if part == begun else share * part / begun
            return state, min(1.0, share), length
        part *= _SHORTER
    return state, 1.0, 0.0
