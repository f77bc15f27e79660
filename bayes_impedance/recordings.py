"""Recordings on disk: reading and writing datasets.

A dataset is a folder of `recordings.csv` (or `.csv.gz`), optionally `subjects.csv` with covariates and `dataset.toml`
with title, unit, sign, network, source and licence; or one CSV file. Everything is checked before it is returned.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import json
import math
import os
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from pathlib import Path

import numpy as np

from bayes_impedance.dataset import Recordings, Subject
from bayes_impedance.errors import InputError
from bayes_impedance.metadata import SIGNS, Metadata, parse_metadata
from bayes_impedance.parquet import SUFFIX, parquet_as_csv
from bayes_impedance.recording_table import CARTESIAN, RecordingTable, parse_recordings
from bayes_impedance.tables import CovariateTable, IntArray, parse_covariates, read_bytes

__all__ = ["Recordings", "Subject", "read_recordings", "write_recordings"]

RECORDINGS_FILES = ("recordings.csv", "recordings.csv.gz", "recordings.parquet")
SUBJECTS_FILE = "subjects.csv"
METADATA_FILE = "dataset.toml"
#: Fewer frequencies than this make no curve.
MINIMUM_POINTS = 3
#: Repetitions of one subject must share at least this part of the frequencies of the longest.
MINIMUM_COMMON = 0.5
#: Above this part of points with Re z of the wrong sign, the sign convention itself is taken to be wrong.
WRONG_SIGN = 0.6


def read_recordings(path: str | os.PathLike[str]) -> Recordings:
    """Read a dataset.

    Parameters
    ----------
    path : path
        Folder of a dataset, or one CSV file (plain or gzip) or Parquet table (a file or a folder of partitions). One
        that is named recordings.csv, .csv.gz or .parquet stands for its folder, because its unit and sign are
        declared beside it.

    Returns
    -------
    Recordings
        Complete rows only, repetitions of one subject on their common frequencies, SI units, passive positive.

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
    data = parquet_as_csv(file) if file.suffix == SUFFIX else read_bytes(file)
    digest = hashlib.sha256(data)
    table = parse_recordings(data, str(file))
    metadata = Metadata(title=(folder.resolve().name if folder else given.name.split(".")[0]) or "recordings")
    covariates = CovariateTable({}, (), ())
    subjects_file = (folder or given.parent) / SUBJECTS_FILE
    if folder is not None and subjects_file.exists():
        content = read_bytes(subjects_file)
        digest.update(content)
        covariates = _match_covariates(parse_covariates(content, str(subjects_file)), table, str(subjects_file))
    metadata_file = (folder or given.parent) / METADATA_FILE
    if folder is not None and metadata_file.exists():
        content = read_bytes(metadata_file)
        digest.update(content)
        metadata = parse_metadata(content, str(metadata_file), metadata.title)
    _check_sign(table, metadata.sign, str(metadata_file))
    subjects, warnings = _assemble(table, metadata, covariates)
    return Recordings(
        title=metadata.title,
        unit=metadata.unit,
        network=metadata.network,
        source=metadata.source,
        licence=metadata.licence,
        subjects=subjects,
        sha256=digest.hexdigest(),
        warnings=table.warnings + covariates.warnings + metadata.warnings + warnings,
        polar=table.polar,
    )


def _recordings_file(folder: Path) -> Path:
    """Return the recordings of a folder, of which there must be one."""
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


def _match_covariates(covariates: CovariateTable, table: RecordingTable, file: str) -> CovariateTable:
    """Refuse subjects without covariates; warn of covariates without recordings."""
    used = [table.subject_names[i] for i in np.unique(table.subject)]
    absent = [name for name in used if name not in covariates.values]
    if absent and covariates.covariates:
        row = table.row[table.subject == table.subject_names.index(absent[0])].min()
        raise InputError(
            f'{file}: subject "{absent[0]}" ({table.file}, row {row}) is missing here'
            f"{f' and so are {len(absent) - 1} more' if len(absent) > 1 else ''}; "
            "add a row, with empty cells for what is not known"
        )
    surplus = [name for name in covariates.values if name not in table.subject_names]
    if not surplus:
        return covariates
    more = f" and {len(surplus) - 5} more" if len(surplus) > 5 else ""
    warning = f"{file}: no recordings of {', '.join(surplus[:5])}{more}; the covariates are not used"
    return replace(covariates, warnings=(*covariates.warnings, warning))


def _check_sign(table: RecordingTable, sign: str, metadata_file: str) -> None:
    """Refuse data that contradict their declared sign, because a negated impedance fits nothing but fails late."""
    declared_positive = sign == SIGNS[0]
    wrong = float(np.mean(table.z.real < 0 if declared_positive else table.z.real > 0))
    if wrong > WRONG_SIGN:
        remedy = SIGNS[1] if declared_positive else SIGNS[0]
        raise InputError(
            f"{table.file}: {wrong:.0%} of the rows (the first is row {table.row[0]}) have a "
            f'{"negative" if declared_positive else "positive"} real part although the sign is "{sign}"; '
            f'write sign = "{remedy}" in {metadata_file}, beside a file named recordings.csv'
        )


