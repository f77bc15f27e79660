"""Operations with constants and parameters at which they change the fingertip, and their formulas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest

from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.network.operations import LOGARITHMIC, N_PARAMETERS, NAMES, TRAITS, Operation, code_of
from bayes_impedance.network.transform import transform_many

NETWORK = parse(PAPER_NETWORK)
FREQUENCY = np.geomspace(5, 5000, 23)
OMEGA = 2 * np.pi * FREQUENCY
S = 1j * OMEGA
THETA = np.log([6.76e-7, 61.4, 7.9e-4, 1.52, 1.15e-3, 0.0517, 4.73e-3, 3.82])
ELEMENTS = dict(zip(NETWORK.elements, np.exp(THETA), strict=True))
W0 = 600.0

PATHS = ((), (0,), (0, 1), (1, 2), (1, 3), (1, 3, 1, 0))
"""The port, the skin, a damper in it, a spring, the limb, and a spring at its end."""


OF_THE_PLACE = tuple(name for name in NAMES if not TRAITS[name].follows_motion)
"""Operations whose T depends on the impedance of the place alone."""


class Case(NamedTuple):
    """An operation with constants and parameters at which it changes the fingertip by a part of itself."""

    name: str
    constants: tuple[float, ...]
    u: tuple[float, ...]

    @property
    def x(self) -> float:
        return float(np.exp(self.u[0])) if self.constants[2:] == (LOGARITHMIC,) else self.constants[0] * self.u[0]


CASES = (
    Case("add", (1e-5, 1.0), (0.7,)),
    Case("add", (0.1, 0.0), (-0.7,)),
    Case("add", (10.0, -1.0), (0.7,)),
    Case("add", (10.0, -1.0, LOGARITHMIC), (0.7,)),
    Case("delay", (1e-5,), (-0.5,)),
    Case("highpass", (3.0,), (0.4,)),
    Case("highpass", (3.0,), (-0.4,)),
    Case("lowpass", (1e-5,), (0.4,)),
    Case("lowpass", (1e-5,), (-0.4,)),
    Case("power", (1.0, W0), (0.1,)),
    Case("hysteresis", (1.0,), (0.2,)),
    Case("line", (1e-4,), (0.3,)),
    Case("line", (1e-4,), (-0.3,)),
    Case("line", (1e-12,), (0.3,)),  # the power series
    Case("beside_power", (2.0, W0), (0.3, 0.2)),
    Case("beside_power", (2.0, W0, LOGARITHMIC), (0.3, 0.2)),
    Case("relaxation", (3.0,), (0.5, -6.0)),
    Case("resonator", (1e-3,), (0.4, 6.0, -2.0)),
    Case("reflex", (100.0, -1.0), (0.4, -3.5, 3.0)),
    Case("reflex", (3.0, 0.0), (0.4, -3.5, 3.0)),
    Case("reflex", (1.0, 0.0, LOGARITHMIC), (0.4, -3.5, 5.0)),
    Case("bypass", (3.0, 200.0), (0.4, 0.6)),
    Case("series_compliance", (1e-6,), (0.7,)),
    Case("series_layer", (1e-6,), (0.7, -8.0)),
    Case("sweep", (1.0, OMEGA[0], 1000.0), (0.3, 0.0)),
    Case("sweep", (1.0, OMEGA[0], 1000.0), (-0.3, -3.0)),
    Case("free_line", (1e-5,), (0.4,)),
    Case("free_line", (1e-5,), (-0.4,)),
    Case("free_line", (1e-11,), (0.4,)),  # the power series
    Case("squeeze_film", (3.0,), (0.5, -6.0)),
    Case("squeeze_film", (3.0,), (0.5, -14.0)),  # the power series
    Case("squeeze_film", (1.0, 0.0, LOGARITHMIC), (0.5, -9.0)),
    Case("semi_inductance", (2.0, W0), (0.3, 0.2)),
    Case("amplitude", (1.0,), (0.3, 5.0, 0.2)),
    Case("amplitude", (1.0,), (-0.3, 7.0, 0.7)),
)
CASE = pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.name}{c.u[0]:+}")


def root_coth(w: np.ndarray) -> np.ndarray:
    """sqrt(w) coth sqrt(w): either root gives the same."""
    root = np.sqrt(w)
    return root / np.tanh(root)


def formula(case: Case, s: np.ndarray, z: np.ndarray) -> np.ndarray:
    """T(z) of the table in the module's docstring."""
    x, c1 = case.x, (*case.constants, 0.0)[1]
    u1, u2 = (*case.u, 0.0, 0.0)[1:3]
    match case.name:
        case "add":
            return z + x * s**c1
        case "delay":
            return z * np.exp(-s * x)
        case "highpass":
            return z * (s / (s + abs(x))) ** np.sign(x)
        case "lowpass":
            return z * (1 / (1 + s * abs(x))) ** np.sign(x)
        case "power":
            return z * (s / c1) ** x
        case "hysteresis":
            return z * (1 + 1j * x)
        case "line":
            return z * root_coth(s * x / z)
        case "beside_power":
            return z + x * (s / c1) ** (1 / (1 + np.exp(-u1)) - 1)
        case "relaxation":
            return z + x / (1 + s * np.exp(u1))
        case "resonator":
            p, d = np.exp(u1), np.exp(u2)
            return z + s * x * (2 * d * p * s + p**2) / (s**2 + 2 * d * p * s + p**2)
        case "reflex":
            return z + x * np.exp(-s * np.exp(u1)) * s**c1 * (1 + s / np.exp(u2)) ** (-2 - c1)
        case "bypass":
            return z + x + c1 * u1 / s
        case "series_compliance":
            return 1 / (1 / z + s * x)
        case "series_layer":
            return 1 / (1 / z + s * x / (1 + s * np.exp(u1)))
        case "sweep":
            p = np.exp(u1)
            return z * np.exp(x * (1 - (s.imag / c1) ** -p) / (1 - case.constants[2] ** -p))
        case "free_line":
            return z / root_coth(s * x * z)
        case "squeeze_film":
            k = np.arange(1, 4001, 2)[:, None]  # the sum; what is left out is below 1e-11
            return z + x * np.sum(96 / (np.pi * k) ** 4 / (1 + 4 * s * np.exp(u1) / (np.pi * k) ** 2), axis=0)
        case "semi_inductance":
            return z + x * (s / c1) ** (1 / (1 + np.exp(-u1)))
        case "amplitude":
            return z * np.exp(x / (1 + (s.imag / np.exp(u1)) ** (2 * np.exp(u2))))
    raise AssertionError(case.name)


