r"""Draws from an expensive density of one to four parameters, interpolated by radial basis functions.

A quadratic through a dozen points describes a posterior that is nearly normal. On a curved or unbounded ridge, where a
coefficient may be five times as large if the exponent is smaller, it depends on where the points were. So the logarithm
of the density is interpolated,

.. math:: \ln p(x) \approx g\cdot x - \tfrac12 x^TCx + \sum_k w_k\,e^{-|x - x_k|^2/(2\ell^2)},

a quadratic that dominates far away and radial basis functions for the remainder, in coordinates in which the present
estimate of the posterior has unit covariance. The interpolation is sampled by importance sampling, new points are
evaluated where draws are far from all previous ones, and this is repeated until mean and covariance of the draws have
converged. Proposals far from all points are discarded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_AXIS, _DIAGONAL = 1.3, 1.0
"""Distance of the first points along an axis, and along each axis of a diagonal, in standard deviations: where a normal
density has fallen to half, and differences of its logarithm are large beside their error."""

_LENGTH = 1.7
"""Length l of the basis functions in standard deviations: somewhat more than the distance of the points. By choice."""

_NOISE = 0.05
"""Assumed error of a value of the log density, because the end of a refit depends on its start. By choice."""

_SMALLEST_CURVATURE = 0.1
"""Smallest curvature of the quadratic part, in units of the posterior's own: it must fall off in all directions. By
choice."""

_PROPOSED, _FREEDOM, _WIDENED = 12_000, 4.0, 1.5
"""Number, degrees of freedom and scale of the t distribution from which draws are proposed: heavier tails than a
posterior has, because its width is known only roughly. By choice."""

_ROUNDS, _FEWEST_ROUNDS = 16, 6
"""Largest and smallest number of rounds. By choice: the first few explore new regions, so that convergence within them
means little."""

_REST, _STRETCH = 0.12, 1.35
"""Convergence: largest step of the centre (standard deviations) and largest change of a variance (factor). By
choice."""


@dataclass(frozen=True)
class Explored:
    """Draws of an expensive density and the points at which it was evaluated.

    Attributes
    ----------
    draws : ndarray, shape (S, A)
    points : ndarray, shape (K, A)
        Points of evaluation.
    rests : bool
        Whether mean and covariance of the draws have converged.
    """

    draws: np.ndarray
    points: np.ndarray
    rests: bool


def explored(
    log_density: Callable[[np.ndarray], float], centre: np.ndarray, root: np.ndarray, seed: int, n_draws: int
) -> Explored:
    """Draw from an expensive density.

    Parameters
    ----------
    log_density : callable
        Of one point (A,), up to a constant.
    centre : ndarray, shape (A,)
        Where the search begins.
    root : ndarray, shape (A, A)
        Root of a covariance of about the right size.
    seed : int
    n_draws : int
    """
    rng = np.random.default_rng(seed)
    size = centre.size
    points = np.array([centre + root @ offset for offset in design(size)])
    heights = np.array([log_density(point) for point in points])
    draws, rests = points, False
    for k in range(_ROUNDS):
        draws = _resampled(points, heights, centre, root, rng)
        middle, new_root = draws.mean(axis=0), _root(np.atleast_2d(np.cov(draws.T)))
        moved = float(np.linalg.norm(np.linalg.solve(new_root, middle - centre)))
        turned = np.linalg.solve(root, new_root)
        stretch = np.linalg.svd(turned, compute_uv=False) ** 2
        centre, root = middle, new_root
        rests = k >= _FEWEST_ROUNDS and moved < _REST and stretch.max() < _STRETCH and stretch.min() > 1 / _STRETCH
        if rests:
            break
        new = _farthest(draws, points, root, 2 + size)
        points = np.vstack([points, new])
        heights = np.r_[heights, [log_density(point) for point in new]]
    return Explored(draws[rng.integers(len(draws), size=n_draws)], points, bool(rests))


def design(size: int) -> list[np.ndarray]:
    """Points that determine a quadratic, in standard deviations."""
    unit = np.eye(size)
    axes = [sign * _AXIS * e for e in unit for sign in (-1, 1)]
    pairs = [_DIAGONAL * (unit[k] + unit[j]) for k in range(size) for j in range(k)]
    return [np.zeros(size), *axes, *pairs]


def quadratic_through(x: np.ndarray, heights: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Value, gradient (A,) and negative curvature (A, A) at zero of a quadratic through points (K, A).

    Weighted least squares, with lower weights for points of low density and for points far away.
    """
    rows, columns = np.triu_indices(x.shape[1])
    weight = np.exp(-np.maximum(heights.max() - heights - 1, 0) / 3 - np.maximum(np.sum(x**2, axis=1) - 9, 0) / 18)
    terms = np.concatenate([np.ones((len(x), 1)), x, x[:, rows] * x[:, columns]], axis=1)
    root = np.sqrt(weight)
    found = np.linalg.lstsq(terms * root[:, None], (heights - heights.max()) * root, rcond=1e-8)[0]
    upper = np.zeros((x.shape[1], x.shape[1]))
    upper[rows, columns] = -found[1 + x.shape[1] :]
    return float(found[0] + heights.max()), found[1 : 1 + x.shape[1]], upper + upper.T


