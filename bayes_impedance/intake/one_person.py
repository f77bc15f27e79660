r"""Files that are taken for as many persons by their names, although they hold one person again and again.

People differ by tens of per cent, and one finger that is put down again by some per cent; what nobody has touched
between two recordings differs by noise alone. With :math:`D_i = \ln z_i - \overline{\ln z}` on a common grid of F
frequencies and polynomials :math:`p_k` of ln f that are orthonormal on it, smooth differences are

.. math:: S^2 = \frac{1}{N - 1}\sum_{i,k} \left|\frac1F \sum_f p_k(f)\,D_i(f)\right|^2,

of which noise makes :math:`S_0^2`, the same with the noise of each point, from second differences of :math:`D_i` over
frequency (of independent values they have six times the variance). :math:`S^2` is a sum of 2 K (N - 1) squares, so that
its standard error is at most :math:`S^2/\sqrt{K (N - 1)}`, and the objects differ by less than

.. math:: \sqrt{\max(S^2 - S_0^2, 0) + 2\,S^2/\sqrt{K (N - 1)}} .
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.spectrum import ComplexArray, FloatArray
from bayes_impedance.recordings.dataset import Subject

ALIKE = 0.01
"""Relative difference below which recordings are of one object that was not even put down again. By choice: the
elements of a finger that is put down again differ by two per cent and more, those of people by tens."""
PUT_DOWN_AGAIN = 0.1
"""Relative difference below which recordings may be of one finger that was put down again, which is said. By choice:
three or eight repetitions of 48 virtual persons differ by less than 0.02 to 0.094, and three or eight persons of 12
populations by 0.19 to 0.5."""
LEAST_FILES = 3
"""Fewest files that are compared. By choice: of two nobody knows whether they are alike by accident."""
_DEGREES = 3
"""Polynomials: level, slope and curvature over the band. By choice: people differ in all of them."""
_LEAST_POINTS = 8
"""Fewest frequencies of the comparison. By choice: second differences of fewer say little of the noise."""

_NUMBERED = re.compile(r"(.*[^\d])\d+")
"""A name that ends with a number."""
_LEAST_PEOPLE = 3
"""Fewest groups of names that are compared. By choice: two people may differ little by accident."""
_MUCH_NEARER = 0.5
"""Ratio of the usual difference within groups of names to that between their means from which on nothing is said. By
choice: one finger that is put down again differs by a tenth to a third of what people differ by."""


def require_persons(subjects: Sequence[Subject], source: str) -> None:
    """Refuse files that are one person again and again.

    Parameters
    ----------
    subjects : sequence of Subject
        Named by their files; only those with a single recording, all on the same frequencies, are compared.
    source : str
        For the message.

    Raises
    ------
    InputError
        If they differ by less than :data:`ALIKE`.
    """
    apart = _apart_of(subjects)
    if apart is not None and apart < ALIKE:
        raise InputError(
            f"{source}: {len(subjects)} files are taken for as many subjects by their names, but apart from noise they "
            f"differ by less than {apart:.2g} of |z|, and people by tens of per cent: these seem to be one subject, "
            "recorded again and again; say which part of a name is the subject and which the repetition, for instance "
            "with --subject-from-name '(?P<subject>[^_]+)_(?P<repetition>\\d+)', or, if every file is another subject, "
            "with '(?P<subject>.+)'"
        )


def put_down_again(subjects: Sequence[Subject]) -> str | None:
    """A remark on subjects who differ by no more than one finger does that is put down again and again; else None.

    Parameters
    ----------
    subjects : sequence of Subject
        As for :func:`require_persons`, which has let them through.
    """
    apart = _apart_of(subjects)
    if apart is None or apart >= PUT_DOWN_AGAIN:
        return None
    return (
        f"{len(subjects)} subjects, named by their files, differ by less than {apart:.2g} of |z| apart from noise, as "
        "one finger does that is put down again, and people by tens of per cent: if they are one subject, say which "
        "part of a name is the subject and which the repetition with --subject-from-name"
    )


def _apart_of(subjects: Sequence[Subject]) -> float | None:
    """How far subjects with one recording each on the same frequencies differ; None of others, and of few."""
    frequency = subjects[0].frequency_hz
    if len(subjects) < LEAST_FILES or frequency.size < _LEAST_POINTS:
        return None
    if any(len(s.z) > 1 or not np.array_equal(s.frequency_hz, frequency) for s in subjects):
        return None
    return difference(frequency, np.array([s.z[0] for s in subjects]))


def repeated_by_name(subjects: Sequence[Subject]) -> str | None:
    """A remark on subjects whose names differ in a last number and who are much more alike than others; else None.

    Files of one person who was recorded several times, ``P1_1.csv`` and ``P1_2.csv``, are as many subjects if nothing
    is said of their names. The population would have twice as many people who come in pairs.

    Parameters
    ----------
    subjects : sequence of Subject
        As for :func:`require_persons`.
    """
    frequency = subjects[0].frequency_hz
    if any(len(s.z) > 1 or not np.array_equal(s.frequency_hz, frequency) for s in subjects):
        return None
    stems = [_NUMBERED.fullmatch(s.name) for s in subjects]
    if None in stems:
        return None
    people: dict[str, list[int]] = {}
    for i, match in enumerate(stems):
        people.setdefault(match[1] if match else "", []).append(i)
    if len(people) < _LEAST_PEOPLE or min(map(len, people.values())) < 2:
        return None
    log_z = np.log(np.array([s.z[0] for s in subjects]))
    within = np.concatenate([_apart(log_z[own], log_z[own]) for own in people.values()])
    means = np.array([log_z[own].mean(axis=0) for own in people.values()])
    if np.median(within) > _MUCH_NEARER * np.median(_apart(means, means)):
        return None
    first, second = (subjects[i].name for i in next(iter(people.values()))[:2])
    return (
        f"{len(subjects)} subjects have names in {len(people)} groups that differ in a last number, such as {first} "
        f"and {second}, and within a group they are much more alike: if a group is one person, give "
        r"--subject-from-name '(?P<subject>.+?)[^\dA-Za-z]*(?P<repetition>\d+)$'"
    )


def _apart(one: ComplexArray, other: ComplexArray) -> FloatArray:
    """Root mean square differences of log impedances (N, F) of all pairs, without those of a curve and itself."""
    turned = np.exp(one[:, None] - other[None])  # phases have no turns here
    square = np.mean(np.abs(np.log(turned)) ** 2, axis=-1)
    return np.asarray(np.sqrt(square[np.triu_indices(len(one), 1)]))


def difference(frequency_hz: FloatArray, z: ComplexArray) -> float:
    """Largest smooth relative difference between objects that their recordings (N, F) leave possible."""
    n, size = z.shape
    powers = np.vander(np.log(frequency_hz), _DEGREES, increasing=True)
    basis = np.linalg.qr(powers)[0].T * np.sqrt(size)
    curve = np.log(z / z.mean(axis=0))
    apart = curve - curve.mean(axis=0)
    square = float(np.sum(np.abs(apart @ basis.T / size) ** 2)) / (n - 1)
    noise = np.abs(np.diff(apart, 2, axis=1)) ** 2 / 6
    by_noise = float(np.sum(noise @ basis[:, 1:-1].T ** 2)) / size**2 / (n - 1)
    error = square / np.sqrt(_DEGREES * (n - 1))
    return float(np.sqrt(max(square - by_noise, 0.0) + 2 * error))
