"""Units as people write them: ``(m/s^2)/N``, ``mm/s/N``, ``N·s·m⁻¹``, ``Ohm``, ``g/lbf``, ``mV/g``.

A unit is a factor to SI and a dimension, the exponents of mass, length, time and current. Radian counts as 1 (so a
torque divided by an angle has the dimension of N m), degrees as pi/180. A general package of units would bring a
thousand units of which measurements of impedance need thirty, and could not decide the one question that matters here:
``g`` is the gram or the acceleration of free fall. Both readings are returned, and who asks knows which dimension is
expected.
"""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass

Dimension = tuple[int, int, int, int]
"""Exponents of mass, length, time and electric current."""

STANDARD_GRAVITY = 9.80665
"""m/s^2, exact by definition (3rd CGPM, 1901)."""
_POUND = 0.45359237  # kg, exact by definition (1959)

_FORCE = (1, 1, -2, 0)
"""Dimension of a force: kg m/s^2."""
_UNITS: dict[str, tuple[float, Dimension]] = {
    "kg": (1.0, (1, 0, 0, 0)),
    "g": (1e-3, (1, 0, 0, 0)),
    "lb": (_POUND, (1, 0, 0, 0)),
    "t": (1e3, (1, 0, 0, 0)),
    "m": (1.0, (0, 1, 0, 0)),
    "in": (0.0254, (0, 1, 0, 0)),
    "inch": (0.0254, (0, 1, 0, 0)),
    "ft": (0.3048, (0, 1, 0, 0)),
    "mil": (2.54e-5, (0, 1, 0, 0)),
    "s": (1.0, (0, 0, 1, 0)),
    "sec": (1.0, (0, 0, 1, 0)),
    "min": (60.0, (0, 0, 1, 0)),
    "Hz": (1.0, (0, 0, -1, 0)),
    "rpm": (2 * math.pi / 60, (0, 0, -1, 0)),
    "N": (1.0, _FORCE),
    "Newton": (1.0, _FORCE),
    "Newtons": (1.0, _FORCE),
    "lbf": (_POUND * STANDARD_GRAVITY, _FORCE),
    "kgf": (STANDARD_GRAVITY, _FORCE),
    "kp": (STANDARD_GRAVITY, _FORCE),
    "gf": (1e-3 * STANDARD_GRAVITY, _FORCE),
    "dyn": (1e-5, _FORCE),
    "Pa": (1.0, (1, -1, -2, 0)),
    "rad": (1.0, (0, 0, 0, 0)),
    "deg": (math.pi / 180, (0, 0, 0, 0)),
    "rev": (2 * math.pi, (0, 0, 0, 0)),
    "gn": (STANDARD_GRAVITY, (0, 1, -2, 0)),
    "g0": (STANDARD_GRAVITY, (0, 1, -2, 0)),
    "gee": (STANDARD_GRAVITY, (0, 1, -2, 0)),
    "A": (1.0, (0, 0, 0, 1)),
    "V": (1.0, (1, 2, -3, -1)),
    "ohm": (1.0, (1, 2, -3, -2)),
    "S": (1.0, (-1, -2, 3, 2)),
    "1": (1.0, (0, 0, 0, 0)),
}
_SPELLINGS = {"Ohm": "ohm", "OHM": "ohm", "ohms": "ohm", "Ohms": "ohm", "Ω": "ohm", "°": "deg", "degree": "deg"}
_SPELLINGS |= {"degrees": "deg", "Volt": "V", "Volts": "V", "Hertz": "Hz", "hz": "Hz", "HZ": "Hz", "Siemens": "S"}
_PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9}
_WITH_PREFIX = ("g", "m", "s", "Hz", "N", "Pa", "rad", "A", "V", "ohm", "S", "gn")
_PLAIN = str.maketrans({"µ": "u", "μ": "u", "Ω": "Ω", "·": "*", "⋅": "*", "∙": "*", "×": "*", "−": "-"})
_SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_TOKEN = re.compile(r"\s*(?:(\*\*|\^)|([*/()])|([A-Za-zΩ°]+0?|1)|(-?\d+))")
_LONGEST = 60
"""Characters of a unit. By choice: no unit in use has half as many."""


@dataclass(frozen=True)
class Unit:
    """One reading of a unit.

    Attributes
    ----------
    factor : float
        Multiply by it to get SI.
    dimension : tuple of int
    """

    factor: float
    dimension: Dimension


def readings(text: str) -> tuple[Unit, ...]:
    """All readings of a unit's text: more than one only where it contains ``g``; none if it is not a unit.

    Parameters
    ----------
    text : str
        Products by space, ``*`` or a dot, quotients by ``/`` (each applies to the next factor only), powers by ``^``,
        ``**``, superscripts or digits behind the symbol, parentheses.
    """
    plain = re.sub(r"([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", r"^\1", text.strip().translate(_PLAIN)).translate(_SUPERSCRIPTS)
    if not plain or len(plain) > _LONGEST:
        return ()
    found: dict[Unit, None] = {}
    for gravity in (False, True):
        try:
            unit, rest = _product(_tokens(plain), gravity)
        except (ValueError, KeyError, IndexError, OverflowError):
            continue
        if not rest:
            found[unit] = None
    return tuple(found)


