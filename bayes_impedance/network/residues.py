r"""A network's impedance and its derivatives at a generic point, in exact arithmetic.

Whether columns of derivatives are linearly dependent is a question about identities, and an identity is decided with
certainty by integers modulo a prime at random arguments, without a tolerance: sums, products and reciprocals are exact
there, as for rational numbers. By the Schwartz-Zippel lemma, the chance that a random point shows a smaller rank than
the generic one is below the degree of the determinant over the prime: 1e-16 (J. T. Schwartz, J. ACM 27, 1980).

Two things are needed besides rational numbers. **Complex numbers**, since a loss factor multiplies by 1 + je: the prime
is 3 modulo 4, so -1 has no root, and pairs of residues are the field of its root j. The unknown coefficients of an
identity are real: each point gives two equations, real and imaginary part. **Transcendental functions of s**:
:math:`e^{-sd}`, :math:`s^a`, :math:`\ln s` and the line's :math:`g(w) = \sqrt w \coth\sqrt w` are algebraically
independent of s and of one another for generic parameters, so an identity between them holds for any numbers in their
place, and each is a random residue of its own. Their derivatives are rational in them again:

.. math:: \frac{\partial}{\partial d} e^{-sd} = -s\,e^{-sd}, \qquad
          \frac{\partial}{\partial a} s^a = s^a \ln s, \qquad
          \frac{dg}{dw} = \frac{g - g^2 + w}{2w}

where :math:`g = \sqrt w \tanh\sqrt w` is another solution of the same equation.

What is algebraic stays so. A power with a held, rational exponent such as 0.5 is a power of :math:`t` with :math:`s =
t^N`. A line without an end is a square root, of which one sign must be taken at all points alike: the product of a
constant's root and a power of t is to be that, and not a change of signs from point to point. All constants and
functions of s are therefore squares of integers modulo the prime, of whose two roots exactly one is a square again,
since -1 is none; the root is taken whose real part is one. Multiplied by a square it remains the one that is taken.
(Of what is a root of no monomial the two signs are conjugate: an identity holds for either.)
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.extensions import PowerLaw, Wrapped
from bayes_impedance.network.notation import Element, Network, Parallel
from bayes_impedance.network.parameters import Symbol

PRIME = 2**61 - 1
"""Mersenne prime, 3 modulo 4: a product of two residues is exact in Python's integers."""

_SEED = 1
"""Seed of the random points. By choice: the result depends on it with probability 1e-16 only."""

_MORE_POINTS = 3
"""Values of s in excess of the number of parameters. By choice: the rank needs no more than that number."""

_LARGEST_DENOMINATOR = 1000
"""Of a held exponent that counts as rational: three decimals. By choice: one with more is as good as irrational,
and the degree of polynomials, which is in proportion, stays far below the prime."""


_POINTS_TRIED, _ATTEMPTS = 150, 4
"""Points that are tried in a row before other constants are taken, and how often that is done. By choice: half of all
numbers have a root, so that with five lines inside one another one point in thirty will do."""


