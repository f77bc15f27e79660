r"""Operations on the impedance of a place, for effects that masses, springs and dampers alone do not describe.

An operation replaces the impedance z of what stands at a place (an element, a group, or the port) by T(z):

==================  ===========================================================  ===========================
name                T(z)                                                         other parameters
==================  ===========================================================  ===========================
add                 z + x s^c1
delay               z exp(-s x)
highpass            z s/(s + x); for x < 0 its inverse with abs(x)
lowpass             z/(1 + s x); for x < 0 its inverse with abs(x)
power               z (s/c1)^x
hysteresis          z (1 + j x)
line                z w^(1/2) coth w^(1/2) with w = x s^(1 + c1)/z
beside_power        z + x (s/c1)^(a - 1)                                         a = 1/(1 + exp(-u1))
relaxation          z + x/(1 + s t)                                              t = exp(u1)
resonator           z + s x (2 d p s + p^2)/(s^2 + 2 d p s + p^2)                p = exp(u1), d = exp(u2)
reflex              c1 = -1: z + x exp(-s t)/(s (1 + s/p))                       t = exp(u1), p = exp(u2)
                    c1 = 0: z + x exp(-s t)/(1 + s/p)^2
bypass              z + x + y/s                                                  y = c1 u1
series_compliance   1/(1/z + s x)
series_layer        1/(1/z + s x/(1 + s t))                                      t = exp(u1)
sweep               z exp(x q), q = (1 - (w/c1)^-p)/(1 - c2^-p)                  p = exp(u1)
free_line           z/(w^(1/2) coth w^(1/2)) with w = s x z
squeeze_film        z + x S(s t), S(w) = 3 (w - w^(1/2) tanh w^(1/2))/w^2        t = exp(u1)
semi_inductance     z + x (s/c1)^a                                               a = 1/(1 + exp(-u1))
amplitude           z exp(x h), h = 1/(1 + (w/p)^(2 q))                          p = exp(u1), q = exp(u2)
own_motion          z exp(x h), h = a^2/(1 + a^2), a = abs(H)/(w p)                p = exp(u1)
power_law           z + x (s/c1)^(a - 1)                                         a = c0 + 1/(1 + exp(-u1))
line_fixed          z w^(1/2) tanh w^(1/2) with w as in the line
line_matched        z w^(1/2)
gain                z x
==================  ===========================================================  ===========================

with s = jw and w the angular frequency in rad/s. The coefficient is x = c0 u0. It may have either sign, and zero means
that the impedance is unchanged. If c2 is 1 the coefficient is positive, x = exp(u0). All parameters u are real and
unbounded, as log elements are, and follow them in every array of parameters; c are constants of the operation.

The line is a layer whose mass x is spread over its thickness (c1 = 0; a damper with c1 = -1). For small w = s x/z it is
z + s x/3: a third of the mass moves along. The free line is its dual: what stands at the place is spread along a way
from which the compliance x leads, so that the mobility is 1/z + s x/3 at first; no force acts on its far side. The
squeeze film is liquid that is pressed out between two plates,

.. math:: S = \frac{96}{\pi^4}\sum_{k\ \text{odd}} \frac{1}{k^4}\,\frac{1}{1 + 4 s t/(\pi k)^2}, \qquad S(0) = 1,

a damper when slow and a spring when fast. In the sweep, c1 is the angular
frequency at which the sweep begins, c2 > 1 the ratio of its ends, and q the part of its time that has passed: p = 1 if
every frequency takes the same number of periods, and p -> 0 if every octave takes the same time. In the amplitude,
:math:`h = a^2/(1 + a^2)` is the saturating part of a motion whose amplitude falls with frequency,
:math:`a = (p/\omega)^q`: q = 1 where the velocity keeps its amplitude, q = 2 where a mass keeps the force's.

In the own motion, H is the velocity at the place per unit of the port's force: see
:mod:`bayes_impedance.network.own_motion`.

The last four operations are computed for a network's own power laws and wrappers
(:mod:`bayes_impedance.network.constructs`); no effect is added as one of them.

The table :data:`TRAITS` holds everything else that the package needs to know about an operation; its formula is in
:mod:`bayes_impedance.network.transform`. A further operation is an entry of the one and a formula in the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.network.operation_traits import Derived, Setting, Traits

N_PARAMETERS = 3
"""Largest number of parameters, and of constants, of any operation in the table above."""

LOGARITHMIC = 1.0
"""Value of c2 that marks a coefficient positive by construction, as defined above."""

LINE_LEVELS = (0.3, 1.0, 3.0, 10.0)
"""Scanned masses of a line, relative to the mass whose impedance equals the place's at the upper end of the band.

By choice: from a layer whose waves lie above the band to one with several standing waves inside it.
"""

BYPASS_RATIOS = 6
"""Number of scanned ratios of stiffness to damping of a bypass.

By choice: with a band of three decades and a third of a decade beyond either end they are 0.8 decades apart, and the
signature of damper and spring together changes over about a decade.
"""

NEGATIVE_SHARE = 0.1
"""A part of a bypass may be estimated below zero by up to this share of the other part: it counts as absent.