def _assemble(
    table: RecordingTable, metadata: Metadata, covariates: CovariateTable
) -> tuple[tuple[Subject, ...], tuple[str, ...]]:
    """Turn rows into subjects, in SI units and passive positive."""
    negate = metadata.sign != SIGNS[0]
    z = table.z * (-metadata.factor if negate else metadata.factor)
    noise_sd = table.noise_sd * metadata.factor
    warnings = [f'{table.file}: z was multiplied by -1 because the sign is "{metadata.sign}"'] if negate else []
    subjects = []
    bounds = np.flatnonzero(np.diff(table.subject, prepend=-1, append=len(table.subject_names)))
    for start, stop in pairwise(bounds.tolist()):
        rows, reduced = _common_rows(table, start, stop)
        if reduced:
            warnings.append(reduced)
        name = table.subject_names[table.subject[start]]
        noise = noise_sd[rows]
        subjects.append(
            Subject(
                name=name,
                frequency_hz=table.frequency_hz[rows[0]],
                z=z[rows],
                repetitions=tuple(table.repetition_names[i] for i in table.repetition[rows[:, 0]]),
                noise_sd=None if np.isnan(noise).any() else noise,
                covariates=covariates.values.get(name, {}),
            )
        )
    return tuple(subjects), tuple(warnings)


def _common_rows(table: RecordingTable, start: int, stop: int) -> tuple[IntArray, str | None]:
    """Return the indices of one subject's rows at the frequencies that all repetitions have.

    Returns
    -------
    rows : ndarray of int, shape (J, F)
    warning : str or None
        What was left out.
    """
    bounds = start + np.flatnonzero(np.diff(table.repetition[start:stop], prepend=-1, append=-2))
    parts = [np.arange(i, j) for i, j in pairwise(bounds.tolist())]
    grids = [table.frequency_hz[part] for part in parts]
    name = table.subject_names[table.subject[start]]
    where = f'{table.file}, row {table.row[start:stop].min()}: subject "{name}"'
    longest = max(grid.size for grid in grids)
    warning = None
    if not all(np.array_equal(grid, grids[0]) for grid in grids):
        common = reduce(lambda one, other: np.intersect1d(one, other, assume_unique=True), grids)
        if common.size < MINIMUM_COMMON * longest:
            raise InputError(
                f"{where} has repetitions of up to {longest} frequencies, of which only {common.size} are in all; "
                "give its repetitions the same frequencies, or make them different subjects"
            )
        parts = [part[np.isin(grid, common)] for part, grid in zip(parts, grids, strict=True)]
        warning = (
            f"{where} has repetitions on different frequencies and was reduced to the {common.size} that all have "
            f"(of up to {longest})"
        )
    if parts[0].size < MINIMUM_POINTS:
        raise InputError(
            f"{where} has {parts[0].size} usable frequencies, but at least {MINIMUM_POINTS} are needed; "
            "complete it, or delete its rows"
        )
    return np.array(parts), warning


def write_recordings(
    recordings: Recordings,
    folder: str | os.PathLike[str],
    *,
    significant_digits: int | None = None,
    compress: bool = False,
) -> Path:
    """Write a dataset that `read_recordings` reads; a dataset that is there already is replaced.

    Parameters
    ----------
    recordings : Recordings
    folder : path
        Folder to write to; it is created. `recordings.csv`, `dataset.toml` and, where there are covariates,
        `subjects.csv` are written to temporary names first, so that no half-written file is left behind.
    significant_digits : int, optional
        Digits of z and noise_sd. By default as many as restore the number exactly; frequencies and covariates always
        are exact.
    compress : bool
        Write `recordings.csv.gz`. The same data give the same bytes.

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
    target.mkdir(parents=True, exist_ok=True)
    table = _recordings_csv(recordings, significant_digits).encode()
    contents = {RECORDINGS_FILES[compress]: _gzip(table) if compress else table}
    if any(subject.covariates for subject in recordings.subjects):
        contents[SUBJECTS_FILE] = _subjects_csv(recordings).encode()
    contents[METADATA_FILE] = _metadata_toml(recordings).encode()
    temporary = {name: target / f".{name}.{os.getpid()}.tmp" for name in contents}
    try:
        for name, content in contents.items():
            temporary[name].write_bytes(content)
        for name, path in temporary.items():
            path.replace(target / name)
    finally:
        for path in temporary.values():
            path.unlink(missing_ok=True)
    # Files of an earlier dataset would be read together with the new ones.
    for name in {*RECORDINGS_FILES, SUBJECTS_FILE} - contents.keys():
        (target / name).unlink(missing_ok=True)
    return target


def _recordings_csv(recordings: Recordings, significant_digits: int | None) -> str:
    def number(value: float) -> str:
        return repr(value) if significant_digits is None else f"{value:.{significant_digits}g}"

    with_noise = any(subject.noise_sd is not None for subject in recordings.subjects)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["subject", "repetition", "frequency_hz", *CARTESIAN, *(["noise_sd"] if with_noise else [])])
    for subject in recordings.subjects:
        frequencies = [repr(value) for value in subject.frequency_hz.tolist()]
        for j, repetition in enumerate(subject.repetitions):
            columns = [map(number, subject.z[j].real.tolist()), map(number, subject.z[j].imag.tolist())]
            if subject.noise_sd is not None:
                columns.append(map(number, subject.noise_sd[j].tolist()))
            elif with_noise:
                columns.append(map(str, [""] * len(frequencies)))
            names = ([name] * len(frequencies) for name in (subject.name, repetition))
            writer.writerows(zip(*names, frequencies, *columns, strict=True))
    return text.getvalue()


def _subjects_csv(recordings: Recordings) -> str:
    covariates = list(dict.fromkeys(name for subject in recordings.subjects for name in subject.covariates))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["subject", *covariates])
    for subject in recordings.subjects:
        values = [float(subject.covariates.get(name, math.nan)) for name in covariates]
        writer.writerow([subject.name, *("" if math.isnan(value) else repr(value) for value in values)])
    return text.getvalue()


def _metadata_toml(recordings: Recordings) -> str:
    pairs = {
        "title": recordings.title,
        "unit": recordings.unit,
        "sign": SIGNS[0],
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
