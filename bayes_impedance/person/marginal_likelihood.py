r"""The likelihood of one person's log elements with the deviations of the repetitions integrated out.

The symbols are those of :mod:`bayes_impedance.person.likelihood`. The deviations must not be held fixed in a
posterior: if the curvature H_j differs between repetitions, they depend on theta, and fixing them makes the standard
deviations of weakly determined elements up to 30 % too small. They are therefore integrated out by Laplace's method at
every theta: Newton steps, with the sum kept at zero, start from the linear dependence :math:`\delta_j(\theta)` at the
mode, one near it and some where theta lies far along a ridge, and

.. math:: \ln p(z\,|\,\theta, \rho) \approx -(\alpha + N')\ln\left(\beta + \tfrac12\chi^2\right)
          - \tfrac12 \sum_j \delta_j^T R^{-1} \delta_j - \tfrac12 \ln\left|U^T A\, U\right|,

with R = diag rho^2, all numbers counted in N', A the block matrix of :math:`A_j = w H_j + R^{-1}` and U a basis of
deviations that sum to zero, so that :math:`\ln|U^TAU| = \sum_j \ln|A_j| + \ln|J^{-1}\sum_j A_j^{-1}|`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.network.kernel import Kernel, compiled, workspace
from bayes_impedance.network.program import Program
from bayes_impedance.person.likelihood import (
    SCALE_SHAPE,
    Likelihood,
    chi_square,
    equations_apart,
    log_likelihood,
    repetition_equations,
)
from bayes_impedance.person.small_matrices import inverted

LEAST_RHO = 1e-3
"""Least dispersion between repetitions, in logarithms, for which deviations are integrated out. By choice: a thousandth
of an element is far less than any finger changes, and the curvature 1/rho^2 stays finite."""

_SETTLED, _MOST_STEPS = 0.1, 8
"""Gain of a Newton step that the quadratic promises below which it is the last, and most steps. By choice: what remains
after a step that gains 0.1 is of third order; near the mode the first one suffices. Far along a valley it does not:
with one step alone the likelihood there was up to 8 units too high for people with a mass that each determines weakly,
and 2700 too low in a band of 1 %."""


@dataclass(frozen=True)
class Ridge:
    """Linear dependence of the deviations of the repetitions on the person's log elements.

    Attributes
    ----------
    theta : ndarray, shape (P,)
        Point of expansion: the mode.
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
    rho = np.maximum(rho, LEAST_RHO)
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
        Up to a constant (:func:`bayes_impedance.person.absolute_density.log_constant`); -inf where the network's
        impedance is not finite.
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
        SCALE_SHAPE + d.values,
        d.beta,
    )
    return np.where(np.isfinite(values), values, -np.inf)


@compiled
def joint_at(
    program: Program,
    theta: np.ndarray,
    moved: np.ndarray,
    rho: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
    sums: np.ndarray,
    outputs: np.ndarray,
) -> float:
    """Log density of recordings and deviations (J, P) at log elements (P,), up to a constant."""
    chi = chi_square(program, theta, moved, omega, z, weight, sums, outputs)
    square = 0.0
    for j in range(moved.shape[0]):
        for p in range(theta.size):
            square += (moved[j, p] / rho[p]) ** 2.0
    return float(-exponent * np.log(beta + 0.5 * chi) - 0.5 * square)


@compiled
def begun(
    program: Program,
    theta: np.ndarray,
    centre: np.ndarray,
    slope: np.ndarray,
    deviations: np.ndarray,
    rho: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
    sums: np.ndarray,
    outputs: np.ndarray,
    moved: np.ndarray,
) -> None:
    """Write the more probable of two beginnings at log elements (P,) into `moved` (J, P).

    The ridge's tangent holds near the mode; far along a curved one, the deviations at the mode.
    """
    for j in range(moved.shape[0]):
        for p in range(theta.size):
            moved[j, p] = deviations[j, p]
            for q in range(theta.size):
                moved[j, p] += slope[j, p, q] * (theta[q] - centre[q])
    tangent = joint_at(program, theta, moved, rho, omega, z, weight, exponent, beta, sums, outputs)
    same = joint_at(program, theta, deviations, rho, omega, z, weight, exponent, beta, sums, outputs)
    if not tangent > same:
        moved[:] = deviations


