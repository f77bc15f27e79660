"""What was noted of every repetition: the table ``repetitions.csv`` (contact force, drive level, temperature ...).

Its columns are ``subject``, ``repetition`` and one for each circumstance, of numbers or of text; text is a category, as
among the covariates of the persons (:mod:`.categories`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import FloatArray, Table, columns_of_values, names, parse_csv
from bayes_impedance.recordings.dataset import Subject

KEYS = ("subject", "repetition")

OF_THE_ESTIMATE = frozenset(
    {
        "averages",
        "hits",
        "noise_degrees_of_freedom",
        "periods",
        "periods_averaged",
        "realisations",
        "scatter_of_realisations_over_noise",
        "steps",
    }
    | {f"{kind}_distortion_of_{signal}" for kind in ("odd", "even") for signal in ("force", "motion")}
)
"""Columns in which an import of signals says how it estimated the impedance: they are no circumstances of it."""

_AMPLITUDE = re.compile(
    r"(?<![a-z])(drive|driving|excitation|amplitude|magnitude|stroke|vibration|shaker(?=[^a-z]+(?!id|no|number)[a-z]))"
    r"(?![a-z])"
)
"""Words of the field for how far or how hard a load is moved. A shaker alone is a device, and a number or a name of
one is no level."""
_SWEEP = re.compile("sweep")
"""Column that may say the direction of a sweep."""

_WORD_BEGINS = re.compile(r"(?<=[a-z])(?=[A-Z])")
_LEVELS = frozenset({"full", "half", "high", "large", "low", "max", "medium", "mid", "min", "small", "strong", "weak"})
"""Values of a column of text that are levels. Others, as in ``excitation=sweep``, may be kinds of signals."""


def is_amplitude(name: str) -> bool:
    """Whether a circumstance says, by its name, how far or how hard the load was moved (``drive_level_v``).

    Parameters
    ----------
    name : str
        Of a column of numbers, or ``column=value`` of one of text.
    """
    column, is_text, value = _WORD_BEGINS.sub("_", name).lower().partition("=")
    return _AMPLITUDE.search(column) is not None and (not is_text or value.strip() in _LEVELS)


UP, DOWN = "up", "down"
_DIRECTIONS = {
    UP: frozenset({"up", "upward", "upwards", "ascending", "increasing", "rising"}),
    DOWN: frozenset({"down", "downward", "downwards", "descending", "decreasing", "falling"}),
}
"""Words for the direction of a sweep, towards higher and lower frequencies."""
_OTHER = {UP: DOWN, DOWN: UP}


def sweep_direction(name: str) -> str | None:
    """The direction of a sweep, ``up`` or ``down``, that a circumstance means where it is 1; None if it is none.

    Parameters
    ----------
    name : str
        ``column=value`` of a column of text, as ``sweep_direction=up``.
    """
    column, is_text, value = _WORD_BEGINS.sub("_", name).lower().partition("=")
    if not is_text or not _SWEEP.search(column):
        return None
    return next((direction for direction, words in _DIRECTIONS.items() if value.strip() in words), None)


def sweep_directions(subjects: Sequence[Subject]) -> frozenset[str]:
    """All directions of sweeps that are noted of any repetition."""
    found = set()
    for subject in subjects:
        for name, values in subject.circumstances.items():
            direction = sweep_direction(name)
            if direction is not None:
                found |= {direction} if np.any(values == 1) else set()
                found |= {_OTHER[direction]} if np.any(values == 0) else set()
    return frozenset(found)


def _single_directions(table: Table) -> dict[str, str]:
    """Columns of one direction for all, with it: they are no categories, but say how the sweeps went."""
    values = {name: {str(cell).strip() for cell in cells} for name, cells in table.columns.items()}
    found = {name: next(iter(own)) for name, own in values.items() if len(own) == 1}
    return {name: value for name, value in found.items() if sweep_direction(f"{name}={value}") is not None}


@dataclass(frozen=True)
class CircumstanceTable:
    """Circumstances by subject and repetition, as read from repetitions.csv.

    Attributes
    ----------
    values : dict of (str, str) to dict of str to float
        Subject and repetition to the name of a circumstance to its value; NaN where the cell is empty.
    circumstances : tuple of str
        Names of the columns besides `subject` and `repetition`.
    warnings : tuple of str
    file : str
    """

    values: Mapping[tuple[str, str], Mapping[str, float]] = field(default_factory=dict)
    circumstances: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    file: str = ""

    def of(self, subject: Subject) -> Subject:
        """The subject with the circumstances of its repetitions; NaN where the table has none."""
        if not self.circumstances:
            return subject
        rows = [self.values.get((subject.name, repetition), {}) for repetition in subject.repetitions]
        table: dict[str, FloatArray] = {
            name: np.array([row.get(name, np.nan) for row in rows]) for name in self.circumstances
        }
        return replace(subject, circumstances=table)

    def unmatched(self, subjects: Sequence[Subject]) -> tuple[str, ...]:
        """Warnings of rows without recordings and of recordings without a row."""
        known = {(subject.name, repetition) for subject in subjects for repetition in subject.repetitions}
        told = []
        for pairs, what in (
            (self.values.keys() - known, "there are no recordings of"),
            (known - self.values.keys() if self.values else set(), "has no row for"),
        ):
            if pairs:
                first = min(pairs)
                more = f" and {len(pairs) - 1} more" if len(pairs) > 1 else ""
                told.append(f'{self.file}: {what} subject "{first[0]}", repetition "{first[1]}"{more}')
        return tuple(told)


def parse_circumstances(data: bytes, file: str) -> CircumstanceTable:
    """Read a table of circumstances.

    Raises
    ------
    InputError
        If `subject` or `repetition` is missing or empty, a pair of them is repeated, or a cell of a column of numbers
        is not a number.
    """
    table = parse_csv(data, file, KEYS)
    for key in KEYS:
        if key not in table.columns:
            raise InputError(
                f'{file}, row 1: column "{key}" is missing (found: {", ".join(table.columns)}); '
                "add it, with the names used in the recordings"
            )
    pairs = list(zip(names(table, "subject").tolist(), names(table, "repetition").tolist(), strict=True))
    first: dict[tuple[str, str], int] = {}
    for i, pair in enumerate(pairs):
        if pair in first:
            raise InputError(
                f'{file}, row {table.row[i]}: subject "{pair[0]}", repetition "{pair[1]}" appears twice (first in row '
                f"{table.row[first[pair]]}); keep one row for each repetition"
            )
        first[pair] = i
    directions = _single_directions(table)
    columns, warnings = columns_of_values(table, (*KEYS, *OF_THE_ESTIMATE, *directions), "repetitions")
    columns |= {f"{name}={value}": np.ones(table.row.size) for name, value in directions.items()}
    values = {pair: {name: float(column[i]) for name, column in columns.items()} for i, pair in enumerate(pairs)}
    return CircumstanceTable(values, tuple(columns), warnings, file)


def circumstances_csv(subjects: Sequence[Subject]) -> bytes | None:
    """The circumstances of all repetitions as the table that is read again; None if there are none."""
    import pandas as pd

    kinds = list(dict.fromkeys(name for subject in subjects for name in subject.circumstances))
    if not kinds:
        return None
    rows = [
        [s.name, repetition, *(float(s.circumstances[k][j]) if k in s.circumstances else np.nan for k in kinds)]
        for s in subjects
        for j, repetition in enumerate(s.repetitions)
    ]
    return pd.DataFrame(rows, columns=[*KEYS, *kinds]).to_csv(index=False, lineterminator="\n").encode()
