r"""Noise with heavier tails than the normal: Student's t for every complex value.

A value of which real and imaginary part have the scale :math:`s\sigma` has the density

.. math:: p(\varepsilon) = \frac1{2\pi s^2\sigma^2}\left(1 + \frac u\nu\right)^{-(\nu/2+1)}, \qquad
          u = \frac{|\varepsilon|^2}{s^2\sigma^2},

with :math:`\nu` degrees of freedom that all recordings have in common. It is normal noise whose precision is multiplied
by a number :math:`\lambda` of each value, of a gamma distribution with both parameters :math:`\nu/2`. Given the
residual, the mean of that number is

.. math:: w = \frac{\nu + 2}{\nu + u} :

a point far off counts little, and the maximum of the likelihood is that of normal noise with the weights
:math:`w/\sigma^2`. A person's weights are found with the person's own fit, in turn, and then stay (:func:`reweighted`).

**How much such recordings say.** Normal noise of these weights would say too much of the elements: a residual that
changes changes its weight too. On average over the noise the curvature is smaller by the factor
:math:`\kappa = (\nu+2)/(\nu+4)`, which is the ratio of Fisher's informations (0.71 for 3 degrees of freedom). So the
likelihood is

.. math:: p(z\,|\,\theta) \propto \left(\beta + \tfrac12\sum w\,|z - Z(\theta)|^2/\sigma^2\right)^{-(\alpha+\kappa N)},

whose maximum is that of Student's t and whose curvature is that which it has on average. The scale in it estimates
:math:`s/\sqrt\kappa`. Its constant is chosen such that the density at the mode is that of Student's t, the scale
integrated out on a grid (:func:`log_density`), so that densities of normal noise and of this can be compared.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import gammaln

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import modes_from
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, information_share

TAILS = np.linspace(0.0, 0.5, 51)
"""Reciprocal degrees of freedom that are compared, from the normal distribution to infinite variance. By choice: steps
of a hundredth are finer than hundreds of points tell apart."""
WORKING_DEGREES = 4.0
"""Degrees of freedom with which everybody is fitted before they are known. By choice: a usual value for robust fits,
which loses a quarter of the information where the noise is normal."""
_REPOSITIONED = 0.3
"""Prior standard deviation of a recording's log elements about the person's. By choice, as for the noise's size."""
_ROUNDS, _SCALE_ROUNDS = 4, 40
"""Times that elements and weights, and in each the scale and weights, are found in turn. By choice: points far off lose
their weight at once; the error of the scale is halved each time."""
_GRID, _REACH = 200, 12.0
"""Points of the grid over the logarithm of the squared scale, and how far it goes to both sides, in standard
deviations. By choice: the integrand is smooth, and the sum exact to rounding."""


def weights_of(square: np.ndarray, degrees: float) -> np.ndarray:
    """Mean precision w of values whose residuals have the square u in units of their scale."""
    return np.asarray((degrees + 2) / (degrees + square))


def squared_scale(square: np.ndarray, degrees: float, used: float = 0.0) -> float:
    """The most probable s^2 for residuals |z - Z|^2 / sigma^2 = `square`, from which a fit of `used` numbers was taken.

    With infinite degrees of freedom it is their mean over both parts.
    """
    parts = max(2 * square.size - used, square.size)
    least = float(np.finfo(float).tiny)
    result = max(float(np.median(square) / (2 * np.log(2))), least)
    if not np.isfinite(degrees):
        return max(float(square.sum()) / parts, least)
    for _ in range(_SCALE_ROUNDS):
        weighted = float(np.sum(weights_of(square / result, degrees) * square))
        result = max(weighted / parts, least)
    return result


def log_likelihoods_of_tails(square: np.ndarray, used: float) -> np.ndarray:
    """Log likelihood of each of :data:`TAILS` for a person's residuals, with the most probable scale of each.

    Parameters
    ----------
    square : ndarray
        Squared absolute residuals of all values over sigma^2.
    used : float
        Number of real parameters that were fitted to them.

    Returns
    -------
    ndarray, shape (51,)
        Up to what is the same for all.
    """
    result = np.empty(TAILS.size)
    for i, tail in enumerate(TAILS.tolist()):
        degrees = 1 / tail if tail else np.inf
        scale = squared_scale(square, degrees, used)
        u = square / scale
        each = -0.5 * u if tail == 0 else -(degrees / 2 + 1) * np.log1p(tail * u)
        result[i] = np.sum(each) - square.size * np.log(scale)
    return result


