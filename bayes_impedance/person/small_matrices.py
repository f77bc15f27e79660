"""Inverse of a small positive definite matrix and solution of a small system, mostly inside compiled functions.

For a dozen rows a library call takes longer than its arithmetic, and the posterior of a person needs some inverses for
each of thousands of draws. What numba compiles around a library's solution takes longer to compile than the kernel.

Of many matrices (n, n, m) side by side an operation is done for all m in one loop, several at a time in the registers
of the processor. They all take the same steps, so rows are not exchanged: those that would need it are done again,
one by one.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import compiled

ROUNDING = 1e-12
"""Relative ridge of an information matrix. Beside a pole of a lossless network one point outweighs all others by 1e20,
and what these say of the other elements is lost in rounding: the matrix would be singular."""

_SMALLEST_PIVOT = 0.05
"""Pivot below which rows must be exchanged, of matrices whose entries are of order one. By choice: rounding grows by
at most the reciprocal in each step."""


@compiled
def inverted(a: np.ndarray) -> float:
    """Replace a symmetric positive definite matrix (n, n) by its inverse; its log determinant, nan if it is not one.

    Only the lower triangle is read. By Cholesky's factor L, whose inverse takes its place.
    """
    n = a.shape[0]
    log_determinant = 0.0
    for j in range(n):
        square = a[j, j]
        for k in range(j):
            square -= a[j, k] * a[j, k]
        if not square > 0.0:
            return np.nan
        root = np.sqrt(square)
        log_determinant += 2.0 * np.log(root)
        a[j, j] = root
        for i in range(j + 1, n):
            entry = a[i, j]
            for k in range(j):
                entry -= a[i, k] * a[j, k]
            a[i, j] = entry / root
    for j in range(n):
        a[j, j] = 1.0 / a[j, j]
        for i in range(j + 1, n):
            entry = 0.0
            for k in range(j, i):
                entry -= a[i, k] * a[k, j]
            a[i, j] = entry / a[i, i]
    for i in range(n):  # L^-T L^-1 into the upper triangle; the rows above i are no longer needed
        for j in range(i + 1):
            entry = 0.0
            for k in range(i, n):
                entry += a[k, i] * a[k, j]
            a[j, i] = entry
    for i in range(n):
        for j in range(i):
            a[i, j] = a[j, i]
    return log_determinant


@compiled
def _largest_pivot(a: np.ndarray, column: int) -> int:
    """Row of the entry with the largest absolute value on and below the diagonal of a column."""
    pivot = column
    for i in range(column + 1, a.shape[0]):
        if abs(a[i, column]) > abs(a[pivot, column]):
            pivot = i
    return pivot


@compiled
def log_determinant(a: np.ndarray) -> float:
    """Logarithm of the determinant's absolute value of a matrix (n, n), which is overwritten; -inf if it is singular.

    By Gaussian elimination with the largest pivot of each column.
    """
    n = a.shape[0]
    total = 0.0
    for k in range(n):
        pivot = _largest_pivot(a, k)
        if a[pivot, k] == 0.0:
            return -np.inf
        for j in range(k, n):
            a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
        total += np.log(abs(a[k, k]))
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k + 1, n):
                a[i, j] -= factor * a[k, j]
    return total


@compiled
def solved(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution x of a x = b, for a (n, n) and b (n,), by Gaussian elimination with the largest pivot of each column.

    Raises
    ------
    LinAlgError
        If a pivot is zero.
    """
    n, left, x = b.size, a.copy(), b.copy()
    for j in range(n):
        pivot = _largest_pivot(left, j)
        if left[pivot, j] == 0.0:
            raise np.linalg.LinAlgError("the matrix is singular to machine precision")
        if pivot != j:
            x[j], x[pivot] = x[pivot], x[j]
            for k in range(j, n):
                left[j, k], left[pivot, k] = left[pivot, k], left[j, k]
        for i in range(j + 1, n):
            factor = left[i, j] / left[j, j]
            x[i] -= factor * x[j]
            for k in range(j + 1, n):
                left[i, k] -= factor * left[j, k]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= left[i, k] * x[k]
        x[i] /= left[i, i]
    return x


@compiled
def log_determinants(a: np.ndarray, result: np.ndarray) -> None:
    """Logarithms of the absolute values of determinants (m,), of many matrices (n, n, m)."""
    n, m = a.shape[0], a.shape[2]
    left, smallest = a.copy(), np.full(m, np.inf)
    result[:] = 1.0
    for k in range(n):
        pivot = left[k, k]
        for i in range(m):
            smallest[i] = min(smallest[i], abs(pivot[i]))
            result[i] *= pivot[i]
        for r in range(k + 1, n):
            factor = left[r, k]
            for i in range(m):
                factor[i] /= pivot[i]
            for c in range(k + 1, n):
                target, source = left[r, c], left[k, c]
                for i in range(m):
                    target[i] -= factor[i] * source[i]
    for i in range(m):
        certain = smallest[i] > _SMALLEST_PIVOT
        result[i] = np.log(abs(result[i])) if certain else log_determinant(a[:, :, i].copy())


@compiled
def inverses(a: np.ndarray, result: np.ndarray) -> None:
    """Inverses (n, n, m) of many matrices, by the method of Gauss and Jordan in place.

    Raises
    ------
    LinAlgError
        If one of them is singular.
    """
    n, m = a.shape[0], a.shape[2]
    smallest, reciprocal = np.full(m, np.inf), np.empty(m)
    result[:] = a
    for k in range(n):
        pivot = result[k, k]
        for i in range(m):
            smallest[i] = min(smallest[i], abs(pivot[i]))
            reciprocal[i] = 1.0 / pivot[i]
            pivot[i] = 1.0
        for c in range(n):
            target = result[k, c]
            for i in range(m):
                target[i] *= reciprocal[i]
        for r in range(n):
            if r == k:
                continue
            factor = result[r, k].copy()
            result[r, k, :] = 0.0
            for c in range(n):
                target, source = result[r, c], result[k, c]
                for i in range(m):
                    target[i] -= factor[i] * source[i]
    for i in range(m):
        if not smallest[i] > _SMALLEST_PIVOT:
            own = a[:, :, i].copy()
            for c in range(n):
                unit = np.zeros(n)
                unit[c] = 1.0
                result[:, c, i] = solved(own, unit)


def inverse(a: np.ndarray) -> np.ndarray:
    """Inverses of positive definite matrices (..., n, n), also where rounding has made one of them singular.

    Rows of very different sizes (:data:`ROUNDING`) may leave no pivot. Scaled to a diagonal of ones, they do.
    """
    try:
        return np.asarray(np.linalg.inv(a))
    except np.linalg.LinAlgError:
        root = np.sqrt(np.einsum("...ii->...i", a))
        scale = root[..., :, None] * root[..., None, :]
        return np.asarray(np.linalg.inv(a / scale + ROUNDING * np.eye(a.shape[-1])) / scale)
