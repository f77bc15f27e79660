"""Excel workbooks (.xlsx) by openpyxl: one sheet as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.optional_libraries import damaged, library
from bayes_impedance.intake.text_tables import TableFormat, read_text_table
from bayes_impedance.recordings.repetitions import MINIMUM_POINTS
from bayes_impedance.runtime.user_table import hint, shown

_LEAST_NUMBERS = 3
"""Fewest numbers in a row of a table of spectra or signals: frequency and two parts, or a time and two channels."""


def read(file: Path, record: str | None) -> list[Contents]:
    """The sheet named by `record`, else the first one, if no other holds numbers too: it may be another person."""
    openpyxl = library("openpyxl", "openpyxl", file)
    try:
        book = openpyxl.load_workbook(file, read_only=True, data_only=True)
    except Exception as error:  # openpyxl passes on whatever zip and XML raise
        raise damaged(file, "a workbook", error) from error
    try:
        if record is not None and record not in book.sheetnames:
            raise InputError(f"{file}: there is no sheet {shown(record)}; {hint(record, book.sheetnames)}")
        rows = _rows(book[record or book.sheetnames[0]])
        others = [] if record is not None else [n for n in book.sheetnames[1:] if _is_table(_rows(book[n]))]
    finally:
        book.close()
    if others and _is_table(rows):
        tables = ", ".join(map(shown, [book.sheetnames[0], *others]))
        raise InputError(
            f"{file}: there are tables of numbers in {1 + len(others)} sheets ({tables}); name one with --record, or "
            "save each as a file of its own"
        )
    # Sheets may have empty columns at the right; a tab cannot be in a cell that has been cleaned.
    width = max((i + 1 for row in rows for i, cell in enumerate(row) if cell), default=0)
    text = "\n".join("\t".join((row + [""] * width)[:width]) if any(row) else "" for row in rows)
    return [read_text_table(text.encode(), str(file), TableFormat(separator="tab", decimal="."))]


def _rows(sheet: Any) -> list[list[str]]:
    return [[_text(value) for value in row] for row in sheet.iter_rows(values_only=True)]


def _is_table(rows: list[list[str]]) -> bool:
    """Whether there are rows of numbers enough for a recording."""
    return sum(sum(map(_is_number, row)) >= _LEAST_NUMBERS for row in rows) >= MINIMUM_POINTS


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _text(value: object) -> str:
    """A cell: numbers with all digits, text in one line."""
    return "" if value is None else repr(value) if isinstance(value, float) else " ".join(str(value).split())
