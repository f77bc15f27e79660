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

Where a mode is searched the deviations are held. A **posterior** must not hold them: if the curvature H_j differs
between repetitions they move along with theta, and holding them makes weakly determined elements up to 30 % too
certain. There they are integrated out by Laplace's method anew at every theta: from the linear dependence
:math:`\delta_j(\theta)` at the mode one Newton step is made with the sum kept at zero, and

.. math:: \ln p(z\,|\,\theta, \rho) \approx -(\alpha + N')\ln\left(\beta + \tfrac12\chi^2\right)
          - \tfrac12 \sum_j \delta_j^T R^{-1} \delta_j - \tfrac12 \ln\left|U^T A\, U\right|,

with R = diag rho^2, all numbers counted in N', A the block matrix of :math:`A_j = w H_j + R^{-1}` and U a basis of
deviations that sum to zero, so that :math:`\ln|U^TAU| = \sum_j \ln|A_j| + \ln|J^{-1}\sum_j A_j^{-1}|`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from bayes_impedance.network.kernel import Kernel, Program, backward, compiled, forward, workspace

SCALE_SHAPE = 2.0
"""alpha = beta of the inverse gamma prior of the squared noise scale: centred near one, a factor of two either way."""

_FREQUENCIES = 104
"""Most frequencies in a block of the normal equations."""

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

    def thinned(self, n: int) -> Likelihood:
        """About n of the frequencies, evenly spread: for decisions that need no precision."""
        f = self.omega.size
        points = np.unique(np.linspace(0, f - 1, min(n, f)).round().astype(int))
        parts = (np.ascontiguousarray(a[..., points]) for a in (self.omega, self.z, self.weight))
        omega, z, weight = parts
        return Likelihood(omega, z, weight, self.deviations, max(self.count - (f - points.size) * z.shape[0], 1.0))

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
    """Chi-square of all repetitions; `sums` and `outputs` are a workspace."""
    total = 0.0
    for j in range(z.shape[0]):
        forward(program, theta + deviations[j], omega, sums, outputs)
        total += _weighted_square(outputs, program.node_parent.size - 1, z, weight, j)
    return total


@_summing
def _weighted_square(outputs: np.ndarray, node: int, z: np.ndarray, weight: np.ndarray, j: int) -> float:
    """Weighted square of the difference between a node's output and recording j."""
    total = 0.0
    for f in range(weight.shape[1]):
        real, imag = outputs[node, 0, f] - z[j, 0, f], outputs[node, 1, f] - z[j, 1, f]
        total += weight[j, f] * (real * real + imag * imag)
    return total


@_summing
def _three_dots(rows: np.ndarray, p: int, q: int, r: int, s: int) -> tuple[float, float, float]:
    """Products of row p with rows q, r and s: three at a time, since reading costs more than multiplying."""
    with_q, with_r, with_s = 0.0, 0.0, 0.0
    for f in range(rows.shape[1]):
        value = rows[p, f]
        with_q += value * rows[q, f]
        with_r += value * rows[r, f]
        with_s += value * rows[s, f]
    return with_q, with_r, with_s


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
    # Blocks of frequencies whose numbers stay in the first-level cache. All are equally long: the last one is filled up
    # with a frequency of no weight.
    n_blocks = max(1, -(-omega.size // _FREQUENCIES))
    size = max(1, -(-omega.size // n_blocks))
    sums, outputs = workspace(program, omega[:size])
    own, adjoints = np.empty(size), np.zeros((n_nodes + 1, 2, size))
    rows = np.empty((n_elements + 1, 2, size))  # the derivatives and the residual, times the root of the weight
    flat = rows.reshape(n_elements + 1, 2 * size)
    products = np.zeros((n_elements + 1, n_elements + 1))
    for start in range(0, omega.size, size):
        present = min(size, omega.size - start)
        for f in range(present):
            own[f] = omega[start + f]
            adjoints[n_nodes, 0, f] = np.sqrt(weight[start + f])
        for f in range(present, size):
            own[f], adjoints[n_nodes, 0, f] = own[f - 1], 0.0
        for f in range(size):
            sums[n_nodes, 0, f] = 1.0 / own[f]
        forward(program, theta, own, sums, outputs)
        backward(program, theta, own, sums, outputs, adjoints, rows)
        for part in range(2):
            for f in range(present):
                residual = outputs[n_nodes - 1, part, f] - z[part, start + f]
                rows[n_elements, part, f] = residual * adjoints[n_nodes, 0, f]
            rows[n_elements, part, present:] = 0.0
        for p in range(n_elements + 1):
            for q in range(0, p + 1, 3):
                dots = _three_dots(flat, p, q, min(q + 1, n_elements), min(q + 2, n_elements))
                for k in range(min(3, p + 1 - q)):
                    products[p, q + k] += dots[k]
    for p in range(n_elements):
        for q in range(p):
            products[q, p] = products[p, q]
    return products[-1, -1], products[-1, :-1].copy(), products[:-1, :-1].copy()


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
    sums, outputs = workspace(program, omega)
    result = np.empty(theta.shape[0])
    for i in range(theta.shape[0]):
        chi = chi_square(program, theta[i], deviations, omega, z, weight, sums, outputs)
        result[i] = -(SCALE_SHAPE + count) * np.log(SCALE_SHAPE + 0.5 * chi)
    return result


@compiled
def _log_likelihood_gradients(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    count: float,
) -> tuple[np.ndarray, np.ndarray]:
    values, gradients = np.empty(theta.shape[0]), np.empty(theta.shape)
    for i in range(theta.shape[0]):
        chi, gradient, _ = all_repetitions(program, theta[i], deviations, omega, z, weight)
        values[i] = -(SCALE_SHAPE + count) * np.log(SCALE_SHAPE + 0.5 * chi)
        gradients[i] = -(SCALE_SHAPE + count) / (SCALE_SHAPE + 0.5 * chi) * gradient
    return values, gradients


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


def log_likelihood_gradient(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log likelihood of log elements (S, P) as in :func:`log_likelihood`, (S,), and its gradient, (S, P)."""
    d = likelihood
    return _log_likelihood_gradients(  # type: ignore[no-any-return]
        kernel.program, np.ascontiguousarray(theta), d.deviations, d.omega, d.z, d.weight, d.count
    )


@dataclass(frozen=True)
class Ridge:
    """How the deviations of the repetitions follow the person's log elements.

    Attributes
    ----------
    theta : ndarray, shape (P,)
        Where the expansion is made: the mode.
    slope : ndarray, shape (J, P, P)
        Derivative of each repetition's deviation with respect to theta; sums to zero over repetitions.
    rho : ndarray, shape (P,)
        Dispersion between repetitions.
    precision : ndarray, shape (P, P)
        Curvature of the likelihood of theta with the deviations integrated out.
    """

    theta: np.ndarray
    slope: np.ndarray
    rho: np.ndarray
    precision: np.ndarray


def find_ridge(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray, scale: float, rho: np.ndarray) -> Ridge:
    """The ridge at a mode.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        With the deviations at their mode.
    theta : ndarray, shape (P,)
    scale : float
        Noise scale at the mode.
    rho : ndarray, shape (P,)
    """
    information = repetition_equations(kernel, likelihood, theta)[1] / scale**2
    if information.shape[0] == 1:
        return Ridge(theta, np.zeros_like(information), rho, information[0])
    rho = np.maximum(rho, 1e-3)
    inverse = np.linalg.inv(information + np.diag(rho**-2.0))
    pulled = inverse @ information
    multiplier = -np.linalg.solve(inverse.sum(axis=0), pulled.sum(axis=0))
    slope = -(pulled + inverse @ multiplier)
    precision = np.sum(information @ (np.eye(theta.size) + slope), axis=0)
    return Ridge(theta, np.ascontiguousarray(slope), rho, 0.5 * (precision + precision.T))


def marginal_log_likelihood(kernel: Kernel, likelihood: Likelihood, ridge: Ridge, theta: np.ndarray) -> np.ndarray:
    """Log likelihood of a person's log elements with the deviations of the repetitions integrated out.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    ridge : Ridge
    theta : ndarray, shape (S, P)

    Returns
    -------
    ndarray, shape (S,)
        Up to a constant; -inf where the network's impedance is not finite.
    """
    d = likelihood
    if d.z.shape[0] == 1:
        return log_likelihood(kernel, likelihood, theta)
    values = _marginal_log_likelihoods(
        kernel.program,
        np.ascontiguousarray(theta),
        ridge.theta,
        ridge.slope,
        ridge.rho,
        d.deviations,
        d.omega,
        d.z,
        d.weight,
    )
    return np.where(np.isfinite(values), values, -np.inf)


@compiled
def _marginal_log_likelihoods(
    program: Program,
    theta: np.ndarray,
    centre: np.ndarray,
    slope: np.ndarray,
    rho: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
) -> np.ndarray:
    n_repetitions, n_elements = deviations.shape
    exponent = SCALE_SHAPE + n_repetitions * omega.size
    sums, outputs = workspace(program, omega)
    inverses = np.empty((n_repetitions, n_elements, n_elements))
    gradients = np.empty((n_repetitions, n_elements))
    result = np.empty(theta.shape[0])
    for i in range(theta.shape[0]):
        moved = deviations.copy()
        for j in range(n_repetitions):
            moved[j] += slope[j] @ (theta[i] - centre)
        chi = 0.0
        for j in range(n_repetitions):
            c, gradients[j], inverses[j] = normal_equations(program, theta[i] + moved[j], omega, z[j], weight[j])
            chi += c
        w = exponent / (SCALE_SHAPE + 0.5 * chi)
        if not np.isfinite(w):
            result[i] = -np.inf
            continue
        log_determinant = 0.0
        total = np.zeros((n_elements, n_elements))
        pulled = np.zeros(n_elements)
        for j in range(n_repetitions):
            curvature = w * inverses[j]
            for p in range(n_elements):
                curvature[p, p] += rho[p] ** -2.0
                gradients[j, p] = -w * gradients[j, p] - moved[j, p] / rho[p] ** 2.0
            factor = np.linalg.cholesky(curvature)
            log_determinant += 2.0 * np.log(np.diag(factor)).sum()
            inverses[j] = np.linalg.inv(curvature)
            gradients[j] = inverses[j] @ gradients[j]
            total += inverses[j]
            pulled += gradients[j]
        log_determinant += 2.0 * np.log(np.diag(np.linalg.cholesky(total / n_repetitions))).sum()
        multiplier = -np.linalg.solve(total, pulled)
        square = 0.0
        for j in range(n_repetitions):
            step = gradients[j] + inverses[j] @ multiplier
            moved[j] += step / max(1.0, 2.0 * np.abs(step).max())
            square += np.sum((moved[j] / rho) ** 2)
        chi = chi_square(program, theta[i], moved, omega, z, weight, sums, outputs)
        result[i] = -exponent * np.log(SCALE_SHAPE + 0.5 * chi) - 0.5 * square - 0.5 * log_determinant
    return result
