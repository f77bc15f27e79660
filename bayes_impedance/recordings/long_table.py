"""The checked table of recordings: one row for every subject, repetition and frequency.

Each check is a function that refuses one kind of fault and names the row; none of them changes the data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import (
    ComplexArray,
    FloatArray,
    IntArray,
    Table,
    encode,
    names,
    numbers,
    parse_csv,
)
from bayes_impedance.runtime.user_table import similar
from bayes_impedance.units import HIGHEST_HZ, LARGEST_IMPEDANCE, LOWEST_HZ, SMALLEST_IMPEDANCE

CARTESIAN = ("z_re", "z_im")
POLAR = ("magnitude", "phase_deg")
KNOWN = ("subject", "repetition", "frequency_hz", *CARTESIAN, *POLAR, "noise_sd")
ONLY_REPETITION = "1"
"""Name of the repetition of everybody in a file without a column of repetitions."""
_REMEDY = {
    "subject": "add it, with a name for each person or object measured",
    "repetition": "add it, with 1 in every row if each subject was measured once",
    "frequency_hz": "add it, with the frequency in hertz",
    "z_re": "add it, or give magnitude and phase_deg",
    "z_im": "add it, or give magnitude and phase_deg",
    "magnitude": "add it, or give z_re and z_im",
    "phase_deg": "add it, with the phase in degrees, or give z_re and z_im",
}
OR_IMPORT = ", or make a dataset of another program's file with 'bayes-impedance import'"
"""End of a sentence about a table that has another form."""


@dataclass(frozen=True, kw_only=True)
class RecordingTable:
    """Rows of all recordings, ordered by subject, then repetition, then frequency.

    Attributes
    ----------
    file : str
        Name to use in messages.
    subject_names, repetition_names : tuple of str
        The different names, in the order in which they appear.
    subject, repetition : ndarray of int, shape (N,)
        Indices into the names.
    frequency_hz : ndarray of float, shape (N,)
        Frequency in Hz, above zero.
    z : ndarray of complex, shape (N,)
        Impedance in the file's unit and sign.
    noise_sd : ndarray of float, shape (N,)
        Standard deviation of each of real and imaginary part, in the file's unit; NaN where none is given.
    row : ndarray of int, shape (N,)
        Spreadsheet row.
    polar : bool
        Whether the file gave magnitude and phase.
    warnings : tuple of str
    """

    file: str
    subject_names: tuple[str, ...]
    repetition_names: tuple[str, ...]
    subject: IntArray
    repetition: IntArray
    frequency_hz: FloatArray
    z: ComplexArray
    noise_sd: FloatArray
    row: IntArray
    polar: bool
    warnings: tuple[str, ...]

    def label(self, index: int) -> str:
        """Return "subject "A", repetition "1"" for a row of the table."""
        subject = self.subject_names[self.subject[index]]
        return f'subject "{subject}", repetition "{self.repetition_names[self.repetition[index]]}"'

    def take(self, index: npt.NDArray[np.intp]) -> RecordingTable:
        """Return the rows of given indices, in their order."""
        return replace(
            self,
            subject=self.subject[index],
            repetition=self.repetition[index],
            frequency_hz=self.frequency_hz[index],
            z=self.z[index],
            noise_sd=self.noise_sd[index],
            row=self.row[index],
        )


def parse_recordings(data: bytes, file: str) -> RecordingTable:
    """Read and check a table of recordings.

    Parameters
    ----------
    data : bytes
        Uncompressed CSV with columns `subject, repetition, frequency_hz, z_re, z_im`, or `magnitude, phase_deg` in
        place of the last two, and optionally `noise_sd`. Without `repetition` everybody was measured once.
    file : str
        Name to use in messages.

    Returns
    -------
    RecordingTable
        The usable rows. Rows with a missing or infinite value are dropped and counted in a warning.

    Raises
    ------
    InputError
        If a column is missing, a value is impossible, or the frequencies of one recording repeat or are not sorted.
    """
    return check_cells(parse_csv(data, file, KNOWN, OR_IMPORT))


def check_cells(cells: Table, may_be_empty: bool = False) -> RecordingTable:
    """The checks of :func:`parse_recordings`; a table without any usable row is refused, or empty if it may be."""
    file = cells.file
    value_columns, warnings = _check_columns(cells)
    polar = value_columns == POLAR
    subject_names, subject = encode(names(cells, "subject"))
    if "repetition" in cells.columns:
        repetition_names, repetition = encode(names(cells, "repetition"))
    else:
        repetition_names, repetition = (ONLY_REPETITION,), np.zeros(cells.row.size, dtype=np.int64)
    if polar:
        magnitude = numbers(cells, POLAR[0])
        _refuse(cells, magnitude < 0, lambda i: _magnitude_message(magnitude[i]))
    z, noise_sd = values(cells, polar)
    frequency_hz = numbers(cells, "frequency_hz")
    _refuse(
        cells,
        frequency_hz <= 0,
        lambda i: f"frequency_hz is {frequency_hz[i]:g}, but must be above zero; correct or delete the row",
    )
    _refuse(
        cells,
        noise_sd <= 0,
        lambda i: f"noise_sd is {noise_sd[i]:g}, but must be above zero; correct it or leave the column out",
    )
    _check_sizes(cells, z, noise_sd, frequency_hz)
    table = RecordingTable(
        file=file,
        subject_names=subject_names,
        repetition_names=repetition_names,
        subject=subject,
        repetition=repetition,
        frequency_hz=frequency_hz,
        z=z,
        noise_sd=noise_sd,
        row=cells.row,
        polar=polar,
        warnings=warnings,
    )
    table = _drop_incomplete(table, may_be_empty)
    # A stable sort keeps the file's order of frequencies, which is checked below.
    table = table.take(np.lexsort((table.repetition, table.subject)))
    _check_duplicates(table)
    _check_sorted(table)
    return table


def _check_sizes(cells: Table, z: ComplexArray, noise_sd: FloatArray, frequency_hz: FloatArray) -> None:
    """Refuse impossible values of impedance, noise or frequency."""
    with np.errstate(over="ignore"):
        size = np.hypot(z.real, z.imag)
    for name, number, low, high in (
        ("|z|", size, SMALLEST_IMPEDANCE, LARGEST_IMPEDANCE),
        ("noise_sd", noise_sd, SMALLEST_IMPEDANCE, LARGEST_IMPEDANCE),
        ("frequency_hz", frequency_hz, LOWEST_HZ, HIGHEST_HZ),
    ):
        wrong = (number < low) | (number > high)
        if not wrong.any():
            continue
        value = number[int(np.argmax(wrong))]
        told = "z is exactly 0" if name == "|z|" and value == 0 else f"{name} is {value:g}"
        more = f" (and so are {int(wrong.sum()) - 1} more rows)" if wrong.sum() > 1 else ""
        message = (
            f"{told}, which cannot be a measured value{more}; leave the cells empty where there is no value, or delete "
            "the row"
        )
        _refuse(cells, wrong, lambda _, message=message: message)  # type: ignore[misc]


def values(cells: Table, polar: bool) -> tuple[ComplexArray, FloatArray]:
    """Impedance in the file's unit and sign, complex, shape (N,), and noise_sd, NaN where none is given."""
    first, second = (numbers(cells, column) for column in (POLAR if polar else CARTESIAN))
    if polar:
        first, second = first * np.cos(np.deg2rad(second)), first * np.sin(np.deg2rad(second))
    noise_sd = numbers(cells, "noise_sd") if "noise_sd" in cells.columns else np.full(first.size, np.nan)
    return first + 1j * second, noise_sd


