"""Numbers that know how they were computed: values for all users at once, and the same as text for a circuit simulator.

A ladder's elements are functions of a user's few parameters. The values serve a state space, the text a SPICE
sub-circuit in which the parameters are drawn anew; both come from one piece of arithmetic, so they cannot disagree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Expression:
    """A value for each user, and its text.

    Attributes
    ----------
    value : ndarray, shape (N,) or ()
    text : str
        In the arithmetic of SPICE; parentheses around everything but names, numbers and calls.
    """

    value: np.ndarray
    text: str

    def __add__(self, other: Expression | float) -> Expression:
        return _joined(self, "+", of(other), np.add)

    def __sub__(self, other: Expression | float) -> Expression:
        return _joined(self, "-", of(other), np.subtract)

    def __mul__(self, other: Expression | float) -> Expression:
        return _joined(self, "*", of(other), np.multiply)

    def __truediv__(self, other: Expression | float) -> Expression:
        return _joined(self, "/", of(other), np.divide)

    def __radd__(self, other: float) -> Expression:
        return of(other) + self

    def __rsub__(self, other: float) -> Expression:
        return of(other) - self

    def __rmul__(self, other: float) -> Expression:
        return of(other) * self

    def __rtruediv__(self, other: float) -> Expression:
        return of(other) / self


def of(x: Expression | float) -> Expression:
    """A number as an expression."""
    if isinstance(x, Expression):
        return x
    return Expression(np.asarray(float(x)), f"{x:.17g}" if x >= 0 else f"({x:.17g})")


def exp(x: Expression) -> Expression:
    """Exponential function."""
    return Expression(np.exp(x.value), f"exp({x.text})")


def sin(x: Expression) -> Expression:
    """Sine."""
    return Expression(np.sin(x.value), f"sin({x.text})")


def sqrt(x: Expression) -> Expression:
    """Square root."""
    return Expression(np.sqrt(x.value), f"sqrt({x.text})")


def arctan(x: Expression) -> Expression:
    """Inverse tangent."""
    return Expression(np.arctan(x.value), f"atan({x.text})")


def parameter_name(element: str) -> str:
    """Name of a parameter in SPICE.

    Plain names are kept; others must not clash with SPICE's case-insensitive reserved words.
    """
    if element[1:].isdigit():
        return element
    return "p_" + "".join(f"{c.lower()}_" if c.isupper() else c.replace("_", "__") for c in element)


def _joined(
    a: Expression, sign: str, b: Expression, operation: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Expression:
    return Expression(np.asarray(operation(a.value, b.value)), f"({a.text}{sign}{b.text})")
