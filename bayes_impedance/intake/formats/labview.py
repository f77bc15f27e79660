"""LabVIEW measurement files (.lvm): a header for the file, one for each segment, columns of samples.

A segment begins with the header that names its channels, units, start and step (``X0``, ``Delta_X``, one for each
channel) and ends with the next one; triggered hits are segments. ``Samples`` is the number of rows, or of those that
were there when the header was written, if more have been appended. ``X_Columns`` says whether there is a column of
times: ``No`` or ``One`` (first column; empty in ``No``), or ``Multi`` (one before every channel).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents, Variable
from bayes_impedance.intake.text_tables import cut_short, decoded
from bayes_impedance.runtime.input_files import read_bytes
from bayes_impedance.runtime.user_table import shown

_END = "***End_of_Header***"
_SEPARATORS = {"Tab": "\t", "Comma": ","}


def read(file: Path, record: str | None) -> list[Contents]:
    """One record for each segment."""
    text, notes = decoded(read_bytes(file), str(file))
    lines = text.splitlines()
    if not lines or not lines[0].startswith("LabVIEW Measurement"):
        raise InputError(f"{file}: the first line is not 'LabVIEW Measurement'; give the file the suffix of its kind")
    separator = next((_SEPARATORS.get(line[10:].strip(), "\t") for line in lines[:30] if line[:9] == "Separator"), "\t")
    header: dict[str, str] = {}
    start = 1
    while start < len(lines) and not lines[start].startswith(_END):
        key, _, value = lines[start].partition(separator)
        header[key.strip()] = value.strip()
        start += 1
    decimal = header.get("Decimal_Separator", ".")[:1] or "."
    columns = header.get("X_Columns", "One")
    segments = _segments(lines, start + 1, separator, str(file))
    found = []
    for i, (own, names, first, last) in enumerate(segments):
        _require_rows(own, first, last, str(file))
        if last == len(lines) > first and not text.endswith(("\n", "\r")):
            notes += cut_short([line.rsplit(separator, 1)[-1] for line in lines[first:]], f"{file}, row {last}")
        variables = _variables(own, names, lines[first:last], separator, decimal, columns, str(file), first + 1)
        part = str(i + 1) if len(segments) > 1 else ""
        if record in (None, part):
            found.append(Contents(file=str(file), variables=variables, part=part, notes=notes))
    if not found:
        raise InputError(f"{file}: there is no segment {shown(record)} with samples in it; export it again")
    return found


def _segments(
    lines: list[str], start: int, separator: str, file: str
) -> list[tuple[dict[str, list[str]], list[str], int, int]]:
    """Header, names of columns, and first and last line of the samples of every segment."""
    found, header, i = [], dict[str, list[str]](), start
    while i < len(lines):
        cells = [cell.strip() for cell in lines[i].split(separator)]
        if cells[0] == _END:
            names = [cell.strip() for cell in lines[i + 1].split(separator)] if i + 1 < len(lines) else []
            first = last = i + 2
            while last < len(lines) and not lines[last].startswith("Channels") and lines[last].strip():
                last += 1
            found.append((header, names, first, last))
            header, i = {}, last
            continue
        if cells[0]:
            header[cells[0]] = cells[1:]
        i += 1
    if not found:
        raise InputError(f"{file}: there is no segment of samples in it; export it again")
    return found


def _require_rows(header: dict[str, list[str]], first: int, last: int, file: str) -> None:
    """Refuse a segment with fewer rows than its header says."""
    expected = max((int(cell) for cell in header.get("Samples", []) if re.fullmatch("[0-9]{1,15}", cell)), default=0)
    if last - first < expected:
        raise InputError(
            f"{file}: from row {first + 1} on there are {last - first} rows of samples, but the header above says "
            f"{expected}: the file is cut short; export or copy it again"
        )


def _variables(
    header: dict[str, list[str]],
    names: list[str],
    lines: list[str],
    separator: str,
    decimal: str,
    x_columns: str,
    file: str,
    row: int,
) -> tuple[Variable, ...]:
    """Channels of a segment, of which the first samples are in `row`."""
    where = f"{file}, row {row}"
    channels = [(i, name) for i, name in enumerate(names) if name not in ("", "Comment", "X_Value")]
    if not lines or not channels:
        raise InputError(f"{where}: the segment has no samples; export the file again")
    units = header.get("Y_Unit_Label", [])
    steps = header.get("Delta_X", [])
    found = []
    for k, (i, name) in enumerate(channels):
        text = []
        for j, line in enumerate(lines):
            cells = line.split(separator)
            if len(cells) <= i:
                raise InputError(
                    f"{file}, row {row + j}: there are {len(cells)} cells, but {i + 1} are needed; complete the row, "
                    "or, if the file was cut, export or copy it again"
                )
            text.append(cells[i].strip())
        try:
            values = np.array([cell.replace(decimal, ".") for cell in text if cell], dtype=np.float64)
            step = float(steps[k].replace(decimal, ".")) if k < len(steps) and x_columns != "Multi" else 0.0
        except ValueError:
            raise InputError(f"{where}: {shown(name)} has a cell that is no number; correct it") from None
        unit = units[k] if k < len(units) else ""
        found.append(Variable(name=name, values=values, unit=unit, rate_hz=1 / step if step > 0 else None))
    return tuple(found)
