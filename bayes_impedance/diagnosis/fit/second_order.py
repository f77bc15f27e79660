r"""The part of the curvature that Gauss-Newton leaves out, learned from a fit's own steps.

A recording's chi-square has half the Hessian

.. math:: J^TWJ + S, \qquad S = \sum_k w_k r_k \nabla^2 r_k,

of which Gauss-Newton takes the first part. S is small where residuals are noise. Under a wrong model they are many
times the noise, and it decides how far a step may go: without it each step overshoots, is shortened, and a fit whose
gain has long been known creeps for dozens of rounds. After a step s from the gradient g (half that of chi-square) to
g', the symmetric update of rank one

.. math:: S \to S + \frac{ee^T}{e^Ts}, \qquad e = g' - g - (J'^TW'J' + S)\,s

makes the curvature agree with what the gradient did. Far from the optimum a learned S misleads. So, as in NL2SOL
(Dennis, Gay and Welsch 1981, ACM Trans. Math. Softw. 7, 348), a person's next step uses it only if it foretold what the
last one brought at least as well as Gauss-Newton did. A step that did not descend is learned from as well: where it
ended the curvature is known, and the next one is tried from the same place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.normal_equations import Equations
from bayes_impedance.network.kernel import compiled

_LEAST_COSINE = 0.01
"""Smallest cosine between e and the step, in units of the curvature, with which S is updated: the update is longer than
e by the inverse of it, and would be little but rounding. By choice."""

_FIRM = 0.05
"""Share of the curvature without S that must be left with it in every direction: with less, the step has no bound. By
choice."""


@dataclass(frozen=True)
class SecondOrder:
    """S of every recording, and whose steps use it.

    Attributes
    ----------
    matrix : ndarray, shape (M, P, P)
    used : ndarray of bool, shape (N,)
    """

    matrix: np.ndarray
    used: np.ndarray

    @classmethod
    def unknown(cls, recordings: int, parameters: int, people: int) -> SecondOrder:
        """Before the first step."""
        return cls(np.zeros((recordings, parameters, parameters)), np.zeros(people, dtype=bool))

    def only(self, rows: np.ndarray, people: np.ndarray) -> SecondOrder:
        """Of some recordings (bool, shape (M,)), which are those of some people (bool, shape (N,))."""
        return SecondOrder(self.matrix[rows], self.used[people])

    def after(self, owner: np.ndarray, step: np.ndarray, before: Equations, equations: Equations) -> SecondOrder:
        """Learn from a step.

        Parameters
        ----------
        owner : ndarray, shape (M,)
            Person of every recording.
        step : ndarray, shape (M, P)
            Zero where nothing moved.
        before, equations : Equations
            At its begin and at its end.
        """
        n = self.used.size
        along = np.einsum("mpq,mq->mp", self.matrix, step)
        plain = np.sum(step * (before.gradient + 0.5 * np.einsum("mpq,mq->mp", before.information, step)), axis=1)
        brought = np.bincount(owner, 0.5 * (equations.chi - before.chi), minlength=n)
        without = np.bincount(owner, plain, minlength=n)
        with_it = np.bincount(owner, plain + 0.5 * np.sum(step * along, axis=1), minlength=n)
        known = np.bincount(owner, np.any(along != 0, axis=1), minlength=n) > 0
        used = np.where(known, np.abs(with_it - brought) <= np.abs(without - brought), self.used)

        error = equations.gradient - before.gradient - np.einsum("mpq,mq->mp", equations.information, step) - along
        down = np.sum(error * step, axis=1)
        scale = np.sqrt(np.maximum(np.einsum("mpp->mp", equations.information), np.finfo(float).tiny))
        # Of a model that is as good as infinite somewhere nothing is learned.
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(error / scale, axis=1) * np.linalg.norm(step * scale, axis=1)
        clear = np.isfinite(length) & (length > 0) & (np.abs(down) > _LEAST_COSINE * length)
        matrix = self.matrix.copy()
        e = error[clear]
        matrix[clear] += e[:, :, None] * e[:, None, :] / down[clear, None, None]
        return SecondOrder(matrix, used)

    def beside(self, curvature: np.ndarray, owner: np.ndarray, weight: np.ndarray, varying: np.ndarray) -> np.ndarray:
        """What is to be added to the curvature; zero where S is not used, or would not leave it positive definite.

        Parameters
        ----------
        curvature : ndarray, shape (M, V, V)
            Of varying parameters, positive definite.
        owner : ndarray, shape (M,)
        weight : ndarray, shape (M,)
            1/scale^2 of the noise.
        varying : ndarray of bool, shape (P,)
        """
        result = np.zeros_like(curvature)
        rows = np.flatnonzero(self.used[owner])
        if not rows.size:
            return result
        own = weight[rows, None, None] * self.matrix[rows][:, varying][:, :, varying]
        firm = _positive_definite((1 - _FIRM) * curvature[rows] + own)
        result[rows[firm]] = own[firm]
        return result


@compiled
def _positive_definite(matrices: np.ndarray) -> np.ndarray:
    """Whether each symmetric matrix of (K, V, V) is positive definite, by Cholesky's pivots; bool, shape (K,)."""
    n, size = matrices.shape[0], matrices.shape[1]
    found, factor = np.ones(n, dtype=np.bool_), np.empty((size, size))
    for k in range(n):
        for i in range(size):
            for j in range(i + 1):
                value = matrices[k, i, j]
                for p in range(j):
                    value -= factor[i, p] * factor[j, p]
                if i > j:
                    factor[i, j] = value / factor[j, j]
                elif value > 0:
                    factor[i, i] = np.sqrt(value)
                else:
                    found[k] = False
                    break
            if not found[k]:
                break
    return found
