"""Populations of quadratic likelihoods whose truth is known, and how often events may happen by chance."""

from __future__ import annotations

import numpy as np
from scipy.stats import binom

from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.within_persons import RepetitionLikelihoods

SURE = 1e-4  # a check by counting fails by chance this often.


def names(p):
    return tuple(f"n{k + 1}" for k in range(p))


def informations(rng, n, p, sd=0.1, unseen=0):
    """Unequal information: element sd about `sd`, persons differ fourfold; every other one sees no `unseen`."""
    a = rng.normal(size=(n, p, 2 * p)) / np.sqrt(2 * p)
    scale = np.exp(rng.normal(0, 0.3, (n, p)) + rng.normal(0, 0.35, (n, 1))) / sd
    h = (a @ np.swapaxes(a, 1, 2)) * scale[:, :, None] * scale[:, None, :]
    h[::2, :unseen], h[::2, :, :unseen] = 0, 0
    return h


def observed(rng, theta, h):
    """Likelihoods of persons whose log elements are theta, with noise."""
    values, vectors = np.linalg.eigh(h)
    noise = vectors * np.sqrt(np.maximum(values, 0))[:, None, :] @ rng.normal(size=(*theta.shape, 1))
    return PersonLikelihoods(names(theta.shape[1]), (h @ theta[..., None] + noise)[..., 0], h)


def covariance(p, sd=0.3, r=0.4):
    """Elements that vary together with alternating sign."""
    sign = (-1.0) ** np.arange(p)
    return sd**2 * (np.eye(p) * (1 - r) + r * np.outer(sign, sign))


def population(rng, n, t, centre=-5.0):
    return centre + rng.normal(size=(n, t.shape[0])) @ np.linalg.cholesky(t).T


def rarely(count, trials, probability):
    """Whether an event of at most this probability may have happened so often."""
    return binom.sf(count - 1, trials, probability) > SURE


def mostly(count, trials, probability):
    """Whether an event of at least this probability may have happened so rarely."""
    return binom.cdf(count, trials, probability) > SURE


def repetitions(rng, n, p, j, beta=0.0, omega=0.0, rho=0.05, sd=0.03, drop=0.0, unseen=0):
    """Recordings of n persons with offsets, common and own slopes; some repetitions are missing."""
    parts = []
    for _ in range(n):
        order = np.flatnonzero(rng.random(j) >= drop)
        slope = beta + omega * rng.normal(size=p)
        deviation = rng.normal(0, 0.1, p) + order[:, None] * slope + rho * rng.normal(size=(order.size, p))
        one = observed(rng, deviation, informations(rng, order.size, p, sd, unseen))
        parts.append((one.linear, one.information, order))
    linear, information, order = zip(*parts, strict=True)
    return RepetitionLikelihoods(names(p), linear, information, order)
