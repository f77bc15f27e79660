"""Recordings on disk: reading and writing datasets.

A dataset is a folder of `recordings.csv` (or `.csv.gz`), optionally `subjects.csv` with covariates, `repetitions.csv`
with what was noted of every repetition, and `dataset.toml` with title, unit, sign, network, source and licence; or one
CSV file. Everything is checked before it is returned.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.calibration import map_table
from bayes_impedance.recordings.calibration_map import MAP_FILE, CalibrationMap, parse_map
from bayes_impedance.recordings.circumstances import CircumstanceTable, circumstances_csv, parse_circumstances
from bayes_impedance.recordings.csv_table import CovariateTable, IntArray, parse_covariates
from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.recordings.long_table import CARTESIAN, KNOWN, RecordingTable, check_cells, parse_recordings
from bayes_impedance.recordings.metadata import CONVENTIONS, SIGNS, Metadata, parse_metadata
from bayes_impedance.recordings.out_of_core import StoredRows, StoredSubject
from bayes_impedance.recordings.parquet import SUFFIX, parquet_table, partitions, release_memory
from bayes_impedance.recordings.plausibility import Plausibility
from bayes_impedance.recordings.repetitions import is_conjugated, signed_factor, subjects_of
from bayes_impedance.recordings.shorter_grid import shorter_grids
from bayes_impedance.runtime.atomic_files import Content, csv_bytes, write_together
from bayes_impedance.runtime.input_files import LARGEST_DESCRIPTION, read_bytes

__all__ = ["Recordings", "Subject", "read_recordings", "write_recordings"]

RECORDINGS_FILES = ("recordings.csv", "recordings.csv.gz", "recordings.parquet")
SUBJECTS_FILE = "subjects.csv"
REPETITIONS_FILE = "repetitions.csv"
METADATA_FILE = "dataset.toml"


def read_recordings(path: str | os.PathLike[str]) -> Recordings:
    """Read a dataset.

    Parameters
    ----------
    path : path
        Folder of a dataset, or one CSV file (plain or gzip) or Parquet table (a file or a folder of partitions). A
        file named recordings.csv, .csv.gz or .parquet stands for its folder, because its unit and sign are declared
        there.

    Returns
    -------
    Recordings
        Complete rows only, repetitions of one subject on their common frequencies, SI units, Re z >= 0 for a passive
        load. Of a Parquet table partitioned by subject (``recordings.parquet/subject=A/part-0.parquet``) every
        partition is read and checked; its data are not kept in memory, but read again when needed.

    Raises
    ------
    InputError
        If anything in the files cannot be used; the message names file, row and remedy.
    """
    given = Path(path)
    if not given.exists():
        raise InputError(f"{given}: there is no such file or folder; check the path")
    is_dataset = given.is_dir() and given.suffix != SUFFIX
    folder = given if is_dataset else given.parent if given.name in RECORDINGS_FILES else None
    file = _recordings_file(folder) if folder is not None else given
    digest = hashlib.sha256()
    metadata = Metadata(title=(folder.resolve().name if folder else given.name.split(".")[0]) or "recordings")
    covariates = CovariateTable({}, (), ())
    described = []
    subjects_file = (folder or given.parent) / SUBJECTS_FILE
    if folder is not None and subjects_file.exists():
        described.append(read_bytes(subjects_file))
        covariates = parse_covariates(described[-1], str(subjects_file))
    circumstances = CircumstanceTable()
    repetitions_file = (folder or given.parent) / REPETITIONS_FILE
    if folder is not None and repetitions_file.exists():
        described.append(read_bytes(repetitions_file))
        circumstances = parse_circumstances(described[-1], str(repetitions_file))
    metadata_file = (folder or given.parent) / METADATA_FILE
    if folder is not None and metadata_file.exists():
        described.append(read_bytes(metadata_file, LARGEST_DESCRIPTION))
        metadata = parse_metadata(described[-1], str(metadata_file), metadata.title)
    calibration_map = None
    if metadata.map_file:
        calibration_map = _map_of(metadata_file, metadata)
        described.append(calibration_map[0])
    reading = _Reading(file, metadata, covariates, circumstances)
    _add_tables(reading, file, digest)
    if file.suffix == SUFFIX:
        release_memory()
    for content in described:
        digest.update(content)
    unused = (*reading.match_covariates(str(subjects_file)), *circumstances.unmatched(reading.subjects))
    reading.require_rows()
    reading.plausibility.require(metadata, f"{file}", reading.first_row, str(metadata_file))
    return Recordings(
        title=metadata.title,
        unit=metadata.unit,
        network=metadata.network,
        source=metadata.source,
        licence=metadata.licence,
        subjects=tuple(reading.subjects),
        sha256=digest.hexdigest(),
        warnings=(
            *reading.of_table,
            *covariates.warnings,
            *circumstances.warnings,
            *unused,
            *metadata.warnings,
            *reading.plausibility.remarks(metadata, str(metadata_file)),
            *reading.of_subjects,
            *reading.shorter(),
        ),
        polar=reading.polar,
        convention=metadata.convention,
        calibration=metadata.calibration,
        calibration_map=None if calibration_map is None else calibration_map[1],
        place=metadata.place,
        quantity=metadata.quantity,
        frequency_unit=metadata.frequency_unit,
    )


def _add_tables(reading: _Reading, file: Path, digest: hashlib._Hash) -> None:
    """Add all tables; none is referred to afterwards."""
    for table, place in _tables(file, digest):
        reading.add(table, *place)


def _map_of(metadata_file: Path, metadata: Metadata) -> tuple[bytes, CalibrationMap]:
    """The table that dataset.toml names for the calibration's error: its bytes and content."""
    file = metadata_file.parent / metadata.map_file
    if not file.exists():
        raise InputError(f"{metadata_file}: there is no {file.name} beside it; import the recordings again")
    if metadata.factor != 1.0:
        raise InputError(
            f"{metadata_file}: the values of {file.name} are in {metadata.unit}, but recordings in another unit; "
            "import the recordings again, which converts them"
        )
    data = read_bytes(file)
    return data, parse_map(data, str(file))


