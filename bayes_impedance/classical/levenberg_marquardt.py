r"""Levenberg-Marquardt on many small problems at once.

From every start the damped Gauss-Newton step :math:`-(J^TJ + \lambda\,\mathrm{diag}\,J^TJ)^{-1} J^T r` is taken if it
lowers the sum of squares; then the damping falls, otherwise it rises (Marquardt 1963). All starts are rows of one
array, so that a search over hundreds of them costs few calls. It finds the basins of attraction;
:func:`scipy.optimize.least_squares` then converges to the last digits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Problem = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Residuals (S, K) and their derivatives (S, K, P) at points (S, P)."""

START_SPREAD = 2.0
"""Standard deviation of random starts in each log element around its natural scale.

By choice: nine in ten starts lie within a factor of 27 of the scale at which an element matters in the band.
"""

_LONGEST_STEP = 2.0
"""Largest step in any log element. By choice: a factor of seven, so that a step cannot overflow."""

_UNUSABLE = 1e6
"""Residual used in place of one that is not finite. By choice: far above usable ones, so that the step is refused."""


def minimise_many(problem: Problem, start: np.ndarray, iterations: int) -> tuple[np.ndarray, np.ndarray]:
    """Minimise the sum of squares from many starts.

    Parameters
    ----------
    problem : callable
        May return values that are not finite; such points rank below all others.
    start : ndarray, shape (S, P)
        Logarithms; no step changes any of them by more than 2.
    iterations : int

    Returns
    -------
    end : ndarray, shape (S, P)
    cost : ndarray, shape (S,)
        Sums of squares at the end points.
    """
    theta = np.array(start, dtype=float)
    identity = np.eye(theta.shape[1])
    damping = np.full(theta.shape[0], 1e-2)
    residual, jacobian = _usable(problem, theta)
    cost = np.sum(residual**2, axis=1)
    for _ in range(iterations):
        transposed = np.swapaxes(jacobian, 1, 2)
        gradient = (transposed @ residual[..., None])[..., 0]
        curvature = transposed @ jacobian
        diagonal = np.einsum("spp->sp", curvature)
        damped = curvature + identity * (damping[:, None] * (diagonal + 1e-12) + 1e-14)[:, None, :]
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        step /= np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / _LONGEST_STEP)
        trial = theta + step
        new_residual, new_jacobian = _usable(problem, trial)
        new_cost = np.sum(new_residual**2, axis=1)
        better = new_cost < cost
        theta[better], cost[better] = trial[better], new_cost[better]
        residual[better], jacobian[better] = new_residual[better], new_jacobian[better]
        damping = np.clip(np.where(better, damping / 5, damping * 4), 1e-12, 1e10)
    return theta, cost


def _usable(problem: Problem, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a start too far away just ranks last
        residual, jacobian = problem(theta)
        bad = ~(np.isfinite(residual).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2)))
        residual[bad], jacobian[bad] = _UNUSABLE, 0.0
    return residual, jacobian
