"""Subjects whose data stay in a file until they are needed.

A dataset partitioned by subject can be larger than memory: its subjects hold the location of their data, and only this
is sent to workers. A process that works on a subject, such as a cluster's worker, reads the data and releases them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from socket import gethostname
from typing import Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray, IntArray
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.long_table import KNOWN, values
from bayes_impedance.recordings.parquet import parquet_table


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredRows:
    """Location of a subject's checked data.

    Attributes
    ----------
    folder : Path
        Absolute path: a worker may have another working directory.
    digest : str
        Digest of the files when they were checked.
    rows : ndarray of int, shape (J, F), or None
        Spreadsheet rows; None for the first J F rows in order.
    shape : tuple of int
        J repetitions, F frequencies.
    polar : bool
    factor, noise_factor : float
        Factors applied to impedance and noise_sd.
    with_noise : bool
    conjugated : bool
    """

    folder: Path
    digest: str
    rows: IntArray | None
    shape: tuple[int, int]
    polar: bool
    factor: float
    noise_factor: float
    with_noise: bool
    conjugated: bool = False


@lru_cache(maxsize=16)
def _read(place: StoredRows) -> tuple[ComplexArray, FloatArray | None]:
    """Impedance and noise, each of shape (J, F); the last few are cached, as both are usually needed."""
    if not place.folder.exists():
        raise InputError(
            f"{place.folder}: the folder does not exist on {gethostname()}; every worker needs the dataset at this path"
        )
    cells, digest = parquet_table(place.folder, KNOWN)
    if digest != place.digest:
        raise InputError(
            f"{place.folder}: the folder has changed since it was checked; start again when no program writes to it"
        )
    z, noise_sd = values(cells, place.polar)
    if place.conjugated:
        z = z.conj()
    first = np.arange(math.prod(place.shape)).reshape(place.shape)
    rows = first if place.rows is None else np.searchsorted(cells.row, place.rows)
    return (z * place.factor)[rows], (noise_sd * place.noise_factor)[rows] if place.with_noise else None


class StoredSubject(Subject):
    """A subject whose impedance and noise are read from a file at each access.

    Parameters
    ----------
    subject : Subject
        The subject with all its data, which are not kept.
    frequency_hz : ndarray of float, shape (F,)
        The subject's frequencies; subjects with a common grid can share the array.
    place : StoredRows
    """

    place: StoredRows

    def __new__(cls, *_: Any, **fields: Any) -> Subject:  # type: ignore[misc]
        """A new stored subject; with all fields, as from `dataclasses.replace`, an ordinary one with data in memory."""
        return Subject(**fields) if fields else object.__new__(cls)

    def __init__(self, subject: Subject, frequency_hz: FloatArray, place: StoredRows) -> None:
        own = {"name": subject.name, "frequency_hz": frequency_hz, "repetitions": subject.repetitions}
        self.__dict__.update(own, covariates=subject.covariates, circumstances=subject.circumstances, place=place)

    @property
    def z(self) -> ComplexArray:
        """Impedance, shape (J, F)."""
        return _read(self.place)[0]

    @property
    def noise_sd(self) -> FloatArray | None:
        """Standard deviation of the noise, shape (J, F), or None if not given."""
        return _read(self.place)[1] if self.place.with_noise else None

    @property
    def digest(self) -> str:
        """Digest from the names and the files' stored digest, without reading the files."""
        return f"{self.name} {self.repetitions} {self.place.digest}"
