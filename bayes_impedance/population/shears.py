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
from bayes_impedance.person.small_matrices import inverses, log_determinants

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
def _combined(weights: np.ndarray, values: np.ndarray, result: np.ndarray) -> None:
    """Weighted sum over the first of two dimensions (k, n), for n persons."""
    result[:] = 0.0
    for k in range(weights.size):
        weight, source = weights[k], values[k]
        for i in range(result.size):
            result[i] += weight * source[i]


@compiled
def _maps_at(t: np.ndarray, shears: np.ndarray, result: np.ndarray) -> None:
    """M(t) (P, P, n) of n persons at one t (S,), for shears (S, P, P, n); M^T for transposed ones."""
    for p in range(result.shape[0]):
        for q in range(result.shape[0]):
            _combined(t, shears[:, p, q], result[p, q])
        result[p, p] += 1.0


@compiled
def _times(a: np.ndarray, transposed: np.ndarray, result: np.ndarray) -> None:
    """Products a m of one matrix (P, P) with those of n persons, transposed as the latter are: (P, P, n)."""
    for q in range(result.shape[0]):
        for p in range(result.shape[0]):
            _combined(a[p], transposed[q], result[q, p])


@compiled
def _dot(left: np.ndarray, right: np.ndarray, result: np.ndarray) -> None:
    """Sum over the first of two dimensions (k, n) of the products, for n persons."""
    result[:] = 0.0
    for k in range(left.shape[0]):
        one, other = left[k], right[k]
        for i in range(result.size):
            result[i] += one[i] * other[i]


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
    side_by_side = np.ascontiguousarray(shears.transpose(1, 3, 2, 0))  # columns of M as rows, which are adjacent
    m, product, line = np.empty((size, size, n_persons)), np.empty((size, size, n_persons)), np.empty(n_persons)
    for w in range(n_sets):
        _maps_at(t[w], side_by_side, m)
        _times(precision[w], m, product)
        for k in range(rows.size):
            _dot(m[rows[k]], product[columns[k]], line)
            for i in range(n_persons):
                squares[i, w, k] = line[i]
        own = linear[w].T.copy()
        for q in range(size):
            _dot(own, m[q], line)
            for i in range(n_persons):
                moved[w, i, q] = line[i]
        log_determinants(m, volume[w])
    return squares, moved, volume


@compiled
def sheared_moments(
    precision: np.ndarray,
    v: np.ndarray,
    counted: np.ndarray,
    t: np.ndarray,
    shears: np.ndarray,
    first: np.ndarray,
    squares: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Moments of Mu from those of u, and the derivative of the log likelihood with respect to t through M.

    With moments :math:`E[u]` and :math:`E[u u^T]` over a person's draws the derivative is
    :math:`\sum_{pq} R_{s,pq}\,(M^{-T} - A\,(M E[u u^T] - v E[u]^T))_{pq}`, as follows from the density above.

    Parameters
    ----------
    precision : ndarray, shape (W, P, P)
        A.
    v : ndarray, shape (W, n, P)
    counted : ndarray, shape (W, n)
        Part by which each person counts, which the moments hold already.
    t : ndarray, shape (W, S)
    shears : ndarray, shape (n, S, P, P)
        In the coordinates u.
    first, squares : ndarray, shape (W, n, P) and (W, n, m)
        Moments of u: of pairs p, q those given by rows and columns (m,).

    Returns
    -------
    first, squares : ndarray, shape (W, n, P) and (W, n, m)
        Of M u.
    slope : ndarray, shape (W, S)
        Summed over persons.

    Raises
    ------
    LinAlgError
        If a map is singular.
    """
    n_sets, n_persons, size = first.shape
    there, after, slope = np.empty(first.shape), np.empty(squares.shape), np.empty(t.shape)
    side_by_side = np.ascontiguousarray(shears.transpose(1, 2, 3, 0))
    m, whole, both, away = np.empty((4, size, size, n_persons))
    product, inverse, line = np.empty((size, size, n_persons)), np.empty((size, size, n_persons)), np.empty(n_persons)
    for w in range(n_sets):
        _maps_at(t[w], side_by_side, m)
        mean, centre = first[w].T.copy(), v[w].T.copy()
        for k in range(rows.size):
            for i in range(n_persons):
                whole[rows[k], columns[k], i] = whole[columns[k], rows[k], i] = squares[w, i, k]
        for p in range(size):
            for q in range(size):
                _dot(m[p], whole[q], both[p, q])  # E[M u u^T]
            _dot(m[p], mean, line)
            for i in range(n_persons):
                there[w, i, p] = line[i]
        for k in range(rows.size):
            _dot(both[rows[k]], m[columns[k]], line)
            for i in range(n_persons):
                after[w, i, k] = line[i]
        for p in range(size):
            for q in range(size):
                target, source, left, right = away[q, p], both[p, q], centre[p], mean[q]
                for i in range(n_persons):
                    target[i] = source[i] - left[i] * right[i]
        _times(precision[w], away, product)
        inverses(m, inverse)
        share = counted[w].copy()
        for s in range(t.shape[1]):
            line[:] = 0.0
            for p in range(size):
                for q in range(size):
                    of_volume, of_density, shear = inverse[q, p], product[q, p], side_by_side[s, p, q]
                    for i in range(n_persons):
                        line[i] += (share[i] * of_volume[i] - of_density[i]) * shear[i]
            slope[w, s] = line.sum()
    return there, after, slope
