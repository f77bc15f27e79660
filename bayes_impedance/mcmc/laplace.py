r"""A normal approximation of a smooth density in a few dozen dimensions, from its values and gradients.

Newton's method on differences, in coordinates v in which the current approximation is a standard normal,
:math:`x = m + A v` with :math:`A A^T` its covariance. With steps h of a quarter of a standard deviation

.. math:: H_{ij} = \frac{g_i(+j) - g_i(-j) + g_j(+i) - g_j(-i)}{4h},

where g(+j) is the gradient at a step of h along coordinate j: 2 D + 1 values and gradients, where values alone would
take D (D + 1) + 1 of them. Steps this wide measure the average curvature over the peak rather than at its top,
and are insensitive to rounding.

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
from scipy.special import ndtri

_FEWEST, _MOST = 3, 10
"""Newton steps. By choice: three where the start, a point estimate, is close; ten where it is a few standard deviations
off along a ridge."""
_DECREMENT, _CHANGE = 0.005, 1.3
"""The iteration ends if the quadratic form promises a smaller gain of the log density, and no variance along an axis
changes by a larger factor. By choice: a tenth of a standard deviation off, and proposals that are seldom rejected."""
_BATCH = 128
"""Evaluations in one call. By choice: about as many as an ensemble has walkers, which bounds the memory."""
_STEP = 0.25
"""Step of the differences in standard deviations. A fourth derivative changes the curvature that gradients at this step
give by a sixth of it times the squared step. Along a ridge thirty times longer than wide and curved, of variance one,
0.88 was found with 0.25, 0.84 with 0.35 and 0.72 with 0.5; rounding of single-precision weights is far below."""
_GROWTH = 4.0
"""Most by which the variance along an axis grows in one iteration. By choice: the next differences then reach as far as
one standard deviation of this one."""
_NARROWEST = 1e-6
"""Least ratio of two lengths of the approximation's axes: the covariance stays positive definite when rounded."""
_QUANTILES = ndtri((np.arange(200) + 0.5) / 200)
"""Of a standard normal coordinate, evenly spread."""
_HALVINGS = 6
"""Lengths of a step that are tried, each half of the one before. By choice: with a wrong curvature a step is at most
four times too long, and the shape changes within some standard deviations."""


def normal_approximation(
    log_density: Callable[[np.ndarray], np.ndarray],
    gradient_of: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    covariance: np.ndarray,
    smallest_precision: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Mode and covariance.

    Parameters
    ----------
    log_density : callable
        Maps (W, D) to (W,).
    gradient_of : callable
        Its gradient: maps (W, D) to (W, D).
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
        value, gradient, hessian = _differences(log_density, gradient_of, mode, factor)
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
    log_density: Callable[[np.ndarray], np.ndarray],
    gradient_of: Callable[[np.ndarray], np.ndarray],
    point: np.ndarray,
    factor: np.ndarray,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Value, gradient (D,) and Hessian (D, D) at a point, both in standard deviations: the columns of `factor`."""
    n = point.size
    steps = _STEP * factor.T
    points = point + np.vstack([np.zeros((1, n)), steps, -steps])
    batches = np.array_split(points, len(points) // _BATCH + 1)
    values = np.concatenate([log_density(batch) for batch in batches])
    gradients = np.concatenate([gradient_of(batch) for batch in batches]) @ factor
    with np.errstate(invalid="ignore"):  # minus infinity outside the support: the caller looks
        hessian = (gradients[1 : n + 1] - gradients[n + 1 :]) / (2 * _STEP)
        hessian[~np.isfinite(values[1 : n + 1] + values[n + 1 :])] = np.nan  # there the gradient says nothing
    return float(values[0]), gradients[0], 0.5 * (hessian + hessian.T)


def at_quantiles(mode: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Points (200, D) whose coordinates, each for itself, are spread like those of the normal approximation.

    They say how often functions of one coordinate exceed a limit, to half a per cent and without a random number; all
    coordinates go together, so that they say nothing of functions of several.
    """
    return np.asarray(mode + np.sqrt(np.diag(covariance)) * _QUANTILES[:, None])
