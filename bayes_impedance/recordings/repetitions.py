"""From a checked table to subjects: SI units, Re z >= 0 if passive, repetitions on their common frequencies."""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from itertools import pairwise

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import CovariateTable, IntArray
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.long_table import RecordingTable
from bayes_impedance.recordings.metadata import CONVENTIONS, SIGNS, Metadata

MINIMUM_POINTS = 3
"""Fewest frequencies of a subject. By choice: a mass, a spring and a damper are three unknowns."""
MINIMUM_COMMON = 0.5
"""Smallest fraction of the longest repetition's frequencies that all repetitions of a subject must share. By choice:
dropping more than half of a recording would change the experiment."""


def signed_factor(metadata: Metadata) -> float:
    """Factor applied to the file's impedance: unit and sign."""
    return metadata.factor if metadata.sign == SIGNS[0] else -metadata.factor


def is_conjugated(metadata: Metadata) -> bool:
    """Whether the file has the complex conjugates of the impedance."""
    return metadata.convention == CONVENTIONS[1]


def subjects_of(
    table: RecordingTable, metadata: Metadata, covariates: CovariateTable
) -> Iterator[tuple[Subject, IntArray, str | None]]:
    """All subjects of a table.

    Yields
    ------
    subject : Subject
    rows : ndarray of int, shape (J, F)
        Indices of the subject's values in the table.
    warning : str or None
        Data that were dropped.

    Raises
    ------
    InputError
        If repetitions share too few frequencies, or a subject has too few frequencies.
    """
    z = table.z * signed_factor(metadata)
    if is_conjugated(metadata):
        z = z.conj()
    noise_sd = table.noise_sd * metadata.factor
    bounds = np.flatnonzero(np.diff(table.subject, prepend=-1, append=len(table.subject_names)))
    for start, stop in pairwise(bounds.tolist()):
        rows, warning = _common_rows(table, start, stop)
        name = table.subject_names[table.subject[start]]
        noise = noise_sd[rows]
        subject = Subject(
            name=name,
            frequency_hz=table.frequency_hz[rows[0]],
            z=z[rows],
            repetitions=tuple(table.repetition_names[i] for i in table.repetition[rows[:, 0]]),
            noise_sd=None if np.isnan(noise).any() else noise,
            covariates=covariates.values.get(name, {}),
        )
        yield subject, rows, warning


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
                f"{where} has repetitions of up to {longest} frequencies, of which only {common.size} are common to "
                "all; give its repetitions the same frequencies, or make them different subjects"
            )
        parts = [part[np.isin(grid, common)] for part, grid in zip(parts, grids, strict=True)]
        warning = (
            f"{where} has repetitions on different frequencies and was reduced to the {common.size} that are common to "
            f"all (of up to {longest})"
        )
    if parts[0].size < MINIMUM_POINTS:
        raise InputError(
            f"{where} has {parts[0].size} usable frequencies, but at least {MINIMUM_POINTS} are needed; "
            "complete it, or delete its rows"
        )
    return np.array(parts), warning