By choice: an absent part is estimated as zero plus noise, and noise of a tenth of the other part is common.
"""


def _middle_of_band(setting: Setting) -> tuple[float, float]:
    return setting.middle, 0.0


def _power_of_s(setting: Setting) -> tuple[float, float]:
    return {"m": 1.0, "r": 0.0, "k": -1.0}[setting.units[0]], 0.0


def _corner(x: Sequence[np.ndarray], _setting: Setting) -> list[Derived]:
    with np.errstate(divide="ignore"):
        return [("corner", "Hz", 1 / (2 * np.pi * x[0]))]


def _power_law_of_spring(x: Sequence[np.ndarray], setting: Setting) -> list[Derived]:
    return [("coefficient", "c", setting.middle ** -x[0] / setting.compliance)]


def line_compliance(omega: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Compliance whose mobility is that of the place at the upper end of the band: z (M, F) to (M,)."""
    return np.asarray(1 / (np.abs(z[:, -1]) * omega[-1]))


def line_mass(omega: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Mass whose impedance is that of the place at the upper end of the band: z (M, F) to (M,)."""
    return np.asarray(np.abs(z[:, -1]) / omega[-1])


def _per_second(x: Sequence[np.ndarray], setting: Setting) -> np.ndarray:
    """The c of c s^(a-1); the operation counts s from the middle of the band."""
    return np.asarray(x[0] * setting.middle ** (1 - x[1]))


def _per_second_rising(x: Sequence[np.ndarray], setting: Setting) -> np.ndarray:
    """The c of c s^a."""
    return np.asarray(x[0] * setting.middle ** -x[1])


def _spring_and_damper(x: Sequence[np.ndarray], _setting: Setting) -> list[Derived]:
    mass, w0, ratio = x
    return [("compliance", "n", 1 / (mass * w0**2)), ("damping", "r", 2 * ratio * w0 * mass)]


def _bypass_allows(u: np.ndarray) -> bool:
    """One of damper and spring may be absent."""
    return not u.max() <= 0 and not u.min() < -NEGATIVE_SHARE * abs(u).max()


def _bypass_ratios(low: float, high: float) -> list[dict[str, float]]:
    """Two coefficients of which only the ratio is a shape: here the frequency at which their impedances are equal."""
    return [{"ratio": float(w)} for w in np.geomspace(low / 3, 3 * high, BYPASS_RATIOS)]


TRAITS: dict[str, Traits] = {
    "add": Traits(
        code=1,
        written="({z})|{element}",
        written_shared="offset[{unit}]({z})",
        read=lambda v: [1 / v["n"]] if "n" in v else list(v.values()),
        one_port=True,
        parameters=("coefficient",),
        units=(("m", "r", "k"),),
        connection="beside",
        built_as="elements",
        constants=_power_of_s,
    ),
    "delay": Traits(code=2, written="delay[{d}]({z})", parameters=("delay",), units=(("s",),), passive=False),
    "highpass": Traits(
        code=3, written="highpass[{f}]({z})", parameters=("corner",), units=(("Hz",),), passive=False, built_as="filter"
    ),
    "lowpass": Traits(
        code=4,
        written="lowpass[{t}]({z})",
        parameters=("time_constant",),
        units=(("s",),),
        passive=False,
        built_as="filter",
        derived=_corner,
    ),
    "power": Traits(
        code=5,
        written="{own_p}^{a}",
        of_the_element=True,
        read=lambda v: [v["a"]],
        one_port=True,
        parameters=("exponent",),
        units=(("",),),
        places=("springs",),
        built_as="ladder",
        constants=_middle_of_band,
        derived=_power_law_of_spring,
    ),
    "hysteresis": Traits(
        code=6,
        written="hysteretic[{e}]({z})",
        parameters=("loss_factor",),
        units=(("",),),
        places=("springs",),
        one_port=True,
    ),
    "line": Traits(
        code=7,
        written="line_free[{m}]({z})",
        one_port=True,
        parameters=("mass",),
        units=(("m",),),
        built_as="ladder",
        scanned=lambda _low, _high: [{"level": level} for level in LINE_LEVELS],
        # The tangent at zero mass is that of a mass; what distinguishes the layer is where waves fit into it.
        secant=lambda shape, omega, z: shape["level"] * line_mass(omega, z),
    ),
    "beside_power": Traits(
        code=8,
        written="({z})|{p}^{a}",
        one_port=True,
        parameters=("coefficient", "exponent"),
        units=(("c",), ("",)),
        links=("linear", "logit"),
        connection="beside",
        built_as="ladder",
        constants=_middle_of_band,
        reported=_per_second,
    ),
    "relaxation": Traits(
        code=9,
        written="({z})|({r}-{n})",
        read=lambda v: [v["r"], v["r"] * v["n"]],
        one_port=True,
        sums_to_any=True,
        parameters=("damping", "time_constant"),
        units=(("r",), ("s",)),
        links=("linear", "log"),
        connection="beside",
        built_as="elements",
        derived=lambda x, _: [("compliance", "n", x[1] / x[0])],
    ),
    "resonator": Traits(
        code=10,
        written="({z})|({m}-({n}|{r}))",
        read=lambda v: [v["m"], (v["m"] * v["n"]) ** -0.5, 0.5 * v["r"] * (v["n"] / v["m"]) ** 0.5],
        one_port=True,
        sums_to_any=True,
        parameters=("mass", "frequency", "damping_ratio"),
        units=(("m",), ("Hz",), ("",)),
        links=("linear", "log", "log"),
        connection="beside",
        built_as="elements",
        derived=_spring_and_damper,
    ),
    "reflex": Traits(
        code=11,
        written="reflex[{unit}, {d}, {f}]({z})",
        parameters=("coefficient", "latency", "corner"),
        units=(("k", "r"), ("s",), ("Hz",)),
        links=("linear", "log", "log"),
        connection="beside",
        constants=_power_of_s,
        passive=False,
    ),
    "bypass": Traits(
        code=12,
        written="({z})|{r}|{n}",
        read=lambda v: [v["r"], 1 / v["n"]],
        one_port=True,
        parameters=("damping", "stiffness"),
        units=(("r",), ("k",)),
        links=("linear", "linear"),
        connection="beside",
        built_as="elements",
        constants=lambda setting: (setting.scales[1], 0.0),
        allows=_bypass_allows,
        derived=lambda x, _: [("compliance", "n", 1 / x[1])],
        scanned=_bypass_ratios,
        direction=lambda shape, omega: 1 + shape["ratio"] / (1j * omega),
    ),
    "series_compliance": Traits(
        code=13,
        written="({z})-{n}",
        parameters=("compliance",),
        units=(("n",),),
        connection="series",
        built_as="elements",
    ),
    "series_layer": Traits(
        code=14,
        written="({z})-({r}|{n})",
        read=lambda v: [v["n"], v["r"] * v["n"]],
        parameters=("compliance", "time_constant"),
        units=(("n",), ("s",)),
        links=("linear", "log"),
        connection="series",
        built_as="elements",
        derived=lambda x, _: [("damping", "r", x[1] / x[0])],
    ),
    "sweep": Traits(
        code=15,
        parameters=("change", "time_law"),
        units=(("",), ("",)),
        links=("linear", "log"),
        constants=lambda setting: (setting.low, setting.high / setting.low),
    ),
    "free_line": Traits(
        code=16,
        written="line_fixed[{z}]({n})",
        of_the_element=True,
        one_port=True,
        parameters=("compliance",),
        units=(("n",),),
        places=("masses", "dampers"),
        scanned=lambda _low, _high: [{"level": level} for level in LINE_LEVELS],
        secant=lambda shape, omega, z: shape["level"] * line_compliance(omega, z),
    ),
    "squeeze_film": Traits(
        code=17,
        written="squeeze_film[{r}, {t}]({z})",
        one_port=True,
        sums_to_any=True,
        parameters=("damping", "time_constant"),
        units=(("r",), ("s",)),
        links=("linear", "log"),
        connection="beside",
    ),
    "semi_inductance": Traits(
        code=18,
        written="({z})|{p}^{b}",
        read=lambda v: [v["p"], v["b"] - 1],
        parameters=("coefficient", "exponent"),
        units=(("l",), ("",)),
        links=("linear", "logit"),
        connection="beside",
        constants=_middle_of_band,
        reported=_per_second_rising,
    ),
    "amplitude": Traits(
        code=19,
        parameters=("change", "corner", "steepness"),
        units=(("",), ("Hz",), ("",)),
        links=("linear", "log", "log"),
    ),
    "own_motion": Traits(
        code=24,
        parameters=("change", "knee"),
        units=(("",), ("n",)),
        links=("linear", "log"),
        places=("springs", "dampers"),
        follows_motion=True,
    ),
}
"""Every operation by its name."""

NAMES = tuple(TRAITS)
"""Names of all operations, in the order of their codes."""

OWN_CODES = {"power_law": 20, "line_fixed": 21, "line_matched": 22, "gain": 23}
"""Codes of the operations that are computed for a network's own nodes only."""

ADDING = tuple(name for name, traits in TRAITS.items() if traits.connection == "beside")
"""Operations that add an impedance beside a place: the change does not depend on the place's impedance."""


def code_of(name: str) -> int:
    """Number of an operation in the compiled functions."""
    return OWN_CODES[name] if name in OWN_CODES else TRAITS[name].code


@dataclass(frozen=True)
class Operation:
    """An operation at a place of a network.

    Attributes
    ----------
    name : str
        One of :data:`NAMES`.
    path : tuple of int
        Of the place, see :class:`bayes_impedance.network.notation.Place`.
    parameters : tuple of str
        Names of the parameters u, as many as the operation has.
    constants : tuple of float
        c0, and c1 and c2 where they are used.
    """

    name: str
    path: tuple[int, ...]
    parameters: tuple[str, ...]
    constants: tuple[float, ...]

    @property
    def code(self) -> int:
        """Number of the operation in the compiled functions."""
        return TRAITS[self.name].code
