"""Compiled formulas of the operations: T(z) and its derivatives with respect to z and the parameters.

The table in :mod:`bayes_impedance.network.operations` gives each formula and its code. Each operation is holomorphic in
z, so one complex derivative dT/dz carries the chain rule through it.
"""

from __future__ import annotations

import cmath
from typing import Any

import numpy as np
from scipy.special import zeta

from bayes_impedance.runtime.compiled_functions import kept_njit

_compiled: Any = kept_njit(nogil=True, error_model="numpy")


_SMALL_COTH, _SMALL_TANH, _SMALL_FILM = 0.1, 0.01, 0.1
"""Of abs(w): below, the power series are used, of which all terms above 1e-15 are kept, also in the derivative. Above,
the closed form of coth has a derivative that is a difference of numbers 1/w times larger, and is good to 1e-14."""

_COTH = (1 / 3, -1 / 45, 2 / 945, -1 / 4725, 2 / 93555, -1382 / 638512875, 4 / 18243225, -3617 / 162820783125)
_TANH = (1.0, -1 / 3, 2 / 15, -17 / 315, 62 / 2835, -1382 / 155925, 21844 / 6081075, -929569 / 638512875)
"""Coefficients of w, w^2, ... of sqrt(w) coth sqrt(w) - 1 and sqrt(w) tanh sqrt(w)."""

_FILM = tuple(
    float(96 / np.pi**4 * (-4 / np.pi**2) ** n * (1 - 2.0 ** -(4 + 2 * n)) * zeta(4 + 2 * n)) for n in range(1, 13)
)
"""Coefficients of w, w^2, ... of :func:`film` - 1, from its sum over odd k; the first left out is 6e-17 of one."""


@_compiled
def transform(
    code: int, u0: float, u1: float, u2: float, c0: float, c1: float, c2: float, omega: float, z: complex
) -> tuple[complex, complex, complex, complex, complex]:
    """T, dT/dz, dT/du0, dT/du1 and dT/du2 at one frequency."""
    s = 1j * omega
    none = 0j
    if c2 == 1.0:
        x = np.exp(u0)
        slope = x  # dx/du0
    else:
        x = c0 * u0
        slope = c0
    if code == 1:
        unit = s if c1 == 1.0 else 1.0 / s if c1 == -1.0 else 1.0 + 0j
        return z + unit * x, 1.0 + 0j, unit * slope, none, none
    if code == 2:
        factor = cmath.exp(-s * x)
        return z * factor, factor, -s * slope * z * factor, none, none
    if code == 3:
        if x >= 0.0:
            factor = s / (s + x)
            return z * factor, factor, -z * factor * slope / (s + x), none, none
        factor = (s - x) / s
        return z * factor, factor, -z * slope / s, none, none
    if code == 4:
        if x >= 0.0:
            factor = 1.0 / (1.0 + s * x)
            return z * factor, factor, -z * s * slope * factor * factor, none, none
        factor = 1.0 - s * x
        return z * factor, factor, -z * s * slope, none, none
    if code == 5:
        log_s = complex(np.log(omega / c1), 0.5 * np.pi)
        factor = cmath.exp(x * log_s)
        return z * factor, factor, z * factor * log_s * slope, none, none
    if code == 6:
        return z * complex(1.0, x), complex(1.0, x), 1j * z * slope, none, none
    if code == 7 or code == 21:
        y = 1.0 + 0j if c1 == -1.0 else s
        w = y * x / z
        g, dg = root_coth(w) if code == 7 else root_tanh(w)
        return z * g, g - w * dg, y * dg * slope, none, none
    if code == 22:
        # The product of two roots in the right half-plane: y/z may be negative, and the sign of its root chance.
        t = root((1.0 + 0j if c1 == -1.0 else s) * x) * root(z)
        return t, 0.5 * t / z, 0.5 * t * slope / x, none, none
    if code == 8:
        a = 1.0 / (1.0 + np.exp(-u1))
        log_s = complex(np.log(omega / c1), 0.5 * np.pi)
        unit = cmath.exp((a - 1.0) * log_s)
        return z + x * unit, 1.0 + 0j, unit * slope, x * unit * log_s * a * (1.0 - a), none
    if code == 9:
        lag = 1.0 + s * np.exp(u1)
        return z + x / lag, 1.0 + 0j, slope / lag, -x * (lag - 1.0) / (lag * lag), none
    if code == 10:
        p, d = np.exp(u1), np.exp(u2)
        elastic = 2.0 * d * p * s + p * p
        below = s * s + elastic
        unit = s * elastic / below
        # d unit / d elastic = s^3 / below^2
        pull = x * s * s * s / (below * below)
        return z + x * unit, 1.0 + 0j, unit * slope, pull * (2.0 * d * p * s + 2.0 * p * p), pull * 2.0 * d * p * s
    if code == 11:
        latency, corner = np.exp(u1), np.exp(u2)
        lag = 1.0 + s / corner
        order = 1.0 if c1 == -1.0 else 2.0
        unit = cmath.exp(-s * latency) / (lag * (s if c1 == -1.0 else lag))
        return z + x * unit, 1.0 + 0j, unit * slope, -s * latency * x * unit, order * x * unit * (s / corner) / lag
    if code == 12:
        return z + x + c1 * u1 / s, 1.0 + 0j, complex(slope, 0.0), c1 / s, none
    if code == 13 or code == 14:
        lag = 1.0 + s * np.exp(u1) if code == 14 else 1.0 + 0j
        factor = 1.0 / (1.0 + z * s * x / lag)
        pull = -z * z * factor * factor * s / lag
        return z * factor, factor * factor, pull * slope, -pull * x * (lag - 1.0) / lag, none
    if code == 15:
        p, passed, all_of_it = np.exp(u1), np.log(omega / c1), np.log(c2)
        above, below = -np.expm1(-p * passed), -np.expm1(-p * all_of_it)
        q = above / below
        factor = np.exp(x * q)
        slowing = (passed * (1.0 - above) - q * all_of_it * (1.0 - below)) / below
        return z * factor, complex(factor, 0.0), z * factor * q * slope, z * factor * x * slowing * p, none
    if code == 16:
        w = s * x * z
        g, dg = root_coth(w)
        return z / g, (g - w * dg) / (g * g), -s * slope * z * z * dg / (g * g), none, none
    if code == 17:
        w = s * np.exp(u1)
        g, dg = film(w)
        return z + x * g, 1.0 + 0j, g * slope, x * w * dg, none
    if code == 18:
        a = 1.0 / (1.0 + np.exp(-u1))
        log_s = complex(np.log(omega / c1), 0.5 * np.pi)
        unit = cmath.exp(a * log_s)
        return z + x * unit, 1.0 + 0j, unit * slope, x * unit * log_s * a * (1.0 - a), none
    if code == 19:
        q, octaves = np.exp(u2), np.log(omega) - u1
        h = 1.0 / (1.0 + np.exp(2.0 * q * octaves))
        factor, bend = np.exp(x * h), 2.0 * q * h * (1.0 - h)
        change = z * factor
        return change, complex(factor, 0.0), change * h * slope, change * x * bend, -change * x * bend * octaves
    if code == 20:
        a = 1.0 / (1.0 + np.exp(-u1))
        log_s = complex(np.log(omega / c1), 0.5 * np.pi)
        unit = cmath.exp((c0 + a - 1.0) * log_s)
        return z + x * unit, 1.0 + 0j, unit * slope, x * unit * log_s * a * (1.0 - a), none
    if code == 23:
        return z * x, complex(x, 0.0), z * slope, none, none
    return z, 1.0 + 0j, none, none, none