def _tables(file: Path, digest: hashlib._Hash) -> Iterator[tuple[RecordingTable, tuple[Path, str] | tuple[()]]]:
    """The whole table, or one for each subject with folder and digest, where it can be read again."""
    parted = partitions(file, "subject") if file.suffix == SUFFIX else []
    for name, folder in parted:
        cells, own = parquet_table(folder, KNOWN, {"subject": name})
        digest.update(own.encode())
        yield check_cells(cells, may_be_empty=True), (folder.resolve(), own)
    if parted:
        return
    if file.suffix == SUFFIX:
        cells, own = parquet_table(file, KNOWN)
        digest.update(own.encode())
        yield check_cells(cells), ()
    else:
        data = read_bytes(file)
        digest.update(data)
        table = parse_recordings(data, str(file))
        del data  # the text takes more memory than the numbers
        yield table, ()


class _Reading:
    """Subjects while they are read, and checks made when all have been read."""

    def __init__(
        self, file: Path, metadata: Metadata, covariates: CovariateTable, circumstances: CircumstanceTable
    ) -> None:
        self.file, self.metadata, self.covariates, self.circumstances = file, metadata, covariates, circumstances
        self.subjects: list[Subject] = []
        self.named: dict[str, str] = {}
        self.ended: dict[str, str] = {}
        self.of_table: list[str] = []
        self.said: set[str] = set()
        self.of_subjects: list[str] = []
        if metadata.sign != SIGNS[0]:
            self.of_subjects.append(f'{file}: z was multiplied by -1 because the sign is "{metadata.sign}"')
        if is_conjugated(metadata):
            self.of_subjects.append(f'{file}: conjugates of z were taken because the convention is "{CONVENTIONS[1]}"')
        self.polar, self.first_row = False, 0
        self.rows, self.plausibility = 0, Plausibility()

    def add(self, table: RecordingTable, folder: Path | None = None, digest: str = "") -> None:
        """Add all subjects of a table; if a folder is given, their data are not kept but read from there again."""
        self._warn(table, folder)
        self.polar |= table.polar
        for name in table.subject_names:
            if name in self.named:
                raise InputError(
                    f'{table.file}: subject "{name}" is also in another partition; put all of its rows into one'
                )
            self.named[name] = table.file
        used, starts = np.unique(table.subject, return_index=True)
        for i, row in zip(used, np.minimum.reduceat(table.row, starts) if used.size else (), strict=True):
            self.named[table.subject_names[i]] = f"{table.file}, row {row}"
        for i, row in zip(used, np.maximum.reduceat(table.row, starts) if used.size else (), strict=True):
            self.ended[table.subject_names[i]] = f"{table.file}, row {row}"
        self.first_row = self.first_row or int(table.row[:1].sum())
        self.rows += table.z.size
        for own, rows, warning in subjects_of(table, self.metadata, self.covariates):
            subject = self.circumstances.of(own)
            self.plausibility.add(subject)
            self.of_subjects += [warning] if warning else []
            self.subjects.append(subject if folder is None else self._stored(subject, table, rows, folder, digest))

    def _stored(self, subject: Subject, table: RecordingTable, rows: IntArray, folder: Path, digest: str) -> Subject:
        own = table.row[rows]
        # Row 2 is the first; most tables are sorted and complete, so that no row indices need to be stored.
        simple = np.array_equal(own.ravel(), np.arange(own.size) + 2)
        shared = self.subjects[-1].frequency_hz if self.subjects else subject.frequency_hz
        grid = shared if np.array_equal(shared, subject.frequency_hz) else subject.frequency_hz
        return StoredSubject(
            subject,
            grid,
            StoredRows(
                folder=folder,
                digest=digest,
                rows=None if simple else own,
                shape=rows.shape,
                polar=table.polar,
                factor=signed_factor(self.metadata),
                noise_factor=self.metadata.factor,
                with_noise=subject.noise_sd is not None,
                conjugated=is_conjugated(self.metadata),
            ),
        )

    def _warn(self, table: RecordingTable, folder: Path | None) -> None:
        """Add a table's warnings; one that holds for many partitions is given for the first only."""
        for warning in table.warnings:
            said = warning.partition(": ")[2] if folder is not None else warning
            self.of_table += [warning] if said not in self.said else []
            self.said.add(said)

    def require_rows(self) -> None:
        """Refuse tables without any usable row."""
        if not self.rows:
            raise InputError(f"{self.file}: no partition has a row with a finite number in every column; fill them in")

    def shorter(self) -> Iterator[str]:
        """Remarks on subjects whose frequencies end before those of everybody else."""
        for name, what in shorter_grids([(subject.name, subject.frequency_hz) for subject in self.subjects]):
            yield (
                f'{self.ended[name]}: subject "{name}" ends here: {what}, and if the sweep was stopped there, keep it'
            )

    def match_covariates(self, file: str) -> tuple[str, ...]:
        """Refuse subjects without covariates; warn of covariates without recordings."""
        given = self.covariates.values
        absent = [s.name for s in self.subjects if s.name not in given]
        if absent and self.covariates.covariates:
            raise InputError(
                f'{file}: subject "{absent[0]}" ({self.named[absent[0]]}) is missing here'
                f"{f' and so are {len(absent) - 1} more' if len(absent) > 1 else ''}; "
                "add a row, with empty cells for what is not known"
            )
        surplus = [name for name in given if name not in self.named]
        if not surplus:
            return ()
        more = f" and {len(surplus) - 5} more" if len(surplus) > 5 else ""
        return (f"{file}: there are no recordings of {', '.join(surplus[:5])}{more}; their covariates are not used",)


