"""Where the search for the posterior's mode begins, in sampled coordinates: the point estimate and rough widths."""

from __future__ import annotations

import numpy as np

from bayes_impedance.population.em import Estimate
from bayes_impedance.population.parameters import Coordinates


def starting_point(
    coordinates: Coordinates, point: Estimate, covariance: np.ndarray, repetitions: np.ndarray
) -> np.ndarray:
    """The point estimate in sampled coordinates.

    Parameters
    ----------
    coordinates : Coordinates
    point : Estimate
    covariance : ndarray, shape (P, P)
        Of a person's mean over the repetitions.
    repetitions : ndarray of int, shape (N,)

    Returns
    -------
    ndarray, shape (D,)
    """
    between = covariance - np.diag(point.between_repetitions**2) / float(np.mean(repetitions))
    return coordinates.pack(point.mu, _positive(between), point.between_repetitions, point.slopes, point.shared)


def starting_scale(
    coordinates: Coordinates, point: Estimate, shared_covariance: np.ndarray, repetitions: np.ndarray
) -> np.ndarray:
    """Rough posterior standard deviations of the coordinates, shape (D,); `shared_covariance` has shape (S, S)."""
    few = 1 / np.sqrt(repetitions.size + 4)
    between = 1 / np.sqrt(np.sum(repetitions - 1) + 4)
    sizes, prior, free = coordinates.sizes, coordinates.prior, list(coordinates.free)
    centre = coordinates.centres.scale(point.mu_sd[free])
    widths = (few, between, few / prior.slope_sd, few)
    blocks = [np.full(k, w) for k, w in zip(sizes[1:-1], widths, strict=True)]
    if coordinates.shared_prior is not None:
        blocks.append(coordinates.shared_scale(shared_covariance))
    return np.concatenate([centre, *blocks])


def _positive(matrix: np.ndarray) -> np.ndarray:
    """A nearby covariance matrix with variances of at least 1e-4 and correlations that are not extreme."""
    variance = np.maximum(np.diag(matrix), 1e-4)
    correlation = matrix / np.sqrt(np.outer(variance, variance))
    values, vectors = np.linalg.eigh(correlation)
    repaired = (vectors * np.maximum(values, 0.02)) @ vectors.T
    scale = np.sqrt(variance / np.diag(repaired))
    return np.asarray(repaired * np.outer(scale, scale))