@compiled
def settled(
    program: Program,
    theta: np.ndarray,
    moved: np.ndarray,
    rho: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
    inverses: np.ndarray,
    steps: np.ndarray,
) -> float:
    r"""Move the deviations (J, P) of the repetitions to their mode at log elements (P,).

    Returns :math:`\ln|U^TAU|` there, nan where the impedance is not finite; `inverses` (J, P, P) and `steps` (J, P)
    are overwritten.
    """
    n_repetitions, n_elements = moved.shape
    total, before = np.empty((n_elements, n_elements)), np.empty((n_repetitions, n_elements))
    multiplier, common = np.empty(n_elements), np.empty(n_elements)
    log_determinant, highest = np.nan, -np.inf
    for _ in range(_MOST_STEPS):
        chi, square = 0.0, 0.0
        gradients = np.empty((n_repetitions, n_elements))
        for j in range(n_repetitions):
            c, gradient, information = equations_apart(program, theta + moved[j], omega, z[j], weight[j])
            chi += c
            for p in range(n_elements):
                square += (moved[j, p] / rho[p]) ** 2.0
                gradients[j, p] = gradient[p]
                for q in range(p + 1):  # of an inverse only this triangle is read
                    inverses[j, p, q] = information[p, q]
        value = -exponent * np.log(beta + 0.5 * chi) - 0.5 * square
        if np.isfinite(highest) and not value > highest - _SETTLED:  # too far: half as far
            for j in range(n_repetitions):
                for p in range(n_elements):
                    steps[j, p] *= 0.5
                    moved[j, p] = before[j, p] + steps[j, p]
            continue
        w = exponent / (beta + 0.5 * chi)
        if not np.isfinite(w):
            return np.nan
        highest = value
        log_determinant = 0.0
        total[:], multiplier[:] = 0.0, 0.0
        for j in range(n_repetitions):
            for p in range(n_elements):
                for q in range(p + 1):
                    inverses[j, p, q] *= w
                inverses[j, p, p] += rho[p] ** -2.0
                gradients[j, p] = -w * gradients[j, p] - moved[j, p] / rho[p] ** 2.0
            log_determinant += inverted(inverses[j])
            for p in range(n_elements):
                steps[j, p] = 0.0  # the free step; its sum over repetitions must vanish
                for q in range(n_elements):
                    steps[j, p] += inverses[j, p, q] * gradients[j, q]
                    total[p, q] += inverses[j, p, q] / n_repetitions
                multiplier[p] -= steps[j, p] / n_repetitions
        log_determinant += inverted(total)
        for p in range(n_elements):
            common[p] = 0.0
            for q in range(n_elements):
                common[p] += total[p, q] * multiplier[q]
        gain, longest = 0.0, 0.0
        for j in range(n_repetitions):
            for p in range(n_elements):
                for q in range(n_elements):
                    steps[j, p] += inverses[j, p, q] * common[q]
                gain += 0.5 * gradients[j, p] * steps[j, p]
                longest = max(longest, abs(steps[j, p]))
        for j in range(n_repetitions):
            for p in range(n_elements):
                before[j, p] = moved[j, p]
                steps[j, p] /= max(1.0, 2.0 * longest)  # the same for all: their sum must stay zero
                moved[j, p] += steps[j, p]
        if not gain > _SETTLED:
            break
    return log_determinant


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
    exponent: float,
    beta: float,
) -> np.ndarray:
    n_repetitions, n_elements = deviations.shape
    sums, outputs = workspace(program, omega)
    inverses = np.empty((n_repetitions, n_elements, n_elements))
    steps, moved = np.empty((n_repetitions, n_elements)), np.empty((n_repetitions, n_elements))
    result = np.empty(theta.shape[0])
    for i in range(theta.shape[0]):
        begun(program, theta[i], centre, slope, deviations, rho, omega, z, weight, exponent, beta, sums, outputs, moved)
        log_determinant = settled(program, theta[i], moved, rho, omega, z, weight, exponent, beta, inverses, steps)
        if np.isfinite(log_determinant):
            there = joint_at(program, theta[i], moved, rho, omega, z, weight, exponent, beta, sums, outputs)
            result[i] = there - 0.5 * log_determinant
        else:
            result[i] = -np.inf
    return result
