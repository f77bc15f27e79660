r"""A proposal for long, narrow and curved posteriors: a mixture of distributions along the valley.

If the recordings determine one combination of elements precisely and another hardly, a person's posterior is a curved
valley: its length is set by the population, its width by the noise. One multivariate t around the mode covers only a
part of it, and its effective number of draws is deceptively high because no draw leaves that part. Here the valley is
followed from the mode in both directions. With H the information of the recordings and :math:`\Lambda` the precision of
the reference population, its direction is the longest axis of the posterior,

.. math:: (H + \Lambda) v = \lambda v, \qquad \lambda \text{ smallest}, \qquad v^T \Lambda v = 1 ,

because the network bends on the scale of one in log elements; where the population itself is narrow, nothing bends.

A step :math:`\theta + h v` is corrected to the posterior's mode at that distance along v; h is chosen so that the
correction c remains small in units of the noise, :math:`c^T H c \le 1`. Each point is the centre of a normal
distribution with precision :math:`H + \Lambda + (\Lambda v)(\Lambda v)^T/h^2`, weighted with the posterior mass that it
represents. These precisions are factorised in the coordinates :math:`u = L^T \theta` in which the reference's
:math:`\Lambda = L L^T` is the identity: where the reference hardly allows a combination of elements to differ, their
entries span thirteen orders of magnitude, and their inverses would not be positive definite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, solve_triangular
from scipy.special import ndtri

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bent_proposal import log_t, stretched
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import Mode, find_mode, mode_at
from bayes_impedance.person.shifted_sobol import uniform_points
from bayes_impedance.person.small_matrices import ROUNDING

_FIRST_STEP, _SHORTEST, _LONGEST = 0.1, 1e-3, 0.5
"""First, shortest and longest step, in standard deviations of the reference population. By choice: longer steps leave
gaps between the normal distributions; a curve that bends within the shortest step is not treated as a valley."""

_STRAIGHT = 1.0
"""Largest squared correction of an accepted step, in units of the noise. By choice: one standard deviation."""

_END = 12.0
"""Decrease of the log density at which the valley ends. By choice: the density there is 6e-6 of that at the mode."""

_MOST = 200
"""Most points to either side of the mode. By choice: a bound on the cost of very long valleys."""

_HOLD = 1e4
"""Prior precision of the distance along the valley during the correction, in one over a squared step. By choice: it
holds the distance to a hundredth of a step."""


@dataclass(frozen=True)
class Valley:
    """A mixture of K normal distributions along a valley.

    Attributes
    ----------
    centre : ndarray, shape (K, P)
    factor : ndarray, shape (K, P, P)
        Upper triangular, with positive diagonals: a factor times its transpose is a covariance.
    weight : ndarray, shape (K,)
        Sums to one.
    """

    centre: np.ndarray
    factor: np.ndarray
    weight: np.ndarray

    def drawn(self, n: int, seed: np.random.SeedSequence) -> np.ndarray:
        """Log elements (n, P) of evenly spread draws, of a t in place of each normal distribution."""
        uniform = uniform_points(n, self.centre.shape[1] + 2, seed)
        which = np.searchsorted(np.cumsum(self.weight), uniform[:, -2])
        which = np.minimum(which, len(self.weight) - 1)  # the sum of the weights is one but for rounding
        t = ndtri(uniform[:, :-2]) * stretched(uniform[:, -1])[:, None]
        return np.asarray(self.centre[which] + np.einsum("npq,nq->np", self.factor[which], t))

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Log density at log elements (n, P), shape (n,)."""
        result = np.full(len(theta), -np.inf)
        for centre, factor, weight in zip(self.centre, self.factor, self.weight, strict=True):
            result = np.logaddexp(result, np.log(weight) + log_t(theta, centre, factor))
        return result


def follow(
    kernel: Kernel, likelihood: Likelihood, theta: np.ndarray, mean: np.ndarray, precision: np.ndarray
) -> Valley:
    """Follow the valley of a person's posterior from its mode.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        With the deviations at their mode.
    theta : ndarray, shape (P,)
        The mode under the reference population, or near it.
    mean : ndarray, shape (P,)
        Of the reference population.
    precision : ndarray, shape (P, P)
        Of the reference population.
    """
    begin = find_mode(kernel, likelihood, theta[None], mean, precision)
    ahead = _walk(kernel, likelihood, begin, mean, precision, +1.0)
    behind = _walk(kernel, likelihood, begin, mean, precision, -1.0)
    points = [*reversed(behind[1:]), *ahead]
    root = np.linalg.cholesky(precision)
    factor = np.array([_factor(root, h, v) for _, h, v, _ in points])
    depth = np.array([d for *_, d in points])
    # Half of the log weight: populations other than the reference give the ends of the valley more weight.
    log_weight = 0.5 * (-depth + np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1))
    weight = np.exp(log_weight - log_weight.max())
    return Valley(np.array([c for c, *_ in points]), factor, weight / weight.sum())


def _factor(root: np.ndarray, information: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Factor of the covariance at a point, from that of the reference's precision and the term that holds the step."""
    whitened = solve_triangular(root, solve_triangular(root, information, lower=True).T, lower=True)
    along = root.T @ direction
    whole = 0.5 * (whitened + whitened.T) + np.eye(len(root)) + np.outer(along, along)
    own = np.linalg.cholesky(whole + ROUNDING * np.diag(np.diag(whole)))
    in_these = solve_triangular(own.T, np.eye(len(root)), lower=False)
    return np.asarray(solve_triangular(root.T, in_these, lower=False))


def _walk(
    kernel: Kernel, likelihood: Likelihood, begin: Mode, mean: np.ndarray, precision: np.ndarray, sign: float
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]:
    """Points of the valley on one side: centre, information of the recordings, direction over the step, and depth."""
    here, step, before = begin, _FIRST_STEP, None
    points = list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]()
    while len(points) < _MOST:
        v = np.asarray(eigh(here.information + precision, subset_by_index=[0, 0])[1][:, 0])
        v /= np.sqrt(v @ precision @ v)
        v *= sign * np.sign(v[np.argmax(np.abs(v))]) if before is None else np.sign(v @ precision @ before)
        along = precision @ v
        there, length = here, step
        while length >= _SHORTEST:
            target = here.theta + length * v
            hold = _HOLD / length**2
            centre = mean + v * (hold / (1 + hold) * (along @ (target - mean)))
            there = find_mode(kernel, likelihood, target[None], centre, precision + hold * np.outer(along, along))
            c = there.theta - target
            if c @ here.information @ c <= _STRAIGHT:
                break
            length *= 0.5
        points.append((here.theta, here.information, v / length, here.objective))
        if length < _SHORTEST:
            break
        here = mode_at(kernel, likelihood, there.theta, mean, precision, 0.0)
        if not here.objective < begin.objective + _END:
            break
        step, before = min(2 * length, _LONGEST), v
    return points
