"""One person's importance draws under a population, and how they change with all that is common to everybody.

Draws are made at one value of the parameters that are the same for everybody and of the dispersions between
repetitions. Where these are elsewhere, the draws' likelihoods are polynomials in them
(:mod:`bayes_impedance.population.shared_draws`, :mod:`bayes_impedance.population.moved_dispersions`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.absolute_density import deviations_of, log_constant
from bayes_impedance.person.choosing import Nearby
from bayes_impedance.person.condensed import NODES_PER_DECADE, condensed, holds
from bayes_impedance.person.importance_draws import Draws, Reference, draw
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import Ridge, find_ridge
from bayes_impedance.population.e_step import PersonFit
from bayes_impedance.population.moved_dispersions import DispersionRange, with_responses
from bayes_impedance.population.shared import SharedEquations
from bayes_impedance.population.shared_draws import Moved, Sharing, moved


@dataclass(frozen=True, kw_only=True)
class DrawingPlan:
    """Settings common to the draws of all persons.

    Attributes
    ----------
    kernel : Kernel
        Of the P parameters that differ between people.
    rho : ndarray, shape (P,)
        Dispersion between repetitions at which deviations are integrated out.
    covariance : ndarray, shape (P, P)
        Of the reference population, already widened.
    n_draws : int
        For each person, a power of two.
    along_valley : bool
        Propose along each person's curved valley.
    sharing : Sharing or None
        How far parameters that are the same for everybody may move.
    span : DispersionRange or None
        How far dispersions between repetitions may move.
    near : Nearby, optional
        Populations for which draws are chosen.
    """

    kernel: Kernel
    rho: np.ndarray
    covariance: np.ndarray
    n_draws: int
    along_valley: bool
    sharing: Sharing | None
    span: DispersionRange | None
    near: Nearby | None = None


@dataclass(frozen=True)
class PersonDraws:
    """One person's draws, and how their likelihoods change.

    Attributes
    ----------
    draws : Draws
    moved : Moved or None
        With the parameters that are the same for everybody.
    response : ndarray, shape (M, K), or None
        With dispersions between repetitions: coefficients of :meth:`DispersionRange.terms`.
    """

    draws: Draws
    moved: Moved | None
    response: np.ndarray | None


def draws_of(
    plan: DrawingPlan,
    likelihood: Likelihood,
    fit: PersonFit,
    equations: SharedEquations | None,
    mean: np.ndarray,
    seed: np.random.SeedSequence,
    stretch: float = 1.0,
) -> PersonDraws:
    """Draw for one person, whose fit is a mode and the deviations there, under a population of the given mean (P,).

    In a population with heavier tails its covariance is stretched for a person far from the others.
    """
    likelihood = likelihood.moved(fit.deviations)
    # The ridge fixes rho; contrasts and the draws' responses give the likelihood of other values of rho.
    ridge = find_ridge(plan.kernel, likelihood, fit.theta, fit.mode.scale, plan.rho)
    reference = Reference(mean, stretch * plan.covariance)
    deviations = deviations_of(plan.kernel, likelihood, fit.theta)
    constant = log_constant(likelihood, ridge, deviations)
    draws, likelihood = _drawn(plan, likelihood, fit, ridge, reference, seed)
    draws = replace(draws, constant=constant, deviations=deviations)
    response, along = None, None
    if plan.span is not None:
        draws, response = with_responses(plan.kernel, plan.span, likelihood, fit, ridge, draws)
    if plan.sharing is not None and equations is not None:
        draws, along = moved(plan.sharing, equations, likelihood, ridge, reference, draws)
    return PersonDraws(draws, along, response)


def _drawn(
    plan: DrawingPlan,
    likelihood: Likelihood,
    fit: PersonFit,
    ridge: Ridge,
    reference: Reference,
    seed: np.random.SeedSequence,
) -> tuple[Draws, Likelihood]:
    """Draws, and the recordings from which their likelihood was computed: summed up where that changes nothing."""
    for per_decade in NODES_PER_DECADE:
        small = condensed(plan.kernel, likelihood, fit.theta, per_decade)
        if small is None:
            break
        draws = draw(plan.kernel, small, fit.mode, ridge, reference, plan.n_draws, seed, plan.along_valley, plan.near)
        if holds(plan.kernel, likelihood, small, ridge, draws.theta, draws.log_weight):
            return draws, small
    draws = draw(plan.kernel, likelihood, fit.mode, ridge, reference, plan.n_draws, seed, plan.along_valley, plan.near)
    return draws, likelihood
