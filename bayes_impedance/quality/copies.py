r"""Recordings that are copies of one another, exact or rounded: an error, because they count as independent people.

Noise makes two recordings of the same person differ at every frequency; equal numbers are one recording under two
names. Copies are found without comparing all pairs: of two curves that agree within :math:`\epsilon` of |z|, the
means of :math:`\ln|z|` differ by at most about :math:`\epsilon`, so that only neighbours in this mean are compared.

Two recordings are copies if they agree to 1e-6 of |z|, or if one of them is the other rounded to a number of
significant digits or of decimals, in real and imaginary part or in magnitude and phase. With few digits or few points
equal numbers may be chance; such pairs are at most a remark (:func:`.curve_anomalies.duplicates`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.quality.curve_anomalies import COPY_LIMIT
from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray
from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.runtime.user_table import shown

LEAST_POINTS = 8
"""Fewest points of a copy. By choice: sixteen numbers that are equal by chance in a third of the cases each are so once
in 4e7 pairs."""
LEAST_DIGITS, MOST_DIGITS = 4, 8
"""Digits that are tried. By choice: with fewer, numbers of one person repeat by chance (noise of 0.1 % is one step of
the third digit); with more the difference is below that of `COPY_LIMIT`."""
MOST_SUBJECTS = 1000
"""Most subjects that are searched: all of their recordings are held in memory for it."""
_NAMED = 6
"""Recordings that a message names. By choice: a line or two."""
_SAME = 1e-9
"""Relative difference of equal numbers after conversion from magnitude and phase: above the rounding of doubles."""
_NEAR = 1e-3
"""Largest difference of the means of ln|z| of copies. By choice: twice the rounding to four digits, 5e-4 at most."""


def require_distinct(recordings: Recordings) -> None:
    """Refuse recordings that are copies of one another.

    Raises
    ------
    InputError
        If there are copies; it names the subjects.
    """
    if len(recordings) > MOST_SUBJECTS:
        return
    groups = copies(recordings.subjects)
    if not groups:
        return
    largest = max(groups, key=len)
    more = len(groups) - 1
    others = f" (and so are those of {more} more group{'s' if more > 1 else ''})" if more else ""
    raise InputError(
        f"{recordings.title}: {len(largest)} recordings are copies of one another, exact or rounded: "
        f"{_named(largest)}{others}; keep one of them, and look for a file that was copied or exported twice"
    )


def _named(group: Sequence[tuple[str, str]]) -> str:
    subjects = list(dict.fromkeys(name for name, _ in group))
    if len(subjects) == 1:
        listed, what = [repetition for _, repetition in group], f"subject {shown(subjects[0])}, repetitions"
    elif len(subjects) == len(group):
        listed, what = subjects, "subjects"
    else:
        listed, what = [f"{name} (repetition {repetition})" for name, repetition in group], "subjects"
    more = f" and {len(listed) - _NAMED} more" if len(listed) > _NAMED else ""
    return f"{what} {', '.join(map(shown, listed[:_NAMED]))}{more}"


def copies(subjects: Sequence[Subject]) -> list[list[tuple[str, str]]]:
    """Groups of recordings that are copies.

    Parameters
    ----------
    subjects : sequence of Subject
        Only recordings on the same frequencies are compared.

    Returns
    -------
    list of list of (str, str)
        Subject and repetition of the recordings of each group, two or more, in the order of the subjects.
    """
    by_grid: dict[bytes, list[Subject]] = {}
    for subject in subjects:
        if subject.frequency_hz.size >= LEAST_POINTS:
            by_grid.setdefault(subject.frequency_hz.tobytes(), []).append(subject)
    return [group for own in by_grid.values() for group in _copies_on_grid(own)]


def _copies_on_grid(subjects: Sequence[Subject]) -> list[list[tuple[str, str]]]:
    labels = [(subject.name, repetition) for subject in subjects for repetition in subject.repetitions]
    z = np.concatenate([subject.z for subject in subjects])
    level = np.log(np.maximum(np.abs(z), np.finfo(float).tiny)).mean(axis=1)
    order = np.argsort(level, kind="stable")
    stops = np.searchsorted(level[order], level[order] + _NEAR, "right")
    group = np.arange(len(labels))
    for place, i in enumerate(order.tolist()):
        for j in order[place + 1 : stops[place]].tolist():
            if group[i] != group[j] and _are_copies(z[i], z[j]):
                group[group == max(group[i], group[j])] = min(group[i], group[j])
    together = [np.flatnonzero(group == k) for k in np.unique(group)]
    return [[labels[i] for i in members.tolist()] for members in together if members.size > 1]


def _are_copies(one: ComplexArray, other: ComplexArray) -> bool:
    size = np.maximum(np.abs(one), np.finfo(float).tiny)
    distance = np.abs(other - one) / size
    if float(np.median(distance)) > 10.0 ** (1 - LEAST_DIGITS) * np.sqrt(2):
        return False
    # A stuck channel or marks of missing values are reported as such.
    return _are_one(one, other, distance) and np.unique(one).size >= LEAST_POINTS


def _are_one(one: ComplexArray, other: ComplexArray, distance: FloatArray) -> bool:
    """Whether recordings at some distance at each frequency, of abs z, are equal or one of them the other rounded."""
    if float(np.sqrt(np.mean(distance**2))) <= COPY_LIMIT:
        return _fine(one.real) or _fine(one.imag)
    forms = [(z.real, z.imag) for z in (one, other)], [(np.abs(z), np.rad2deg(np.angle(z))) for z in (one, other)]
    return any(
        all(_rounded(p, q) for p, q in zip(a, b, strict=True)) or all(_rounded(q, p) for p, q in zip(a, b, strict=True))
        for a, b in forms
    )


def _fine(values: FloatArray) -> bool:
    """Whether numbers have digits enough that others are not equal by chance."""
    return not bool(_equal(_significant(values, LEAST_DIGITS - 1), values))


def _rounded(exact: FloatArray, values: FloatArray) -> bool:
    """Whether numbers are others rounded to significant digits, or to decimals that most of them need."""
    largest = float(np.abs(exact).max())
    if largest == 0:
        return bool(np.all(values == 0))
    digits = np.arange(LEAST_DIGITS, MOST_DIGITS + 1)[:, None]
    step = 10.0 ** (np.floor(np.log10(largest)) - digits + 1)
    enough = float(np.median(np.abs(exact))) >= 10.0 ** (LEAST_DIGITS - 1) * step[:, 0]
    # Unequal recordings differ at the first points that are looked at, and all pairs that are near may be unequal.
    for part in (np.linspace(0, exact.size - 1, LEAST_POINTS).astype(int), slice(None)):
        significant = _equal(_significant(exact[part], digits), values[part])
        decimals = _equal(np.round(exact[part] / step) * step, values[part], _SAME * step)
        holds = significant | (enough & decimals)
        if not holds.any():
            return False
        digits, step, enough = digits[holds], step[holds], enough[holds]
    return True


def _equal(one: FloatArray, other: FloatArray, apart: FloatArray | float = 0.0) -> np.ndarray:
    """Whether numbers are equal to the rounding of doubles, or not further apart, along the last axis."""
    return np.asarray(np.all(np.abs(one - other) <= apart + _SAME * np.abs(other), axis=-1))


def _significant(values: FloatArray, digits: int | np.ndarray) -> FloatArray:
    size = np.maximum(np.abs(values), np.finfo(float).tiny)
    step = 10.0 ** np.maximum(np.floor(np.log10(size)) - digits + 1, -300.0)
    return np.asarray(np.round(values / step) * step)