def _recordings_file(folder: Path) -> Path:
    """Return the recordings file of a folder; there must be exactly one."""
    found = [folder / name for name in RECORDINGS_FILES if (folder / name).exists()]
    if not found:
        raise InputError(
            f"{folder}: the folder has no {', '.join(RECORDINGS_FILES[:-1])} or {RECORDINGS_FILES[-1]}; "
            "put the recordings there or name a CSV file"
        )
    if len(found) > 1:
        raise InputError(
            f"{folder}: the folder has both {' and '.join(file.name for file in found)}; delete the wrong one"
        )
    return found[0]


def write_recordings(
    recordings: Recordings,
    folder: str | os.PathLike[str],
    *,
    significant_digits: int | None = None,
    compress: bool = False,
    recipe: str = "",
    beside: Mapping[str, Content] | None = None,
) -> Path:
    """Write a dataset that `read_recordings` reads; an existing dataset is replaced.

    Parameters
    ----------
    recordings : Recordings
    folder : path
        Folder to write to; it is created. `recordings.csv`, `dataset.toml` and, where there are covariates,
        `subjects.csv` and `repetitions.csv` are written to temporary names first, so that no half-written file is left
        behind.
    significant_digits : int, optional
        Digits of z and noise_sd. By default enough to restore the numbers exactly; frequencies and covariates are
        always exact.
    compress : bool
        Write `recordings.csv.gz`. The same data give the same bytes.
    recipe : str
        TOML that is appended to `dataset.toml`: the table that records how the dataset was made.
    beside : mapping of str to bytes, or to parts of bytes one after the other, optional
        Further files of the folder, which appear together with the others; a `subjects.csv` replaces that of the
        covariates.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If there are no subjects.
    """
    if not recordings.subjects:
        raise InputError(f"{folder}: there are no subjects to write")
    target = Path(folder)
    table = _recordings_csv(recordings, significant_digits)
    contents: dict[str, Content] = {RECORDINGS_FILES[compress]: _gzip(b"".join(table)) if compress else table}
    if any(subject.covariates for subject in recordings.subjects):
        contents[SUBJECTS_FILE] = recordings.subjects_table().to_csv(lineterminator="\n").encode()
    noted = circumstances_csv(recordings.subjects)
    if noted is not None:
        contents[REPETITIONS_FILE] = noted
    left = "" if recordings.calibration is None else recordings.calibration.toml() + "\n"
    if recordings.calibration_map is not None:
        left, contents[MAP_FILE] = map_table(MAP_FILE) + "\n", recordings.calibration_map.csv()
    contents[METADATA_FILE] = "\n".join(filter(None, (_metadata_toml(recordings), left, recipe))).encode()
    contents |= beside or {}
    write_together({target / name: content for name, content in contents.items()})
    # Files of an earlier dataset would be read together with the new ones.
    for name in {*RECORDINGS_FILES, SUBJECTS_FILE, REPETITIONS_FILE} - contents.keys():
        (target / name).unlink(missing_ok=True)
    return target