@dataclass(frozen=True, slots=True)
class Residue:
    """re + j im modulo the prime."""

    re: int
    im: int = 0

    def __add__(self, other: Residue) -> Residue:
        return Residue((self.re + other.re) % PRIME, (self.im + other.im) % PRIME)

    def __sub__(self, other: Residue) -> Residue:
        return Residue((self.re - other.re) % PRIME, (self.im - other.im) % PRIME)

    def __mul__(self, other: Residue) -> Residue:
        a, b, c, d = self.re, self.im, other.re, other.im
        return Residue((a * c - b * d) % PRIME, (a * d + b * c) % PRIME)

    def __neg__(self) -> Residue:
        return Residue(-self.re % PRIME, -self.im % PRIME)

    def __truediv__(self, other: Residue) -> Residue:
        norm = pow(other.re * other.re + other.im * other.im, -1, PRIME)
        return self * Residue(other.re * norm % PRIME, -other.im * norm % PRIME)

    def __pow__(self, power: int) -> Residue:
        base, result = (self if power >= 0 else ONE / self), ONE
        for bit in bin(abs(power))[2:]:
            result = result * result
            result = result * base if bit == "1" else result
        return result

    def root(self) -> Residue | None:
        """The square root whose real part is a square, if there is one.

        By G. Adj and F. Rodriguez-Henriquez, IEEE Trans. Computers 63, 2014.
        """
        first = self ** ((PRIME - 3) // 4)
        start = first * self
        alpha = first * start
        root = J * start if alpha == -ONE else (ONE + alpha) ** ((PRIME - 1) // 2) * start
        if root * root != self:
            return None
        square = pow(root.re or root.im, (PRIME - 1) // 2, PRIME) == 1  # Euler's criterion
        return root if square else -root


ONE, J = Residue(1), Residue(0, 1)


class _NoRoot(Exception):  # noqa: N818
    """A line without an end stands where there is no square root at this point: another one is needed."""


class _Point:
    """Random residues: those of constants are the same at every point, functions of s differ from point to point."""

    def __init__(self, constants: dict[Hashable, Residue], order: int, squares: bool, rng: np.random.Generator) -> None:
        self.constants, self.functions, self.rng = constants, dict[Hashable, Residue](), rng
        self.t, self.order, self.squares = self.random(), order, squares
        self.s = self.t**order

    def random(self) -> Residue:
        return Residue(int(self.rng.integers(1, PRIME)) ** 2 % PRIME)

    def function(self, key: Hashable) -> Residue:
        return self.functions.setdefault(key, self.random())

    def constant(self, key: Hashable) -> Residue:
        return self.constants.setdefault(key, self.random())

    def value(self, symbol: Symbol) -> Residue:
        """Of a parameter: generic, or the fraction at which it is held; of a frequency times 2 pi.

        Where roots are taken, what is held is a random square as well, the same for equal values.
        """
        factor = self.constant("2 pi") if symbol.name[0] == "f" else ONE
        if symbol.value is None:
            return factor * self.constant(symbol.name)
        if self.squares and symbol.value:
            size = factor * self.constant((symbol.name[0], abs(symbol.value)))
            return size if symbol.value > 0 else -size
        top, bottom = symbol.value.as_integer_ratio()
        return factor * Residue(top * pow(bottom, -1, PRIME) % PRIME)


def slopes_at_points(network: Network) -> list[list[int]]:
    """Derivatives of z with respect to ``network.elements``, shape (at least P, P), modulo the prime.

    Raises
    ------
    InputError
        If lines without an end are nested so deep that no points with all their roots are found.
    """
    names, rng = network.elements, np.random.default_rng(_SEED)
    powers = [node for _, node in network.walk() if isinstance(node, PowerLaw)]
    order = math.lcm(*(e.denominator for e in map(_rational, powers) if e is not None))
    squares = any(isinstance(n, Wrapped) and n.construct.operation == "line_matched" for _, n in network.walk())
    for _ in range(_ATTEMPTS):
        constants, rows, tried = dict[Hashable, Residue](), list[list[int]](), 0
        while tried < _POINTS_TRIED:
            try:
                _, slopes = _value(network, _Point(constants, order, squares, rng))
            except _NoRoot:
                tried += 1
                continue
            found, tried = [slopes[name] for name in names], 0
            rows += [[slope.re for slope in found], [slope.im for slope in found]]
            if len(rows) == 2 * (len(names) + _MORE_POINTS):
                return rows
    raise InputError(
        f"network {network}: too many nested infinite lines (line_matched) to decide which elements are identifiable"
    )


Slopes = dict[str, Residue]


def _value(node: Network, at: _Point) -> tuple[Residue, Slopes]:
    """Impedance, and its derivative with respect to each parameter that is not held."""
    if isinstance(node, Element):
        kind, x = kind_of(node.name), at.value(node.symbol)
        z = at.s**kind.power * x**kind.exponent
        return z, _free((node.symbol,), (z / x if kind.exponent > 0 else -z / x,))
    if isinstance(node, PowerLaw):
        return _power_law(node, at)
    if isinstance(node, Wrapped):
        part, slopes = _value(node.part, at)
        z, inner, own = _wrapped(node, part, at)
        return z, {name: inner * slope for name, slope in slopes.items()} | _free(node.symbols, own)
    total, slopes = Residue(0), {}
    for part_node in node.parts:
        z, own_slopes = _value(part_node, at)
        inverse = ONE if isinstance(node, Parallel) else ONE / z
        weight = ONE if isinstance(node, Parallel) else -inverse * inverse
        total = total + (z if isinstance(node, Parallel) else inverse)
        slopes.update({name: weight * slope for name, slope in own_slopes.items()})
    if isinstance(node, Parallel):
        return total, slopes
    z = ONE / total
    return z, {name: -z * z * slope for name, slope in slopes.items()}


def _free(symbols: tuple[Symbol, ...], slopes: tuple[Residue, ...]) -> Slopes:
    return {symbol.name: slope for symbol, slope in zip(symbols, slopes, strict=True) if symbol.value is None}


def _rational(node: PowerLaw) -> Fraction | None:
    """A held exponent less one, if it is a fraction with a small denominator."""
    value = node.exponent.value
    if value is None:
        return None
    near = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return near - 1 if float(near) == value else None


def _power_law(node: PowerLaw, at: _Point) -> tuple[Residue, Slopes]:
    size, rational, exponent = at.value(node.size), _rational(node), node.exponent
    # Equal exponents are equal functions, whatever the parameters are called.
    key = exponent.name if exponent.value is None else exponent.value
    power = at.function(("power", key)) if rational is None else at.t ** int(rational * at.order)
    log = at.function("log")
    if node.reference_hz is not None:
        power = power * at.constant(("power", key, node.reference_hz))
        log = log - at.constant(("log", node.reference_hz))
    z = size * power
    return z, _free((node.size, exponent), (power, z * log))


def _wrapped(node: Wrapped, z: Residue, at: _Point) -> tuple[Residue, Residue, tuple[Residue, ...]]:
    """T, dT/dz and the derivatives with respect to the wrapper's parameters."""
    first, s = node.symbols[0], at.s
    x = at.value(first)
    unit = {"m": s, "k": ONE / s}.get(first.name[0], ONE)
    match node.construct.operation:
        case "add":
            return z + x * unit, ONE, (unit,)
        case "delay":
            late = _late(first, at)
            return z * late, late, (-s * z * late,)
        case "gain":
            return z * x, x, (z,)
        case "hysteresis":
            return z * (ONE + J * x), ONE + J * x, (J * z,)
        case "highpass" | "lowpass" as which:
            lag, slope = (ONE + x / s, ONE / s) if which == "highpass" else (ONE + x * s, s)
            if first.value is not None and first.value < 0:  # one that is free is taken to be above zero
                lag, slope = (ONE - x / s, ONE / s) if which == "highpass" else (ONE - x * s, s)
                return z * lag, lag, (-z * slope,)
            return z / lag, ONE / lag, (-z * slope / (lag * lag),)
        case "line" | "line_fixed":
            w = x * unit / z
            g = at.constant(("line", first.name, w))  # a function of w, which may be the same at all points
            slope = (g - g * g + w) / (w + w)
            return z * g, g - w * slope, (unit * slope,)
        case "line_matched":
            root = (x * unit * z).root()
            if root is None:
                raise _NoRoot
            return root, root / (z + z), (root / (x + x),)
        case "reflex":
            late, corner = _late(node.symbols[1], at), at.value(node.symbols[2])
            lag = ONE + s / corner
            stretch = first.name[0] == "k"
            answer, order = late / (lag * (s if stretch else lag)), ONE if stretch else ONE + ONE
            return z + x * answer, ONE, (answer, -s * x * answer, order * x * answer * s / (corner * corner * lag))
        case "squeeze_film":
            time = node.symbols[1]
            key = time.name if time.value is None else time.value  # equal times are equal functions
            film, slope = at.function(("film", key)), at.function(("film slope", key))
            return z + x * film, ONE, (film, x * s * slope)
    raise NotImplementedError(f"the derivative of {node.construct.operation} in residues")


def _late(symbol: Symbol, at: _Point) -> Residue:
    """exp(-s d): equal for equal held delays, and the reciprocal of that of the opposite one."""
    if symbol.value is None:
        return at.function(("delay", symbol.name))
    late = at.function(("delay", abs(symbol.value))) if symbol.value else ONE
    return late if symbol.value >= 0 else ONE / late
