"""Recordings that contradict their declared sign or convention: a fit of them would fail later, or be all wrong.

Negative real parts alone are no contradiction: a lag or a filter of a channel causes them on an inertial load, at
nearly all frequencies. A wrong sign turns the phase of every point by 180 degrees, and complex conjugation reverses it;
Bode's relation between phase and magnitude shows both (:mod:`.phase_relation`).
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings import frequency_scale
from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.recordings.driving_point import sentence, verdict_of
from bayes_impedance.recordings.metadata import CONVENTIONS, DRIVING_POINT, HERTZ, SIGNS, Metadata
from bayes_impedance.recordings.phase_relation import excess_phase

WRONG_SIGN = 0.6
"""Fraction of points with Re z of the wrong sign above which the sign convention may be wrong. By choice: above one
half, the largest fraction that noise around zero gives."""
NEARLY_ALL = 0.95
"""The same for curves of few points or a narrow band, and those of which the phase does not say whether they are
turned. By choice: a wrong sign turns all points, up to those around zero; a lag, those of an inertial load."""

CLEARLY, SHARE = 0.1, 0.05
"""Re z below this share of -abs z is clearly negative (6 degrees), and the share of such points of a person above which
another quantity is looked for. By choice: an impedance of a passive load has none, and needs no explanation."""
OPPOSITE = (
    "the phase is opposite to that of the magnitude, and Re z too small to say why: these are complex conjugates, from "
    "the convention exp(-jwt), or force or motion is counted the other way"
)
"""What is said where :func:`is_opposite`, without what to do."""
_SOME = 3
"""Persons that are asked. By choice: one quantity is everybody's."""


class Plausibility:
    """Counts of points that contradict the declared sign or convention, over all subjects of a dataset."""

    def __init__(self) -> None:
        self.points = self.wrong = self.turned = self.conjugated = self.opposite = self.transfer = 0
        self.bands: set[frequency_scale.Band] = set()

    def add(self, subject: Subject) -> None:
        """Count the points of one subject."""
        wrong, size = int(np.sum(subject.z.real < 0)), subject.z.size
        self.points, self.wrong = self.points + size, self.wrong + wrong
        turned, conjugated = is_turned(subject), is_conjugate(subject)
        self.turned += size if turned else 0
        self.conjugated += size if conjugated else 0
        self.opposite += size if turned or conjugated or is_opposite(subject) else 0
        self.transfer += size if wrong > 0 and is_transfer(subject) else 0
        self.bands.add(frequency_scale.band_of(subject.frequency_hz))

    def require(self, metadata: Metadata, file: str, first_row: int, metadata_file: str) -> None:
        """Refuse a dataset that contradicts its metadata.

        A sign is refused if more than `WRONG_SIGN` of the points have negative real parts and most are turned. A
        convention is refused if most recordings are complex conjugates and none is declared: too large a mass or
        stiffness that was subtracted can do the same, and who declares the convention is believed. Transfer functions
        are refused if most recordings are clearly none of a driving point, unless that is declared; frequencies, if
        all bands seem to be in one other unit than Hz, unless Hz are declared.

        Parameters
        ----------
        metadata : Metadata
        file : str
        first_row : int
        metadata_file : str

        Raises
        ------
        InputError
        """
        if self.other_unit(metadata) in frequency_scale.SURELY:
            raise InputError(f"{file}: {self._about_unit(metadata, metadata_file)}")
        if metadata.place is None and self.transfer > 0.5 * self.points:
            raise InputError(
                f"{file}: {sentence(surely=True)}; record force and motion at one place, or, if they are of one, write "
                f'place = "{DRIVING_POINT}" in {metadata_file}, beside a file named recordings.csv'
            )
        wrong = self.wrong / max(self.points, 1)
        if wrong > WRONG_SIGN and self.turned > 0.5 * self.points:
            declared_positive = metadata.sign == SIGNS[0]
            remedy = SIGNS[1] if declared_positive else SIGNS[0]
            kind = "negative" if declared_positive else "positive"
            raise InputError(
                f"{file}: {wrong:.0%} of the rows (the first is row {first_row}) have a {kind} real part "
                f'although the sign is "{metadata.sign}"; if force or velocity was counted the other way, write '
                f'sign = "{remedy}" in {metadata_file}, beside a file named recordings.csv; if z is not force per '
                "velocity but per acceleration or displacement, convert it"
            )
        if metadata.convention is None and self.conjugated > 0.5 * self.points:
            raise InputError(
                f"{file}: the phase agrees with the slope of the magnitude only if its sign is reversed, from row "
                f"{first_row} on: these seem to be complex conjugates, from the convention exp(-jwt) or an analyser "
                f'that subtracts phases the other way; write convention = "{CONVENTIONS[1]}" in {metadata_file}, '
                f'beside a file named recordings.csv, and they are turned, or "{CONVENTIONS[0]}" if they are none'
            )
        if metadata.convention is None and self.opposite > 0.5 * self.points:
            raise InputError(
                f'{file}: {OPPOSITE}, from row {first_row} on; write convention = "{CONVENTIONS[1]}" in '
                f'{metadata_file}, beside a file named recordings.csv, and they are turned, or "{CONVENTIONS[0]}" if '
                "they are right"
            )

    def other_unit(self, metadata: Metadata) -> str | None:
        """The unit in which all frequencies seem to be, if it is not declared to be Hz and another fits better."""
        found = {frequency_scale.seems(band, metadata.unit) for band in self.bands}
        return next(iter(found)) if metadata.frequency_unit is None and len(found) == 1 else None

    def remarks(self, metadata: Metadata, metadata_file: str) -> tuple[str, ...]:
        """What may be wrong and is not refused, in sentences."""
        doubted = self.other_unit(metadata) is not None
        return (self._about_unit(metadata, metadata_file),) if doubted else ()

    def _about_unit(self, metadata: Metadata, metadata_file: str) -> str:
        other = self.other_unit(metadata)
        assert other is not None  # who asks has found one
        _, low, high, _ = min(self.bands)
        return (
            f"{frequency_scale.sentence(other, low, high)}; import the file with --frequency-unit {other}, or, if they "
            f'are in Hz, write frequency_unit = "{HERTZ}" in {metadata_file}, beside a file named recordings.csv'
        )


