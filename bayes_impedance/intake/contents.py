"""What a file holds, whatever its format: named variables with units, not yet with a meaning."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import hint, shown

Array = npt.NDArray[Any]

_MISSING = frozenset({"", "-", "na", "n/a", "#n/a", "nan", "null", "none", "inf", "-inf", "infinity"})


@dataclass(frozen=True, eq=False, kw_only=True)
class Variable:
    """One column or array of a file.

    Attributes
    ----------
    name : str
    values : ndarray, shape (N,)
        Real or complex numbers, or text (dtype object).
    unit : str
        As the file writes it; empty if it gives none.
    rate_hz : float or None
        Sampling rate, if the file gives one.
    cells : tuple of str or None
        The text of each value, where the file is text: names keep their leading zeros.
    """

    name: str
    values: Array
    unit: str = ""
    rate_hz: float | None = None
    cells: tuple[str, ...] | None = None

    @property
    def is_text(self) -> bool:
        """Whether the values are cells of text."""
        return self.values.dtype == object


@dataclass(frozen=True, eq=False, kw_only=True)
class Contents:
    """The variables of one file, or of one record of a file with several.

    Attributes
    ----------
    file : str
        Name to use in messages.
    variables : tuple of Variable
    part : str
        Name of the record in the file; empty if it is the only one.
    rows : ndarray of int, shape (N,), or None
        Line of the file of each value, of tables of text.
    decimal : str
        Decimal mark of cells of text.
    notes : tuple of str
        What was guessed or left out.
    facts : dict of str to str
        What else the file says of the recording.
    """

    file: str
    variables: tuple[Variable, ...]
    part: str = ""
    rows: Array | None = None
    decimal: str = "."
    notes: tuple[str, ...] = ()
    facts: dict[str, str] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return tuple(variable.name for variable in self.variables)

    def variable(self, name: str, option: str) -> Variable:
        """A variable by its name, in the file's or another case, or by its number, counted from 1.

        Raises
        ------
        InputError
            If there is none, or several; `option` names what asked for it.
        """
        exact = [v for v in self.variables if v.name == name]
        found = exact or [v for v in self.variables if v.name.casefold() == name.strip().casefold()]
        if not found and name.isdecimal() and 1 <= int(name[:6]) <= len(self.variables):
            found = [self.variables[int(name) - 1]]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(
                f"{self.file}: {option} names {shown(name)}, of which there are {len(found)}; give the number of the "
                "column, counted from 1"
            )
        raise InputError(
            f"{self.file}: {option} names {shown(name)}, but there is no such column; {hint(name, self.names[:30])}"
        )

    def numbers(self, variable: Variable) -> npt.NDArray[np.float64]:
        """Values as real numbers, NaN where there is none.

        Raises
        ------
        InputError
            If a cell is no number; the message names its row.
        """
        if not variable.is_text:
            if np.iscomplexobj(variable.values):
                raise InputError(f"{self.file}: {shown(variable.name)} is complex; say --columns complex=NAME")
            return np.asarray(variable.values, dtype=np.float64)
        return np.array([self._number(variable, i, float) for i in range(variable.values.size)], dtype=np.float64)

    def complex_numbers(self, variable: Variable) -> npt.NDArray[np.complex128]:
        """Values as complex numbers, of cells such as ``1.5-0.2i`` too."""
        if not variable.is_text:
            return np.asarray(variable.values, dtype=np.complex128)
        return np.array([self._number(variable, i, complex) for i in range(variable.values.size)], dtype=np.complex128)

    def texts(self, variable: Variable) -> list[str]:
        """Values as names; a whole number has no decimals."""
        if variable.cells is not None or variable.is_text:
            return [str(cell).strip() for cell in (variable.cells or variable.values)]
        return [f"{value:.15g}" for value in np.asarray(variable.values, dtype=np.float64)]

    def where(self, index: int) -> str:
        """File and row of a value, for messages."""
        return self.file if self.rows is None else f"{self.file}, row {self.rows[index]}"

    def _number(self, variable: Variable, index: int, kind: type[Any]) -> Any:
        text = str(variable.values[index]).strip()
        plain = text.replace(",", ".") if self.decimal == "," else text
        if kind is complex:
            plain = plain.replace(" ", "").replace("i", "j").replace("*j", "j").strip("()")
        try:
            if "_" in plain:
                raise ValueError
            return kind(plain)
        except ValueError:
            if text.lower() in _MISSING:
                return kind("nan")
        raise InputError(
            f"{self.where(index)}: {variable.name} is {shown(text)}, which is not a number; correct it, or leave the "
            "cell empty where there is no value"
        )
