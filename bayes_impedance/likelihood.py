r"""The likelihood of one person's log elements.

With J recordings of a person, noise of known shape sigma and one unknown scale s,

.. math:: z_{jk} = Z_k(\theta + \delta_j) + \varepsilon_{jk}, \qquad
          \operatorname{Re}\varepsilon_{jk},\ \operatorname{Im}\varepsilon_{jk} \sim N(0, s^2\sigma_{jk}^2),

where theta are the person's log elements and the deviations :math:`\delta_j` (which sum to zero) say how the finger
lay in repetition j. They are estimated, not averaged away: the mean of recordings with shifted resonances is not a
recording with the mean resonance. The scale has an inverse gamma prior and is integrated out in closed form,

.. math:: p(z\,|\,\theta) \propto \left(\beta + \tfrac12\chi^2(\theta)\right)^{-(\alpha + N)},
          \qquad \chi^2(\theta) = \sum_{jk} |z_{jk} - Z_k(\theta+\delta_j)|^2/\sigma_{jk}^2,

with N the number of complex numbers less those that the deviations use up. A network that does not fit therefore
widens its own posterior instead of pretending to be exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from bayes_impedance.kernel import Kernel, Program, backward, compiled, forward

SCALE_SHAPE = 2.0
"""alpha = beta of the inverse gamma prior of the squared noise scale: centred near one, a factor of two either way."""

_summing: Any = njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
"""Decorator of long sums: the compiler may reorder them, and so use vector instructions."""


@dataclass(frozen=True)
class Likelihood:
    """Data of one person, ready for the compiled functions.

    Attributes
    ----------
    omega : ndarray, shape (F,)
        Angular frequency in rad/s.
    z : ndarray, shape (J, 2, F)
        Real and imaginary part of the recordings.
    weight : ndarray, shape (J, F)
        1/sigma^2 of each of the two parts.
    deviations : ndarray, shape (J, P)
        Log elements of each repetition less the person's; columns sum to zero.
    count : float
        Number N of complex numbers that tell about theta and the noise scale.
    """

    omega: np.ndarray
    z: np.ndarray
    weight: np.ndarray
    deviations: np.ndarray
    count: float

    @classmethod
    def make(cls, frequency_hz: np.ndarray, z: np.ndarray, noise_sd: np.ndarray, deviations: np.ndarray) -> Likelihood:
        """From complex recordings of shape (J, F) and the standard deviation of the noise, same shape."""
        parts = np.ascontiguousarray(np.stack([z.real, z.imag], axis=1))
        count = z.size - 0.5 * (z.shape[0] - 1) * deviations.shape[1]
        weight = np.ascontiguousarray(np.broadcast_to(noise_sd, z.shape) ** -2.0)
        return cls(2 * np.pi * np.ascontiguousarray(frequency_hz), parts, weight, deviations, max(count, 1.0))

    def moved(self, deviations: np.ndarray) -> Likelihood:
        """The same data with other deviations of the repetitions."""
        return Likelihood(self.omega, self.z, self.weight, np.ascontiguousarray(deviations), self.count)


@compiled
def chi_square(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    sums: np.ndarray,
    outputs: np.ndarray,
) -> float:
    """Chi-square of all repetitions; `sums` and `outputs` are scratch of shape (N, 2, F)."""
    last = program.node_parent.size - 1
    total = 0.0
    for j in range(z.shape[0]):
        forward(program, theta + deviations[j], omega, sums, outputs)
        total += _weighted_square(outputs[last, 0], outputs[last, 1], z[j, 0], z[j, 1], weight[j])
    return total


@_summing
def _weighted_square(
    a_real: np.ndarray, a_imag: np.ndarray, b_real: np.ndarray, b_imag: np.ndarray, weight: np.ndarray
) -> float:
    total = 0.0
    for f in range(weight.size):
        real, imag = a_real[f] - b_real[f], a_imag[f] - b_imag[f]
        total += weight[f] * (real * real + imag * imag)
    return total


@_summing
def _weighted_dot(a: np.ndarray, b: np.ndarray, weight: np.ndarray) -> float:
    total = 0.0
    for f in range(weight.size):
        total += weight[f] * (a[0, f] * b[0, f] + a[1, f] * b[1, f])
    return total


@compiled
def normal_equations(
    program: Program, theta: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """One recording at theta: chi-square, J^T W r with r = Z - z, and J^T W J.

    Parameters
    ----------
    z : ndarray, shape (2, F)
    weight : ndarray, shape (F,)

    Returns
    -------
    chi_square : float
    gradient : ndarray, shape (P,)
    information : ndarray, shape (P, P)
    """
    n_nodes, n_elements = program.node_parent.size, theta.size
    sums = np.empty((n_nodes, 2, omega.size))
    outputs = np.empty((n_nodes, 2, omega.size))
    derivative = np.empty((n_elements, 2, omega.size))
    forward(program, theta, omega, sums, outputs)
    backward(program, theta, omega, outputs, sums, derivative)  # the sums are not needed any more
    residual = outputs[n_nodes - 1]
    for f in range(omega.size):
        residual[0, f] -= z[0, f]
        residual[1, f] -= z[1, f]
    gradient = np.empty(n_elements)
    information = np.empty((n_elements, n_elements))
    for p in range(n_elements):
        gradient[p] = _weighted_dot(derivative[p], residual, weight)
        for q in range(p + 1):
            information[p, q] = _weighted_dot(derivative[p], derivative[q], weight)
            information[q, p] = information[p, q]
    return _weighted_dot(residual, residual, weight), gradient, information


@compiled
def all_repetitions(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Chi-square, gradient and information of all repetitions together."""
    chi, gradient, information = normal_equations(program, theta + deviations[0], omega, z[0], weight[0])
    for j in range(1, z.shape[0]):
        c, g, h = normal_equations(program, theta + deviations[j], omega, z[j], weight[j])
        chi += c
        gradient += g
        information += h
    return chi, gradient, information


@compiled
def _log_likelihoods(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    count: float,
) -> np.ndarray:
    """Log likelihood with the noise scale integrated out, up to a constant, for parameter sets (S, P): shape (S,)."""
    n_nodes = program.node_parent.size
    sums = np.empty((n_nodes, 2, omega.size))
    outputs = np.empty((n_nodes, 2, omega.size))
    result = np.empty(theta.shape[0])
    for i in range(theta.shape[0]):
        chi = chi_square(program, theta[i], deviations, omega, z, weight, sums, outputs)
        result[i] = -(SCALE_SHAPE + count) * np.log(SCALE_SHAPE + 0.5 * chi)
    return result


def repetition_equations(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient J^T W r, shape (J, P), and information J^T W J, shape (J, P, P), of every repetition at theta (P,)."""
    d = likelihood
    pairs = [
        normal_equations(kernel.program, theta + d.deviations[j], d.omega, d.z[j], d.weight[j])[1:]
        for j in range(d.z.shape[0])
    ]
    return np.array([g for g, _ in pairs]), np.array([h for _, h in pairs])


def log_likelihood(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> np.ndarray:
    """Log likelihood of a person's log elements, up to a constant.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    theta : ndarray, shape (S, P)

    Returns
    -------
    ndarray, shape (S,)
        -inf where the network's impedance is not finite.
    """
    d = likelihood
    theta = np.ascontiguousarray(theta)
    values = _log_likelihoods(kernel.program, theta, d.deviations, d.omega, d.z, d.weight, d.count)
    return np.where(np.isfinite(values), values, -np.inf)
