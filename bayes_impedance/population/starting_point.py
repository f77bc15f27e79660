"""Where the search for the posterior's mode begins: the point estimate in sampled coordinates, and rough widths."""

from __future__ import annotations

import numpy as np

from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.population.em import Estimate
from bayes_impedance.population.moved_dispersions import DispersionRange
from bayes_impedance.population.parameters import Coordinates
from bayes_impedance.population.prior import Prior

_BEND, _LEAST_DISPERSION = 1 / 3, 1e-4
"""Bend of a dispersion's coordinate, relative to the point estimate, and least estimate that counts. By choice: a
dispersion that few people determine to 30 % lies on the logarithmic part, one that may be zero within or near the
linear part."""


def bend_of(dispersion: np.ndarray, prior: Prior, span: DispersionRange | None = None) -> np.ndarray:
    """Where coordinates of dispersions bend, in units of the prior's scale, for point estimates (P,).

    A dispersion whose range reaches down to what is negligible lies on the linear part with all of its range: its
    logarithm would have a long tail, even where the point estimate is far from zero.
    """
    bend = _BEND * np.maximum(dispersion, _LEAST_DISPERSION)
    if span is not None:
        bend = np.where(span.lowest <= LEAST_RHO, np.maximum(bend, span.highest), bend)
    return np.asarray(bend / prior.dispersion_sds)


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
    return coordinates.pack(
        point.mu,
        _positive(between),
        point.between_repetitions,
        point.slopes,
        point.shared,
        point.tail,
        point.groups,
    )


def starting_scale(
    coordinates: Coordinates, point: Estimate, shared_covariance: np.ndarray, repetitions: np.ndarray
) -> np.ndarray:
    """Rough posterior standard deviations of the coordinates, shape (D,); `shared_covariance` has shape (S', S')."""
    few = 1 / np.sqrt(repetitions.size + 4)
    between = 1 / np.sqrt(np.sum(repetitions - 1) + 4)
    sizes, prior, free = coordinates.sizes, coordinates.prior, list(coordinates.free)
    centre = coordinates.centres.scale(point.mu_sd[free], point.mu[free])
    widths = (few, between, few / prior.slope_sd, few, 1.0, 2 * few, 0.5)  # of tails the prior's, of groups rough
    blocks = [np.full(k, w) for k, w in zip(sizes[1:-1], widths, strict=True)]
    if coordinates.shared_prior is not None:
        blocks.append(coordinates.shared_scale(point.shared, shared_covariance))
    return np.concatenate([centre, *blocks])


def _positive(matrix: np.ndarray) -> np.ndarray:
    """A nearby covariance matrix with variances of at least 1e-4 and correlations that are not extreme."""
    variance = np.maximum(np.diag(matrix), 1e-4)
    correlation = matrix / np.sqrt(np.outer(variance, variance))
    values, vectors = np.linalg.eigh(correlation)
    repaired = (vectors * np.maximum(values, 0.02)) @ vectors.T
    scale = np.sqrt(variance / np.diag(repaired))
    return np.asarray(repaired * np.outer(scale, scale))
