"""Comparison of whole curves: copies, outlying subjects, poor repeatability, and wrong units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.phase_relation import (
    BODE_CONTRAST,
    BODE_MINIMUM_DEG,
    LEAST_BAND,
    bode_phase,
    excess_phase,
)
from bayes_impedance.units import MAD_TO_SD

COPY_LIMIT = 1e-6
"""Relative difference of |z| below which recordings count as copies: rounding of an export with six or seven digits."""
COPY_CONTRAST = 0.02
"""Also copies: a difference below this fraction of the median distance of nearest neighbours, if there are enough of
them (exports with fewer digits). By choice: independent noise does not make two recordings fifty times closer."""
MINIMUM_SUBJECTS = 5
"""Fewest subjects for comparisons with the median. By choice: a median needs a majority of normal subjects."""
ODD_LIMIT = 8.0
"""Robust z-score above which a subject, or the spread of its repetitions, is reported. By choice far above 3, which the
largest of a hundred normal values reaches, because subjects are not normally distributed."""
ODD_FACTOR, ODD_PHASE_DEG, SPREAD_FACTOR = 2.0, 20.0, 4.0
"""Smallest differences that are reported in addition: a factor in magnitude, degrees in phase, a factor in spread. By
choice: for very similar subjects the robust standard deviation is small, and a harmless difference has a large
score."""

_BODE_POINTS = 60
"""Points of the grid of ln f for Bode's relation. By choice: a sixth of an octave for three decades."""
_COMPARED_POINTS = 40
"""Frequencies in the first comparison of pairs of curves. By choice, to save time: close pairs are then compared at all
frequencies."""
_NEIGHBOURS_OF = 400
"""Most recordings whose nearest neighbours are looked for, evenly spread over all. By choice: their median is known to
some percent, and a hundred thousand recordings take as long as all pairs of some thousand."""
_LEVEL_OF_COPIES, _SIMILAR = 2.0, 0.1
"""Largest difference of two copies' mean ln|z|, in units of the limit, where that is below the second number. A point's
relative difference d changes ln|z| by at most -ln(1 - d), and the mean of that over 40 points is less than twice the
root mean square of d even if they differ at one of them alone."""


@dataclass(frozen=True)
class Copy:
    """Two recordings that are copies.

    Attributes
    ----------
    subject, repetition, other_subject, other_repetition : str
    distance : float
        Root mean square difference relative to |z|.
    """

    subject: str
    repetition: str
    other_subject: str
    other_repetition: str
    distance: float


@dataclass(frozen=True)
class OddSubject:
    """A subject whose curve lies far from the others.

    Attributes
    ----------
    name : str
    factor : float
        Magnitude relative to the median subject, averaged over frequency.
    phase_deg : float
        Phase relative to the median subject in degrees, averaged over frequency.
    """

    name: str
    factor: float
    phase_deg: float


def duplicates(subjects: Sequence[Subject]) -> list[Copy]:
    """Return pairs of recordings that are identical or nearly so.

    Parameters
    ----------
    subjects : sequence of Subject
        Only recordings on the same frequencies are compared.

    Returns
    -------
    list of Copy
        Each recording appears at most once as the second of a pair.
    """
    by_grid: dict[bytes, list[Subject]] = {}
    for subject in subjects:
        by_grid.setdefault(subject.frequency_hz.tobytes(), []).append(subject)
    copies: list[Copy] = []
    for group in by_grid.values():
        copies.extend(_duplicates_on_grid(group))
    return copies


def _duplicates_on_grid(subjects: Sequence[Subject]) -> list[Copy]:
    labels = [(subject.name, repetition) for subject in subjects for repetition in subject.repetitions]
    z = np.concatenate([subject.z for subject in subjects])
    # Pairs are compared at few frequencies first, and only those of nearly the same level.
    some = z[:, np.unique(np.linspace(0, z.shape[1] - 1, _COMPARED_POINTS).astype(int))]
    limit = _limit_of_copies(some)
    level = np.log(np.maximum(np.abs(some), np.finfo(float).tiny)).mean(axis=1)
    order = np.argsort(level, kind="stable")
    reach = _LEVEL_OF_COPIES * limit if limit < _SIMILAR else np.inf
    stops = np.searchsorted(level[order], level[order] + reach, "right")
    pairs: list[tuple[int, int]] = []
    for place, i in enumerate(order.tolist()):
        near = order[place + 1 : stops[place]]
        one, other = np.minimum(i, near), np.maximum(i, near)
        close = _distance(some[one], some[other]) <= limit
        pairs += zip(one[close].tolist(), other[close].tolist(), strict=True)
    copies: dict[int, Copy] = {}
    for i, j in sorted(pairs):
        exact = float(_distance(z[i], z[j][None])[0])
        if exact <= limit:
            copies.setdefault(j, Copy(*labels[i], *labels[j], exact))
    return list(copies.values())


