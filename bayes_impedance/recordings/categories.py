"""Columns of text among the covariates: categories, as one covariate of 0 and 1 for each value but one.

With the values a, b, c of a column ``x``, the covariates ``x=b`` and ``x=c`` are 1 for those persons and 0 for all
others of known value, so that their coefficients are differences from a, the first in alphabetical order. A column in
which nearly everybody has a value of their own (a name, a remark) is no category, and is left out.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from bayes_impedance.runtime.user_table import shown

#: Cells (lower case) that mean "no value", besides what `float` itself reads as not finite.
MISSING_CELLS = frozenset({"", "-", "na", "n/a", "#n/a", "null", "none"})
DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
MOST_CATEGORIES = 10
"""Categories of a column. By choice: each is a coefficient of every element on which it acts."""
FEWEST_PERSONS = 2
"""Persons for each category, on average. By choice: with fewer a category is the person."""

_WITH_UNIT = re.compile(r"([+-]?\d[\d.,]*(?:[eE][+-]?\d+)?)\s*([^\d\s].*)")
"""A number and what stands behind it."""


def is_categorical(cells: npt.NDArray[Any]) -> bool:
    """Whether a column is of text: more cells are words than numbers.

    If at least half of the cells are numbers, words among them are mistakes; so are decimal commas.
    """
    if cells.dtype != object:
        return False
    filled = _known(cells)
    words = [cell for cell in filled if not _is_number(cell)]
    return len(words) > len(filled) / 2 and not any(DECIMAL_COMMA.fullmatch(cell) for cell in words)


def indicators_of(name: str, cells: npt.NDArray[Any]) -> tuple[dict[str, npt.NDArray[np.float64]], str]:
    """Covariates of a column of text, and what became of it, as a sentence.

    Parameters
    ----------
    name : str
        Of the column.
    cells : ndarray of str, shape (N,)

    Returns
    -------
    covariates : dict of str to ndarray of float, shape (N,)
        NaN where the cell has no value; empty if the column is left out.
    said : str
    """
    filled = _known(cells)
    values = sorted(set(filled))
    if len(values) < 2:
        return {}, f"{name} is {shown(values[0])} for all subjects, and is not used"
    if len(values) > MOST_CATEGORIES or len(filled) < FEWEST_PERSONS * len(values):
        return {}, (
            f"{name} is text with {len(values)} different values for {len(filled)} subjects, and is not used: for a "
            f"category there must be at most {MOST_CATEGORIES}, of {FEWEST_PERSONS} subjects or more on average"
            f"{_numbers_with_unit(filled)}"
        )
    stripped = [str(cell).strip() for cell in cells]
    known = np.array([cell.lower() not in MISSING_CELLS for cell in stripped])
    covariates = {
        f"{name}={value}": np.where(known, np.array([cell == value for cell in stripped], dtype=np.float64), np.nan)
        for value in values[1:]
    }
    told = " and ".join(covariates)
    said = f"{name} is text, and used as category: {told} (1 if so) against {shown(values[0])}"
    return covariates, said + _numbers_with_unit(filled)


def _numbers_with_unit(filled: list[str]) -> str:
    """End of a sentence if all cells are numbers with the same word behind them, as "23 y"; else empty."""
    matches = [_WITH_UNIT.fullmatch(cell) for cell in filled]
    units = {match[2] for match in matches if match}
    if None in matches or len(units) != 1:
        return ""
    return f"; all its cells are numbers with {shown(units.pop())} behind them: leave that out, and it is a number"


def _known(cells: npt.NDArray[Any]) -> list[str]:
    return [text for cell in cells if (text := str(cell).strip()).lower() not in MISSING_CELLS]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell
