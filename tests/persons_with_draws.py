"""Persons with normal likelihoods and their importance draws, populations near them, and contrasts of repetitions."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal

from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.coordinates_gradient import pulled_back
from bayes_impedance.population.likelihood_gradient import likelihood_gradient
from bayes_impedance.population.parameters import PopulationParameters

P = 3
N = 11  # more than one block of persons
REFERENCE_COVARIANCE = np.array([[0.30, 0.08, -0.05], [0.08, 0.20, 0.02], [-0.05, 0.02, 0.25]])


def spd(rng, scale, n=P):
    a = rng.normal(size=(n, 2 * n))
    return scale * (a @ a.T) / (2 * n)


def people(seed=0):
    """Centres m_i and covariances C_i of Gaussian likelihoods, and numbers of repetitions."""
    rng = np.random.default_rng(seed)
    centres = rng.multivariate_normal(np.zeros(P), REFERENCE_COVARIANCE, N)
    return centres, np.array([spd(rng, 0.1) for _ in range(N)]), np.array([1, 2, 3, 5] * N)[:N]


def slopes_of(density, u, step):
    """Central differences of fourth order along each coordinate, (W, D)."""
    found = np.empty(u.shape)
    for d, e in enumerate(step * np.eye(u.shape[1])):
        near, far = density(u + e) - density(u - e), density(u + 2 * e) - density(u - 2 * e)
        found[:, d] = (8 * near - far) / (12 * step)
    return found


def require_gradient(marginal, coordinates, u, step, tolerance):
    """The gradient of likelihood and prior is that of differences, up to a share of the largest."""

    def density(x):
        return marginal(coordinates.unpack(x)) + coordinates.log_prior(x)

    sets = coordinates.unpack(u)
    own = pulled_back(coordinates, u, sets, likelihood_gradient(marginal, sets))
    expected = slopes_of(density, u, step)
    assert np.abs(own - expected).max() < tolerance * np.abs(expected).max()


def gaussian_draws(centres, covariances, means, k, seed):
    """Independent draws from each person's posterior under the reference, a bit widened, as the package keeps them.

    Also ln L - ln q at its peak, which the estimate leaves out: a constant for each person.
    """
    rng = np.random.default_rng(seed)
    draws, constants = [], []
    for m, c, mean in zip(centres, covariances, means, strict=True):
        covariance = np.linalg.inv(np.linalg.inv(c) + np.linalg.inv(REFERENCE_COVARIANCE))
        middle = covariance @ (np.linalg.solve(c, m) + np.linalg.solve(REFERENCE_COVARIANCE, mean))
        q = multivariate_normal(middle, 1.2 * covariance)
        theta = q.rvs(k, random_state=rng)
        log_ratio = multivariate_normal(m, c).logpdf(theta) - q.logpdf(theta)
        log_weight = log_ratio + multivariate_normal(mean, REFERENCE_COVARIANCE).logpdf(theta)
        draws.append(Draws(theta, log_ratio, log_weight - np.logaddexp.reduce(log_weight)))
        constants.append(log_ratio.max() - 0.5 * P * np.log(2 * np.pi))
    return draws, np.array(constants)


def parameters(w, seed=0, covariates=0, rho=True):
    """W populations in the neighbourhood of the reference."""
    rng = np.random.default_rng(seed)
    covariances = [0.8 * REFERENCE_COVARIANCE + spd(rng, 0.05) for _ in range(w)]
    tau = np.sqrt([np.diag(c) for c in covariances])
    factors = np.linalg.cholesky([c / np.outer(t, t) for c, t in zip(covariances, tau, strict=True)])
    between_repetitions = rng.uniform(0.05, 0.3, (w, P)) * rho
    slopes = rng.normal(0, 0.1, (w, P, covariates))
    return PopulationParameters(
        mu=rng.normal(0, 0.15, (w, P)),
        between_persons=tau,
        correlation_cholesky=factors,
        between_repetitions=between_repetitions,
        slopes=slopes,
    )


def contrasts_of(count, n=5, seed=0):
    """Of n persons with `count` contrasts each."""
    rng = np.random.default_rng(seed + count)
    size = count * P
    information = np.array([np.linalg.inv(spd(rng, 0.05, size)) for _ in range(n)])
    gradient = np.empty((n, size))
    for h, b in zip(information, gradient, strict=True):
        b[:] = h @ (rng.normal(0, 0.2, size) + rng.multivariate_normal(np.zeros(size), np.linalg.inv(h)))
    return Contrasts(np.ascontiguousarray(np.moveaxis(information, 0, -1)), np.ascontiguousarray(gradient.T))