def _magnitude_message(value: float) -> str:
    return (
        f"magnitude is {value:g}, but must not be negative; "
        "correct the row, or convert the column if it is in dB (10^(dB/20))"
    )


def _check_columns(cells: Table) -> tuple[tuple[str, str], tuple[str, ...]]:
    """Return the pair of value columns to use and warnings of the columns that are ignored."""
    found = cells.columns
    polar = any(name in found for name in POLAR) and not any(name in found for name in CARTESIAN)
    # With one column of each pair neither is complete, and the message names the Cartesian pair.
    if not all(name in found for name in CARTESIAN) and all(name in found for name in POLAR):
        polar = True
    value_columns = POLAR if polar else CARTESIAN
    for name in ("subject", "repetition", "frequency_hz", *value_columns):
        if name not in found:
            guess = similar(name, [other for other in found if other not in KNOWN])
            if name == "repetition" and guess is None:
                continue  # everybody was measured once
            remedy = f'{_REMEDY[name]}, or rename "{guess}" if it is that' if guess else _REMEDY[name]
            raise InputError(
                f'{cells.file}, row 1: column "{name}" is missing (found: {", ".join(found)}); {remedy}{OR_IMPORT}'
            )
    used = {"subject", "repetition", "frequency_hz", "noise_sd", *value_columns}
    ignored = tuple(
        f'{cells.file}: column "{name}" is not used'
        + (f"; values are taken from {' and '.join(value_columns)}" if name in KNOWN else "")
        for name in found
        if name not in used
    )
    return value_columns, ignored