def _resampled(
    points: np.ndarray, heights: np.ndarray, centre: np.ndarray, root: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draws from the interpolated density, (S, A)."""
    from scipy.interpolate import RBFInterpolator

    size = centre.size
    x = np.linalg.solve(root, (points - centre).T).T
    constant, gradient, curvature = quadratic_through(x, heights)
    values, vectors = np.linalg.eigh(curvature)
    curvature = (vectors * np.maximum(values, _SMALLEST_CURVATURE)) @ vectors.T

    def smooth(at: np.ndarray) -> np.ndarray:
        return np.asarray(constant + at @ gradient - 0.5 * np.einsum("ka,ab,kb->k", at, curvature, at))

    # Far below the best point the exact depth does not matter, and it would make the interpolation oscillate.
    rest = np.maximum(heights, heights.max() - 15) - np.maximum(smooth(x), heights.max() - 15)
    swing = max(float(np.std(rest)), _NOISE)
    rough = RBFInterpolator(
        x, rest, kernel="gaussian", epsilon=1 / (np.sqrt(2) * _LENGTH), smoothing=(_NOISE / swing) ** 2, degree=-1
    )
    normal = rng.normal(size=(_PROPOSED, size))
    stretch = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, _PROPOSED))
    proposed = _WIDENED * normal * stretch[:, None]
    log_proposal = -0.5 * (_FREEDOM + size) * np.log1p(np.sum((proposed / _WIDENED) ** 2, axis=1) / _FREEDOM)
    near = _distance(proposed, x) < 1 + 0.5 * np.sqrt(size)
    proposed, log_proposal = proposed[near], log_proposal[near]
    value = smooth(proposed) + rough(proposed)
    # Values interpolated far above every evaluated point are capped: they are sampled, but not trusted.
    log_weight = np.minimum(value, heights.max() + 1) - log_proposal
    weight = np.exp(log_weight - log_weight.max())
    chosen = rng.choice(len(proposed), _PROPOSED, p=weight / weight.sum())
    return np.asarray(centre + proposed[chosen] @ root.T)


def _farthest(draws: np.ndarray, points: np.ndarray, root: np.ndarray, n: int) -> np.ndarray:
    """Select n draws one by one, each the farthest from all points so far, shape (n, A)."""
    x = np.linalg.solve(root, draws[:400].T).T
    known = np.linalg.solve(root, points.T).T
    chosen = []
    for _ in range(n):
        k = int(np.argmax(_distance(x, known)))
        chosen.append(k)
        known = np.vstack([known, x[k]])
    return draws[chosen]


def _distance(x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance to the nearest point."""
    return np.asarray(np.sqrt(np.min(np.sum((x[:, None] - points[None]) ** 2, axis=2), axis=1)))


def _root(covariance: np.ndarray) -> np.ndarray:
    return np.linalg.cholesky(covariance + 1e-9 * np.diag(np.diag(covariance)) + 1e-18 * np.eye(len(covariance)))
