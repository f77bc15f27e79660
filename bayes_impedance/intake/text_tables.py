"""Tables of text as instruments and spreadsheets write them: any separator, decimal comma, encoding, with a preamble.

Such a file has a preamble of unknown length, a line with the names of the columns, perhaps one with their units, and
the numbers. The separator is the one with which most cells of the lines are numbers; with a comma inside the cells the
decimal mark is a comma. The numbers begin with the longest run of lines of equal width in the beginning of the file;
names are in the last line before it, or in the last comment of the same width. All of it can be given instead.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Array, Contents, Variable
from bayes_impedance.intake.quantities import channel_of, hertz_factor, is_response_unit, radian_factor
from bayes_impedance.runtime.user_table import shown
from bayes_impedance.units import counted

SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ",", "bar": "|", "space": " "}
_COMMENTS = ("#", "%", "!", "//", "'")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?$")
_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?$")
_COMPLEX = re.compile(r"\(?[+-]?[\d.]+(?:[eE][+-]?\d+)?\s*[+-]\s*[\d.]+(?:[eE][+-]?\d+)?\s*\*?[ij]\)?$")
_WIDE = re.compile(r"\t|[ ]{2,}")
"""Between names that are set in columns above rows with another separator, as Z60W and Autolab write them."""
_BEGINNING = 1000
"""Lines in which the table must begin. By choice: headers of instruments have a hundred."""
_SAMPLED = 2**16
"""Characters by which a binary file is told from text."""
_FEWEST_ROWS = 10
"""Rows from which the length of the last cell says that a file ends in the middle of a number. By choice."""
_LOOKED_AT = 30
"""Lines by which the separator is judged."""
Splitter = Callable[[str], list[str]]
_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


@dataclass(frozen=True, kw_only=True)
class TableFormat:
    """How a table is written; what is None is found out.

    Attributes
    ----------
    separator : str or None
        A word of :data:`SEPARATORS`.
    decimal : str or None
        ``.`` or ``,``.
    encoding : str or None
    of_words : bool
        The first row has the names of the columns, and cells may all be words.
    """

    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    of_words: bool = False


def decoded(data: bytes, file: str, encoding: str | None = None) -> tuple[str, tuple[str, ...]]:
    """Text of a file, and a note if its encoding was guessed.

    Raises
    ------
    InputError
        If it is no text.
    """
    marked = next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    for name in (encoding or marked or "utf-8", "cp1252", "latin-1"):
        try:
            text = data.decode(name)
        except LookupError:
            raise InputError(f"{file}: encoding {shown(name)} is unknown; write for instance cp1252") from None
        except UnicodeError:
            if encoding or marked:
                raise InputError(
                    f"{file}: the text is not {name}; if the file was cut, copy it again, else name its encoding with "
                    "--encoding"
                ) from None
            continue
        break
    beginning = text[:_SAMPLED]
    if sum(beginning.count(chr(c)) for c in (*range(9), *range(14, 27))) > len(beginning) / 1000:
        raise InputError(
            f"{file}: this is a binary file, of a kind that is not known by its name; export the data as CSV, or give "
            "the file the suffix of its kind"
        )
    return text, (f"{file}: read as {name}, because it is not UTF-8",) if name in ("cp1252", "latin-1") else ()


def read_text_table(data: bytes, file: str, how: TableFormat | None = None) -> Contents:
    """Split the text of a table into variables.

    Parameters
    ----------
    data : bytes
    file : str
        Name to use in messages.
    how : TableFormat, optional

    Raises
    ------
    InputError
        If the file is empty or no text, has no rows of numbers, or a row of another length.
    """
    how = how or TableFormat()
    text, notes = decoded(data, file, how.encoding)
    if not text.strip():
        raise InputError(f"{file}: the file is empty; it needs a row of column names and rows of numbers")
    lines = text.splitlines()
    name = how.separator or (_separator_of_names(lines) if how.of_words else _separator(lines))
    split = _splitter(SEPARATORS[name], '"' in text)
    first = _second_filled(lines, file) if how.of_words else _first_row(lines, split, file)
    width = len(split(lines[first]))
    columns, rows = _columns(lines, first, width, split, SEPARATORS[name], file)
    if not text.endswith(("\n", "\r")):
        notes += cut_short(columns[-1], f"{file}, row {rows[-1]}")
    decimal = how.decimal or _decimal(columns, file)
    empty = len(list(itertools.takewhile(lambda column: not any(column), reversed(columns))))
    header, units = _header(lines[:first], width, split, empty)
    names = [] if header is not None else [len(split(line)) for line in lines[:first]]
    if any(1 < count < width for count in names):  # numbers are two cells, surely so if all of them are
        for line in lines[first : first + _LOOKED_AT]:
            _require_points(lines[first], line, split, file, whole=any(2 * count == width for count in names))
    kept = [i for i in range(width) if header is None or header[i] or any(columns[i])]
    variables = []
    for i in kept:
        label = header[i] if header is not None and header[i] else f"column {i + 1}"
        variables.append(Variable(name=label, values=_values(columns[i], decimal), unit=units[i], cells=columns[i]))
    if decimal == ",":
        notes += (f"{file}: decimal commas were read",)
    return Contents(file=file, variables=tuple(variables), rows=rows, decimal=decimal, notes=notes)


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.match(cell) or _COMMA_NUMBER.match(cell) or _COMPLEX.match(cell))


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENTS)


def _splitter(separator: str, quoted: bool) -> Splitter:
    """Function from a line to its cells."""

    def cells(line: str) -> list[str]:
        if separator == " ":
            return line.split()
        if quoted and '"' in line:
            found = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        else:
            found = line.split(separator)
        return [cell.strip() for cell in found]

    return cells


def _separator(lines: Sequence[str]) -> str:
    """The separator with which the largest share of cells are numbers, of those the one with most cells."""
    filled = (line for line in reversed(lines) if line.strip() and not _is_comment(line))
    middle = [line for line in itertools.islice(filled, _LOOKED_AT) if any(c.isdigit() for c in line)]
    best, chosen = (-1.0, 0), "comma"
    for name, separator in SEPARATORS.items():
        split = _splitter(separator, any('"' in line for line in middle))
        cells = [cell for line in middle for cell in split(line) if cell]
        number = sum(map(_is_number, cells))
        score = (number / max(len(cells), 1), number)
        if number and score > best:
            best, chosen = score, name
    return chosen


def _separator_of_names(lines: Sequence[str]) -> str:
    """The separator that the first row has most often; blanks are a part of names."""
    names = next(line for line in lines if line.strip())
    return max(("comma", "semicolon", "tab", "bar"), key=lambda name: names.count(SEPARATORS[name]))


def _second_filled(lines: Sequence[str], file: str) -> int:
    filled = [i for i, line in enumerate(lines) if line.strip()]
    if len(filled) < 2:
        raise InputError(f"{file}: there are column names but no rows below them; add one row for each subject")
    return filled[1]


def _first_row(lines: Sequence[str], split: Splitter, file: str) -> int:
    """Line (from 0) with which the longest run of rows of numbers of equal width begins."""
    best, start, run, width = 0, -1, 0, -1
    for i, line in enumerate(lines[:_BEGINNING]):
        cells = split(line)
        if not line.strip() or _is_comment(line):
            continue
        numeric = sum(map(_is_number, cells)) >= min(2, len(cells))
        if numeric and len(cells) == width:
            run += 1
        elif numeric:
            run, width, begin = 1, len(cells), i
        else:
            run, width = 0, -1
        # A run that begins later must be longer by far: a row cut short in the middle begins another one.
        if numeric and (run > 2 * best or begin == start):
            best, start = run, begin
    if start < 0:
        raise InputError(
            f"{file}: there are no rows of numbers in it; it needs a row of column names and, below, rows of numbers"
        )
    above = next((i for i in range(start - 1, -1, -1) if lines[i].strip() and not _is_comment(lines[i])), None)
    if above is not None:
        cells, below = split(lines[above]), len(split(lines[start]))
        if len(cells) > 1 and all(map(_is_number, cells)):
            _require_points(lines[above], lines[start], split, file)
            raise InputError(
                f"{file}, row {above + 1}: there are {len(cells)} cells, but {below} in the rows below; correct the row"
            )
    return start


def _columns(
    lines: Sequence[str], first: int, width: int, split: Splitter, separator: str, file: str
) -> tuple[list[tuple[str, ...]], npt.NDArray[np.int64]]:
    """Cells of all columns of the table, and the line of each row."""
    block = lines[first:]
    while block and not block[-1].strip():
        block = block[:-1]
    joined = "\n".join(block)
    # Long signals: all rows at once, if nothing needs a closer look.
    plain = separator != " " and not any(mark in joined for mark in ('"', "\n\n", *_COMMENTS))
    if plain and all(line.count(separator) == width - 1 for line in block):
        cells = joined.replace(separator, "\n").split("\n")
        return [tuple(cells[i::width]) for i in range(width)], first + 1 + np.arange(len(block))
    records: list[list[str]] = []
    rows: list[int] = []
    for i in range(first, len(lines)):
        line = lines[i]
        if not line.strip():
            continue
        cells = split(line)
        if len(cells) != width:
            if _is_comment(line):
                continue
            _require_points(lines[first], line, split, file)
            last = not any(rest.strip() for rest in lines[i + 1 :])
            cause = "the file is cut short: copy it again, or delete the row" if last else "correct the row"
            there = f"there {'is' if len(cells) == 1 else 'are'} {counted(len(cells), 'cell')}"
            raise InputError(f"{file}, row {i + 1}: {there}, but {width} in the rows above; {cause}")
        records.append(cells)
        rows.append(i + 1)
    return list(zip(*records, strict=True)), np.array(rows)


def _require_points(one: str, other: str, split: Splitter, file: str, *, whole: bool = True) -> None:
    """Refuse decimal commas beside commas between columns, in two rows whose numbers of cells are not right.

    They are of numbers alone (`whole`), or a cell is nothing but digits behind a decimal mark, which may begin with a
    zero before other digits.
    """
    cells = [*split(one), *split(other)]
    parts = (whole and all(map(_is_number, cells))) or any(re.fullmatch(r"0\d+", cell) for cell in cells)
    if one.count(",") == len(split(one)) - 1 and not any("." in cell for cell in cells) and parts:
        raise InputError(
            f"{file}: there seem to be decimal commas, and commas between the columns too, which cannot be told apart; "
            "export with semicolons or tabs between the columns, or with decimal points"
        )


def cut_short(cells: Sequence[str], where: str) -> tuple[str, ...]:
    """A remark if a file seems to end in the middle of a number, or an error if it surely does.

    Parameters
    ----------
    cells : sequence of str
        The last column of a text that has no end of the line after its last cell.
    where : str
        File and last row, for the message.

    Raises
    ------
    InputError
    """
    *others, last = map(len, cells)
    *places, own = map(_decimals, cells)
    if len(others) < _FEWEST_ROWS:
        return ()
    if own < min(places) == max(places):
        raise InputError(
            f"{where}: the file ends with {shown(cells[-1])}, without an end of the line, and all numbers above have "
            f"{places[0][0]} decimals: it is cut short; copy it again, or delete the row"
        )
    if last >= min(others):
        return ()
    said = (
        f"{where}: the file ends with {shown(cells[-1])}, without an end of the line, and all numbers above are longer"
    )
    if last <= min(others) / 2:
        raise InputError(f"{said}: it is cut short; copy it again, or delete the row")
    return (f"{said}: it may be cut short",)


def _decimals(cell: str) -> tuple[int, bool]:
    """Digits behind the decimal mark of a number, and whether it has an exponent."""
    mantissa, _, exponent = cell.strip().lower().partition("e")
    return len(re.split("[.,]", mantissa)[-1]) if re.search("[.,]", mantissa) else 0, bool(exponent)


def _decimal(columns: Sequence[Sequence[str]], file: str) -> str:
    sample = [cell.strip() for column in columns for cell in column[:_BEGINNING]]
    comma = [cell for cell in sample if _COMMA_NUMBER.match(cell)]
    point = [cell for cell in sample if "." in cell and _NUMBER.match(cell)]
    if comma and point:
        raise InputError(
            f"{file}: {shown(comma[0])} has a comma and {shown(point[0])} has a point, so that the decimal mark is not "
            "clear; give it with --decimal"
        )
    return "," if comma else "."


def _header(above: Sequence[str], width: int, split: Splitter, empty: int) -> tuple[list[str] | None, list[str]]:
    """Names and units of the columns from the lines above the numbers; no names if there are none.

    The names may be without those of the last columns, if these are empty: rows then end with the separator.
    """
    blank = [""] * width
    filled = [line for line in above if line.strip()]
    candidates = []
    for line in reversed(filled[-20:]):
        cells = split(line)
        if len(cells) != width and _is_comment(line):
            cells = split(line.lstrip().lstrip("#%!/'").strip())
        if len(cells) > width and not any(cells[width:]):  # BioLogic ends the line of names alone with a tab
            cells = cells[:width]
        if 1 < len(cells) < width <= len(cells) + empty:
            cells += [""] * (width - len(cells))
        if len(cells) == width and any(cells) and not all(map(_is_number, filter(None, cells))):
            candidates.append([cell.strip().strip('"').lstrip("#%!").strip() for cell in cells])
        if len(candidates) == 2:
            break
    if not candidates and filled:
        cells = [cell.strip() for cell in _WIDE.split(filled[-1].strip().strip('"').strip())]
        if len(cells) == width > 1 and not any(map(_is_number, cells)):
            candidates.append(cells)
    if not candidates:
        return None, blank
    if len(candidates) > 1 and _are_units(candidates[0]):
        return candidates[1], [_unit_of_cell(cell) for cell in candidates[0]]
    return candidates[0], blank


def _unit_of_cell(cell: str) -> str:
    return cell.strip("()[]")


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any quantity that a recording can have."""
    return bool(
        text == "dB"
        or is_response_unit(text)
        or hertz_factor(text) is not None
        or radian_factor(text) is not None
        or channel_of(text) is not None
        or text == "s"
    )


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a line holds units: more than half of its cells, which are not names of columns as well."""
    filled = [_unit_of_cell(cell) for cell in cells if cell]
    return sum(map(is_unit, filled)) > len(filled) / 2


def _values(cells: Sequence[str], decimal: str) -> Array:
    """Numbers if all cells are, which is the fast way; else the cells."""
    try:
        joined = "\n".join(cells)
        if "_" in joined:
            raise ValueError
        return np.array((joined.replace(",", ".") if decimal == "," else joined).split("\n"), dtype=np.float64)
    except ValueError:
        return np.array([cell.strip() for cell in cells], dtype=object)
