"""Marks for missing values (sentinel values) in the data: zeros, 9999, the largest number of a format.

A program without a value writes a number that cannot be a measurement, and a stuck converter repeats its last value.
Both repeat a number exactly, far away from the curve on either side. Numbers of few digits also repeat in good
recordings, but not far from their neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.quality.point_anomalies import (
    OUTLIER_LIMIT,
    OUTLIER_MINIMUM,
    deviation,
    noise_scale,
    running_median,
    without,
)
from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray
from bayes_impedance.recordings.dataset import Subject

KNOWN_MARKS = (0.0, 99.0, 999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 1e20, 1e30, 1e37, 1e38)
"""Absolute values that programs write for "no value", which need not occur twice: nines, ends of 16-bit converters, and
the powers of ten that formats such as netCDF fill with."""
FLOAT_MAXIMUM = float(np.finfo(np.float32).max)
"""Largest single-precision number, another such mark."""
MINIMUM_REST = 3
"""Fewest remaining points of a recording to define its curve: a line through two, and one to check it."""
STEPS = 4.0
"""Smallest distance of a mark from the curve in rounding steps: a point is off by half a step in each part, so are the
points that define the curve, and extrapolation may add as much again."""
_DIGITS = 12
"""Significant digits in which equal magnitudes count as repeated. By choice: they are computed from two numbers, with
rounding errors beyond these digits."""


@dataclass(frozen=True)
class Mark:
    """A number that marks missing values.

    Attributes
    ----------
    part : str
        ``z``, ``Re z``, ``Im z`` or ``|z|``: the quantity with the repeated number.
    value : complex
        The number; for a part, the imaginary part is zero.
    points : tuple of (str, str, float)
        Subject, repetition and frequency in Hz of each point.
    """

    part: str
    value: complex
    points: tuple[tuple[str, str, float], ...]


def marks(subjects: Sequence[Subject]) -> tuple[list[Mark], list[np.ndarray]]:
    """Find numbers that mark missing values.

    Parameters
    ----------
    subjects : sequence of Subject

    Returns
    -------
    found : list of Mark
        One for each number, however often it occurs.
    where : list of ndarray of bool, shape (J, F)
        The points, for each subject.
    """
    where = [np.zeros(subject.z.shape, dtype=bool) for subject in subjects]
    found: list[Mark] = []
    if not subjects:
        return found, where
    # A mark in both parts is reported once.
    for part in ("z", "Re z", "Im z", "|z|"):
        own = [_part(subject.z, part) for subject in subjects]
        every = np.concatenate([values[~w] for values, w in zip(own, where, strict=True)])
        different, count = np.unique(every, return_counts=True)
        repeated = different[(count > 1) | _is_known(different)]
        points: dict[complex, list[tuple[str, str, float]]] = {}
        for subject, values, marked in zip(subjects, own, where, strict=True):
            candidate = np.isin(values, repeated) & ~marked
            far = _far(subject.frequency_hz, subject.z, candidate, marked, part)
            for j, i in np.argwhere(far).tolist():
                name = subject.name, subject.repetitions[j], float(subject.frequency_hz[i])
                points.setdefault(complex(values[j, i]), []).append(name)
            marked |= far
        found += [
            Mark(part, value, tuple(at))
            for value, at in points.items()
            if len(at) > 1 or bool(_is_known(np.array([value]))[0])
        ]
    return found, where


def _part(z: ComplexArray, part: str) -> np.ndarray:
    if part == "|z|":
        size = np.abs(z)
        exponent = np.floor(np.log10(np.maximum(size, np.finfo(float).tiny)))
        unit = 10.0 ** np.maximum(exponent - _DIGITS + 1, -300.0)
        return np.asarray(np.round(size / unit) * unit)
    return {"z": z, "Re z": z.real, "Im z": z.imag}[part]


def _is_known(values: np.ndarray) -> np.ndarray:
    """Whether all non-zero parts of numbers are known marks."""
    known = np.array([*KNOWN_MARKS, FLOAT_MAXIMUM])

    def listed(sizes: FloatArray) -> npt.NDArray[np.bool_]:
        return np.asarray(np.any(np.abs(sizes[:, None] - known) <= 1e-6 * known, axis=1))

    return np.asarray(listed(np.abs(values.real)) & listed(np.abs(values.imag)))


def _far(f: FloatArray, z: ComplexArray, candidate: np.ndarray, marked: np.ndarray, part: str) -> np.ndarray:
    """Mask of candidates as far from the curve of the other points as an outlier, shape (J, F)."""
    far = np.zeros(z.shape, dtype=bool)
    if f.size <= MINIMUM_REST:
        return far
    values = _part(z, part)
    limits = _limit(f, z)
    with np.errstate(over="ignore", invalid="ignore"):
        around = running_median(z.real, 5) + 1j * running_median(z.imag, 5)
        near = np.abs(values - _part(around, part)) <= limits
    for j in np.flatnonzero(candidate.any(axis=1)):
        if candidate[j].all() and bool(np.all(z[j] == z[j, 0])):
            far[j] = True  # no recording is without any noise and any frequency dependence
            continue
        different, index, count = np.unique(values[j][candidate[j]], return_inverse=True, return_counts=True)
        # One or two points do not move medians; most numbers that repeat by rounding are settled here.
        settled = (count <= 2) & (np.bincount(index, near[j][candidate[j]]) > 0)
        for value in different[~settled]:
            own = candidate[j] & (values[j] == value)
            drop = own | marked[j]
            if np.sum(~drop) < MINIMUM_REST:
                continue
            curve = without(f, z[j][None], drop[None])
            limit = _limit(f, curve)[0]
            # All occurrences are tested: a curve that passes through a number is close to it there.
            far[j] |= own & bool(np.all(np.abs(values[j] - _part(curve[0], part))[own] > limit[own]))
    return far


def _limit(f: FloatArray, z: ComplexArray) -> FloatArray:
    """Distance from the curve that noise and rounding do not exceed, shape (J, F)."""
    with np.errstate(over="ignore", invalid="ignore"):
        relative = np.maximum(OUTLIER_LIMIT * noise_scale(deviation(f, z)), OUTLIER_MINIMUM)
        steps = [np.diff(np.unique(part)).min(initial=np.inf) for part in (z.real, z.imag)]
        rounding = STEPS * max((step for step in steps if np.isfinite(step)), default=0.0)
        return np.asarray(np.maximum(relative * running_median(np.abs(z), 5), rounding))
