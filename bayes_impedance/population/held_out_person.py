r"""The log density of somebody whom a fit has not seen, under each of its population draws.

With draws :math:`\phi_s` of the population parameters from a fit of the others, the predictive density of person i is
:math:`p(z_i|z_{-i}) \approx S^{-1}\sum_s p(z_i|\phi_s)`. The terms are those of
:mod:`bayes_impedance.population.person_densities`: the person's mode is sought under the mean population from several
starting points, and importance draws are made there. The noise has to be given with the recordings; its scale is
integrated out.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.person.heavy_noise import reweighted, squared_scale, squares_at
from bayes_impedance.person.heavy_noise import weights_of as weights_of_points
from bayes_impedance.person.importance_draws import widening
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.population.e_step import PersonFit, expect, squared_distances
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.heavy_tails import weights_of
from bayes_impedance.population.moved_dispersions import DispersionRange
from bayes_impedance.population.posterior import FEWEST_DRAWS, RARELY
from bayes_impedance.population.recording_noise import noise_of
from bayes_impedance.population.sharded_likelihood import part_of
from bayes_impedance.population.shared import Placed
from bayes_impedance.recordings.files import Subject

_STARTS = 32
"""Starting points from the population, besides its mean. By choice: a person is not far from the population, and its
other modes are tried as well."""
_MOST_ROUNDS, _AT_REST = 30, 1e-3
"""Rounds in which mode and deviations are found in turn, at most, and the change of the deviations, relative to their
dispersion, at which they end. By choice: the draws correct for what remains."""
_REWEIGHTED = 3
"""Times that the weight of a person in a population with tails, or those of points whose noise has tails, and the mode
under them, are found in turn. By choice: the draws correct for what remains."""
_MORE_DRAWS = 8
"""Times as many draws as the fit takes for each person. By choice: there is only one person here."""


def held_out_log_densities(fit: PopulationFit, person: Subject, seed: np.random.SeedSequence) -> np.ndarray:
    """Log density of a person's recordings under the population draws of a fit of others.

    Parameters
    ----------
    fit : PopulationFit
        Of two persons or more, without this one.
    person : Subject
        With the standard deviation of its noise, and the covariates of the fit if it has any.
    seed : SeedSequence

    Returns
    -------
    ndarray, shape (E S,)
        Natural logarithms of the density of real and imaginary parts in the unit of the recordings.
    """
    p, elements = fit.parameters, len(fit.kernel.elements)
    covariates = _standardised(fit, person)
    rho = np.maximum(np.median(p.between_repetitions, axis=0), LEAST_RHO)
    stretch = 1.0  # of somebody far from the others
    mean = p.mu.mean(axis=0) + p.slopes.mean(axis=0) @ covariates
    covariance = p.covariance.mean(axis=0) + np.diag(rho**2) / len(person.repetitions)
    nothing = np.zeros((len(person.repetitions), elements))
    likelihood = Likelihood.make(person.frequency_hz, person.z, noise_of(person, None), nothing)
    searching, drawing, again = seed.spawn(3)
    found = _mode(fit, likelihood, mean, covariance, rho, searching)
    if fit.noise_weights is not None and fit.noise_tail is not None:
        degrees, plain = float(1 / fit.noise_tail[0]), likelihood
        for _ in range(_REWEIGHTED):
            square = squares_at(fit.kernel, plain.moved(found.deviations), found.theta)
            weights = weights_of_points(square / squared_scale(square, degrees, found.deviations.size), degrees)
            likelihood = reweighted(plain, weights, degrees)
            found = _mode(fit, likelihood, mean, covariance, rho, searching)
    if p.tail is not None:
        precision, tail = np.linalg.inv(covariance), float(p.tail.mean())
        for _ in range(_REWEIGHTED):
            weight = weights_of(squared_distances([found], mean[None], precision), tail, elements)[0]
            stretch = max(1 / weight, 1.0)
            found = _mode(fit, likelihood, mean, stretch * covariance, rho, searching)
    span = DispersionRange.of_draws(p.between_repetitions, [found])
    wide = covariance * widening(len(fit.recordings.subjects)) ** 2
    for child, along_valley in ((drawing, False), (again, True)):
        part = part_of(
            fit.kernel,
            rho,
            [likelihood],
            [found],
            mean[None],
            wide,
            covariates[None],
            _MORE_DRAWS * fit.settings.draws,
            [child],
            along_valley,
            span,
            np.array([stretch]),
        )
        effective = part.marginal.terms(p, effective=True)[1]
        if np.quantile(effective, RARELY) >= FEWEST_DRAWS:
            break
    return part.log_densities(p)[:, 0]


def _mode(
    fit: PopulationFit,
    likelihood: Likelihood,
    mean: np.ndarray,
    covariance: np.ndarray,
    rho: np.ndarray,
    seed: np.random.SeedSequence,
) -> PersonFit:
    """The person's mode and the deviations of the repetitions, one after the other until they rest."""
    points = np.random.default_rng(seed).normal(size=(_STARTS, mean.size))
    starts = mean + points @ np.linalg.cholesky(covariance).T
    precision, least = np.linalg.inv(covariance), np.maximum(rho, LEAST_RHO)
    before: Placed | PersonFit = Placed(mean, likelihood.deviations)
    for k in range(_MOST_ROUNDS):
        own = starts if k in (0, 2) else starts[:0]
        found = expect(fit.kernel, precision, rho, likelihood, before, mean, own)
        if k > 2 and np.abs((found.deviations - before.deviations) / least).max() < _AT_REST:
            break
        before = found
    return found


def _standardised(fit: PopulationFit, person: Subject) -> np.ndarray:
    """The person's covariates, shape (Q,), on the scale on which those of the fit have mean 0 and deviation 1."""
    names = fit.settings.covariates
    others = np.array([[float(s.covariates[name]) for name in names] for s in fit.recordings.subjects])
    own = np.array([float(person.covariates[name]) for name in names])
    return np.asarray((own - others.mean(axis=0)) / others.std(axis=0)) if names else np.zeros(0)
