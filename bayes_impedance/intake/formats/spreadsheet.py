"""Excel workbooks (.xlsx) by openpyxl: one sheet as a table."""

from __future__ import annotations

from pathlib import Path

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.optional_libraries import damaged, library
from bayes_impedance.intake.text_tables import TableFormat, read_text_table
from bayes_impedance.runtime.user_table import hint, shown


def read(file: Path, record: str | None) -> list[Contents]:
    """The sheet named by `record`, else the first one."""
    openpyxl = library("openpyxl", "openpyxl", file)
    try:
        book = openpyxl.load_workbook(file, read_only=True, data_only=True)
    except Exception as error:  # openpyxl passes on whatever zip and XML raise
        raise damaged(file, "a workbook", error) from error
    try:
        if record is not None and record not in book.sheetnames:
            raise InputError(f"{file}: there is no sheet {shown(record)}; {hint(record, book.sheetnames)}")
        sheet = book[record or book.sheetnames[0]]
        rows = [[_text(value) for value in row] for row in sheet.iter_rows(values_only=True)]
    finally:
        book.close()
    # Sheets may have empty columns at the right; a tab cannot be in a cell that has been cleaned.
    width = max((i + 1 for row in rows for i, cell in enumerate(row) if cell), default=0)
    text = "\n".join("\t".join((row + [""] * width)[:width]) if any(row) else "" for row in rows)
    return [read_text_table(text.encode(), str(file), TableFormat(separator="tab", decimal="."))]


def _text(value: object) -> str:
    """A cell: numbers with all digits, text in one line."""
    return "" if value is None else repr(value) if isinstance(value, float) else " ".join(str(value).split())
