r"""Parameters of a network: how each is written, its unit, and the unbounded scale on which it is estimated.

Every parameter of a network has a name of its own, whose first letter says what it is:

========  =======================  ==============  ==========================================================
letter    quantity                 unit            link, value from the unbounded u
========  =======================  ==============  ==========================================================
m, n, r   mass, compliance,        as ever         log: exp u
          damping
p         power law                of impedance    log: exp u
a, b      its exponent             1               logit: 1/(1 + exp(-u)); b lies one higher
d         delay                    s               signed: u; log: exp u
t         time constant            s               signed, or log
f         corner frequency         Hz              signed, or log
k         stiffness                N/m             signed, or log
g         gain                     1               log: exp u
e         loss factor              1               log: exp u
========  =======================  ==============  ==========================================================

A quantity that differs between people is positive, and its logarithm is normal over the population: people differ by
a factor, in a mass as in a latency. What belongs to the rig is the same for all of them, and its error may have either
sign: a parameter that is marked ``*`` (the same for everybody) is therefore estimated on its own, signed scale wherever
the network gives it a meaning below zero. Zero means that the effect is absent.

A parameter may also be held at a value that is known from elsewhere, ``m9=0.0115``; it is not estimated at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.units import unit_of

LOG, LOGIT, SIGNED = "log", "logit", "signed"
"""Links: the value is exp u, lies between two bounds, or is u times a scale."""


@dataclass(frozen=True)
class Quantity:
    """What a letter stands for.

    Attributes
    ----------
    name : str
    unit : str
        As in :func:`bayes_impedance.units.unit_of`.
    story : str
        One sentence of explanation for the report.
    low : float
        Lower bound of a value that lies between two bounds one apart.
    factor : float
        What the value is multiplied by in the formulas: 2 pi for a frequency in Hz.
    """

    name: str
    unit: str
    story: str
    low: float = 0.0
    factor: float = 1.0


QUANTITIES: dict[str, Quantity] = {
    "m": Quantity("mass", "m", "Inertia: force proportional to acceleration."),
    "n": Quantity("compliance", "n", "Elasticity: displacement per force (1/stiffness)."),
    "r": Quantity("damper", "r", "Viscous loss: force proportional to velocity."),
    "k": Quantity("stiffness", "k", "Force per displacement (1/compliance)."),
    "p": Quantity("power law", "r", "Magnitude of a power law's impedance at its reference frequency."),
    "a": Quantity("exponent", "", "Exponent of a power law between a spring (0) and a damper (1)."),
    "b": Quantity("exponent", "", "Exponent of a power law between a damper (1) and a mass (2).", low=1.0),
    "d": Quantity("delay", "s", "Delay of a signal, or of a force that responds to motion."),
    "t": Quantity("time constant", "s", "Time constant of a first-order low-pass filter."),
    "f": Quantity("corner frequency", "Hz", "Corner (-3 dB) frequency of a first-order filter.", factor=2 * np.pi),
    "g": Quantity("gain", "", "Factor on the whole impedance."),
    "e": Quantity("loss factor", "", "Tangent of the loss angle, the same at every frequency."),
}
"""Every quantity by its letter."""

EXPONENTS = ("a", "b")
"""Letters of the exponents of power laws."""


def quantity_of(name: str) -> Quantity:
    """What the parameter with this name is.

    Raises
    ------
    InputError
        If its first letter stands for nothing.
    """
    quantity = QUANTITIES.get(name[:1])
    if quantity is None:
        raise InputError(
            f"element '{name}' is of no known kind: its first letter must be m (mass), n (compliance) or r (damper), "
            "or p for a power law such as p1^a1"
        )
    return quantity


def exactly(value: float) -> str:
    """The shortest text from which the same number is read."""
    return repr(float(value)).removesuffix(".0")


def unit_of_parameter(name: str, impedance_unit: str) -> str:
    """Unit of the parameter with this name, given the unit of the impedance."""
    return unit_of(quantity_of(name).unit, impedance_unit)


@dataclass(frozen=True)
class Symbol:
    """A parameter as it is written in a network.

    Attributes
    ----------
    name : str
        Empty if only a value is written.
    shared : bool
        Whether it is the same for everybody, written ``*``.
    value : float or None
        The value at which it is held.
    """

    name: str
    shared: bool = False
    value: float | None = None

    def __str__(self) -> str:
        if self.value is not None:
            return f"{self.name}={exactly(self.value)}" if self.name else exactly(self.value)
        return f"{self.name}*" if self.shared else self.name


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of a network.

    Attributes
    ----------
    symbol : Symbol
    letter : str
        Of the quantity; a held exponent may have no name that shows it.
    link : str
        ``log``, ``logit`` or ``signed``.
    """

    symbol: Symbol
    letter: str
    link: str

    @property
    def name(self) -> str:
        """Name in the network and in every table."""
        return self.symbol.name

    @property
    def shared(self) -> bool:
        """Whether it is the same for everybody."""
        return self.symbol.shared

    @property
    def held(self) -> bool:
        """Whether it is known, and so not estimated."""
        return self.symbol.value is not None

    @property
    def quantity(self) -> Quantity:
        """What it is."""
        return QUANTITIES[self.letter]

    def unit(self, impedance_unit: str) -> str:
        """Unit of its value, given the unit of the impedance."""
        return unit_of(self.quantity.unit, impedance_unit)

    def value(self, u: np.ndarray) -> np.ndarray:
        """Value in its unit, from u: any shape."""
        if self.link == LOG:
            return np.asarray(np.exp(u) / self.quantity.factor)
        if self.link == LOGIT:
            return np.asarray(self.quantity.low + 1 / (1 + np.exp(-np.asarray(u))))
        return np.asarray(u, dtype=float)

    def u(self, value: np.ndarray | float) -> np.ndarray:
        """The unbounded u, from the value in its unit: any shape.

        Raises
        ------
        InputError
            If the parameter cannot have the value.
        """
        x = np.asarray(value, dtype=float)
        if self.link == LOG and np.all((x > 0) & np.isfinite(x)):
            return np.asarray(np.log(x * self.quantity.factor))
        inside = x - self.quantity.low
        if self.link == LOGIT and np.all((inside > 0) & (inside < 1)):
            return np.asarray(np.log(inside) - np.log1p(-inside))
        if self.link == SIGNED and np.all(np.isfinite(x)):
            return x
        low = self.quantity.low
        wanted = {LOG: "above zero and finite", LOGIT: f"between {low:g} and {low + 1:g}", SIGNED: "finite"}[self.link]
        raise InputError(f"{self.quantity.name} '{self.name or self.letter}' cannot be {value}: it must be {wanted}")


def plain_parameter(symbol: Symbol) -> Parameter:
    """A mass, compliance, damper or power law: on a logarithmic scale. An exponent: between its bounds."""
    letter = symbol.name[:1]
    return Parameter(symbol=symbol, letter=letter, link=LOGIT if letter in EXPONENTS else LOG)


def values_of(parameters: Sequence[Parameter], u: np.ndarray) -> np.ndarray:
    """Values in their units of all parameters, which are the last axis of u."""
    return np.stack([p.value(u[..., i]) for i, p in enumerate(parameters)], axis=-1)
