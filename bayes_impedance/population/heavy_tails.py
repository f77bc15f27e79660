r"""Populations with heavier tails than the normal: people whose elements follow a multivariate Student t.

With nu degrees of freedom, scale matrix :math:`\Sigma` and P elements, a person's log elements are

.. math:: \theta_i \sim t_\nu(\mu + Bx_i,\ \Sigma), \qquad\text{that is}\qquad
          \theta_i\,|\,\lambda_i \sim N(\mu + Bx_i,\ \lambda_i\Sigma), \quad
          \lambda_i \sim \operatorname{IG}(\tfrac\nu2, \tfrac\nu2):

one factor :math:`\lambda_i` for each person on the covariance, with inverse gamma distribution. A person far from the
others gets a large factor, and moves centres and dispersions little. Repetitions of a person differ by normal
deviations as before, so that the mean over J repetitions is, given the factor,
:math:`N(\mu + Bx_i, \lambda_i\Sigma + \operatorname{diag}(\rho^2)/J)`. Integrated over the factor this is no t
distribution, but it is a mixture of normal distributions whatever J is. With :math:`x = \ln\lambda`

.. math:: p(\theta_i) = \int dx\, f_\nu(x)\, N(\theta_i; \mu_i, e^x\Sigma + \operatorname{diag}(\rho^2)/J), \qquad
          f_\nu(x) = \frac{(\nu/2)^{\nu/2}}{\Gamma(\nu/2)} \exp\left(-\tfrac\nu2\,(x + e^{-x})\right) .

The integrand is smooth and vanishes at both ends, where the trapezoidal rule converges exponentially. For a squared
distance :math:`q = (\theta-\mu)^T\Sigma^{-1}(\theta-\mu)` it is largest at :math:`e^x = (\nu+q)/(\nu+P)`, with a
standard deviation of about :math:`\sqrt{2/(\nu+P)}`. The nodes reach from :math:`q = 0` to a person far outside
(:data:`FARTHEST`). So the likelihood of a population with tails is a sum of :data:`NODES` likelihoods of normal
populations from the same draws (:mod:`bayes_impedance.population.importance_likelihood`), and its gradient is the mean
of theirs, weighted with the probability of each node.

**Prior.** :math:`1/\nu` is uniform on (0, 1/2): zero is the normal distribution, and a half the end of those with a
variance. The median is 4 degrees of freedom. (Gelman et al., Bayesian Data Analysis, 3rd edition 2013, chapter 17,
sample uniformly in 1/nu, because distributions of large nu hardly differ.) The sampled coordinate is the probit of
:math:`2/\nu`: its prior is standard normal, and where recordings cannot tell nu from infinity the posterior has the
prior's tail.

**Dispersions** are the scales :math:`\sqrt{\Sigma_{pp}}`. The standard deviation between persons is larger by the
factor :math:`\sqrt{\nu/(\nu-2)}`, which may be infinite within the posterior and is not reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaln, ndtr, ndtri

if TYPE_CHECKING:
    from bayes_impedance.population.parameters import PopulationParameters

NORMAL, STUDENT_T = "normal", "student_t"
"""Distributions of people's log elements."""

HEAVIEST = 0.5
"""Largest reciprocal of the degrees of freedom: at two the variance of a t distribution becomes infinite."""
LIGHTEST = 1e-6
"""Least reciprocal of the degrees of freedom. By choice: a person six standard deviations away then has a density that
differs by a thousandth from the normal one, and differences of logarithms of gamma functions keep ten digits."""
NODES = 12
"""Normal distributions of the mixture. Measured with up to ten elements: the log density is exact to 0.006 for
squared distances up to 100 and to 0.02 up to :data:`FARTHEST`; with 8 nodes to 0.14. Time is proportional to it."""
FARTHEST = 300.0
"""Squared distance of the farthest person for which the nodes are placed: six standard deviations in each of eight
elements, or 17 in one. Of persons still farther away the density falls faster than that of the t distribution."""
_MARGIN = 3.0
"""Standard deviations of the integrand by which the nodes reach beyond. By choice: what is left out is 0.1 %."""
_DIFFERENCE = 1e-4
"""Relative step in 1/nu of the differences that give the slopes of nodes and weights. By choice: of second order, so
that they err by about 1e-8, and rounding by 1e-9."""


def tail_of(coordinate: np.ndarray) -> np.ndarray:
    """Reciprocal degrees of freedom for their coordinate, which is standard normal under the prior."""
    return np.asarray(np.maximum(HEAVIEST * ndtr(coordinate), LIGHTEST))


def coordinate_of(tail: float) -> float:
    """Inverse of :func:`tail_of`."""
    return float(ndtri(np.clip(tail, LIGHTEST, HEAVIEST * (1 - 1e-9)) / HEAVIEST))


