"""Sums of exponentials of many single-precision numbers, vectorised."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_impedance.network.kernel import compiled
from bayes_impedance.runtime.compiled_functions import kept_njit

_summing: Any = kept_njit(nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
"""Decorator that lets the compiler reorder sums, so that it can use vector instructions."""

_LOG2_E, _LOWEST = np.float32(1 / np.log(2)), np.float32(-126.0)
"""Factor from natural to binary logarithms, and smallest exponent of a normal single-precision number (IEEE 754)."""
_C0, _C1, _C2 = np.float32(1.00000007), np.float32(0.69314695), np.float32(0.24022122)
_C3, _C4, _C5 = np.float32(0.05550743), np.float32(0.00967546), np.float32(0.0013267)
"""2^r = c0 + c1 r + ... + c5 r^5 for |r| <= 1/2, by least squares of the relative error, which is below 1e-7."""
_HALF, _BIAS, _MANTISSA = np.float32(0.5), np.int32(127), np.int32(23)
"""One half, to round to the nearest integer; bias of the exponent, and bits of the mantissa, of IEEE 754 singles."""
_SIGN, _REST, _LEAST = np.int32(31), np.int32(0x7FFFFFFF), np.int32(-0x80000000)
"""Of 32-bit integers: position of the sign bit, mask of the other bits, and the smallest value."""


@compiled
def _largest(row: np.ndarray) -> np.float32:
    """Largest of single-precision numbers; nan if there is one.

    Floating-point numbers sort like the integers with the same bits, if all bits but the sign are flipped for negative
    numbers. The compiler vectorises comparisons of integers, but not of floats, because of nan.
    """
    bits = row.view(np.int32)
    most = _LEAST
    for k in range(bits.size):
        key = np.int32(bits[k] ^ np.int32(np.int32(bits[k] >> _SIGN) & _REST))
        most = key if key > most else most
    return np.int32(most ^ np.int32(np.int32(most >> _SIGN) & _REST)).view(np.float32)


@_summing
def _exponentials(row: np.ndarray, peak: np.float32) -> tuple[np.float32, np.float32]:
    """Sum of exp(row - peak) and of its squares; terms below 1e-38 are replaced by that value.

    In base two: the integer part of the exponent is written into the exponent bits of the result, and the fractional
    part is evaluated by a polynomial. Unlike a library call this is vectorised, and it needs no temporary array.
    """
    total, squares = np.float32(0), np.float32(0)
    for k in range(row.size):
        y = (row[k] - peak) * _LOG2_E  # the difference first, so that y is never above zero, however large both are
        y = _LOWEST if y < _LOWEST else y
        whole = np.floor(y + _HALF)
        r = y - whole
        value = ((((_C5 * r + _C4) * r + _C3) * r + _C2) * r + _C1) * r + _C0
        value = value * np.int32(np.int32(np.int32(whole) + _BIAS) << _MANTISSA).view(np.float32)
        total += value
        squares += value * value
    return total, squares


@compiled
def sums_of_exponentials(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest of the log weights (W, B, K), sum of exp(value - largest), and sum of its squares; each (W, B)."""
    shape = values.shape[:2]
    peaks, totals, squares = np.empty(shape), np.empty(shape), np.empty(shape)
    for w in range(shape[0]):
        for n in range(shape[1]):
            peak = _largest(values[w, n])
            totals[w, n], squares[w, n] = _exponentials(values[w, n], peak)
            peaks[w, n] = peak
    return peaks, totals, squares


@_summing
def _add_exponentials(row: np.ndarray, offset: np.float32, peaks: np.ndarray, total: np.ndarray) -> None:
    """Add exp(row + offset - peaks) to the total, as in :func:`_exponentials`."""
    for k in range(row.size):
        y = (row[k] + offset - peaks[k]) * _LOG2_E
        y = _LOWEST if y < _LOWEST else y
        whole = np.floor(y + _HALF)
        r = y - whole
        value = ((((_C5 * r + _C4) * r + _C3) * r + _C2) * r + _C1) * r + _C0
        total[k] += value * np.int32(np.int32(np.int32(whole) + _BIAS) << _MANTISSA).view(np.float32)


@compiled
def log_sums(values: np.ndarray, offsets: np.ndarray, result: np.ndarray) -> None:
    """Logarithms of the sums over G of exp(values + offsets).

    Parameters
    ----------
    values : ndarray of float32, shape (W, G, B, K)
    offsets : ndarray of float32, shape (W, G, B)
    result : ndarray of float32, shape (W, B, K)
        Where the logarithms are written; nan where a value is not a number.
    """
    total = np.empty(values.shape[3], dtype=np.float32)
    for w in range(values.shape[0]):
        for n in range(values.shape[2]):
            peaks = result[w, n]
            for k in range(total.size):
                total[k] = np.float32(0)
                peaks[k] = values[w, 0, n, k] + offsets[w, 0, n]
            for g in range(1, values.shape[1]):
                row, offset = values[w, g, n], offsets[w, g, n]
                for k in range(total.size):
                    own = row[k] + offset
                    peaks[k] = peaks[k] if peaks[k] > own else own  # a nan, once there, stays in the sum
            for g in range(values.shape[1]):
                _add_exponentials(values[w, g, n], offsets[w, g, n], peaks, total)
            for k in range(total.size):
                peaks[k] += np.log(total[k])


_NOTHING = np.float32(-50)
"""Binary logarithm of a weight, relative to the largest, below which it is zero: less than rounding, and products with
subnormal numbers take a hundred times longer."""


@_summing
def _weights(row: np.ndarray, peak: np.float32) -> np.float32:
    """Replace numbers by exp(row - peak), as in :func:`_exponentials`; their sum."""
    total = np.float32(0)
    for k in range(row.size):
        y = (row[k] - peak) * _LOG2_E
        y = _LOWEST if y < _LOWEST else y
        whole = np.floor(y + _HALF)
        r = y - whole
        value = ((((_C5 * r + _C4) * r + _C3) * r + _C2) * r + _C1) * r + _C0
        value = value * np.int32(np.int32(np.int32(whole) + _BIAS) << _MANTISSA).view(np.float32)
        value = value if y > _NOTHING else np.float32(0)
        row[k] = value
        total += value
    return total


@compiled
def normalise_rows(values: np.ndarray) -> None:
    """Replace log weights (W, B, K) by weights that sum to one over K; nan where they are not finite."""
    for w in range(values.shape[0]):
        for n in range(values.shape[1]):
            row = values[w, n]
            scale = np.float32(1) / _weights(row, _largest(row))
            for k in range(row.size):
                row[k] *= scale
