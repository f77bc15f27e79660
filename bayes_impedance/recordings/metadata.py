"""Metadata of a dataset: dataset.toml, with its unit, sign and convention.

Impedance is F/v in the force-voltage analogy (force = voltage, velocity = current), so the same file format serves
mechanical, rotational, acoustic and electrical one-ports. Values are stored in the SI unit of their kind.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.calibration import TABLE, CommonError, common_error_of, map_file_of
from bayes_impedance.runtime.input_files import decode, line_of, parse_toml
from bayes_impedance.runtime.user_table import UserTable, shown

DEFAULT_UNIT = "N s/m"
SIGNS = ("passive positive", "passive negative")
CONVENTIONS = ("exp(+jwt)", "exp(-jwt)")
DRIVING_POINT = "driving point"
"""The only place of which recordings are evaluated; who declares it is believed."""
IMPEDANCE, HERTZ = "impedance", "Hz"
"""The only quantity and unit of frequency that are evaluated; who declares them is believed."""
_KEYS = (
    "title",
    "unit",
    "sign",
    "convention",
    "network",
    "source",
    "licence",
    "place",
    "quantity",
    "frequency_unit",
    TABLE,
)
RECIPE = "import"
"""Key of the table that records how the dataset was made from other files; it is not evaluated."""

#: Spellings, without spaces and signs of multiplication and of powers, of each unit that is kept.
_SPELLINGS = {
    "N s/m": ("Ns/m", "N/(m/s)", "Nsm-1", "kg/s", "kgs-1"),
    "ohm": ("ohm", "Ohm", "OHM", "ohms", "Ohms", "\u03a9", "V/A"),
    "N m s/rad": ("Nms/rad", "Nm/(rad/s)", "Nms", "Nmsrad-1"),
    "Pa s/m3": ("Pas/m3", "Pa/(m3/s)", "Pasm-3"),
    "Pa s/m": ("Pas/m", "Pa/(m/s)", "Pasm-1", "rayl", "Rayl"),
}
_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
"""SI prefixes and their factors; those that occur with units of impedance."""
#: Scaled spellings that are no prefix before a spelling from above.
_SCALED = {
    "g/s": ("N s/m", 1e-3),
    "Ns/mm": ("N s/m", 1e3),
    "N/(mm/s)": ("N s/m", 1e3),
    "mNs/mm": ("N s/m", 1.0),
    "Ns/cm": ("N s/m", 1e2),
    "dyns/cm": ("N s/m", 1e-3),
    "Nmms/rad": ("N m s/rad", 1e-3),
}
_OTHER_QUANTITIES = {
    "m": "a displacement",
    "mm": "a displacement",
    "um": "a displacement",
    "m/s": "a velocity",
    "mm/s": "a velocity",
    "N": "a force",
    "N/m": "a stiffness",
    "N/mm": "a stiffness",
    "m/N": "a compliance",
    "mm/N": "a compliance",
    "m/s/N": "a mobility",
    "m/(Ns)": "a mobility",
    "kg": "a mass",
    "g": "a mass",
    "dB": "a level",
    "S": "an admittance",
    "1/ohm": "an admittance",
    "Hz": "a frequency",
    "deg": "an angle",
    "rad": "an angle",
}


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """Content of dataset.toml.

    Attributes
    ----------
    title, source, licence : str
    unit : str
        SI unit of the impedance after conversion.
    factor : float
        Factor that converts the file's numbers to `unit`, without the sign.
    sign : str
        One of `SIGNS`.
    convention : str or None
        One of `CONVENTIONS`, the sign of time in phasors; None if the file does not say.
    network : str or None
        Notation of the network that the data are usually modelled with.
    warnings : tuple of str
    calibration : CommonError or None
        What a calibration has left uncertain in all recordings, as a rig of few parameters.
    map_file : str
        Name of the table beside the file that holds the same at each frequency; empty if there is none.
    place : str or None
        :data:`DRIVING_POINT` if that is declared.
    quantity, frequency_unit : str or None
        :data:`IMPEDANCE` and :data:`HERTZ` if they are declared.
    """

    title: str
    unit: str = DEFAULT_UNIT
    factor: float = 1.0
    sign: str = SIGNS[0]
    convention: str | None = None
    network: str | None = None
    source: str = ""
    licence: str = ""
    warnings: tuple[str, ...] = ()
    calibration: CommonError | None = None
    map_file: str = ""
    place: str | None = None
    quantity: str | None = None
    frequency_unit: str | None = None


def parse_metadata(data: bytes, file: str, default_title: str) -> Metadata:
    """Read dataset.toml.

    Parameters
    ----------
    data : bytes
        Content of the file.
    file : str
        Name to use in messages.
    default_title : str
        Title of a dataset that has none.

    Returns
    -------
    Metadata
        Its warnings name unknown keys and converted units.

    Raises
    ------
    InputError
        If the file is not TOML, a value is no string, or the unit, sign or convention is none of those known.
    """
    text = decode(data, file)

    def where(key: str) -> str:
        return f"{file}, line {line_of(text, key)}"

    # Other programs' keys may be present: unknown keys give a warning, not an error.
    table = UserTable(parse_toml(text, file), where, _KEYS, tolerant=True)
    warnings = [table.about_unknown(key) for key in table.unknown if key != RECIPE]
    if RECIPE in table and not _makes_again(table[RECIPE]):
        warnings.append(
            f"{where(RECIPE)}: the table [import] has no arguments, so that --again cannot make the dataset once more; "
            "delete it, or restore it from the dataset that 'import' has written"
        )
    title, source, licence, network, declared, given_sign, given_convention = (
        table.text(key, default)
        for key, default in (
            ("title", ""),
            ("source", ""),
            ("licence", ""),
            ("network", ""),
            ("unit", DEFAULT_UNIT),
            ("sign", SIGNS[0]),
            ("convention", ""),
        )
    )
    unit, factor = parse_unit(declared, where("unit"))
    if factor != 1.0:
        warnings.append(f"{where('unit')}: values in {declared.strip()} were multiplied by {factor:g} to be in {unit}")
    sign = " ".join(given_sign.lower().split())
    if sign not in SIGNS:
        raise InputError(
            f"{where('sign')}: sign {shown(given_sign)} is unknown; "
            f'write "{SIGNS[0]}" (Re z >= 0 for a passive load) or "{SIGNS[1]}"'
        )
    convention = "".join(given_convention.lower().split()).replace("exp(jwt)", CONVENTIONS[0])
    if convention and convention not in CONVENTIONS:
        raise InputError(
            f"{where('convention')}: convention {shown(given_convention)} is unknown; "
            f'write "{CONVENTIONS[0]}" (a mass is +jwm) or "{CONVENTIONS[1]}"'
        )
    map_file = map_file_of(table[TABLE], where) if TABLE in table else ""
    return Metadata(
        title=title.strip() or default_title,
        unit=unit,
        factor=factor,
        sign=sign,
        convention=convention or None,
        network=network.strip() or None,
        source=source,
        licence=licence,
        warnings=tuple(warnings),
        calibration=common_error_of(table[TABLE], where) if TABLE in table and not map_file else None,
        map_file=map_file,
        place=table.choice("place", (DRIVING_POINT,)) if "place" in table else None,
        quantity=table.choice("quantity", (IMPEDANCE,)) if "quantity" in table else None,
        frequency_unit=table.choice("frequency_unit", (HERTZ,)) if "frequency_unit" in table else None,
    )


def _makes_again(recipe: object) -> bool:
    """Whether a table [import] has the arguments of the import."""
    return isinstance(recipe, dict) and bool(recipe.get("arguments"))


def parse_unit(unit: str, where: str) -> tuple[str, float]:
    """Return the SI unit of an impedance and the factor that converts to it.

    Parameters
    ----------
    unit : str
        Unit in common notation, e.g. "N s/m", "N*s/m", "kg/s", "mN s/m", "kOhm".
    where : str
        File and line, for messages.

    Returns
    -------
    unit : str
        One of "N s/m", "ohm", "N m s/rad", "Pa s/m3", "Pa s/m".
    factor : float
        Multiply by it to get that unit.

    Raises
    ------
    InputError
        If the unit is unknown or belongs to another quantity.
    """
    spelling = _compact(unit)
    for kept, spellings in _SPELLINGS.items():
        if spelling in spellings:
            return kept, 1.0
    if spelling in _SCALED:
        return _SCALED[spelling]
    for kept, spellings in _SPELLINGS.items():
        if spelling[:1] in _PREFIXES and spelling[1:] in spellings:
            return kept, _PREFIXES[spelling[0]]
    accepted = ", ".join(f'"{kept}"' for kept in _SPELLINGS)
    quantity = _OTHER_QUANTITIES.get(spelling)
    problem = f"belongs to {quantity}" if quantity else "is unknown"
    raise InputError(
        f"{where}: unit {shown(unit)} {problem}, but an impedance F/v is expected; "
        f"convert the values and give one of {accepted}"
    )


def _compact(unit: str) -> str:
    """Return a spelling without spaces, multiplication and power signs, in ASCII except for the ohm sign."""
    plain = unit.translate(str.maketrans("\u00b5\u03bc\u2126\u207b\u00b9\u00b2\u00b3", "uu\u03a9-123"))
    return re.sub(r"[\s*^\u00b7\u22c5\u2219.]", "", plain)
