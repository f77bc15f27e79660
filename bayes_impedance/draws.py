r"""Weighted draws from one person's exact posterior under a reference population.

The proposal q is a multivariate t (10 degrees of freedom: tails heavier than the target's) around the person's mode.
Draws and weights of one round give the mean and covariance of the next round's proposal, which takes care of
posteriors that are wider on one side than the curvature at the mode says. Points come from a scrambled Sobol sequence,
which covers eight dimensions far more evenly than random ones.

What is kept of a draw is its log elements and :math:`\ln L(\theta) - \ln q(\theta)`. Multiplied with **any** population
density :math:`N(\theta; \mu, \Sigma)` and averaged, this is the person's marginal likelihood under that population: the
reference only decides where the draws lie. It must be near the truth (a broad one leaves a handful of effective draws
for elements that a single person hardly determines), and a little wider.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv, gammaln, ndtri

from bayes_impedance.kernel import Kernel
from bayes_impedance.likelihood import Likelihood, log_likelihood
from bayes_impedance.subject import Mode

WIDENING = 1.1
"""Spread of the reference population relative to the estimate it stands for."""

_DEGREES_OF_FREEDOM = 10.0


@dataclass(frozen=True)
class Reference:
    """A population in whose shadow draws are made.

    Attributes
    ----------
    mean : ndarray, shape (P,)
        The mean for this person, covariates included.
    covariance : ndarray, shape (P, P)
    """

    mean: np.ndarray
    covariance: np.ndarray

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Log normal density at theta (S, P), shape (S,)."""
        factor = np.linalg.cholesky(self.covariance)
        u = np.linalg.solve(factor, (theta - self.mean).T)
        return np.asarray(-0.5 * np.sum(u**2, axis=0) - np.sum(np.log(np.diag(factor))))


@dataclass(frozen=True)
class Draws:
    """Weighted draws of one person.

    Attributes
    ----------
    theta : ndarray, shape (K, P)
        Log elements.
    log_ratio : ndarray, shape (K,)
        ln L - ln q, up to a constant.
    log_weight : ndarray, shape (K,)
        Logarithm of the weights under the reference, normalised to sum to one.
    """

    theta: np.ndarray
    log_ratio: np.ndarray
    log_weight: np.ndarray

    @property
    def effective(self) -> float:
        """Effective number of draws under the reference, 1 / sum of squared weights."""
        return float(np.exp(-np.logaddexp.reduce(2 * self.log_weight)))


def draw(
    kernel: Kernel, likelihood: Likelihood, mode: Mode, reference: Reference, n: int, seed: np.random.SeedSequence
) -> Draws:
    """Draw from a person's posterior under the reference population.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    mode : Mode
        The person's mode under the reference.
    reference : Reference
        Already widened.
    n : int
        Number of draws, a power of two.
    seed : SeedSequence

    Returns
    -------
    Draws
        Ask ``effective`` how good they are.
    """
    centre, covariance = mode.theta, np.linalg.inv(mode.precision)
    laplace = covariance
    best: Draws | None = None
    seeds = seed.spawn(6)
    for attempt, child in enumerate(seeds):
        draws = _round(kernel, likelihood, centre, covariance, reference, n if attempt else min(n, 256), child)
        if attempt and (best is None or draws.effective > best.effective):
            best = draws
        if attempt >= 1 and best is not None and best.effective > 0.5 * n:
            break
        # Weights are tempered until they rest on enough draws to give a covariance.
        log_weight = draws.log_weight
        while np.exp(-np.logaddexp.reduce(2 * log_weight)) < 6 * centre.size:
            log_weight = 0.7 * log_weight
            log_weight = log_weight - np.logaddexp.reduce(log_weight)
        weight = np.exp(log_weight)
        centre = weight @ draws.theta
        offset = draws.theta - centre
        covariance = (offset * weight[:, None]).T @ offset + 0.02 * laplace
    assert best is not None  # at least two rounds are made
    return best


def _round(
    kernel: Kernel,
    likelihood: Likelihood,
    centre: np.ndarray,
    covariance: np.ndarray,
    reference: Reference,
    n: int,
    seed: np.random.SeedSequence,
) -> Draws:
    from scipy.stats import qmc  # half a second to import

    dimension, nu = centre.size, _DEGREES_OF_FREEDOM
    uniform = qmc.Sobol(dimension + 1, rng=np.random.default_rng(seed)).random(n)
    uniform = np.clip(uniform, 1e-12, 1 - 1e-12)
    stretch = np.sqrt(nu / (2 * gammaincinv(nu / 2, uniform[:, -1])))
    normal = ndtri(uniform[:, :-1]) * stretch[:, None]
    factor = np.linalg.cholesky(covariance)
    theta = centre + normal @ factor.T
    log_q = (
        gammaln((nu + dimension) / 2)
        - gammaln(nu / 2)
        - 0.5 * dimension * np.log(nu * np.pi)
        - np.sum(np.log(np.diag(factor)))
        - 0.5 * (nu + dimension) * np.log1p(np.sum(normal**2, axis=1) / nu)
    )
    log_ratio = log_likelihood(kernel, likelihood, theta) - log_q
    log_weight = log_ratio + reference.log_density(theta)
    return Draws(theta, log_ratio, log_weight - np.logaddexp.reduce(log_weight))
