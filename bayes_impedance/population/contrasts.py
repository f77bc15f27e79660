r"""The likelihood of dispersions between repetitions, from the contrasts between them.

Given a person's mean, the J - 1 orthonormal contrasts d of the deviations
:math:`\delta_{ij}` are N(0, diag rho^2). A repetition differs little from the person's mean, so the log likelihood of d
is taken as quadratic, with gradient b and curvature H at zero deviation; each repetition has its own curvature. The
Gaussian integral has a closed form,

.. math:: \ln p = -\tfrac12 \ln\left|I + D H D\right| + \tfrac12\, b^T D\,(I + D H D)^{-1} D\, b, \qquad D =
          \operatorname{diag}\rho,

which needs no inverse of H and is smooth down to rho = 0. With :math:`M = (I + DHD)^{-1}` and :math:`y = M D b` its
derivative is, by Fisher's identity,

.. math:: \frac{\partial \ln p}{\partial \rho_p} = \frac1{\rho_p}\sum_c \left(y_{cp}^2 + M_{cp,cp} - 1\right).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.network.kernel import compiled


@dataclass(frozen=True)
class Contrasts:
    """Likelihood of the contrasts between repetitions, for persons with the same number of repetitions.

    With C contrasts of P elements each, the combined index runs over contrasts and, within each, over elements.

    Attributes
    ----------
    information : ndarray, shape (C P, C P, n)
        Negative second derivative of the log likelihood of each of n persons.
    gradient : ndarray, shape (C P, n)
        Gradient of the log likelihood at zero deviation.
    """

    information: np.ndarray
    gradient: np.ndarray

    def log_likelihood(self, rho: np.ndarray) -> np.ndarray:
        """Log likelihood of dispersions between repetitions, shape (W, P), up to a constant: shape (W,)."""
        return np.asarray(_contrast_likelihood(self.information, self.gradient, np.ascontiguousarray(rho)))

    def slope(self, rho: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`log_likelihood` with respect to the dispersions: (W, P), zero at dispersions of zero."""
        return np.asarray(_contrast_gradient(self.information, self.gradient, np.ascontiguousarray(rho)))


@compiled
def _factored(
    information: np.ndarray, gradient: np.ndarray, rho: np.ndarray, factor: np.ndarray, y: np.ndarray
) -> float:
    """Fill the Cholesky factor of I + D H D, with reciprocals on its diagonal, and y = factor^-1 D b.

    Returns the log likelihood, summed over persons. Persons are the last, contiguous axis: the compiler handles several
    of them with one instruction.
    """
    size, n = gradient.shape
    total = 0.0
    for p in range(size):
        scale_p = rho[p % rho.size]
        for q in range(p):
            scale = scale_p * rho[q % rho.size]
            row, column, entry = factor[p], factor[q], information[p, q]
            target = row[q]
            for i in range(n):
                target[i] = scale * entry[i]
            for k in range(q):
                left, right = row[k], column[k]
                for i in range(n):
                    target[i] -= left[i] * right[i]
            diagonal = column[q]
            for i in range(n):
                target[i] *= diagonal[i]
        pivot, entry, own, slope = factor[p, p], information[p, p], y[p], gradient[p]
        for i in range(n):
            pivot[i] = 1.0 + scale_p * scale_p * entry[i]
            own[i] = scale_p * slope[i]
        for k in range(p):
            left, before = factor[p, k], y[k]
            for i in range(n):
                pivot[i] -= left[i] * left[i]
                own[i] -= left[i] * before[i]
        for i in range(n):
            total -= 0.5 * np.log(pivot[i])
            pivot[i] = 1.0 / np.sqrt(pivot[i])
            own[i] *= pivot[i]
            total += 0.5 * own[i] * own[i]
    return total


@compiled
def _contrast_likelihood(information: np.ndarray, gradient: np.ndarray, rho: np.ndarray) -> np.ndarray:
    size, n = gradient.shape
    factor, y = np.empty((size, size, n)), np.empty((size, n))
    result = np.empty(rho.shape[0])
    for w in range(rho.shape[0]):
        result[w] = _factored(information, gradient, rho[w], factor, y)
    return result


@compiled
def _contrast_gradient(information: np.ndarray, gradient: np.ndarray, rho: np.ndarray) -> np.ndarray:
    size, n = gradient.shape
    n_elements = rho.shape[1]
    factor, y = np.empty((size, size, n)), np.empty((size, n))
    inverse, solution, own = np.empty((size, n)), np.empty(n), np.empty(n)
    result = np.zeros(rho.shape)
    for w in range(rho.shape[0]):
        _factored(information, gradient, rho[w], factor, y)
        for q in range(size):  # column q of the factor's inverse, below its diagonal
            for i in range(n):
                inverse[q, i] = factor[q, q, i]
                own[i] = inverse[q, i] * inverse[q, i]  # M_qq
                solution[i] = inverse[q, i] * y[q, i]  # (M D b)_q
            for p in range(q + 1, size):
                target = inverse[p]
                for i in range(n):
                    target[i] = 0.0
                for k in range(q, p):
                    left, before = factor[p, k], inverse[k]
                    for i in range(n):
                        target[i] -= left[i] * before[i]
                diagonal, right = factor[p, p], y[p]
                for i in range(n):
                    target[i] *= diagonal[i]
                    own[i] += target[i] * target[i]
                    solution[i] += target[i] * right[i]
            total = 0.0
            for i in range(n):
                total += solution[i] * solution[i] + own[i] - 1.0
            if rho[w, q % n_elements] > 0.0:
                result[w, q % n_elements] += total / rho[w, q % n_elements]
    return result
