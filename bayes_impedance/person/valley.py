r"""A proposal for long, narrow and curved posteriors: a mixture of normal distributions along the valley.

If the recordings determine one combination of elements precisely and another hardly, a person's posterior is a curved
valley: its length is set by the population, its width by the noise. One multivariate t around the mode covers only a
part of it, and its effective number of draws is deceptively high because no draw leaves that part. Here the valley is
followed from the mode in both directions. With H the information of the recordings and :math:`\Lambda` the precision of
the reference population, its direction is the eigenvector with

.. math:: H v = \lambda\,\Lambda v, \qquad \lambda \text{ smallest}, \qquad v^T \Lambda v = 1 .

A step :math:`\theta + h v` is corrected by the mode under a prior that holds its distance along v only; h is chosen so
that the correction c remains small in units of the noise, :math:`c^T H c \le 1`. Each point is the centre of a normal
distribution with precision :math:`H + \Lambda + (\Lambda v)(\Lambda v)^T/h^2`, weighted with the posterior mass that it
represents.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import Mode, find_mode, mode_at

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
    covariance : ndarray, shape (K, P, P)
    weight : ndarray, shape (K,)
        Sums to one.
    """

    centre: np.ndarray
    covariance: np.ndarray
    weight: np.ndarray


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
    covariance = np.linalg.inv(np.array([p for _, p, _ in points]))
    depth = np.array([d for _, _, d in points])
    # Half of the log weight: populations other than the reference give the ends of the valley more weight.
    log_weight = 0.5 * (-depth + 0.5 * np.linalg.slogdet(covariance)[1])
    weight = np.exp(log_weight - log_weight.max())
    return Valley(np.array([c for c, _, _ in points]), covariance, weight / weight.sum())


def _walk(
    kernel: Kernel, likelihood: Likelihood, begin: Mode, mean: np.ndarray, precision: np.ndarray, sign: float
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Points of the valley on one side, each with the precision of its normal distribution and its depth."""
    here, step, before = begin, _FIRST_STEP, None
    points = list[tuple[np.ndarray, np.ndarray, float]]()
    while len(points) < _MOST:
        v = np.asarray(eigh(here.information, precision, subset_by_index=[0, 0])[1][:, 0])
        v *= sign * np.sign(v[np.argmax(np.abs(v))]) if before is None else np.sign(v @ precision @ before)
        along = precision @ v
        there, length = here, step
        while length >= _SHORTEST:
            target = here.theta + length * v
            held = precision * 1e-6 + np.outer(along, along) * _HOLD / length**2
            there = find_mode(kernel, likelihood, target[None], target, held)
            c = there.theta - target
            if c @ here.information @ c <= _STRAIGHT:
                break
            length *= 0.5
        points.append((here.theta, here.information + precision + np.outer(along, along) / length**2, here.objective))
        if length < _SHORTEST:
            break
        here = mode_at(kernel, likelihood, there.theta, mean, precision, 0.0)
        if not here.objective < begin.objective + _END:
            break
        step, before = min(2 * length, _LONGEST), v
    return points
