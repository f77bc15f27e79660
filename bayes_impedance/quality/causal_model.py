r"""Rational functions that are causal, and such that need not be, fitted to one curve: array functions of the checks.

A linear, time-invariant system of lumped elements has the impedance

.. math:: z(s) = \frac{c_0}{s} + d + e\,s + g\,s^2 + \sum_k \frac{c_k}{s - p_k}, \qquad s = j\omega,

with real coefficients, or conjugate pairs. It is causal if no pole has :math:`\operatorname{Re} p_k > 0`; the real
and imaginary parts of every term then obey the Kramers-Kronig relations, and so does their sum, whatever the
coefficients are. Power laws, lines, delays and filters are limits of such sums (poles on the negative real axis,
pairs, and outside of the band the powers of s). The poles are found by vector fitting [1]_ with the relaxed constraint
of [2]_: multiply z by an unknown :math:`\sigma` with the present poles, whose zeros are the poles of z; both are
linear in their numerators. The zeros of :math:`\sigma` are the eigenvalues of :math:`A - b\,\tilde c^T/\tilde d` and
the next poles; those in the right half plane are reflected, so that each model stays causal.

**The other half.** Any curve is a causal one plus one whose poles lie in the right half plane. What is wrong with a
record brings in its conjugate, whose poles are those of z reflected: with Re z scaled by :math:`1+\epsilon`, say,
:math:`z + \epsilon (z + \bar z)/2`, and on the imaginary axis

.. math:: \overline{\frac{1}{s - p}} = \frac{-1}{s + \bar p}, \qquad s = j\omega .

The second model of each order therefore has the same poles, and these reflected: a linear least squares problem.

References
----------
.. [1] B. Gustavsen, A. Semlyen, "Rational approximation of frequency domain responses by vector fitting", IEEE
   Transactions on Power Delivery 14(3), 1999.
.. [2] B. Gustavsen, "Improving the pole relocating properties of vector fitting", IEEE Trans. Power Deliv. 21(3), 2006.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray

OUTSIDE = 4
"""Terms without a pole of their own: 1/s, 1, s and s^2."""

_RELOCATIONS = 8
"""Sets of poles that are tried for each order. By choice: vector fitting settles in three to five steps, but for
superfluous poles, which never do."""
_SPAN = 10.0
"""Factor by which the first real poles reach beyond the band on either side. By choice: what lies further away is
described by the powers of s."""
_DAMPING = 0.03
"""Damping ratio of the first pairs. By choice, between the 0.01 that [1]_ recommends and smooth curves."""
_PAIRS = 4
"""One pair for so many poles at first. By choice: pairs become two real poles, and these a pair, by relocation."""
_SMALLEST_CONSTANT = 1e-8
"""Smallest relaxed constant that is divided by. By choice: about the square root of machine precision."""
_LEAST_DAMPING = 1e-6
"""Least damping ratio of a pole. By choice: further from the axis than rounding, closer than any resonance."""
_RANK = 1e-10
"""Relative singular value below which columns count as dependent. By choice: above the rounding of scaled columns."""


@dataclass(frozen=True, eq=False)
class Misfits:
    """What models of one order leave of a curve.

    Attributes
    ----------
    causal, either : float
        Weighted square of the residual for each degree of freedom: 1 if the model is right and the noise is known.
        `either` has the reflected poles as well.
    residual : ndarray of complex, shape (F,)
        Weighted residual of the causal model.
    correlation : float
        Correlation of neighbours in the residual of the other one, below 0.2 if that is white noise.
    """

    causal: float
    either: float
    residual: ComplexArray
    correlation: float


def misfits(s: ComplexArray, z: ComplexArray, weight: FloatArray, order: int) -> Misfits:
    """Fit the causal model of one order, and the one that has the reflected poles as well.

    Parameters
    ----------
    s : ndarray of complex, shape (F,)
        j times the angular frequency, around 1.
    z : ndarray of complex, shape (F,)
    weight : ndarray of float, shape (F,)
        Inverse standard deviation of real and imaginary part.
    order : int
        Number of poles; 2 F must exceed 3 `order` + `OUTSIDE`.

    Returns
    -------
    Misfits
        Of the best of the relocated sets of poles.
    """
    outside = np.column_stack([1 / s, s**0, s, s**2])
    poles = _first_poles(s, order)
    best, least, kept = np.inf, np.zeros_like(z), poles
    for step in range(_RELOCATIONS):
        if step:
            poles = _relocated(s, z, weight, poles, outside)
        residual, _ = _residual(np.hstack([_fractions(s, poles), outside]), z, weight)
        square = float(np.sum(np.abs(residual) ** 2))
        if square < best:
            best, least, kept = square, residual, poles
    reflected = _fractions(s, -kept.conj())
    residual, rank = _residual(np.hstack([_fractions(s, kept), reflected, outside]), z, weight)
    # Poles cost as much as numerators, and are the same in both models.
    causal = best / (2 * s.size - 2 * order - OUTSIDE)
    either = float(np.sum(np.abs(residual) ** 2)) / (2 * s.size - order - rank)
    neighbours = float(np.sum((residual[1:] * residual[:-1].conj()).real))
    return Misfits(causal, either, least, neighbours / float(np.sum(np.abs(residual) ** 2)))


def _first_poles(s: ComplexArray, order: int) -> ComplexArray:
    """Real poles over the band and around it, and upper poles of pairs within it."""
    low, high = float(np.abs(s[0])), float(np.abs(s[-1]))
    pairs = order // _PAIRS
    alone = -np.geomspace(low / _SPAN, high * _SPAN, order - 2 * pairs) + 0j
    upper = (1j - _DAMPING) * np.geomspace(low, high, 2 * pairs + 1)[1::2]
    return np.concatenate([alone, upper])


def _fractions(s: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Columns with real coefficients, shape (F, order): of real poles, then two for each upper pole of a pair."""
    real = poles.imag == 0
    size = np.abs(poles)
    alone = size[real] / (s[:, None] - poles[real])
    upper, lower = (size[~real] / (s[:, None] - p) for p in (poles[~real], poles[~real].conj()))
    return np.hstack([alone, upper + lower, 1j * (upper - lower)])


