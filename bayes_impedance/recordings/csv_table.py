"""CSV tables: bytes to named columns, with the spreadsheet row of every invalid cell.

The standard library's `csv` reads 85 000 rows in a tenth of a second and counts rows, as the messages need; no other
import is needed to reject a file. Checks are array operations; a loop over cells is used only to find the invalid
cell.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.categories import DECIMAL_COMMA, MISSING_CELLS, indicators_of, is_categorical
from bayes_impedance.runtime.input_files import decode
from bayes_impedance.runtime.user_table import shown

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
ComplexArray = npt.NDArray[np.complex128]
Cells = npt.NDArray[Any]

_FEWEST_ROWS = 8
"""Fewest rows above the last one, the header included, by whose cells the length of its last cell is judged. By choice:
lengths of fewer numbers vary by chance."""
_SEPARATOR_NAMES = {";": "semicolons", "\t": "tabs", "|": "bars"}


@dataclass(frozen=True)
class Table:
    """Cells of a file by column, blank rows left out.

    Attributes
    ----------
    file : str
        Name to use in messages.
    columns : dict of str to ndarray of str, shape (N,)
        Cells by column name; names have no surrounding space. Where the file has numbers, ndarray of numbers.
    row : ndarray of int, shape (N,)
        Spreadsheet row of each record; the header is row 1.
    """

    file: str
    columns: dict[str, Cells]
    row: IntArray


def parse_csv(data: bytes, file: str, known: Collection[str], or_else: str = "") -> Table:
    """Split a CSV file into named columns.

    Parameters
    ----------
    data : bytes
        Uncompressed content: UTF-8, comma-separated, column names in the first row.
    file : str
        Name to use in messages.
    known : collection of str
        Column names, in lower case, that are recognised in upper case too; other names are kept as they are.
    or_else : str
        Another remedy, the end of a sentence, for a table with another separator.

    Returns
    -------
    Table
        Its columns; blank rows are left out, the others keep their row number.

    Raises
    ------
    InputError
        If the file is empty, not comma-separated text, has no header or no data, or a row is of another length.
    """
    reader = csv.reader(io.StringIO(decode(data, file), newline=""), strict=True, skipinitialspace=True)
    records: list[list[str]] = []
    try:
        records.extend(reader)
    except csv.Error as error:
        if "field limit" in str(error):
            raise InputError(
                f"{file}, row {len(records) + 1}: a cell has more than {csv.field_size_limit()} characters; "
                "look for a quotation mark that is never closed, or another kind of file"
            ) from error
        raise InputError(
            f"{file}, row {len(records) + 1}: the quotation marks do not match ({error}); correct the row"
        ) from error
    if not any(records):
        raise InputError(f"{file}: the file is empty; it needs a row of column names and rows of data")
    header = [cell.strip() for cell in records[0]]
    header = [name.lower() if name.lower() in known else name for name in header]
    _check_header(header, records, file, or_else)
    width = np.fromiter(map(len, records), dtype=np.int64, count=len(records))
    _check_end(records, width, len(header), data[-1:] in (b"\n", b"\r"), file)
    _check_width(width, len(header), file)
    row = np.flatnonzero(width)[1:]
    cells = np.array([records[i] for i in row], dtype=object).reshape(row.size, len(header))
    filled = ~(cells == "").all(axis=1)
    if not filled.any():
        raise InputError(f"{file}: there are column names but no rows of data; add the data below row 1")
    columns = {name: cells[filled, i] for i, name in enumerate(header) if name}
    return Table(file, columns, row[filled] + 1)


def table_of(columns: Sequence[tuple[str, Cells]], file: str, known: Collection[str]) -> Table:
    """A table from columns of str or of numbers that are already separate; errors are those of `parse_csv`."""
    header = [name.strip() for name, _ in columns]
    header = [name.lower() if name.lower() in known else name for name in header]
    if not header:
        raise InputError(f"{file}: the file is empty; it needs columns and rows of data")
    _check_header(header, [], file)
    filled = np.zeros(len(columns[0][1]), dtype=bool)
    for _, cells in columns:
        filled |= cells != "" if cells.dtype == object else ~np.isnan(cells)
    if not filled.any():
        raise InputError(f"{file}: there are columns but no rows of data; add the data, or delete the file")
    row = np.flatnonzero(filled)
    return Table(file, {name: c[row] for name, (_, c) in zip(header, columns, strict=True) if name}, row + 2)


def _check_header(header: list[str], records: list[list[str]], file: str, or_else: str = "") -> None:
    """Refuse a first row that does not hold column names separated by commas."""
    if not any(header):
        raise InputError(f"{file}, row 1: the row is empty; put the column names into row 1")
    for separator, name in _SEPARATOR_NAMES.items():
        if any(separator in cell for cell in header):
            comma = any(re.search(r"\d,\d", ",".join(record)) for record in records[1:3])
            decimal = " and decimal commas to decimal points" if comma else ""
            raise InputError(
                f"{file}, row 1: the columns are separated by {name}; change the separator to commas{decimal}{or_else}"
            )
    if any(_is_number(cell) for cell in header):
        raise InputError(
            f"{file}, row 1: {shown(next(filter(_is_number, header)))} is a number and not a column name; "
            "insert a row of column names above the data"
        )
    named = [name for name in header if name]
    for name in named:
        if named.count(name) > 1:
            raise InputError(f'{file}, row 1: column "{name}" appears twice; rename or delete one of the two')


def _check_end(records: list[list[str]], width: IntArray, expected: int, ended: bool, file: str) -> None:
    """Refuse a last row that is shorter than all others, as of a file that was cut.

    Parameters
    ----------
    records : list of list of str
    width : ndarray of int
        Cells of each.
    expected : int
        Columns.
    ended : bool
        Whether the last line has an end.
    file : str
        Name to use in messages.
    """
    *others, last = np.flatnonzero(width).tolist()
    remedy = "the file is cut short: export or copy it again, complete the row, or delete it"
    # If other rows are short, too, the file was not cut but written so, and the first of them is named.
    if others and width[last] < expected and np.all(width[others] == expected):
        raise InputError(f"{file}, row {last + 1}: the last row has only {width[last]} of {expected} cells; {remedy}")
    if ended or len(others) < _FEWEST_ROWS or width[last] != expected:
        return
    final = records[last][-1]
    least = min(len(records[i][-1]) for i in others[1:])
    if least and len(final) <= least / 2:
        said = f"the last cell is {shown(final)}" if final else "the last cell is empty"
        raise InputError(
            f"{file}, row {last + 1}: {said}, without an end of the line, and all above are longer; {remedy}"
        )


def _check_width(width: IntArray, expected: int, file: str) -> None:
    """Refuse rows with more or fewer cells than the header; a row without any cell is a blank line."""
    wrong = np.flatnonzero((width != expected) & (width > 0))
    if wrong.size:
        first = int(wrong[0])
        remedy = (
            "remove the surplus commas (decimal commas look like this too: write decimal points)"
            if width[first] > expected
            else "add the missing cells, or delete the row"
        )
        raise InputError(f"{file}, row {first + 1}: there are {width[first]} cells but {expected} columns; {remedy}")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return cell.strip().lower() not in ("nan", "inf", "infinity")


def names(table: Table, column: str) -> Cells:
    """Return a column of names, as they are written (leading zeros stay) but without surrounding space.

    Returns
    -------
    ndarray of str, shape (N,)

    Raises
    ------
    InputError
        If a name is missing or contains a control character.
    """
    cells, given = np.empty(table.row.size, dtype=object), table.columns[column]
    if given.dtype != object:
        given = np.array(["" if value != value else str(value) for value in given.tolist()], dtype=object)
    cells[:] = list(map(str.strip, given))
    empty = np.flatnonzero(cells == "")
    if empty.size:
        raise InputError(
            f"{table.file}, row {table.row[empty[0]]}: {column} is empty; give the name, or delete the row"
        )
    # Each distinct name is checked once: there are few of them in many rows.
    for name in dict.fromkeys(cells):
        if has_control_character(name):
            row = table.row[np.flatnonzero(cells == name)[0]]
            raise InputError(
                f"{table.file}, row {row}: {column} {name!r} contains a line break or control character; remove it"
            )
    return cells


def has_control_character(name: str) -> bool:
    """Tell whether a name contains a line break, a tab or another control character."""
    return any(ord(character) < 32 or ord(character) == 127 for character in name)


def numbers(table: Table, column: str) -> FloatArray:
    """Return a column of numbers; cells without a value, and infinities, become NaN.

    Returns
    -------
    ndarray of float, shape (N,)

    Raises
    ------
    InputError
        If a cell holds text that is neither a number nor one of the signs for "no value".
    """
    cells = table.columns[column]
    values: FloatArray
    try:
        if cells.dtype != object:
            return np.where(np.isfinite(cells), cells, np.nan).astype(np.float64)
        # Python's float also reads 1_000, which no other program means as a number.
        if "_" in "".join(cells):
            raise ValueError
        values = cells.astype(np.float64)
    except ValueError:
        values = np.array([_number(cell, table, column, i) for i, cell in enumerate(cells)])
    return np.where(np.isfinite(values), values, np.nan)


def _number(cell: str, table: Table, column: str, index: int) -> float:
    """Return the value of one cell, NaN where it is empty; the slow path of `numbers`."""
    text = cell.strip()
    if text.lower() in MISSING_CELLS:
        return float("nan")
    try:
        if "_" in text:
            raise ValueError
        return float(text)
    except ValueError:
        where = f"{table.file}, row {table.row[index]}: {column} is {shown(text)}"
    if DECIMAL_COMMA.fullmatch(text):
        raise InputError(f"{where}, which has a decimal comma; write decimal points in the whole file")
    raise InputError(f"{where}, which is not a number; correct it, or leave the cell empty where there is no value")


def encode(cells: Cells) -> tuple[tuple[str, ...], IntArray]:
    """Give each name in a column a number, in the order in which they appear.

    Returns
    -------
    names : tuple of str
        The different names.
    code : ndarray of int, shape (N,)
        Index into `names`.
    """
    index = {name: i for i, name in enumerate(dict.fromkeys(cells))}
    return tuple(index), np.fromiter(map(index.__getitem__, cells), dtype=np.int64, count=cells.size)


@dataclass(frozen=True)
class CovariateTable:
    """Covariates by subject, as read from subjects.csv.

    Attributes
    ----------
    values : dict of str to dict of str to float
        Subject to covariate name to value; NaN where the cell is empty.
    covariates : tuple of str
        Names of the columns besides `subject`.
    warnings : tuple of str
    """

    values: dict[str, dict[str, float]]
    covariates: tuple[str, ...]
    warnings: tuple[str, ...]


def parse_covariates(data: bytes, file: str) -> CovariateTable:
    """Read a table of covariates: a column `subject`, columns of numbers, and columns of text, which are categories.

    Raises
    ------
    InputError
        If `subject` is missing, empty or repeated, or a covariate is not a number.
    """
    table = parse_csv(data, file, ("subject",))
    if "subject" not in table.columns:
        raise InputError(
            f'{file}, row 1: column "subject" is missing (found: {", ".join(table.columns)}); '
            "add it, with the names used in the recordings"
        )
    subject = names(table, "subject")
    different, code = encode(subject)
    if len(different) < subject.size:
        first = np.unique(code, return_index=True)[1]
        again = int(np.setdiff1d(np.arange(subject.size), first)[0])
        raise InputError(
            f'{file}, row {table.row[again]}: subject "{subject[again]}" appears twice; keep one row for each subject'
        )
    columns, warnings = columns_of_values(table, ("subject",), "subjects")
    covariates = tuple(columns)
    values = {str(who): {name: float(columns[name][i]) for name in covariates} for i, who in enumerate(subject)}
    return CovariateTable(values, covariates, warnings)


def columns_of_values(table: Table, keys: Sequence[str], rows: str) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """All columns besides the keys as numbers, those of text as categories; and what is to be said of them.

    Parameters
    ----------
    table : Table
    keys : sequence of str
        Columns of names.
    rows : str
        What the rows are, for messages.

    Raises
    ------
    InputError
        If a cell of a column of numbers is not a number.
    """
    columns: dict[str, FloatArray] = {}
    categorical: list[str] = []
    for name in table.columns:
        if name not in keys and not is_categorical(table.columns[name]):
            columns[name] = numbers(table, name)
        elif name not in keys:
            indicators, said = indicators_of(name, table.columns[name])
            columns |= {key: values for key, values in indicators.items() if key not in table.columns}
            categorical.append(f"{table.file}: {said}")
    return columns, tuple(categorical) + tuple(
        f"{table.file}: {name} is missing for {int(np.isnan(column).sum())} of {table.row.size} {rows}, "
        f"the first in row {table.row[np.flatnonzero(np.isnan(column))[0]]}"
        for name, column in columns.items()
        if np.isnan(column).any()
    )
