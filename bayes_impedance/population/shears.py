r"""Draws that follow shared parameters, each in its own direction.

When the shared parameters move by t, a person's posterior moves along the path of its mode,
:math:`c + s(t)`. Where the impedance bends, so that the person's elements answer to t in one part of the posterior
otherwise than in another, draws that are all moved alike leave it, and their weights differ by more than they did at
the origin. Draws are therefore moved by an affine map about the mode,

.. math:: \theta' = c + s(t) + M(t)\,(\theta - c), \qquad M(t) = 1 + \sum_s t_s R_s,

whose Jacobian is the same for all of a person's draws, so that

.. math:: p(z\,|\,\phi(t), \mu, T) \approx \frac{|M(t)|}{K} \sum_k \frac{L(\theta'_k, \phi(t))}{q(\theta_k)}\,
          N(\theta'_k; \mu, T).

**The shears** :math:`R_s` are a linear regression of the Gauss-Newton response at some of the draws
(:mod:`bayes_impedance.population.shared`) on where they lie. Any shears are right, good ones leave the weights as they
are. With :math:`\theta' = m + W^{-1}(M u + p(t))` in the coordinates u in which the reference population around m is a
standard normal,

.. math:: \ln N = -\tfrac12\, u^T M^T A M\, u + v^T A M\, u - \tfrac12\, v^T A\, v + \text{const}, \qquad
          v = \mu_u - p(t) :

the same monomials of u as without shears, with other coefficients.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import compiled
from bayes_impedance.person.small_matrices import log_determinant

_REGULAR = 1.0
"""Ridge of the regression, beside the sum of squares over the draws of coordinates in which they have a variance of
one. By choice: it counts as one draw."""
_MOST_SHEAR = 0.7
"""Largest norm of M - 1 within the reach, in coordinates in which the person's draws have a variance of one; larger
ones are made smaller. By choice: below one M is invertible, and a draw's neighbours stay its neighbours."""


def fitted_shears(theta: np.ndarray, responses: np.ndarray, covariance: np.ndarray, reach: float) -> np.ndarray:
    """Shears R (S, V, V) from the responses at n points.

    Parameters
    ----------
    theta : ndarray, shape (n, V)
    responses : ndarray, shape (n, V, S)
        Derivative of the elements with respect to t.
    covariance : ndarray, shape (V, V)
        Of the person's draws.
    reach : float
        Largest length of t.
    """
    factor = np.linalg.cholesky(covariance)
    x = np.linalg.solve(factor, (theta - theta.mean(axis=0)).T).T
    own = np.linalg.solve(factor, np.moveaxis(responses - responses.mean(axis=0), 2, 0).swapaxes(1, 2))  # (S, V, n)
    shears = own @ x @ np.linalg.inv(x.T @ x + _REGULAR * np.eye(x.shape[1]))
    # At t the norm of the sum is at most |t| times the root of the sum of squares.
    size = reach * float(np.sqrt(np.sum(np.linalg.norm(shears, ord=2, axis=(1, 2)) ** 2)))
    shears *= min(1.0, _MOST_SHEAR / max(size, 1e-300))
    return np.asarray(factor @ shears @ np.linalg.inv(factor))


def maps(t: np.ndarray, shears: np.ndarray) -> np.ndarray:
    """M(t) for t (W, S) and shears (..., S, V, V): shape (W, ..., V, V)."""
    size = shears.shape[-1]
    sheared = t @ np.moveaxis(shears, -3, 0).reshape(t.shape[1], -1)
    return np.asarray(np.eye(size) + sheared.reshape(len(t), *shears.shape[:-3], size, size))


@compiled
def sheared_coefficients(
    precision: np.ndarray,
    linear: np.ndarray,
    t: np.ndarray,
    shears: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of the monomials of u under W populations, for n persons.

    Parameters
    ----------
    precision : ndarray, shape (W, P, P)
        A.
    linear : ndarray, shape (W, n, P)
        A v.
    t : ndarray, shape (W, S)
    shears : ndarray, shape (n, S, P, P)
        In the coordinates u.
    rows, columns : ndarray of int, shape (m,)
        Pairs p, q of elements.

    Returns
    -------
    squares : ndarray, shape (n, W, m)
        Entries of M^T A M.
    linear : ndarray, shape (W, n, P)
        M^T A v.
    log_determinant : ndarray, shape (W, n)
        ln |M|.
    """
    n_sets, n_persons, size = linear.shape
    squares = np.empty((n_persons, n_sets, rows.size))
    moved, volume = np.empty((n_sets, n_persons, size)), np.empty((n_sets, n_persons))
    m, product = np.empty((size, size)), np.empty((size, size))
    for i in range(n_persons):
        for w in range(n_sets):
            for p in range(size):
                for q in range(size):
                    m[p, q] = 1.0 if p == q else 0.0
            for s in range(t.shape[1]):
                for p in range(size):
                    for q in range(size):
                        m[p, q] += t[w, s] * shears[i, s, p, q]
            for p in range(size):
                for q in range(size):
                    product[p, q] = 0.0
                for a in range(size):
                    for q in range(size):
                        product[p, q] += precision[w, p, a] * m[a, q]
            for k in range(rows.size):
                entry = 0.0
                for a in range(size):
                    entry += m[a, rows[k]] * product[a, columns[k]]
                squares[i, w, k] = entry
            for q in range(size):
                entry = 0.0
                for a in range(size):
                    entry += linear[w, i, a] * m[a, q]
                moved[w, i, q] = entry
            volume[w, i] = log_determinant(m)
    return squares, moved, volume
