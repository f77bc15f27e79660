"""Known loads of calibration runs, as they are given: ``open:FILE``, ``mass=10 g:FILE``, ``stiffness=2 N/mm:FILE``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.quantities import response_of
from bayes_impedance.intake.spectrum import ComplexArray, FloatArray
from bayes_impedance.runtime.user_table import hint, shown

OPEN = "open"
_FORMS = {
    "mass": "apparent mass",
    "inertia": "apparent mass",
    "damper": "impedance",
    "resistance": "impedance",
    "stiffness": "dynamic stiffness",
    "spring": "dynamic stiffness",
}
_VALUE = re.compile(r"([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([^\s0-9.].*)")
_EXAMPLE = "write for instance open:empty.csv or 'mass=10 g:ten_grams.csv'"


@dataclass(frozen=True, kw_only=True)
class KnownLoad:
    """A load whose impedance is known.

    Attributes
    ----------
    name : str
        As it was given.
    form : str
        Of :data:`.quantities.FORMS`; empty for no load.
    value : float
        In SI units of the form.
    unit : str
        Unit of its impedance; empty for no load.
    file : Path
        Of the run.
    """

    name: str
    form: str = ""
    value: float = 0.0
    unit: str = ""
    file: Path

    @property
    def same_as(self) -> tuple[str, float]:
        """Equal for runs with one load."""
        return self.form, self.value

    def impedance(self, frequency_hz: FloatArray) -> ComplexArray:
        """Impedance in `unit`, shape (F,)."""
        power = {"apparent mass": 1, "impedance": 0, "dynamic stiffness": -1}.get(self.form, 0)
        return np.asarray(self.value * (2j * np.pi * frequency_hz) ** power)


def known_load(text: str) -> KnownLoad:
    """A load and its run from ``LOAD:FILE``.

    Raises
    ------
    InputError
        If it is not of this kind, or the value is not above zero.
    """
    load, colon, file = text.partition(":")
    word, equals, value = load.partition("=")
    word = word.strip().lower()
    if not colon or not file.strip():
        raise InputError(f"--known-load {shown(text)} names no file; {_EXAMPLE}")
    if word == OPEN and not equals:
        return KnownLoad(name=OPEN, file=Path(file))
    if word not in _FORMS:
        raise InputError(f"--known-load {shown(text)} is no load; {hint(word, (OPEN, *_FORMS))}")
    match = _VALUE.fullmatch(value.strip())
    try:
        number = float(match[1]) if match else 0.0
    except ValueError:
        number = 0.0
    if match is None or not 0 < number < float("inf"):
        raise InputError(f"--known-load {shown(text)} has no value above zero with a unit; {_EXAMPLE}")
    response = response_of(match[2], f"--known-load {shown(text)}", _FORMS[word])
    return KnownLoad(
        name=" ".join(load.split()), form=response.form, value=number * response.factor, unit=response.unit,
        file=Path(file),
    )  # fmt: skip
