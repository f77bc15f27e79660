r"""An operation's T(z) and its derivatives at all frequencies of a node at once.

:func:`bayes_impedance.network.transform.transform` has every formula once, for one frequency. It takes tens of
nanoseconds, more than a whole network of masses, springs and dampers, most of it for what is the same at every
frequency. Networks hold some operations as parts of their own (:mod:`bayes_impedance.network.constructs`), so these
stand here a second time, as loops in which only what changes with the frequency is computed: a power law is

.. math:: x \left(\frac{s}{c}\right)^{a-1} = x\, e^{(a-1)\ln(\omega/c)}\; e^{j(a-1)\pi/2}

with a constant phase, one real logarithm and one real exponential. All others, and what is below, are computed by the
formula. Tests hold the two against each other.
"""

from __future__ import annotations

import cmath
from typing import Any

import numpy as np
from numba.core import types as numba_types

from bayes_impedance.network.transform import inverse, root, root_coth, root_tanh, transform
from bayes_impedance.runtime.compiled_functions import by_address, kept_njit

compiled: Any = kept_njit(nogil=True, error_model="numpy")

ADD, DELAY, HIGHPASS, LOWPASS, HYSTERESIS, LINE, BESIDE_POWER = 1, 2, 3, 4, 6, 7, 8
REFLEX, POWER_LAW, LINE_FIXED, LINE_MATCHED, GAIN = 11, 20, 21, 22, 23
"""Codes of :mod:`bayes_impedance.network.operations` that have loops of their own."""

_QUARTER_TURN = 0.5 * np.pi


@compiled
def coefficient(u0: float, c0: float, c2: float) -> tuple[float, float]:
    """The coefficient x, and dx/du0."""
    if c2 == 1.0:
        x = np.exp(u0)
        return x, x
    return c0 * u0, c0


@compiled
def _filter(code: int, x: float, omega: float) -> tuple[complex, complex]:
    """Factor of a filter, and its derivative with respect to x."""
    if code == HIGHPASS:
        if x >= 0.0:
            lag = inverse(complex(x, omega))
            return complex(0.0, omega) * lag, complex(0.0, -omega) * lag * lag
        return complex(1.0, x / omega), complex(0.0, 1.0 / omega)
    if x >= 0.0:
        lag = inverse(complex(1.0, omega * x))
        return lag, complex(0.0, -omega) * lag * lag
    return complex(1.0, -omega * x), complex(0.0, -omega)


@compiled
def _line(code: int, y: complex, z: complex) -> tuple[complex, complex, complex]:
    """T, dT/dz and dT/dy of a line."""
    if code == LINE_MATCHED:
        t = root(y) * root(z)
        return t, 0.5 * t * inverse(z), 0.5 * t * inverse(y)
    w = y * inverse(z)
    g, dg = root_coth(w) if code == LINE else root_tanh(w)
    return z * g, g - w * dg, dg


@compiled
def transform_row(
    code: int,
    u: tuple[float, float, float],
    c: np.ndarray,
    omega: np.ndarray,
    sums: np.ndarray,
    outputs: np.ndarray,
    node: int,
) -> None:
    """Fill a node's output with T of its sum."""
    n = omega.size
    x, _ = coefficient(u[0], c[0], c[2])
    if code == GAIN:
        for f in range(n):
            outputs[node, 0, f], outputs[node, 1, f] = x * sums[node, 0, f], x * sums[node, 1, f]
    elif code == ADD:
        for f in range(n):
            outputs[node, 0, f] = sums[node, 0, f] + (x if c[1] == 0.0 else 0.0)
            along = x * omega[f] if c[1] == 1.0 else -x / omega[f] if c[1] == -1.0 else 0.0
            outputs[node, 1, f] = sums[node, 1, f] + along
    elif code == HYSTERESIS:
        for f in range(n):
            a, b = sums[node, 0, f], sums[node, 1, f]
            outputs[node, 0, f], outputs[node, 1, f] = a - x * b, b + x * a
    elif code == DELAY:
        for f in range(n):
            turn = omega[f] * x
            t = complex(sums[node, 0, f], sums[node, 1, f]) * complex(np.cos(turn), -np.sin(turn))
            outputs[node, 0, f], outputs[node, 1, f] = t.real, t.imag
    elif code in (HIGHPASS, LOWPASS):
        for f in range(n):
            t = complex(sums[node, 0, f], sums[node, 1, f]) * _filter(code, x, omega[f])[0]
            outputs[node, 0, f], outputs[node, 1, f] = t.real, t.imag
    elif code in (POWER_LAW, BESIDE_POWER):
        power = (c[0] if code == POWER_LAW else 0.0) + 1.0 / (1.0 + np.exp(-u[1])) - 1.0
        turn, start = x * cmath.exp(1j * _QUARTER_TURN * power), np.log(c[1])
        for f in range(n):
            size = np.exp(power * (np.log(omega[f]) - start))
            outputs[node, 0, f] = sums[node, 0, f] + size * turn.real
            outputs[node, 1, f] = sums[node, 1, f] + size * turn.imag
    elif code in (LINE, LINE_FIXED, LINE_MATCHED):
        for f in range(n):
            y = complex(x, 0.0) if c[1] == -1.0 else complex(0.0, x * omega[f])
            t, _, _ = _line(code, y, complex(sums[node, 0, f], sums[node, 1, f]))
            outputs[node, 0, f], outputs[node, 1, f] = t.real, t.imag
    elif code == REFLEX:
        latency, slowness = np.exp(u[1]), np.exp(-u[2])
        for f in range(n):
            turn = omega[f] * latency
            late, lag = x * complex(np.cos(turn), -np.sin(turn)), complex(1.0, omega[f] * slowness)
            t = late * inverse((complex(0.0, omega[f]) if c[1] == -1.0 else lag) * lag)
            outputs[node, 0, f], outputs[node, 1, f] = sums[node, 0, f] + t.real, sums[node, 1, f] + t.imag
    else:
        for f in range(n):
            z = complex(sums[node, 0, f], sums[node, 1, f])
            t = transform(code, u[0], u[1], u[2], c[0], c[1], c[2], omega[f], z)[0]
            outputs[node, 0, f], outputs[node, 1, f] = t.real, t.imag


