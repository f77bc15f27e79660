"""Units and numbers as an engineer writes them: with a prefix, and with no more digits than are known.

Texts of every room (sentences, tables, axes) take their prefixes and digits from here. There are two ways to write
digits: :func:`rounded` leaves out zeros at the end, for sentences; :func:`significant` keeps them, for tables, where
digits stand below digits.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

SMALLEST_IMPEDANCE, LARGEST_IMPEDANCE = 1e-25, 1e25
"""Of |z| and of noise, in the dataset's unit: results keep curves in single precision, which ends at 1e-38 and 3e38,
and predicted curves need room on either side. What programs fill gaps with (1e30 to 1e38) lies outside."""
LARGEST_ELEMENT = 1e15
"""Of an element's value in its unit, and of its reciprocal: none of any kind is larger or smaller."""
LOWEST_HZ, HIGHEST_HZ = 1e-12, 1e15
"""Frequencies: a period of thirty thousand years, and light. Powers of s as high as networks have stay finite."""

ELECTRICAL_UNIT = "ohm"
"""Of the impedance of electrical recordings, which the force-voltage analogy describes."""

NORMAL_Q95 = 1.6448536269514722
"""Half the width of a 90 % interval, the level of all intervals here, in standard errors: the 95 % quantile of the
standard normal distribution."""
MAD_TO_SD = 1.4826
"""Ratio of the standard deviation of a normal distribution to its median absolute deviation."""
INTERVAL = (0.05, 0.5, 0.95)
"""Quantiles that are given of a posterior: the ends of the 90 % interval, and the median between them."""

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
# A prefix on a unit with a power would be raised to it as well, so such units get a power of ten instead.
_FIRST_UNIT = re.compile(r"(kg|rad|ohm|Pa|N|m|s|H|F|V|A)(?![\w^])")
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# Units of mass m, compliance n, damper r and stiffness k for each unit of impedance with names of its own.
_ELEMENT_UNITS: dict[str, dict[str, str]] = {
    "N s/m": {"m": "kg", "n": "m/N", "r": "N s/m", "k": "N/m"},
    "N m s/rad": {"m": "kg m^2", "n": "rad/(N m)", "r": "N m s/rad", "k": "N m/rad"},
    "ohm": {"m": "H", "n": "F", "r": "ohm", "k": "1/F"},
}


def who(unit: str, number: int = 2) -> str:
    """Word for those who were recorded: electrical recordings, of cells for example, are not of people.

    Parameters
    ----------
    unit : str
        Of the impedance.
    number : int
        How many are meant.
    """
    plural, single = ("subjects", "subject") if unit == ELECTRICAL_UNIT else ("people", "person")
    return single if number == 1 else plural


def counted(number: int, what: str) -> str:
    """A number with what it counts, which is named in the singular.

    Examples
    --------
    >>> counted(1, "subject"), counted(12, "subject")
    ('1 subject', '12 subjects')
    """
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def ratio_of(unit: str) -> str:
    """Which quantity over which an impedance of this unit is: V/I of electrical recordings, else F/v."""
    return "V/I" if unit == ELECTRICAL_UNIT else "F/v"


def unit_of(unit: str, impedance_unit: str) -> str:
    """Unit of an element or of another parameter.

    Parameters
    ----------
    unit : str
        ``m``, ``n``, ``r`` (kinds of elements), ``k`` (stiffness), ``c`` (coefficient of a power law,
        ``c s^(a-1)``) and ``l`` (of a semi-inductance, ``c s^a``) depend on the unit of the impedance. All others are
        units already.
    impedance_unit : str
    """
    general = {
        "m": f"{impedance_unit} s",
        "n": f"s/({impedance_unit})",
        "r": impedance_unit,
        "k": f"{impedance_unit}/s",
        "c": f"{impedance_unit} s^(a-1)",
        "l": f"{impedance_unit} s^a",
    }
    return (general | _ELEMENT_UNITS.get(impedance_unit, {})).get(unit, unit)


@dataclass(frozen=True)
class Scale:
    """What a value is multiplied by to be written in a unit with a prefix.

    Attributes
    ----------
    factor : float
    unit : str
        Unit with its prefix, in typeset characters (``µm/N``, ``Ω``); empty for a pure number.
    """

    factor: float
    unit: str

    def label(self, text: str) -> str:
        """Text of an axis: what it shows, and the unit in parentheses."""
        return f"{text} ({self.unit})" if self.unit else text