@_compiled
def inverse(z: complex) -> complex:
    """1/z, without the care for numbers beyond 1e154 that a compiled complex division takes."""
    scale = 1.0 / (z.real * z.real + z.imag * z.imag)
    return complex(z.real * scale, -z.imag * scale)


@_compiled
def root(z: complex) -> complex:
    """The root of z with real part above zero, without the care for numbers beyond 1e154."""
    larger = np.sqrt(0.5 * (np.sqrt(z.real * z.real + z.imag * z.imag) + abs(z.real)))
    smaller = 0.5 * abs(z.imag) / larger if larger > 0.0 else 0.0
    if z.real >= 0.0:
        return complex(larger, np.copysign(smaller, z.imag))
    return complex(smaller, np.copysign(larger, z.imag))


@_compiled
def root_tanh(w: complex) -> tuple[complex, complex]:
    """g(w) = sqrt(w) tanh sqrt(w), analytic in w, and its derivative."""
    if w.real * w.real + w.imag * w.imag < _SMALL_TANH**2:
        return _series(w, 0.0, _TANH)  # type: ignore[no-any-return]
    x = root(w)  # with Re x >= 0, so that the exponential cannot overflow
    e = np.exp(-2.0 * x.real) * complex(np.cos(2.0 * x.imag), -np.sin(2.0 * x.imag))
    tanh = (1.0 - e) * inverse(1.0 + e)
    return x * tanh, 0.5 * (tanh * inverse(x) + 1.0 - tanh * tanh)


@_compiled
def root_coth(w: complex) -> tuple[complex, complex]:
    """g(w) = sqrt(w) coth sqrt(w), analytic in w, and its derivative."""
    if w.real * w.real + w.imag * w.imag < _SMALL_COTH**2:
        return _series(w, 1.0, _COTH)  # type: ignore[no-any-return]
    x = root(w)  # with Re x >= 0, so that the exponential cannot overflow
    e = np.exp(-2.0 * x.real) * complex(np.cos(2.0 * x.imag), -np.sin(2.0 * x.imag))
    coth = (1.0 + e) * inverse(1.0 - e)
    return x * coth, 0.5 * (coth * inverse(x) + 1.0 - coth * coth)


@_compiled
def film(w: complex) -> tuple[complex, complex]:
    """S(w) = 3 (w - sqrt(w) tanh sqrt(w))/w^2, analytic in w, and its derivative."""
    if w.real * w.real + w.imag * w.imag < _SMALL_FILM**2:
        return _series(w, 1.0, _FILM)  # type: ignore[no-any-return]
    g, dg = root_tanh(w)
    below = inverse(w)
    value = 3.0 * (w - g) * below * below
    return value, (3.0 * (1.0 - dg) * below - 2.0 * value) * below


@_compiled
def _series(w: complex, constant: float, coefficients: tuple[float, ...]) -> tuple[complex, complex]:
    """A power series and its derivative, by Horner's rule; the coefficients begin with that of w."""
    g, dg = 0j, 0j
    for k in range(len(coefficients) - 1, -1, -1):
        g = g * w + coefficients[k]
        dg = dg * w + (k + 1) * coefficients[k]
    return constant + g * w, dg


@_compiled
def transform_many(code: int, u: np.ndarray, c: np.ndarray, omega: np.ndarray, z: np.ndarray) -> np.ndarray:
    """All five results of :func:`transform`: u (M, 3), c (3,), omega (F,), z (M, F) to shape (5, M, F)."""
    result = np.empty((5, *z.shape), dtype=np.complex128)
    for m in range(z.shape[0]):
        for f in range(omega.size):
            t = transform(code, u[m, 0], u[m, 1], u[m, 2], c[0], c[1], c[2], omega[f], z[m, f])
            result[0, m, f], result[1, m, f], result[2, m, f], result[3, m, f], result[4, m, f] = t
    return result