def own_fits(
    kernel: Kernel, likelihood: Likelihood, theta: np.ndarray, degrees: float
) -> tuple[np.ndarray, np.ndarray]:
    """Fit each of a person's recordings with noise of these degrees of freedom.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        Of normal noise.
    theta : ndarray, shape (P,)
        The person's log elements, near which those of each recording are.
    degrees : float

    Returns
    -------
    square : ndarray, shape (J, F)
        Squared absolute residuals over sigma^2.
    weights : ndarray, shape (J, F)
        w of every value, the scale being that of all of the person's recordings.
    """
    recordings = [likelihood.recording(j, theta.size) for j in range(len(likelihood.z))]
    own = np.tile(theta, (len(recordings), 1))
    precision = np.eye(theta.size) / _REPOSITIONED**2
    weights = np.ones_like(likelihood.weight)
    for k in range(_ROUNDS + 1):
        square = likelihood.weight * _squared_residuals(kernel, likelihood, own)
        scale = squared_scale(square, degrees, float(own.size))
        weights = weights_of(square / scale, degrees)
        if k == _ROUNDS:
            break
        for j, one in enumerate(recordings):
            there = replace(one, weight=np.ascontiguousarray(one.weight * weights[[j]]))
            found = modes_from(kernel, there, own[[j]], theta, precision)[0][0]
            own[j] = found if np.all(np.isfinite(found)) else own[j]
    return square, weights


def reweighted(likelihood: Likelihood, weights: np.ndarray, degrees: float) -> Likelihood:
    """The likelihood of a person whose points have these weights (J, F), from that of normal noise."""
    lost = (1 - information_share(degrees)) * likelihood.values
    return replace(
        likelihood,
        weight=np.ascontiguousarray(likelihood.weight * weights),
        count=max(likelihood.count - lost, 1.0),
        values=likelihood.values - lost,
        degrees=degrees,
        plain=likelihood.weight,
    )


def squares_at(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> np.ndarray:
    """Squared absolute residuals over sigma^2 at log elements (P,) with the likelihood's deviations, (J, F)."""
    plain = likelihood.weight if likelihood.plain is None else likelihood.plain
    return np.asarray(plain * _squared_residuals(kernel, likelihood, theta + likelihood.deviations))


def log_density(square: np.ndarray, log_weight: float, degrees: float) -> float:
    """Log density of a person's recordings given their residuals, with the scale integrated out.

    Parameters
    ----------
    square : ndarray, shape (J, F)
        Squared absolute residuals over sigma^2.
    log_weight : float
        Sum of ln(1/sigma^2) over all values.
    degrees : float

    Returns
    -------
    float
        Natural logarithm of the density of real and imaginary parts in the unit of the recordings.
    """
    n = square.size
    middle, sd = np.log(squared_scale(square, degrees)), np.sqrt((1 + 4 / degrees) / n)  # from Fisher's information
    # The prior of the squared scale is centred near one: it moves the peak of few points.
    low, high = min(middle, 0.0) - _REACH * sd, max(middle, 0.0) + _REACH * sd
    log_square = np.linspace(low, high, max(_GRID, int((high - low) / sd * _GRID / (2 * _REACH))))
    total = np.zeros(log_square.size)
    for row in square:
        total -= (degrees / 2 + 1) * np.sum(np.log1p(row[:, None] * np.exp(-log_square) / degrees), axis=0)
    total += -(n + SCALE_SHAPE) * log_square - SCALE_SHAPE * np.exp(-log_square)
    prior = SCALE_SHAPE * np.log(SCALE_SHAPE) - gammaln(SCALE_SHAPE)
    step = np.log(log_square[1] - log_square[0])
    return float(np.logaddexp.reduce(total) + step + prior + log_weight - n * np.log(2 * np.pi))


def _squared_residuals(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> np.ndarray:
    """Of each recording with its own log elements (J, P), shape (J, F)."""
    z = likelihood.z[:, 0] + 1j * likelihood.z[:, 1]
    square = np.abs(kernel.impedance(theta, likelihood.omega / (2 * np.pi)) - z) ** 2
    return np.asarray(np.where(np.isfinite(square), square, np.finfo(float).max))
