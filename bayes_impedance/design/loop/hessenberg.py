r"""Whether the eigenvalues of many matrices that differ in one row lie inside a circle: one user's loop at many gains.

A feedback :math:`f = g^T x` that enters through one column makes :math:`M = M_0 + \gamma g^T`. With an orthogonal Q
that maps :math:`\gamma` onto the first axis and makes the rest of :math:`Q^T M_0 Q` upper Hessenberg (the *controller
Hessenberg form*, [1]_) g changes only the first row:

.. math:: Q^T M Q = H_0 + |\gamma|\, e_1 (Q^T g)^T .

So the reduction, most of the work for a small matrix, is done once per user, and the QR iteration with Francis's
double shift [2]_ runs on each gain. It ends as soon as one eigenvalue beyond the limit has been found.

References
----------
.. [1] P. Van Dooren, M. Verhaegen, "On the use of unitary state-space transformations", Contemporary Mathematics 47
   (1985) 447-463.
.. [2] G. H. Golub, C. F. Van Loan, "Matrix Computations", 4th edition (2013), section 7.5.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import hessenberg

from bayes_impedance.network.kernel import compiled

_ITERATIONS = 90
"""Most QR steps for one eigenvalue before it counts as not found. By choice: three times the number in EISPACK's
hqr."""


def reduced(matrix: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Controller Hessenberg form.

    Parameters
    ----------
    matrix : ndarray, shape (q, q)
    column : ndarray, shape (q,)
        Column through which the feedback enters, not zero.

    Returns
    -------
    hessenberg : ndarray, shape (q, q)
    turned : ndarray, shape (q, q)
        ``g @ turned`` is added to the first row.
    """
    size = np.linalg.norm(column)
    mirror = column / size
    mirror[0] += 1.0 if mirror[0] >= 0 else -1.0
    mirror /= np.linalg.norm(mirror)
    q = np.eye(column.size) - 2 * np.outer(mirror, mirror)
    form, more = hessenberg(q @ matrix @ q, calc_q=True)
    q = q @ more
    return form, q * float(q[:, 0] @ column)


@compiled
def all_inside(form: np.ndarray, rows: np.ndarray, limit: float, result: np.ndarray) -> None:
    """For each first row, whether all eigenvalues have a modulus below the limit.

    Parameters
    ----------
    form : ndarray, shape (q, q)
        Upper Hessenberg.
    rows : ndarray, shape (G, q)
        Added to the first row.
    limit : float
    result : ndarray of int8, shape (G,)
        Filled: 1 inside, 0 not, -1 if the iteration did not converge.
    """
    q = form.shape[0]
    work = np.empty((q, q))
    for g in range(rows.shape[0]):
        for i in range(q):
            for j in range(q):
                work[i, j] = form[i, j] if i <= j + 1 else 0.0
        for j in range(q):
            work[0, j] += rows[g, j]
        result[g] = _inside(work, limit)


@compiled
def _inside(a: np.ndarray, limit: float) -> int:
    """The same for one matrix, which is overwritten; the names are those of the textbook's algorithm."""
    eps = 2.2e-16
    norm = 0.0
    for i in range(a.shape[0]):
        for j in range(max(i - 1, 0), a.shape[0]):
            norm += abs(a[i, j])
    end = a.shape[0] - 1
    shifted = 0.0
    count = 0
    while end >= 0:
        start = end
        while start >= 1:
            scale = abs(a[start - 1, start - 1]) + abs(a[start, start])
            if scale == 0.0:
                scale = norm
            if abs(a[start, start - 1]) <= eps * scale:
                a[start, start - 1] = 0.0
                break
            start -= 1
        x = a[end, end]
        if start == end:
            if abs(x + shifted) >= limit:
                return 0
            end -= 1
            count = 0
            continue
        y = a[end - 1, end - 1]
        w = a[end, end - 1] * a[end - 1, end]
        if start == end - 1:
            p = 0.5 * (y - x)
            inner = p * p + w
            root = np.sqrt(abs(inner))
            x += shifted
            if inner >= 0.0:
                root = p + root if p >= 0.0 else p - root
                other = x - w / root if root != 0.0 else x
                if abs(x + root) >= limit or abs(other) >= limit:
                    return 0
            elif np.sqrt((x + p) * (x + p) + root * root) >= limit:
                return 0
            end -= 2
            count = 0
            continue
        if count == _ITERATIONS:
            return -1
        if count % 10 == 9:  # an exceptional shift, to prevent cycles
            shifted += x
            for i in range(end + 1):
                a[i, i] -= x
            s = abs(a[end, end - 1]) + abs(a[end - 1, end - 2])
            x = 0.75 * s
            y = x
            w = -0.4375 * s * s
        count += 1
        _sweep(a, start, end, x, y, w)
    return 1


@compiled
def _sweep(a: np.ndarray, start: int, end: int, x: float, y: float, w: float) -> None:
    """One double-shift QR step on the active block."""
    eps = 2.2e-16
    m = end - 2
    p, q, r = 0.0, 0.0, 0.0
    while m >= start:
        z = a[m, m]
        r = x - z
        s = y - z
        p = (r * s - w) / a[m + 1, m] + a[m, m + 1]
        q = a[m + 1, m + 1] - z - r - s
        r = a[m + 2, m + 1]
        s = abs(p) + abs(q) + abs(r)
        p /= s
        q /= s
        r /= s
        if m == start:
            break
        u = abs(a[m, m - 1]) * (abs(q) + abs(r))
        v = abs(p) * (abs(a[m - 1, m - 1]) + abs(z) + abs(a[m + 1, m + 1]))
        if u <= eps * v:
            break
        m -= 1
    for i in range(m + 2, end + 1):
        a[i, i - 2] = 0.0
        if i != m + 2:
            a[i, i - 3] = 0.0
    for k in range(m, end):
        last = k == end - 1
        if k != m:
            p = a[k, k - 1]
            q = a[k + 1, k - 1]
            r = 0.0 if last else a[k + 2, k - 1]
            x = abs(p) + abs(q) + abs(r)
            if x != 0.0:
                p /= x
                q /= x
                r /= x
        s = np.sqrt(p * p + q * q + r * r)
        if p < 0.0:
            s = -s
        if s == 0.0:
            continue
        if k == m:
            if start != m:
                a[k, k - 1] = -a[k, k - 1]
        else:
            a[k, k - 1] = -s * x
        p += s
        x = p / s
        y = q / s
        z = r / s
        q /= p
        r /= p
        for j in range(k, end + 1):
            p = a[k, j] + q * a[k + 1, j]
            if not last:
                p += r * a[k + 2, j]
                a[k + 2, j] -= p * z
            a[k + 1, j] -= p * y
            a[k, j] -= p * x
        for i in range(start, min(end, k + 3) + 1):
            p = x * a[i, k] + y * a[i, k + 1]
            if not last:
                p += z * a[i, k + 2]
                a[i, k + 2] -= p * r
            a[i, k + 1] -= p * q
            a[i, k] -= p
