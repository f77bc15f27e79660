r"""Ladders of positive elements for power laws and lines, for many users at once.

All users get the same ladder with values of their own. Ladders of positive elements are passive by construction.

**Power law** :math:`c\,s^{-\beta}`, :math:`0 < \beta < 1`. From

.. math:: s^{-\beta} = \frac{\sin \pi\beta}{\pi} \int_{-\infty}^{\infty} \frac{e^{(1 - \beta) t}}{s + e^t}\, dt

by the trapezoidal rule with step h: each term :math:`k_i/(s + x_i)` is a compliance :math:`1/k_i` in series with a
damper :math:`k_i/x_i`. On the imaginary axis the integrand is analytic within :math:`\pi/2` of the real line, so the
error of the rule falls as :math:`e^{-\pi^2/h}`; terms far below the band are one spring, those far above one damper,
whose sums are geometric series. :math:`c\,s^{+\beta}` is the same for the mobility: each term is a mass :math:`1/k_i`
beside a damper :math:`x_i/k_i`, and they stand in a chain.

**Lines** with :math:`w = y/z` are sums of such terms too,

.. math:: \sqrt w \coth\sqrt w = 1 + \sum_{k=1}^\infty \frac{2w}{w + k^2\pi^2}, \quad
          \sqrt w \tanh\sqrt w = \sum_{k=1}^\infty \frac{2w}{w + (k - \frac12)^2\pi^2}, \quad
          \sqrt w = \frac2\pi \int_0^\infty \frac{w}{w + \kappa^2}\, d\kappa .

Each term :math:`z\,c\,w/(w + \kappa^2)` is y multiplied by :math:`c/\kappa^2` in series with a copy of z multiplied by
c, beside the others. If w reaches far, the sum beyond the first eight terms is the integral over k (the midpoint rule,
read backwards), by Gauss's rule on panels of ln k. The integral of the third is a trapezoidal rule in
:math:`\ln\kappa`. What is left beyond the last :math:`\kappa` is a multiple of y, what is left below the first one a
multiple of z.

**A squeeze film** is a sum of dampers :math:`r_k` in series with springs, of time constants :math:`4t/(\pi k)^2`,

.. math:: r\,S(st) = \sum_{k\ \text{odd}} \frac{r_k}{1 + 4 s t/(\pi k)^2}, \qquad r_k = \frac{96\,r}{\pi^4 k^4},

of which the terms beyond the band are one damper.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bayes_impedance.design.circuits import expressions
from bayes_impedance.design.circuits.expressions import Expression, of
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Element, Network, Parallel, Series

Found = tuple[Network, dict[str, Expression]]
"""A network and the values of its elements."""

_FIRST = 8
"""Terms of a line's sum that are always kept as they are, if it does not end sooner. The midpoint rule that stands for
the rest has a relative error of 2e-4 where it is largest."""
_PANEL = 1.5
"""Width of the panels in ln k. By choice: with w at a right angle, as in diffusion, Gauss's rule gains a factor of six
with each point."""
_FINEST = 0.15
"""Smallest step in ln kappa. By choice: a line without an end whose material has hardly a loss would need any number of
terms."""


class Names:
    """Creates elements with unused names."""

    def __init__(self, used: set[str] | None = None) -> None:
        self.used = set(used or ())

    def element(self, letter: str, value: Expression) -> Found:
        """A new element and its value."""
        number = 1 + max((int(n[1:]) for n in self.used if n[0] == letter and n[1:].isdigit()), default=0)
        name = f"{letter}{number}"
        self.used.add(name)
        return Element(name), {name: value}


def power_ladder(
    strength: Expression,
    beta: Expression,
    names: Names,
    band_hz: tuple[float, float],
    accuracy: float,
    *,
    rising: bool = False,
) -> Found:
    """Ladder for z = strength s^(-beta), or for z = strength s^beta if `rising`.

    Parameters
    ----------
    strength : Expression
        In the impedance's unit times (rad/s)^beta, or divided by it.
    beta : Expression
        Between 0 and 1.
    names : Names
    band_hz : (float, float)
    accuracy : float
        Largest relative error in the band.
    rising : bool

    Raises
    ------
    InputError
        If no passive ladder has this power law.
    """
    least, most = float(beta.value.min()), float(beta.value.max())
    if not (least > 0 and most < 1 and np.all(strength.value > 0)):
        raise InputError(
            f"a power law with exponent {-most:.4g} is not passive: the exponent must lie between -1 (spring) and "
            "0 (damper)"
        )
    low, high = 2 * np.pi * band_hz[0], 2 * np.pi * band_hz[1]
    # Half the error is allowed for the rule, a quarter for either end, where terms are lumped to first order.
    step = float(np.pi**2 / np.log(8 / accuracy))
    # To first order the error of the lumped terms is (x/w) relative to a sum that falls as (x/w)^(1-beta), or mirrored
    # above the band.
    below = np.log(8 / accuracy) / (2 - most)
    above = np.log(8 / accuracy) / (1 + least)
    first = int(np.floor((np.log(low) - below) / step))
    last = int(np.ceil((np.log(high) + above) / step))
    scale = (1 / strength if rising else strength) * expressions.sin(np.pi * beta) * (step / np.pi)
    rest = 1 - beta
    # Geometric sums of the terms outside the band: springs below (1 - beta > 0), dampers k/x above (-beta < 0).
    spring = scale * expressions.exp(rest * (step * (first - 1))) / (1 - expressions.exp(rest * -step))
    damper = scale * expressions.exp(beta * (-step * (last + 1))) / (1 - expressions.exp(beta * -step))
    storing, lost = ("m", _inverse) if rising else ("n", of)
    pieces = [names.element(storing, 1 / spring), names.element("r", lost(damper))]
    for i in range(first, last + 1):
        x = float(np.exp(step * i))
        k = scale * expressions.exp(rest * (step * i))
        pair = names.element(storing, 1 / k), names.element("r", lost(k / x))
        pieces.append(together(Parallel if rising else Series, *pair))
    return together(Series if rising else Parallel, *pieces)


class Terms(NamedTuple):
    """A line as a sum of terms z c w/(w + kappa^2).

    Attributes
    ----------
    kappa, c : ndarray
    of_z, of_y : float
        Multiples of z and of y beside them.
    """

    kappa: np.ndarray
    c: np.ndarray
    of_z: float
    of_y: float


def line_terms(word: str, w: np.ndarray, accuracy: float) -> Terms:
    """Terms of a line.

    Parameters
    ----------
    word : str
        ``line_free``, ``line_fixed`` or ``line_matched``.
    w : ndarray, complex
        y/z at the frequencies and for the users for whom they are to be accurate.
    accuracy : float
        Wanted relative error; near resonances of a line without losses it may be larger.
    """
    # The terms beyond kappa = reach sqrt(w), to first order in w, leave 2/(3 pi reach^3) of sqrt(w).
    reach = (2 / (3 * np.pi * accuracy)) ** (1 / 3)
    largest = reach * float(np.sqrt(np.abs(w).max()))
    if word == "line_matched":
        strip = (np.pi - float(np.abs(np.angle(w)).max())) / 2
        step = max(2 * np.pi * strip / np.log(8 / accuracy), _FINEST)
        smallest = float(np.sqrt(np.abs(w).min())) / reach
        first, last = int(np.floor(np.log(smallest) / step)), int(np.ceil(np.log(largest) / step))
        kappa = np.exp(step * np.arange(first, last + 1))
        share, ratio = 2 * step / np.pi, np.exp(-step) / -np.expm1(-step)
        return Terms(kappa, share * kappa, float(share * kappa[0] * ratio), float(share / kappa[-1] * ratio))
    free = word == "line_free"
    shift = 0.0 if free else 0.5
    terms = int(np.ceil(largest / np.pi + shift))
    kappa = (np.arange(1, max(min(terms, _FIRST), 1) + 1) - shift) * np.pi
    c = np.full(kappa.size, 2.0)
    static = 1 / 3 if free else 1.0
    if terms <= _FIRST:
        return Terms(kappa, c, float(free), float(static - np.sum(c / kappa**2)))
    start = kappa[-1] + np.pi / 2
    panels = int(np.ceil(np.log(largest / start) / _PANEL)) if largest > start else 1
    edges = np.linspace(np.log(start), np.log(max(largest, 1.1 * start)), panels + 1)
    x, weight = np.polynomial.legendre.leggauss(max(2, int(np.ceil(np.log(1 / accuracy) / np.log(6)))))
    half = np.diff(edges)[:, None] / 2
    tail = np.exp(edges[:-1, None] + half * (1 + x)).ravel()
    more = 2 / np.pi * (half * weight).ravel() * tail
    return Terms(np.append(kappa, tail), np.append(c, more), float(free), float(2 / np.pi * np.exp(-edges[-1])))


def line_ladder(
    terms: Terms, along: Callable[[float], Found], across: Callable[[float], Found], *, whole: bool = True
) -> Found:
    """The ladder of a line.

    Parameters
    ----------
    terms : Terms
    along, across : function
        A new copy of y, and of z, with its impedance multiplied by a number.
    whole : bool
        False leaves out the multiple of z, for a network that has it already.
    """
    pieces = [
        together(Series, along(float(c / kappa**2)), across(float(c)))
        for kappa, c in zip(terms.kappa, terms.c, strict=True)
    ]
    pieces.append(along(terms.of_y))
    if whole and terms.of_z > 0:
        pieces.append(across(terms.of_z))
    return together(Parallel, *pieces)


def film_terms(largest: float, accuracy: float) -> list[tuple[float, float]]:
    """Terms of a squeeze film: damping and time constant of each, relative to those of the film.

    Parameters
    ----------
    largest : float
        Of w = s t, at the upper end of the band.
    accuracy : float
        Wanted relative error.
    """
    # What the lumped terms leave is below a^4/(8 k^5) of the whole, a^2 = 4 w/pi^2, and beyond k = a only.
    a = 2 * np.sqrt(largest) / np.pi
    last = max(a, (a**4 / (8 * accuracy)) ** 0.2, 1.0)
    return [(96 / (np.pi * k) ** 4, 4 / (np.pi * k) ** 2) for k in range(1, int(last) + 2, 2)]


def film_rest(terms: int) -> float:
    """Damping of a squeeze film beyond its first terms, relative to the whole."""
    return float(1 - sum(96 / (np.pi * k) ** 4 for k in range(1, 2 * terms, 2)))


def together(kind: type[Parallel | Series], *pieces: Found) -> Found:
    """Parts in parallel or in series, flat."""
    values: dict[str, Expression] = {}
    parts: list[Network] = []
    for part, own in pieces:
        parts.extend(part.parts if isinstance(part, kind) else (part,))
        values |= own
    return kind(tuple(parts)), values


def _inverse(x: Expression) -> Expression:
    return 1 / x