def is_transfer(subject: Subject) -> bool:
    """Whether a subject's curve is of no driving point."""
    return verdict_of(subject.frequency_hz, subject.mean) == "transfer"


def is_conjugate(subject: Subject) -> bool:
    """Whether the phase of a subject belongs to its magnitude only with the opposite sign."""
    found = excess_phase(subject.frequency_hz, subject.mean)
    return found is not None and found.cause == "conjugation"


def is_opposite(subject: Subject) -> bool:
    """Whether the phase is against that of the magnitude, and Re z too small to say whether by its sign or conjugation.

    So is that of a mass or spring with hardly any loss. Measured as in :mod:`.driving_point`: of 400 random structures
    each none is named, late or behind a filter of first or second order neither; with a mass subtracted in excess one,
    where 18 are called conjugates.
    """
    small = float(np.mean(subject.z.real > CLEARLY * np.abs(subject.z))) < SHARE
    if not small or np.mean(subject.z.real < 0) > WRONG_SIGN:
        return False
    found = excess_phase(subject.frequency_hz, subject.mean)
    return found is not None and found.cause == "sign"


def some_subjects(recordings: Recordings) -> list[Subject]:
    """The first, middle and last subject, or fewer."""
    n = len(recordings)
    return (
        [recordings.subjects[i] for i in sorted({round(k * (n - 1) / (_SOME - 1)) for k in range(_SOME)})] if n else []
    )


def negative_without_cause(recordings: Recordings) -> bool:
    """Whether Re z is clearly negative at enough points of some subjects that it may be another quantity."""
    shares = [_clearly_negative(subject) for subject in some_subjects(recordings)]
    return bool(shares) and float(np.median(shares)) > SHARE


def is_clearly_negative(subject: Subject) -> bool:
    """Whether Re z of a subject is clearly negative at more than a few points."""
    return _clearly_negative(subject) > SHARE


def _clearly_negative(subject: Subject) -> float:
    z = subject.mean
    return float(np.mean(z.real < -CLEARLY * np.abs(z)))


def is_turned(subject: Subject) -> bool:
    """Whether the impedance of a subject has the wrong sign."""
    wrong = float(np.mean(subject.z.real < 0))
    if wrong <= WRONG_SIGN:
        return False
    found = excess_phase(subject.frequency_hz, subject.mean)
    if found is None or found.cause is None:
        return wrong > NEARLY_ALL
    return found.cause == "sign"
