r"""An explanation measured: its dispersions, and the joint posterior of its additions.

A quick refit has typical dispersions, and every person's shapes where they started. Before an explanation is believed,
everybody's frequencies are searched (:mod:`.shape_starts`), dispersions are taken from the posterior
(:mod:`.coefficient_posterior`), and the model is fitted with them.

**In some people.** A fit holds everybody's coefficient to one normal distribution, the mean of which lies between those
who have an effect and those who lack it. It is wide, and members who determine their own coefficient are found where
they are. Where coefficient and time constant can only be told together, along a curved ridge, a member is held to a
point of it that is too near to zero, and what is expanded there is off: the compliance of 13 people's layer was 20 %
too small and its time constant 20 % too long, both by 2.5 standard deviations. So members are fitted again under their
own distribution, as the posterior gives it, with everything else held; their likelihoods are expanded there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior, coefficient_posterior
from bayes_impedance.diagnosis.fit.extend import extended_start, with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.normal_equations import Equations
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.shape_starts import searched_shapes
from bayes_impedance.diagnosis.fit.spike_slab import members

_PASSES, _ROUNDS = 2, 20
"""How often members are fitted under their own distribution, and rounds of each. By choice: the second time the
distribution is that of the first, and changes little."""

_DISPERSIONS = (0.03, 1.5)
"""Bounds of the relative dispersions that are taken over from a posterior. By choice: below the first, a coefficient is
nearly shared; above the second, a coefficient of one sign cannot vary."""


def measured(refitter: Refitter, fit: Refit, seed: int) -> tuple[Refit, CoefficientPosterior]:
    """The fit with dispersions at their posterior medians, and the joint posterior of the additions."""
    fit = searched_shapes(refitter, fit)
    posterior = posterior_of(refitter, fit, seed)
    for _ in range(2):
        if all(a.pooling == "shared" for a in fit.model.additions):
            break
        fit = with_measured_dispersions(refitter, fit, posterior)
        posterior = posterior_of(refitter, fit, seed)
    return fit, posterior


def posterior_of(refitter: Refitter, fit: Refit, seed: int) -> CoefficientPosterior:
    """Joint posterior of the additions, of what only some have from those who have it.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Of a model with at least one addition.
    seed : int
    """
    posterior = coefficient_posterior(fit, seed)
    if any(a.absent_in_some for a in fit.model.additions):
        for _ in range(_PASSES):
            posterior = coefficient_posterior(_under_their_own(refitter, fit, posterior), seed)
    return posterior


def with_measured_dispersions(refitter: Refitter, fit: Refit, posterior: CoefficientPosterior) -> Refit:
    """Refit with the dispersions of varying parameters at their posterior medians."""
    model = fit.model
    for i, addition in enumerate(model.additions):
        if addition.pooling != "shared":
            middle = _medians(fit, i, posterior)
            if addition.absent_in_some:  # the posterior's is among those who have it, that of a fit among all
                middle[0] = addition.dispersion
            model = with_pooling(model, i, addition.pooling, middle)
    return refitter.fit(model, *extended_start(fit, model))


def _medians(fit: Refit, addition: int, posterior: CoefficientPosterior) -> list[float]:
    """Medians of an addition's relative dispersions, within what may be taken over."""
    columns = [c - fit.model.n_elements for c in fit.model.columns(addition)]
    middle = np.clip(np.median(posterior.relative_dispersion[:, columns], axis=0), *_DISPERSIONS)
    return [float(value) for value in middle]


def _under_their_own(refitter: Refitter, fit: Refit, posterior: CoefficientPosterior) -> Refit:
    """The fit with the parameters of members where they are under the distribution of those who have an effect."""
    for i, addition in enumerate(fit.model.additions):
        who = members(fit, i) if addition.absent_in_some else None
        has_it = np.zeros(0, dtype=bool) if who is None or not who.only_some else who.probability >= 0.5
        if not has_it.any():
            continue
        model = with_pooling(fit.model, i, addition.pooling, _medians(fit, i, posterior))
        mu, place = fit.population.mu.copy(), np.cumsum(~model.shared) - 1
        for column in model.columns(i):
            if not model.shared[column]:
                mu[place[column]] = posterior.central[:, column - model.n_elements].mean()
        population, rows = replace(fit.population, mu=mu), np.flatnonzero(has_it[fit.owner])
        few = refitter.subset(np.flatnonzero(has_it))
        there = few.fit(model, fit.u[rows], population, _ROUNDS, hold_population=True, hold_additions=True)
        u, known, own = fit.u.copy(), fit.equations, there.equations
        equations = Equations(known.chi.copy(), known.gradient.copy(), known.information.copy())
        u[rows], equations.chi[rows] = there.u, own.chi
        equations.gradient[rows], equations.information[rows] = own.gradient, own.information
        fit = replace(fit, u=u, equations=equations)
    return fit