def typeset(unit: str) -> str:
    """Unit with typographic characters: ``ohm`` becomes Ω, ``m^2`` m²."""
    text = re.sub(r"\^(-?\d+)", lambda match: match.group(1).translate(_SUPERSCRIPT), unit)
    return re.sub(r"\bohm\b", "Ω", text)


def scale_for(value: float, unit: str) -> Scale:
    """Scale in which a value is easy to read: between 0.1 and 1000 if no prefix is needed, else between 0.1 and 100.

    Frequencies are in Hz or, from 1000 Hz on, in kHz.

    Parameters
    ----------
    value : float
        In `unit`; zero and non-finite values get no prefix.
    unit : str
    """
    if unit == "Hz":
        return Scale(1e-3, "kHz") if 1000 <= abs(value) < math.inf else Scale(1.0, "Hz")
    first = _FIRST_UNIT.match(unit)
    in_grams = first is not None and first.group(1) == "kg"
    base = 1000.0 if in_grams else 1.0
    size = abs(value) * base
    if (in_grams and 1000 <= size < 1e6) or not math.isfinite(size) or size == 0.0:
        return Scale(1.0, typeset(unit))
    # 680 nm/N and 0.68 µm/N are both right; the second is what is said. Best is no prefix at all.
    exponent = 0 if 0.1 <= size < 1000 else 3 * math.floor((math.log10(size) + 1) / 3)
    if exponent == 0 and not in_grams:
        return Scale(1.0, typeset(unit))
    if first is None or exponent not in _PREFIXES:
        power = math.floor(math.log10(abs(value)))
        return Scale(10.0**-power, f"10{str(power).translate(_SUPERSCRIPT)} {typeset(unit)}".strip())
    rest = "g" + unit[2:] if in_grams else unit
    return Scale(base * 10.0**-exponent, _PREFIXES[exponent] + typeset(rest))


def rounded(value: float, digits: int = 3) -> str:
    """Value with at most so many significant digits (6 at most), without an exponent from 1e-4 to 1e6."""
    return f"{float(f'{value:.{digits}g}'):g}"


def number_with_unit(value: float, unit: str, digits: int = 3) -> str:
    """A value for a sentence, in the unit with the prefix in which it is easy to read."""
    if not math.isfinite(value):
        return "an unknown amount"
    if unit in ("", "1"):
        return rounded(value, digits)
    if unit.startswith("per "):
        return f"{rounded(value, digits)} {unit}"
    scale = scale_for(value, unit)
    return joined(rounded(value * scale.factor, digits), scale.unit)


def joined(number: str, unit: str) -> str:
    """A number in front of the unit of a :class:`Scale`, which may begin with a power of ten."""
    return f"{number}{'×' if unit.startswith('10') else ' '}{unit}".strip()


def hertz(value: float, digits: int = 3) -> str:
    """Frequency in Hz or kHz, for a sentence."""
    return "infinity" if math.isinf(value) else number_with_unit(value, "Hz", digits)


def decimals(half_width: float) -> int:
    """Decimals that show an uncertainty of this size with two digits."""
    if not math.isfinite(half_width) or half_width <= 0:
        return 2
    return max(0, 1 - math.floor(math.log10(half_width)))


def significant(value: float, digits: int = 3) -> str:
    """Value with a number of significant digits, zeros included, without an exponent for ordinary sizes."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "–"
    if not 1e-4 <= abs(value) < 1e6:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa}×10{str(int(power)).translate(_SUPERSCRIPT)}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{places}f}"


def signed(value: float) -> str:
    """A correlation with its sign, two decimals; zero has none."""
    text = f"{value:+.2f}"
    return "0.00" if float(text) == 0 else text.replace("-", "−")


def excludes_zero(low: float, high: float) -> bool:
    """Whether the interval of a correlation excludes zero as :func:`signed` writes it."""
    return (min(low, high) > 0 and signed(low) != "0.00") or (max(low, high) < 0 and signed(high) != "0.00")


def with_interval(median: float, low: float, high: float) -> tuple[str, str]:
    """A median, and its interval, with the digits that the interval's width allows."""
    places = decimals((high - low) / 2)
    return f"{median:.{places}f}", f"{low:.{places}f} to {high:.{places}f}"