def unit_in(text: str, expected: dict[Dimension, str]) -> Unit | None:
    """The reading of a unit's text that has one of the expected dimensions; None if there is none."""
    return next((unit for unit in readings(text) if unit.dimension in expected), None)


def same_unit(one: str, other: str) -> bool:
    """Whether two texts can be one unit, as ``N s/mm`` and ``kN·s·m⁻¹``."""
    return any(
        a.dimension == b.dimension and math.isclose(a.factor, b.factor, rel_tol=1e-9)
        for a, b in itertools.product(readings(one), readings(other))
    )


def _tokens(text: str) -> list[str]:
    tokens, place = [], 0
    while place < len(text.rstrip()):
        match = _TOKEN.match(text, place)
        if match is None:
            raise ValueError(text)
        token = next(group for group in match.groups() if group is not None)
        tokens.append("^" if token == "**" else token)
        place = match.end()
    return tokens


def _product(tokens: list[str], gravity: bool) -> tuple[Unit, list[str]]:
    """Product of factors up to the end or a closing parenthesis."""
    total, divide, wanted = Unit(1.0, (0, 0, 0, 0)), False, True
    while tokens and tokens[0] != ")":
        if tokens[0] in ("*", "/"):
            if wanted:
                raise ValueError("two operators")
            divide, wanted, tokens = tokens[0] == "/", True, tokens[1:]
            continue
        factor, tokens = _power(tokens, gravity)
        total = _times(total, _raised(factor, -1) if divide else factor)
        divide, wanted = False, False
    if wanted:
        raise ValueError("an operator without a factor")
    return total, tokens


def _power(tokens: list[str], gravity: bool) -> tuple[Unit, list[str]]:
    first, tokens = tokens[0], tokens[1:]
    if first == "(":
        unit, tokens = _product(tokens, gravity)
        if tokens[0] != ")":
            raise ValueError("a parenthesis is not closed")
        last, tokens = unit, tokens[1:]
        before = Unit(1.0, (0, 0, 0, 0))
    else:
        *firsts, last = _symbols(first, gravity)
        before = Unit(1.0, (0, 0, 0, 0))
        for one in firsts:
            before = _times(before, one)
    if tokens and tokens[0] == "^":
        tokens = tokens[1:]
    if tokens and re.fullmatch(r"-?\d+", tokens[0]) and first != "1":
        exponent, tokens = int(tokens[0]), tokens[1:]
        if abs(exponent) > 6:
            raise ValueError("no unit has such a power")
        last = _raised(last, exponent)
    return _times(before, last), tokens


def _symbols(text: str, gravity: bool) -> list[Unit]:
    """Units of one word, which may be several written together (``Ns``, ``Nms``, ``mNs``).

    Splittings into symbols without prefix come first, so that ``Nms`` is N m s; but no symbol twice (``Nmm`` is N mm),
    and no metre before newton (``mNs`` is mN s).
    """
    whole = _symbol(text, gravity)
    if whole is not None:
        return [whole]
    for plain in (True, False):
        for cuts in range(1, min(len(text), 4)):
            for places in itertools.combinations(range(1, len(text)), cuts):
                parts = [text[i:j] for i, j in itertools.pairwise((0, *places, len(text)))]
                if plain and (len(set(parts)) < len(parts) or ("m", "N") in itertools.pairwise(parts)):
                    continue
                units = [_symbol(part, gravity) for part in parts if not plain or _SPELLINGS.get(part, part) in _UNITS]
                found = [unit for unit in units if unit is not None]
                if len(found) == len(parts):
                    return found
    raise KeyError(text)


def _symbol(text: str, gravity: bool) -> Unit | None:
    text = _SPELLINGS.get(text, text)
    scale = 1.0
    if text not in _UNITS and text[:1] in _PREFIXES:
        rest = _SPELLINGS.get(text[1:], text[1:])
        if rest in _WITH_PREFIX:
            scale, text = _PREFIXES[text[0]], rest
    if text not in _UNITS:
        return None
    if gravity and text == "g":
        text = "gn"
    factor, dimension = _UNITS[text]
    return Unit(scale * factor, dimension)


def _times(one: Unit, other: Unit) -> Unit:
    a, b = one.dimension, other.dimension
    return Unit(one.factor * other.factor, (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]))


def _raised(unit: Unit, exponent: int) -> Unit:
    a = unit.dimension
    return Unit(unit.factor**exponent, (a[0] * exponent, a[1] * exponent, a[2] * exponent, a[3] * exponent))
