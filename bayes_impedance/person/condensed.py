r"""A person's recordings, summed up at a few frequencies for the posterior near its mode.

Hundreds of frequencies carry no more than a few dozen where the impedance that is compared with them changes smoothly.
Around a fit :math:`Z^0` with residuals :math:`r = z - Z^0` the chi-square of another impedance :math:`Z = Z^0 + D` is

.. math:: \sum_k w_k |r_k - D_k|^2 = \sum_k w_k |r_k|^2 - 2\operatorname{Re} \sum_k w_k \bar r_k D_k
          + \sum_k w_k |D_k|^2,

in which the recordings' noise enters only through sums. D is smooth, and so is its square: with cardinal functions
:math:`B_b` of a local interpolation between nodes :math:`\omega_b`,
:math:`D_k \approx \sum_b B_b(\ln\omega_k) D(\omega_b)`, and likewise its square. Then

.. math:: W_b = \sum_k w_k B_b(\ln\omega_k), \qquad R_b = \frac{1}{W_b}\sum_k w_k r_k B_b(\ln\omega_k)

give the same chi-square up to a constant from the nodes alone, as if :math:`Z^0_b + R_b` had been recorded there with
the weight :math:`W_b`. Derivatives follow as they do from recordings. Errors are those of interpolating D, not Z: the
nearer to the fit, the smaller. The idea is that of the *relative binning* of gravitational waves (Zackay, Dai and
Venumadhav 2018, arXiv:1806.08792); here the interpolation is of degree five. Whether the nodes suffice is measured for
each person, at draws of the posterior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import Ridge, marginal_log_likelihood

NODES_PER_DECADE = (22, 44)
"""Nodes in a decade of frequency, and how many if these are too few. Measured at 401 points in three decades (twelve
virtual fingertips): the log likelihood of posterior draws is off by at most 0.02 (standard deviation over the draws of
one person) with 17, 0.005 with 22, 0.002 with 27. Of interpolations through 2, 4, 6 and 8 nodes those through six are
the best with 17 to 22 nodes: 0.07, 0.013, 0.005 and 0.004."""
_THROUGH = 6
"""Nodes through which the interpolation passes: those nearest to a frequency."""
_FEWEST = 20
"""Least number of nodes. By choice: in a narrow band, that too few nodes near its ends cannot matter."""
_WORTH = 0.5
"""Largest share of the frequencies at which summing them up is worth it. By choice."""
_TESTED = 32
"""Draws of the posterior at which the error is measured. By choice: its standard deviation is then known to 12 %."""
_WRONG = 0.02
"""Largest error of the log likelihood (standard deviation over draws of one person's posterior). By choice: it moves
nothing by more than 0.02 of the person's own standard deviations."""


def condensed(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray, per_decade: int) -> Likelihood | None:
    """The recordings of one person summed up at nodes, for log elements near theta (P,).

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        With the deviations of the repetitions at their mode.
    theta : ndarray, shape (P,)
        The mode.
    per_decade : int
        Number of nodes in a decade of frequency.

    Returns
    -------
    Likelihood or None
        None where it is not worth it: with few frequencies, or where the network does not describe the recordings.
    """
    d = likelihood
    interpolation = interpolation_of(d.omega, per_decade)
    if interpolation is None:
        return None
    z0 = kernel.impedance(theta + d.deviations, d.omega / (2 * np.pi))
    there = summed_up(interpolation, d.z, d.weight, z0)
    if there is None:
        return None
    z, weight, rest = there
    omega = np.ascontiguousarray(d.omega[interpolation.nodes])
    return replace(d, omega=omega, z=z, weight=weight, rest=float(rest.sum()))


@dataclass(frozen=True)
class Interpolation:
    """Of B nodes among F frequencies.

    Attributes
    ----------
    nodes : ndarray of int, shape (B,)
        Their places among the frequencies.
    basis : ndarray, shape (F, B)
        Cardinal functions.
    """

    nodes: np.ndarray
    basis: np.ndarray


def interpolation_of(omega: np.ndarray, per_decade: int) -> Interpolation | None:
    """Nodes among the frequencies omega (F,); None where summing up is not worth it, or they do not increase."""
    return _interpolation(omega.tobytes(), per_decade)


@lru_cache(maxsize=64)
def _interpolation(omega: bytes, per_decade: int) -> Interpolation | None:
    x = np.log(np.frombuffer(omega))
    nodes = _nodes(x, per_decade)
    if nodes.size > _WORTH * x.size or np.any(np.diff(x) <= 0):
        return None
    return Interpolation(nodes, _cardinal(x, nodes))


def summed_up(
    interpolation: Interpolation, z: np.ndarray, weight: np.ndarray, z0: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Recordings summed up at the nodes, for impedances near a fit.

    Parameters
    ----------
    interpolation : Interpolation
    z : ndarray, shape (M, 2, F)
        Real and imaginary part of the recordings.
    weight : ndarray, shape (M, F)
    z0 : ndarray, complex, shape (M, F)
        The fit.

    Returns
    -------
    z : ndarray, shape (M, 2, B)
    weight : ndarray, shape (M, B)
    rest : ndarray, shape (M,)
        What is to be added to each recording's chi-square.

    None instead where the fit has no value, or a node no weight.
    """
    nodes, basis = interpolation.nodes, interpolation.basis
    fitted = np.stack([z0.real, z0.imag], axis=1)
    residual = z - fitted
    summed = weight @ basis
    if not (np.all(np.isfinite(residual)) and np.all(summed > 0)):
        return None
    mean = (weight[:, None] * residual) @ basis / summed[:, None]
    squares = np.sum(weight[:, None] * residual**2, axis=(1, 2)) - np.sum(summed[:, None] * mean**2, axis=(1, 2))
    return np.ascontiguousarray(fitted[:, :, nodes] + mean), np.ascontiguousarray(summed), squares


def holds(
    kernel: Kernel, whole: Likelihood, small: Likelihood, ridge: Ridge, theta: np.ndarray, log_weight: np.ndarray
) -> bool:
    """Whether summed-up recordings give the same log likelihood as all of them, up to a constant.

    Parameters
    ----------
    kernel : Kernel
    whole, small : Likelihood
        All recordings, and those that are summed up.
    ridge : Ridge
        At the mode.
    theta : ndarray, shape (K, P)
        Draws of the posterior.
    log_weight : ndarray, shape (K,)
        Logarithms of their weights, which sum to one.
    """
    ticks = (np.arange(_TESTED) + 0.5) / _TESTED
    rows = np.minimum(np.searchsorted(np.cumsum(np.exp(log_weight)), ticks), len(theta) - 1)
    there = theta[np.unique(rows)]
    both = [marginal_log_likelihood(kernel, own, ridge, there) for own in (whole, small)]
    return bool(np.all(np.isfinite(both)) and np.std(both[1] - both[0]) < _WRONG)


def _nodes(x: np.ndarray, per_decade: int) -> np.ndarray:
    """Indices of the frequencies nearest to evenly spread logarithms x (F,)."""
    n = max(int(np.ceil((x[-1] - x[0]) / np.log(10) * per_decade)) + 1, _FEWEST)
    wanted = np.linspace(x[0], x[-1], n)
    after = np.clip(np.searchsorted(x, wanted), 1, x.size - 1)
    return np.unique(np.where(wanted - x[after - 1] < x[after] - wanted, after - 1, after))


def _cardinal(x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Cardinal functions (F, B) at x (F,): of each frequency's nearest nodes, Lagrange's polynomials; else zero."""
    at = x[nodes]
    first = np.clip(np.searchsorted(at, x) - _THROUGH // 2, 0, nodes.size - _THROUGH)
    near = first[:, None] + np.arange(_THROUGH)
    result = np.zeros((x.size, nodes.size))
    for i in range(_THROUGH):
        own = np.ones(x.size)
        for j in range(_THROUGH):
            if i != j:
                own *= (x - at[near[:, j]]) / (at[near[:, i]] - at[near[:, j]])
        result[np.arange(x.size), near[:, i]] = own
    return result