def _rows(columns: np.ndarray) -> FloatArray:
    return np.concatenate([columns.real, columns.imag])


def _scaled(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns of length one, and what they were divided by."""
    length = np.linalg.norm(columns, axis=0)
    length[length == 0] = 1.0
    return columns / length, length


def _residual(columns: ComplexArray, z: ComplexArray, weight: FloatArray) -> tuple[ComplexArray, int]:
    """Weighted residual of the best real coefficients, shape (F,), and the rank of the columns."""
    scaled, _ = _scaled(_rows(weight[:, None] * columns))
    data = _rows(weight * z)
    basis, singular, _ = np.linalg.svd(scaled, full_matrices=False)
    basis = basis[:, singular > _RANK * singular[0]]
    left = data - basis @ (basis.T @ data)
    return left[: z.size] + 1j * left[z.size :], basis.shape[1]


def _relocated(
    s: ComplexArray, z: ComplexArray, weight: FloatArray, poles: ComplexArray, outside: ComplexArray
) -> ComplexArray:
    """Zeros of sigma, reflected into the left half plane: real poles and upper poles of pairs."""
    own = _fractions(s, poles)
    sigma = np.hstack([own, np.ones((s.size, 1))])
    columns = _rows(weight[:, None] * np.hstack([own, outside, -z[:, None] * sigma]))
    scaled, length = _scaled(columns)
    # Only the numerators of sigma are needed: the triangular factor's last block holds them.
    first = own.shape[1] + outside.shape[1]
    triangle: FloatArray = np.asarray(np.linalg.qr(scaled, mode="r"))
    triangle, length = triangle[first:, first:], length[first:]
    mean = sigma.real.sum(axis=0) / np.sqrt(s.size) / length
    target = np.zeros(len(triangle) + 1)
    target[-1] = np.sqrt(s.size)
    numerators = np.linalg.lstsq(np.vstack([triangle, mean]), target, rcond=None)[0] / length
    constant = float(numerators[-1])
    if abs(constant) < _SMALLEST_CONSTANT:
        constant = _SMALLEST_CONSTANT
    zeros = np.linalg.eigvals(_state_matrix(poles, numerators[:-1] / constant))
    damping = np.maximum(np.abs(zeros.real), _LEAST_DAMPING * np.abs(zeros))
    return np.asarray((-damping + 1j * zeros.imag)[zeros.imag >= 0])


def _state_matrix(poles: ComplexArray, numerators: FloatArray) -> FloatArray:
    """A - b c^T of the fractions with given numerators, shape (order, order)."""
    real = poles.imag == 0
    alone, upper = poles[real].real, poles[~real]
    matrix = np.diag(np.concatenate([alone, upper.real, upper.real]))
    i = alone.size + np.arange(upper.size)
    j = i + upper.size
    matrix[i, j], matrix[j, i] = upper.imag, -upper.imag
    b = np.concatenate([np.abs(alone), 2 * np.abs(upper), np.zeros(upper.size)])
    return np.asarray(matrix - np.outer(b, numerators))
