r"""A normal approximation of a smooth density in a few dozen dimensions, from its values alone.

Newton's method on second differences, in coordinates v in which the current approximation is a standard normal,
:math:`x = m + A v` with :math:`A A^T` its covariance. With steps h of about half a standard deviation the quadratic
form of every pair of coordinates needs two values beyond those of the single coordinates,

.. math:: 2 h^2 H_{ij} = f(+i{+}j) + f(-i{-}j) - 2f_0 - h^2 H_{ii} - h^2 H_{jj},

D (D + 1) + 1 values in all, which a vectorised density gives in half a second for 52 dimensions. Steps this wide
measure the average curvature over the peak rather than at its top, and are insensitive to rounding.

**Why not in the coordinates of the density.** Where a long ridge lies oblique to them, the curvature along it is a
small difference of large numbers. A parameter that is the same for everybody moves all people's elements along, and
its ridge is a hundred times longer than wide: a third derivative across it is enough to turn the curvature along it
negative. In v the ridge is found as it is, once the approximation is roughly that of the peak. It grows at most
twofold in an iteration, so that one wrong curvature does not send the next differences far away. The precision has a
given lower bound, because the posterior is not wider than its prior.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_FEWEST, _MOST = 3, 10
"""Newton steps. By choice: three where the start, a point estimate, is close; ten where it is a few standard deviations
off along a ridge."""
_DECREMENT, _CHANGE = 0.02, 2.0
"""The iteration ends if the quadratic form promises a smaller gain of the log density, and no variance along an axis
changes by a larger factor. By choice: a fifth of a standard deviation off, and proposals that are seldom rejected."""
_BATCH = 128
"""Evaluations in one call. By choice: about as many as an ensemble has walkers, which bounds the memory."""
_STEP = 0.5
"""Step of the differences in standard deviations. By choice: see the module's docstring."""
_GROWTH = 4.0
"""Most by which the variance along an axis grows in one iteration. By choice: the next differences then reach as far as
one standard deviation of this one."""
_NARROWEST = 1e-6
"""Least ratio of two lengths of the approximation's axes: the covariance stays positive definite when rounded."""
_HALVINGS = 6
"""Lengths of a step that are tried, each half of the one before. By choice: with a wrong curvature a step is at most
four times too long, and the shape changes within some standard deviations."""


def normal_approximation(
    log_density: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    covariance: np.ndarray,
    smallest_precision: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Mode and covariance.

    Parameters
    ----------
    log_density : callable
        Maps (W, D) to (W,).
    start : ndarray, shape (D,)
        Initial estimate of the mode.
    covariance : ndarray, shape (D, D)
        Initial estimate.
    smallest_precision : float
        Lower bound of the eigenvalues of the precision.

    Returns
    -------
    mode : ndarray, shape (D,)
    covariance : ndarray, shape (D, D)
    """
    mode, factor = start, np.linalg.cholesky(covariance)
    for iteration in range(_MOST):
        value, gradient, hessian = _differences(log_density, mode, _STEP * factor)
        if not np.isfinite(value):
            break  # outside the support: the current estimate is kept
        if not np.all(np.isfinite(hessian)):  # differences reach outside the support
            factor = 0.5 * factor
            continue
        eigenvalues, vectors = np.linalg.eigh(-hessian)
        curvature = np.maximum(eigenvalues, 1 / _GROWTH)
        axes = factor @ vectors
        step = axes @ (vectors.T @ gradient / curvature)
        trials = mode + step * 0.5 ** np.arange(_HALVINGS)[:, None]
        values = log_density(trials)
        if values.max() > value:
            mode = trials[int(np.argmax(values))]
        factor = _limited(axes / np.sqrt(curvature), smallest_precision)
        decrement = 0.5 * np.sum((vectors.T @ gradient) ** 2 / curvature)
        still = curvature.max() < _CHANGE and curvature.min() > 1 / _CHANGE and decrement < _DECREMENT
        if iteration + 1 >= _FEWEST and still:
            break
    return mode, factor @ factor.T


def _limited(factor: np.ndarray, smallest_precision: float) -> np.ndarray:
    """A factor (D, D) of the nearest covariance with eigenvalues of the precision above a limit."""
    axes, lengths, _ = np.linalg.svd(factor)
    longest = min(lengths[0], smallest_precision**-0.5)
    return np.asarray(axes * np.clip(lengths, _NARROWEST * longest, longest))


def _differences(
    log_density: Callable[[np.ndarray], np.ndarray], point: np.ndarray, steps: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Value, gradient (D,) and Hessian (D, D) by central differences along D steps, the columns of (D, D).

    Gradient and Hessian are those in standard deviations, of which a step has `_STEP`.
    """
    n = point.size
    single = steps.T
    first, second = np.tril_indices(n, -1)
    double = single[first] + single[second]
    points = point + np.vstack([np.zeros((1, n)), single, -single, double, -double])
    batches = np.array_split(points, len(points) // _BATCH + 1)
    values = np.concatenate([log_density(batch) for batch in batches])
    centre, rest = values[0], values[1:]
    ahead, behind = rest[:n], rest[n : 2 * n]
    both, neither = np.split(rest[2 * n :], 2)
    with np.errstate(invalid="ignore"):  # minus infinity outside the support: the caller looks
        curvature = ahead + behind - 2 * centre
        hessian = np.diag(curvature)
        mixed = 0.5 * (both + neither - 2 * centre - curvature[first] - curvature[second])
        hessian[first, second] = hessian[second, first] = mixed
        return float(centre), (ahead - behind) / (2 * _STEP), hessian / _STEP**2