def _limit_of_copies(some: ComplexArray) -> float:
    """Distance up to which two of R curves (R, F) are copies, by how far the nearest other one typically is."""
    if len(some) < MINIMUM_SUBJECTS:
        return COPY_LIMIT
    asked = np.unique(np.linspace(0, len(some) - 1, min(len(some), _NEIGHBOURS_OF)).round().astype(int))
    nearest = [
        min(_distance(some[i], some[part]).min(initial=np.inf) for part in _without(i, len(some))) for i in asked
    ]
    return max(COPY_LIMIT, COPY_CONTRAST * float(np.median(nearest)))


def _without(i: int, n: int) -> tuple[slice, slice]:
    return slice(0, i), slice(i + 1, n)


def _distance(one: ComplexArray, others: ComplexArray) -> FloatArray:
    """Return the root mean square relative difference of a curve (F,), or of R, to others (R, F), shape (R,)."""
    size = np.maximum(np.abs(one), np.finfo(float).tiny)
    distance: FloatArray = np.sqrt(np.mean(np.abs((others - one) / size) ** 2, axis=-1))
    return distance


def odd_subjects(subjects: Sequence[Subject]) -> list[OddSubject]:
    """Return subjects whose whole curve is far from the others in magnitude or phase.

    Parameters
    ----------
    subjects : sequence of Subject
        At least `MINIMUM_SUBJECTS` whose frequency bands overlap, else nothing is returned.

    Returns
    -------
    list of OddSubject
    """
    if len(subjects) < MINIMUM_SUBJECTS:
        return []
    low = max(float(subject.frequency_hz[0]) for subject in subjects)
    high = min(float(subject.frequency_hz[-1]) for subject in subjects)
    if low >= high:
        return []
    x = np.linspace(np.log(low), np.log(high), _COMPARED_POINTS)
    curves = np.array([_log_curve(subject, x) for subject in subjects])
    away = curves - (np.median(curves.real, axis=0) + 1j * np.median(curves.imag, axis=0))
    magnitude, phase = away.real.mean(axis=1), np.rad2deg(away.imag.mean(axis=1))
    far = (_robust_score(magnitude) > _limit(len(subjects))) & (np.abs(magnitude) > np.log(ODD_FACTOR))
    far |= (_robust_score(phase) > _limit(len(subjects))) & (np.abs(phase) > ODD_PHASE_DEG)
    return [
        OddSubject(subjects[i].name, float(np.exp(magnitude[i])), float(phase[i])) for i in np.flatnonzero(far).tolist()
    ]


def _log_curve(subject: Subject, x: FloatArray) -> ComplexArray:
    """Return ln|z| + j phase of a subject's mean at log frequencies, with the phase unwrapped, in radians."""
    own, z = np.log(subject.frequency_hz), subject.mean
    phase = np.unwrap(np.angle(z))
    # Unwrapping leaves multiples of 2 pi undetermined; passive phases are around zero.
    phase -= 2 * np.pi * np.round(np.median(phase) / (2 * np.pi))
    log_curve: ComplexArray = np.interp(x, own, _log_magnitude(z)) + 1j * np.interp(x, own, phase)
    return log_curve


def _log_magnitude(z: ComplexArray) -> FloatArray:
    log_magnitude: FloatArray = np.log(np.maximum(np.abs(z), np.finfo(float).tiny))
    return log_magnitude


def _robust_score(values: FloatArray) -> FloatArray:
    """Return distances from the median in units of the robust standard deviation."""
    distance = np.abs(values - np.median(values))
    score: FloatArray = distance / max(MAD_TO_SD * float(np.median(distance)), np.finfo(float).tiny)
    return score


def _limit(count: int) -> float:
    """Return the limit for a robust score; the median distance of few values is often small by chance."""
    return ODD_LIMIT * (1 + 2 * MINIMUM_SUBJECTS / count)


