r"""A proposal for posteriors that are long, narrow and curved: normal distributions strung along the valley.

Where recordings determine a combination of elements sharply and another hardly, a person's posterior is a curved valley
whose length is the population's and whose width is the noise's. One multivariate t around its deepest point covers a
stretch of it, and its draws seem efficient because they never leave that stretch. Here the valley is followed from the
mode in both directions. With H the information of the recordings and :math:`\Lambda` the precision of the reference
population, its direction is the eigenvector with

.. math:: H v = \lambda\,\Lambda v, \qquad \lambda \text{ smallest}, \qquad v^T \Lambda v = 1 .

A step :math:`\theta + h v` is corrected by the mode under a prior that holds its distance along v only; h is chosen so
that the correction c remains small in units of the noise, :math:`c^T H c \le 1`. At every point stands a normal
distribution with precision :math:`H + \Lambda + (\Lambda v)(\Lambda v)^T/h^2`, weighted with the mass that it stands
for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import Mode, find_mode, mode_at

_FIRST_STEP, _SHORTEST, _LONGEST = 0.1, 1e-3, 0.5
"""Steps in standard deviations of the reference population; a valley that bends within a thousandth of them is none."""

_STRAIGHT = 1.0
"""Square of a correction, in units of the noise, up to which a step has followed the valley."""

_END = 12.0
"""Fall of the log density at which the valley ends: what lies beyond holds 6e-6 of the height."""

_MOST = 200
"""Points to either side of the mode: then the valley is followed no further."""

_HOLD = 1e4
"""Precision with which the distance along the valley is held while the rest is corrected, one over a squared step."""


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
    # Half of the logarithm: other populations than the reference weigh the ends of the valley more.
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