def tail_slope(coordinate: np.ndarray) -> np.ndarray:
    """Derivative of :func:`tail_of`."""
    return np.asarray(HEAVIEST * np.exp(-0.5 * coordinate**2) / np.sqrt(2 * np.pi))


def nodes_of(tail: np.ndarray, n_elements: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the mixture.

    Parameters
    ----------
    tail : ndarray, shape (W,)
        Reciprocal degrees of freedom.
    n_elements : int
        Number P of elements that differ between people.

    Returns
    -------
    log_factor : ndarray, shape (W, G)
        Logarithms of the factors on the covariance, evenly spaced.
    log_weight : ndarray, shape (W, G)
        Logarithms of the weights. Their sum is one but for what the nodes leave out.
    """
    nu = 1 / np.asarray(tail, dtype=float)[:, None]
    sd = np.sqrt(2 / (nu + n_elements))
    low = np.log(nu / (nu + n_elements)) - _MARGIN * sd
    high = np.log((nu + FARTHEST) / (nu + n_elements)) + _MARGIN * sd
    x = low + (high - low) * np.linspace(0, 1, NODES)
    half = 0.5 * nu
    density = half * np.log(half) - gammaln(half) - half * (x + np.exp(-x))
    return x, density + np.log((high - low) / (NODES - 1))


@dataclass(frozen=True)
class Mixture:
    """W populations with tails as mixtures of G normal ones each.

    Attributes
    ----------
    parameters : PopulationParameters
        W G normal populations, those of one mixture one after the other.
    log_factor, log_weight : ndarray, shape (W, G)
        As :func:`nodes_of` returns them.
    factor_slope, weight_slope : ndarray, shape (W, G)
        Derivatives of both with respect to the reciprocal degrees of freedom.
    """

    parameters: PopulationParameters
    log_factor: np.ndarray
    log_weight: np.ndarray
    factor_slope: np.ndarray
    weight_slope: np.ndarray


def mixture_of(parameters: PopulationParameters) -> Mixture:
    """The mixtures of W populations with tails."""
    tail, n_elements = parameters.tail, parameters.mu.shape[1]
    assert tail is not None  # it has been asked whether there are tails
    log_factor, log_weight = nodes_of(tail, n_elements)
    step = _DIFFERENCE * tail
    above, below = nodes_of(tail + step, n_elements), nodes_of(tail - step, n_elements)
    slopes = [(a - b) / (2 * step[:, None]) for a, b in zip(above, below, strict=True)]
    each = replace(parameters[np.repeat(np.arange(len(tail)), NODES)], tail=None)
    widened = each.between_persons * np.exp(0.5 * log_factor.reshape(-1, 1))
    return Mixture(replace(each, between_persons=widened), log_factor, log_weight, *slopes)


def drawn_factors(tail: np.ndarray, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Factors on the standard deviations of people, square roots of lambda.

    Parameters
    ----------
    tail : ndarray
        Reciprocal degrees of freedom, of a shape that is broadcast to `shape`.
    shape : tuple of int
        Of the people.
    rng : Generator
    """
    half = np.broadcast_to(0.5 / np.asarray(tail), shape)
    return np.asarray(np.sqrt(half / rng.gamma(half)))


def log_t(square: np.ndarray, tail: np.ndarray | float, n_elements: int) -> np.ndarray:
    """Log density of a multivariate t, relative to the normalisation (2 pi)^(-P/2) |Sigma|^(-1/2).

    Parameters
    ----------
    square : ndarray
        Squared distances q.
    tail : ndarray or float
        Reciprocal degrees of freedom.
    n_elements : int
    """
    half = 0.5 / np.asarray(tail)
    whole = half + 0.5 * n_elements
    constant = gammaln(whole) - gammaln(half) - 0.5 * n_elements * np.log(half)
    return np.asarray(constant - whole * np.log1p(0.5 * np.asarray(square) / half))


def weights_of(square: np.ndarray, tail: float, n_elements: int) -> np.ndarray:
    r"""Expected precision factors :math:`E[1/\lambda_i] = (\nu+P)/(\nu+q_i)` of persons at squared distances (N,)."""
    return np.asarray((1 + tail * n_elements) / (1 + tail * square))


_GRID = np.linspace(-3, 3, 121)
"""Coordinates at which :func:`estimated_tail` looks: three standard deviations of the prior, in steps that no estimate
from a sample resolves."""


def estimated_tail(square: np.ndarray, n_elements: int) -> float:
    """Reciprocal degrees of freedom of greatest posterior density, given squared distances (N,) of persons."""
    tails = tail_of(_GRID)
    value = np.sum(log_t(square, tails[:, None], n_elements), axis=1) - 0.5 * _GRID**2
    return float(tails[np.argmax(value)])
