"""Touchstone one-ports (.s1p), version 1: reflection, impedance or admittance over frequency.

The option line ``# <frequency unit> <parameter> <format> R <reference>`` has defaults GHz, S, MA and 50 ohm. Values of
Z and Y are normalised to the reference in version 1. With a reflection S, z = R (1 + S) / (1 - S).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents, Variable
from bayes_impedance.intake.text_tables import cut_short, decoded
from bayes_impedance.runtime.input_files import read_bytes
from bayes_impedance.runtime.user_table import shown

_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9}
_FORMATS = ("ma", "db", "ri")
_PARAMETERS = ("s", "z", "y")


def read(file: Path, record: str | None) -> list[Contents]:  # noqa: ARG001  (has no records)
    """Impedance in ohm; the file is refused if it has more than one port."""
    text, notes = decoded(read_bytes(file), str(file))
    unit, parameter, form, reference = 1e9, "s", "ma", 50.0
    rows, lines, last_cells = [], [], []
    seen = False
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.partition("!")[0].strip().lower()
        if line.startswith("["):
            if line.startswith("[version]"):
                raise InputError(f"{file}, row {number}: Touchstone version 2 is not read; save it as version 1")
            continue
        if line.startswith("#") and not seen:
            unit, parameter, form, reference = _options(line[1:].split(), f"{file}, row {number}")
            seen = True
        elif line and not line.startswith("#"):
            cells = line.split()
            try:
                values = [float(cell) for cell in cells]
            except ValueError:
                raise InputError(f"{file}, row {number}: {shown(line)} is no row of numbers; correct it") from None
            if len(values) != 3:
                raise InputError(
                    f"{file}, row {number}: there are {len(values)} numbers, but a one-port has 3 (frequency and one "
                    "value); give a file of one port"
                )
            rows.append(values)
            lines.append(number)
            last_cells.append(cells[-1])
    if not rows:
        raise InputError(f"{file}: there are no rows of numbers in it; export it again")
    if not text.endswith(("\n", "\r")) and lines[-1] == text.count("\n") + 1:
        notes += cut_short(last_cells, f"{file}, row {lines[-1]}")
    frequency, first, second = np.array(rows).T
    if form == "ri":
        value = first + 1j * second
    else:
        value = (10 ** (first / 20) if form == "db" else first) * np.exp(1j * np.deg2rad(second))
    with np.errstate(divide="ignore", invalid="ignore"):
        z = {"s": (1 + value) / (1 - value), "z": value, "y": 1 / value}[parameter] * reference
    variables = (
        Variable(name="frequency", values=frequency * unit, unit="Hz"),
        Variable(name="impedance", values=z.astype(np.complex128), unit="ohm"),
    )
    return [Contents(file=str(file), variables=variables, rows=np.array(lines), notes=notes)]


def _options(words: list[str], where: str) -> tuple[float, str, str, float]:
    unit, parameter, form, reference = 1e9, "s", "ma", 50.0
    rest = list(words)
    while rest:
        word = rest.pop(0)
        if word in _HERTZ:
            unit = _HERTZ[word]
        elif word in _PARAMETERS:
            parameter = word
        elif word in _FORMATS:
            form = word
        elif word == "r" and rest:
            try:
                reference = float(rest.pop(0))
            except ValueError:
                raise InputError(f"{where}: the reference resistance is not a number; correct it") from None
        else:
            raise InputError(f"{where}: the option {shown(word)} is unknown; a line is like '# Hz S RI R 50'")
    return unit, parameter, form, reference