def _recordings_csv(recordings: Recordings, significant_digits: int | None) -> Iterator[bytes]:
    """The table in parts, one for each recording: as text it is several times as large as its numbers in memory."""

    def number(value: float) -> str:
        return repr(value) if significant_digits is None else f"{value:.{significant_digits}g}"

    with_noise = any(subject.noise_sd is not None for subject in recordings.subjects)
    yield csv_bytes([["subject", "repetition", "frequency_hz", *CARTESIAN, *(["noise_sd"] if with_noise else [])]])
    for subject in recordings.subjects:
        frequencies = [repr(value) for value in subject.frequency_hz.tolist()]
        for j, repetition in enumerate(subject.repetitions):
            columns = [map(number, subject.z[j].real.tolist()), map(number, subject.z[j].imag.tolist())]
            if subject.noise_sd is not None:
                columns.append(map(number, subject.noise_sd[j].tolist()))
            elif with_noise:
                columns.append(map(str, [""] * len(frequencies)))
            names = ([name] * len(frequencies) for name in (subject.name, repetition))
            yield csv_bytes(zip(*names, frequencies, *columns, strict=True))


def _metadata_toml(recordings: Recordings) -> str:
    pairs = {
        "title": recordings.title,
        "unit": recordings.unit,
        "sign": SIGNS[0],
        "convention": CONVENTIONS[0] if recordings.convention else "",
        "place": recordings.place,
        "quantity": recordings.quantity,
        "frequency_unit": recordings.frequency_unit,
        "network": recordings.network,
        "source": recordings.source,
        "licence": recordings.licence,
    }
    # A JSON string is a TOML basic string, except that TOML also wants the delete character escaped.
    lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in pairs.items() if value)
    return "\n".join(lines).replace("\x7f", "\\u007f") + "\n"


def _gzip(data: bytes) -> bytes:
    """Compress without time and name in the header."""
    buffer = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", compresslevel=9, fileobj=buffer, mtime=0) as file:
        file.write(data)
    return buffer.getvalue()