def repetition_spreads(subjects: Sequence[Subject]) -> list[tuple[str, float, float]]:
    """Return subjects whose repetitions differ much more than those of the others.

    Parameters
    ----------
    subjects : sequence of Subject
        At least `MINIMUM_SUBJECTS` with two repetitions or more, else nothing is returned.

    Returns
    -------
    list of (str, float, float)
        Name, standard deviation between its repetitions relative to |z| (median over frequency), and the median of
        all subjects.
    """
    repeated = [subject for subject in subjects if len(subject.repetitions) > 1]
    if len(repeated) < MINIMUM_SUBJECTS:
        return []
    spread = np.array([_spread(subject) for subject in repeated])
    usual = float(np.median(spread))
    if usual == 0:
        return []
    log_spread = np.log(np.maximum(spread, np.finfo(float).tiny))
    far = (_robust_score(log_spread) > _limit(len(repeated)) / 2) & (spread > SPREAD_FACTOR * usual)
    return [(repeated[i].name, float(spread[i]), usual) for i in np.flatnonzero(far).tolist()]


def _spread(subject: Subject) -> float:
    mean = np.maximum(np.abs(subject.mean), np.finfo(float).tiny)
    return float(np.median(subject.z.std(axis=0, ddof=1) / mean))


def suspect_units(subjects: Sequence[Subject], polar: bool = True) -> tuple[str, ...]:
    """Return the conventions that the data seem to violate: linear magnitude, phase in degrees, exp(+jwt).

    The phase of a passive one-port without excess delay follows from its magnitude (see `bode_phase`), to a few degrees
    within a band. If the relation fails, but holds for a magnitude converted from dB or a phase converted from radians,
    that unit is reported. A magnitude far above 20 dB together with a phase in radians resembles a damper and is not
    detected. If it holds for the negative phase, the recordings are complex conjugates (convention exp(-j w t)).

    Parameters
    ----------
    subjects : sequence of Subject
        Those whose band is wider than a factor of four are used.
    polar : bool
        Whether the data were given as magnitude and phase; units are not checked for real and imaginary parts.

    Returns
    -------
    tuple of str
        Any of "phase_in_radians" and "magnitude_in_db", or "phase_conjugated" alone.
    """
    phases, linear, decibel = [], [], []
    for subject in subjects:
        own, z = np.log(subject.frequency_hz), subject.mean
        if own[-1] - own[0] < np.log(LEAST_BAND):
            continue
        x = np.linspace(own[0], own[-1], _BODE_POINTS)
        step = float(x[1] - x[0])
        linear.append(bode_phase(np.interp(x, own, _log_magnitude(z)), step))
        decibel.append(bode_phase(np.interp(x, own, np.abs(z)) * np.log(10) / 20, step))
        phases.append(np.interp(x, own, np.unwrap(np.angle(z))))
    if not phases:
        return ()
    phase, from_linear, from_decibel = (np.rad2deg(np.median(rows, axis=0)) for rows in (phases, linear, decibel))
    misfit: dict[tuple[str, ...], float] = {
        (): _rms(_without_turns(phase - from_linear)),
        ("phase_conjugated",): _rms(_without_turns(phase + from_linear)),
    }
    if polar:
        misfit["magnitude_in_db",] = _rms(phase - from_decibel)
    largest = max(float(np.abs(np.angle(subject.z)).max()) for subject in subjects)
    # Passive phases in radians are at most pi/2; twice that allows for noise and faults.
    if polar and largest < np.deg2rad(np.pi):
        in_radians = np.rad2deg(phase)
        misfit["phase_in_radians",] = _rms(in_radians - from_linear)
        misfit["phase_in_radians", "magnitude_in_db"] = _rms(in_radians - from_decibel)
    best = min(misfit, key=lambda suspects: misfit[suspects])
    return best if misfit[()] > max(BODE_MINIMUM_DEG, BODE_CONTRAST * misfit[best]) else ()


def _without_turns(difference_deg: FloatArray) -> FloatArray:
    """Without the whole turns that all points have: where a measured phase begins at -144 degrees, it is 216 too."""
    shifted: FloatArray = difference_deg - 360.0 * np.round(np.median(difference_deg) / 360.0)
    return shifted


def conjugated_repetitions(subject: Subject) -> tuple[str, ...]:
    """Return the repetitions of one person that seem to be complex conjugates, whatever the others' are.

    :func:`suspect_units` looks at the median person and does not see one file in the other convention. The magnitude
    of such a file is right, and so is the mean of its phase where a resonance is in the middle of the band, so that
    it need not lie far from the others. Curves of few points or a narrow band say nothing
    (:func:`~bayes_impedance.recordings.phase_relation.excess_phase`).
    """
    causes = [excess_phase(subject.frequency_hz, z) for z in subject.z]
    return tuple(
        repetition
        for repetition, cause in zip(subject.repetitions, causes, strict=True)
        if cause is not None and cause.cause == "conjugation"
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
