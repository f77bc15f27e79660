"""Starts that do not depend on where a wrong model has left the elements.

A network that lacks something describes people by elements that nobody has: some are driven towards zero or infinity,
where the impedance no longer depends on their logarithm. A refit with the missing effect that begins there stays there,
and a right explanation loses against a wrong one. So refits also begin *cold*: all people at the median person's
elements, with a typical dispersion, and elements that were driven away at the value at which their impedance has the
recordings' magnitude in the middle of the band.

Where everybody has a sharp resonance of their own, nobody is described by the median person's. So they also begin with
**the lost elements alone** at that value, and all others where they are in each recording: beside a resonance of the
rig, from the median person 390 thousand units of log evidence were missing in 57 people, whose undamped branch
resonates elsewhere in each, and from there the refit is 670 ahead of the one that keeps all elements. In eighteen
populations of ``analyses/other_worlds`` with elements driven away, at the missing effect's true shape, this start ended
highest in three, that of the median person in five, both in one, and neither was better than the fit's own elements in
nine.

They also begin at the elements of the best explanation found so far.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.elements import KINDS, band_scale

_DRIVEN_AWAY = 0.6
"""Standard deviation of a log element between people above which a model may have driven it away: a factor of 1.8.
People differ by 0.2 to 0.5; elements that a missing effect had driven away showed 0.9 to 1.8."""

TYPICAL = 0.3
"""Standard deviation of the log elements between people at the start: a typical one."""

TYPICAL_REPETITIONS = 0.03
"""The same between repetitions. By choice: small, so that a person's repetitions begin together."""


def driven_away(fit: Refit) -> np.ndarray:
    """Which elements of the network a model may have driven away from everybody's values: bool, shape (P,)."""
    sd = np.sqrt(np.diag(fit.population.covariance))[: fit.model.n_elements]
    known = np.array([name[:1] in KINDS for name in fit.model.network.elements])
    return np.asarray(known & (sd > _DRIVEN_AWAY))


def cold_start(without: Refit, grown: Refit) -> tuple[np.ndarray, Population]:
    """Start of another refit of a model, whose additions begin where they are.

    Parameters
    ----------
    without : Refit
        Of the model without its last addition, or of the same model: where elements may have been driven away.
    grown : Refit
        Of the model.

    Returns
    -------
    u : ndarray, shape (M, P)
    population : Population
    """
    n, scales = grown.model.n_elements, grown.model.scales
    centre = np.median(without.persons[:, :n], axis=0)
    for k in np.flatnonzero(driven_away(without)).tolist():
        centre[k] = band_scale(grown.model.network.elements[k], scales.z_middle, scales.middle / (2 * np.pi))
    u = grown.u.copy()
    u[:, :n] = centre
    return u, population_around(grown.population, centre)


def lost_alone(without: Refit, grown: Refit) -> tuple[np.ndarray, Population]:
    """Start like :func:`cold_start`, with its parameters, that changes only the elements that were driven away.

    All others, and their population, are those of `without` in each recording.
    """
    lost = np.flatnonzero(driven_away(without))
    scales, names = grown.model.scales, grown.model.network.elements
    u, population = beside_the_leader(grown, without)
    for k in lost.tolist():
        u[:, k] = population.mu[k] = band_scale(names[k], scales.z_middle, scales.middle / (2 * np.pi))
    population.covariance[lost], population.covariance[:, lost] = 0.0, 0.0
    population.covariance[lost, lost], population.rho[lost] = TYPICAL**2, TYPICAL_REPETITIONS
    return u, population


def beside_the_leader(fit: Refit, leader: Refit) -> tuple[np.ndarray, Population]:
    """Start of another refit of a model, with the network's elements of a fit with another addition.

    Parameters
    ----------
    fit : Refit
        Where the additions begin.
    leader : Refit
        Where the elements begin; of the same network and people.

    Returns
    -------
    u : ndarray, shape (M, P)
    population : Population
    """
    n = fit.model.n_elements
    u, mu, covariance, rho = (
        x.copy() for x in (fit.u, fit.population.mu, fit.population.covariance, fit.population.rho)
    )
    u[:, :n], mu[:n], rho[:n] = leader.u[:, :n], leader.population.mu[:n], leader.population.rho[:n]
    covariance[:n], covariance[:, :n] = 0.0, 0.0
    covariance[:n, :n] = leader.population.covariance[:n, :n]
    return u, Population(mu, covariance, rho)


def population_around(population: Population, centre: np.ndarray) -> Population:
    """The population with its first elements at a centre (n,), with typical dispersions and without correlations."""
    n = centre.size
    mu, covariance, rho = population.mu.copy(), population.covariance.copy(), population.rho.copy()
    mu[:n], rho[:n] = centre, TYPICAL_REPETITIONS
    covariance[:n], covariance[:, :n] = 0.0, 0.0
    covariance[np.arange(n), np.arange(n)] = TYPICAL**2
    return Population(mu, covariance, rho)