def _refuse(cells: Table, wrong: npt.NDArray[np.bool_], message: Callable[[int], str]) -> None:
    """Raise InputError about the first row that is wrong, if there is one; NaN compares as not wrong."""
    if wrong.any():
        first = int(np.argmax(wrong))
        raise InputError(f"{cells.file}, row {cells.row[first]}: {message(first)}")


def _drop_incomplete(table: RecordingTable, may_be_empty: bool) -> RecordingTable:
    """Drop rows with a missing value; noise_sd is required only of subjects that have it in some row."""
    has_noise = np.zeros(len(table.subject_names), dtype=bool)
    has_noise[table.subject[np.isfinite(table.noise_sd)]] = True
    complete = np.isfinite(table.frequency_hz) & np.isfinite(table.z)
    complete &= np.isfinite(table.noise_sd) | ~has_noise[table.subject]
    if complete.all():
        return table
    if not complete.any() and not may_be_empty:
        raise InputError(
            f"{table.file}: no row has a finite number in every column (row {table.row[0]} is the first); fill them in"
        )
    dropped = np.flatnonzero(~complete)
    warnings = [
        f"{table.file}: {dropped.size} of {complete.size} rows have no finite value and were dropped, "
        f"the first is row {table.row[dropped[0]]}"
    ]
    code = table.subject * len(table.repetition_names) + table.repetition
    lost = np.setdiff1d(code, code[complete])
    for recording in lost:
        index = int(np.flatnonzero(code == recording)[0])
        warnings.append(f"{table.file}: {table.label(index)} has no usable row and was left out")
    return replace(table.take(np.flatnonzero(complete)), warnings=table.warnings + tuple(warnings))


def _check_duplicates(table: RecordingTable) -> None:
    """Refuse a frequency that appears twice in one recording."""
    order = np.lexsort((table.row, table.frequency_hz, table.repetition, table.subject))
    same = (
        (np.diff(table.subject[order]) == 0)
        & (np.diff(table.repetition[order]) == 0)
        & (np.diff(table.frequency_hz[order]) == 0)
    )
    if same.any():
        pairs = np.flatnonzero(same)
        second = order[pairs + 1]
        earliest = int(np.argmin(table.row[second]))
        now, before = second[earliest], order[pairs[earliest]]
        raise InputError(
            f"{table.file}, row {table.row[now]}: {table.frequency_hz[now]:g} Hz was already given in row "
            f"{table.row[before]} for {table.label(int(now))}; delete one, or number them as different repetitions"
        )


def _check_sorted(table: RecordingTable) -> None:
    """Refuse a recording whose frequencies do not ascend."""
    falls = (np.diff(table.subject) == 0) & (np.diff(table.repetition) == 0) & (np.diff(table.frequency_hz) < 0)
    if falls.any():
        after = np.flatnonzero(falls) + 1
        now = int(after[np.argmin(table.row[after])])
        raise InputError(
            f"{table.file}, row {table.row[now]}: frequency_hz falls from {table.frequency_hz[now - 1]:g} to "
            f"{table.frequency_hz[now]:g} within {table.label(now)}; sort each recording by ascending frequency"
        )
