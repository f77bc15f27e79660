"""A subject whose numbers stay in a file until somebody needs them.

A dataset that is parted by subject can be larger than memory: its subjects hold where their numbers are, and travel as
that. Whoever works on a subject, be it a cluster's worker, reads the numbers there and forgets them.
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
    """Where a subject's checked numbers are.

    Attributes
    ----------
    folder : Path
        Absolute: a worker may be at home elsewhere.
    digest : str
        Of the files when they were checked.
    rows : ndarray of int, shape (J, F), or None
        Spreadsheet rows; None for the first J F in their order.
    shape : tuple of int
        J repetitions, F frequencies.
    polar : bool
    factor, noise_factor : float
        What impedance and noise_sd are multiplied by.
    with_noise : bool
    """

    folder: Path
    digest: str
    rows: IntArray | None
    shape: tuple[int, int]
    polar: bool
    factor: float
    noise_factor: float
    with_noise: bool


@lru_cache(maxsize=16)
def _read(place: StoredRows) -> tuple[ComplexArray, FloatArray | None]:
    """Impedance and noise, each of shape (J, F); the last few are remembered: who needs one needs the other soon."""
    if not place.folder.exists():
        raise InputError(
            f"{place.folder}: is not there for {gethostname()}; every worker needs the dataset at this path"
        )
    cells, digest = parquet_table(place.folder, KNOWN)
    if digest != place.digest:
        raise InputError(f"{place.folder}: has changed since it was checked; begin again when nobody writes to it")
    z, noise_sd = values(cells, place.polar)
    first = np.arange(math.prod(place.shape)).reshape(place.shape)
    rows = first if place.rows is None else np.searchsorted(cells.row, place.rows)
    return (z * place.factor)[rows], (noise_sd * place.noise_factor)[rows] if place.with_noise else None


class StoredSubject(Subject):
    """A subject whose impedance and noise are read from a file each time somebody asks for them.

    Parameters
    ----------
    subject : Subject
        With all its numbers, which are not kept.
    frequency_hz : ndarray of float, shape (F,)
        The subject's own: those who share a grid can share the array.
    place : StoredRows
    """

    place: StoredRows

    def __new__(cls, *_: Any, **fields: Any) -> Subject:  # type: ignore[misc]
        """An empty one; but `dataclasses.replace` gives all fields, and whoever has numbers is no longer stored."""
        return Subject(**fields) if fields else object.__new__(cls)

    def __init__(self, subject: Subject, frequency_hz: FloatArray, place: StoredRows) -> None:
        own = {"name": subject.name, "frequency_hz": frequency_hz, "repetitions": subject.repetitions}
        self.__dict__.update(own, covariates=subject.covariates, place=place)

    @property
    def z(self) -> ComplexArray:
        """Impedance, shape (J, F)."""
        return _read(self.place)[0]

    @property
    def noise_sd(self) -> FloatArray | None:
        """Standard deviation of the noise, shape (J, F), where the data give it."""
        return _read(self.place)[1] if self.place.with_noise else None

    @property
    def digest(self) -> str:
        """The same for the files, which need not be read for it."""
        return f"{self.name} {self.repetitions} {self.place.digest}"
