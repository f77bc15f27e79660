r"""Rational functions of s: a network's impedance as a ratio of polynomials.

.. math:: z(s) = \frac{b_N s^N + \dots + b_0}{a_M s^M + \dots + a_0}

Coefficients are kept in ascending powers as plain Python numbers while a network is reduced, so that Fractions stay
exact, and are returned in descending powers, the convention of numpy, scipy.signal and of the paper's appendix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Polynomial = tuple[Any, ...]


@dataclass(frozen=True)
class TransferFunction:
    """A ratio of two polynomials in s.

    Attributes
    ----------
    ascending : tuple of two tuples
        Coefficients of numerator and denominator, constant term first.
    """

    ascending: tuple[Polynomial, Polynomial]

    @classmethod
    def from_coefficients(cls, numerator: Sequence[Any], denominator: Sequence[Any]) -> TransferFunction:
        """From coefficients in descending powers of s."""
        return cls((tuple(reversed(numerator)), tuple(reversed(denominator))))

    @property
    def numerator(self) -> np.ndarray:
        """Coefficients in descending powers of s, shape (degree + 1,)."""
        return np.array(self.ascending[0][::-1])

    @property
    def denominator(self) -> np.ndarray:
        """Coefficients in descending powers of s, shape (degree + 1,)."""
        return np.array(self.ascending[1][::-1])

    def normalised(self) -> TransferFunction:
        """The same function with 1 as the leading coefficient of the denominator."""
        lead = self.ascending[1][-1]
        numerator, denominator = (tuple(c / lead for c in p) for p in self.ascending)
        return TransferFunction((numerator, denominator))

    def reciprocal(self) -> TransferFunction:
        """1/z: the mobility of an impedance."""
        return TransferFunction((self.ascending[1], self.ascending[0]))

    def zeros(self) -> np.ndarray:
        """Roots of the numerator in rad/s."""
        return np.roots(np.array([complex(c) if isinstance(c, complex) else float(c) for c in self.numerator]))

    def poles(self) -> np.ndarray:
        """Roots of the denominator in rad/s."""
        return np.roots(np.array([complex(c) if isinstance(c, complex) else float(c) for c in self.denominator]))

    def __call__(self, s: npt.ArrayLike) -> np.ndarray:
        """Value at complex frequency s (rad/s), same shape as `s`."""
        s = np.asarray(s)
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)


def monomial(value: Any, exponent: int, power: int) -> TransferFunction:
    """``value**exponent * s**power`` for exponent +1 or -1 and power -1, 0 or 1."""
    top, bottom = ((value,), (1,)) if exponent > 0 else ((1,), (value,))
    return TransferFunction(((0,) * max(power, 0) + top, (0,) * max(-power, 0) + bottom))


def add_fractions(terms: Sequence[TransferFunction]) -> TransferFunction:
    """Sum of rational functions whose denominators share no factor but powers of s."""
    orders = [_order(term.ascending[1]) for term in terms]
    highest = max(orders)
    stripped = [term.ascending[1][order:] for term, order in zip(terms, orders, strict=True)]
    denominator: Polynomial = (0,) * highest + (1,)
    for polynomial in stripped:
        denominator = _multiply(denominator, polynomial)
    numerator: Polynomial = ()
    for i, term in enumerate(terms):
        product = (0,) * (highest - orders[i]) + term.ascending[0]
        for j, polynomial in enumerate(stripped):
            if j != i:
                product = _multiply(product, polynomial)
        numerator = _add(numerator, product)
    return TransferFunction((numerator, denominator))


def _order(polynomial: Polynomial) -> int:
    """Largest power of s that divides the polynomial."""
    return next(i for i, coefficient in enumerate(polynomial) if coefficient != 0)


def _add(a: Polynomial, b: Polynomial) -> Polynomial:
    longer, shorter = (a, b) if len(a) >= len(b) else (b, a)
    return tuple(x + y for x, y in zip(longer, shorter, strict=False)) + longer[len(shorter) :]


def _multiply(a: Polynomial, b: Polynomial) -> Polynomial:
    product = [a[0] * 0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            product[i + j] = product[i + j] + x * y
    return tuple(product)
