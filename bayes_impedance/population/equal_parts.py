r"""Equal parts of a network, named alike in everybody.

Two branches that are written alike can be exchanged without changing the impedance, so that a search ends at either
arrangement by chance, person by person. If in some people m1 is what m2 is in the others, the population has two groups
that are none, a dispersion that is as wide as the branches are apart, and something is missing in the recordings: of 31
people with the network ``(n1-m1)|(n2-m2)`` two were arranged the other way, which cost 1700 units of log evidence, and
a resonator was claimed. So everybody is given the arrangement :math:`\pi` that is nearest to a common centre c,

.. math:: \sum_i \min_\pi \sum_k \frac{|\theta_{i\pi(k)} - c_k|}{s_k}, \qquad
          s_k = \text{median}_i\,|\theta_{ik} - c_k|,

alternating between arrangements and the centre, which is the median. Where it begins matters if the people are divided
evenly: several people's own values are tried, and the smallest sum counts.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.symmetry import exchanges
from bayes_impedance.population.prior import Prior

_BEGINNINGS = 5
"""People, evenly spread, whose values are tried as the first centre. By choice: half of them begin in either of two
arrangements."""

_MOST_ROUNDS = 20
"""Most alternations. By choice: each lowers the sum, and few arrangements change more than twice."""

_LEAST_SCALE = 0.05
"""Least median distance from the centre by which distances are divided. By choice: an element known to 5 %."""

_ROUNDING = 1e-9
"""Relative difference of two sums that is none: mirror images of the whole population are equal."""


def steps_of(kernel: Kernel, prior: Prior) -> list[np.ndarray]:
    """Exchanges of two equal parts of which the prior says the same, as positions (P,) from which values are taken."""
    position = {name: k for k, name in enumerate(kernel.elements)}
    found = []
    for exchange in exchanges(kernel.network):
        step = np.array([position[exchange.get(name, name)] for name in kernel.elements])
        exchanged = prior.of(step)
        alike = np.array_equal(exchanged.centre, prior.centre) and np.array_equal(exchanged.tailed, prior.tailed)
        if alike and np.array_equal(exchanged.covariance, prior.covariance):
            found.append(step)
    return found


def named_alike(theta: np.ndarray, steps: list[np.ndarray]) -> np.ndarray:
    """Everybody's parameters, equal parts arranged as in most people.

    Parameters
    ----------
    theta : ndarray, shape (N, P)
    steps : list of ndarray of int, shape (P,)
        Exchanges of two parts, as :func:`steps_of` gives them.

    Returns
    -------
    ndarray, shape (N, P)
    """
    n, size = theta.shape
    if not steps or n == 1:
        return theta
    same = np.tile(np.arange(size), (n, 1))
    best, least = theta, np.inf
    for begin in np.unique(np.linspace(0, n - 1, _BEGINNINGS).round().astype(int)):
        arranged, centre = same, theta[begin]
        for _ in range(_MOST_ROUNDS):
            values = np.take_along_axis(theta, arranged, axis=1)
            scale = np.maximum(np.median(np.abs(values - centre), axis=0), _LEAST_SCALE)
            moved = _nearest(theta, arranged, steps, centre, scale)
            centre = np.median(np.take_along_axis(theta, moved, axis=1), axis=0)
            if np.array_equal(moved, arranged):
                break
            arranged = moved
        values = np.take_along_axis(theta, arranged, axis=1)
        total = float(np.abs(values - centre).sum())
        if total < least * (1 - _ROUNDING):
            best, least = values, total
    return best


def _nearest(
    theta: np.ndarray, arranged: np.ndarray, steps: list[np.ndarray], centre: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Arrangements (N, P) one exchange from these, where that is nearer to the centre."""
    result = arranged.copy()
    distance = np.sum(np.abs(np.take_along_axis(theta, result, axis=1) - centre) / scale, axis=1)
    for step in steps:
        other = result[:, step]
        there = np.sum(np.abs(np.take_along_axis(theta, other, axis=1) - centre) / scale, axis=1)
        nearer = there < distance
        result[nearer], distance[nearer] = other[nearer], there[nearer]
    return result