def five(case: Case, u: Sequence[float], z: np.ndarray) -> np.ndarray:
    """T and its derivatives at the impedances z, one for each of OMEGA, shape (5, F)."""
    own, constants = np.zeros((1, N_PARAMETERS)), np.zeros(N_PARAMETERS)
    own[0, : len(u)], constants[: len(case.constants)] = u, case.constants
    code = code_of(case.name)
    return transform_many(code, own, constants, OMEGA, np.ascontiguousarray(z[None]))[:, 0]


def difference(function: Callable[[float], np.ndarray], h: float = 1e-5) -> np.ndarray:
    """Derivative at zero by central differences of steps h and 2 h, the error of order h^2 taken out."""
    near, far = ((function(step) - function(-step)) / (2 * step) for step in (h, 2 * h))
    return (4 * near - far) / 3


def assert_close(analytic: np.ndarray, numeric: np.ndarray, z: np.ndarray) -> None:
    """To 1e-6 of itself; differences of z say nothing about a derivative below 1e-3 of z."""
    error = np.abs(analytic - numeric) / (np.abs(analytic) + 1e-3 * np.abs(z))
    assert error.max() < 1e-6


def operation(case: Case, path: tuple[int, ...], number: int = 0) -> Operation:
    return Operation(case.name, path, tuple(f"{letter}{number}" for letter in "xyw"[: len(case.u)]), case.constants)


def some_impedances(seed: int) -> np.ndarray:
    """Passive ones of the fingertip's size, of any phase."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.uniform(-1, 4, OMEGA.size)) * np.exp(1j * rng.uniform(-1.5, 1.5, OMEGA.size))