@compiled
def slopes_row(
    code: int,
    u: tuple[float, float, float],
    c: np.ndarray,
    omega: np.ndarray,
    sums: np.ndarray,
    adjoints: np.ndarray,
    node: int,
    slopes: np.ndarray,
) -> None:
    """Fill slopes (3, 2, F) with the result's derivatives by u, and turn a node's adjoint of T into that of its sum."""
    x, slope = coefficient(u[0], c[0], c[2])
    power = (c[0] if code == POWER_LAW else 0.0) + 1.0 / (1.0 + np.exp(-u[1])) - 1.0
    turn, start = cmath.exp(1j * _QUARTER_TURN * power), np.log(c[1])
    bend = np.exp(-u[1]) / (1.0 + np.exp(-u[1])) ** 2
    latency, slowness = np.exp(u[1]), np.exp(-u[2])
    for f in range(omega.size):
        w = omega[f]
        z, bar = complex(sums[node, 0, f], sums[node, 1, f]), complex(adjoints[node, 0, f], adjoints[node, 1, f])
        inner, first, second, third = 1.0 + 0j, 0j, 0j, 0j
        if code == GAIN:
            inner, first = complex(x, 0.0), z * slope
        elif code == ADD:
            first = slope * complex(
                1.0 if c[1] == 0.0 else 0.0, w if c[1] == 1.0 else -1.0 / w if c[1] == -1.0 else 0.0
            )
        elif code == HYSTERESIS:
            inner, first = complex(1.0, x), slope * complex(-z.imag, z.real)
        elif code == DELAY:
            inner = complex(np.cos(w * x), -np.sin(w * x))
            first = complex(0.0, -w * slope) * z * inner
        elif code in (HIGHPASS, LOWPASS):
            inner, first = _filter(code, x, w)
            first = slope * z * first
        elif code in (POWER_LAW, BESIDE_POWER):
            log = np.log(w) - start
            unit = np.exp(power * log) * turn
            first, second = slope * unit, x * bend * unit * complex(log, _QUARTER_TURN)
        elif code in (LINE, LINE_FIXED, LINE_MATCHED):
            unit = complex(1.0, 0.0) if c[1] == -1.0 else complex(0.0, w)
            _, inner, first = _line(code, x * unit, z)
            first = slope * unit * first
        elif code == REFLEX:
            lag = inverse(complex(1.0, w * slowness))
            unit = complex(np.cos(w * latency), -np.sin(w * latency)) * lag
            unit *= complex(0.0, -1.0 / w) if c[1] == -1.0 else lag
            first, second = slope * unit, complex(0.0, -w * latency * x) * unit
            third = x * unit * complex(0.0, (1.0 if c[1] == -1.0 else 2.0) * w * slowness) * lag
        else:
            _, inner, first, second, third = transform(code, u[0], u[1], u[2], c[0], c[1], c[2], w, z)
        first, second, third, bar = bar * first, bar * second, bar * third, bar * inner
        slopes[0, 0, f], slopes[0, 1, f] = first.real, first.imag
        slopes[1, 0, f], slopes[1, 1, f] = second.real, second.imag
        slopes[2, 0, f], slopes[2, 1, f] = third.real, third.imag
        adjoints[node, 0, f], adjoints[node, 1, f] = bar.real, bar.imag


types: Any = numba_types  # without annotations
_LINE, _BLOCK = (types.Array(types.float64, n, "C") for n in (1, 3))
_OF_NODE = (types.int64, types.UniTuple(types.float64, 3), _LINE, _LINE, _BLOCK, _BLOCK, types.int64)
transform_row_apart = by_address(transform_row, _OF_NODE)
slopes_row_apart = by_address(slopes_row, (*_OF_NODE, _BLOCK))
"""The same for the kernel, which does not take their code into its own: most networks have no operation."""
