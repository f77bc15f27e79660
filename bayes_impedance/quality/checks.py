"""Checks of recordings before a model is fitted to them.

Each check looks for one fault that biases a population estimate without making it fail: an inverted sign, a gain
switch, a copied file, a subject measured in another unit. Limits are conservative, so that clean data give no warning.
The interpretation of a finding is left to the user, and no data are removed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from dataclasses import replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.quality import point_anomalies
from bayes_impedance.quality.curve_anomalies import (
    conjugated_repetitions,
    duplicates,
    odd_subjects,
    repetition_spreads,
    suspect_units,
)
from bayes_impedance.quality.findings import COMMON, COMMON_MINIMUM, Event, Finding, group, of_all
from bayes_impedance.quality.kramers_kronig import Violation, violations
from bayes_impedance.quality.late_channel import late_channel
from bayes_impedance.quality.marks import Mark, marks
from bayes_impedance.quality.negative_real_part import explain, sentence
from bayes_impedance.quality.place import doubts_of_place
from bayes_impedance.recordings.dataset import Recordings, Subject, require_recordings
from bayes_impedance.runtime.user_table import shown

_EXPLAIN_PARTS = ("not_passive", "jump", "lag", "phase_conjugated", "phase_in_radians", "magnitude_in_db")
"""Findings of faults that also part the real from the imaginary part: one fault is reported once."""


def check_recordings(recordings: Recordings) -> tuple[Finding, ...]:
    """Run all checks.

    Parameters
    ----------
    recordings : Recordings
        One subject and one repetition are enough; recordings of few points are not searched for outliers and jumps.

    Returns
    -------
    tuple of Finding
        Warnings first, beginning with what was changed or ignored when the files were read; empty if there is none.
    """
    require_recordings(recordings)
    read = [*_check_reading(recordings), *_check_network(recordings), *_check_names(recordings)]
    if not recordings.subjects:
        return tuple(read)
    found, where = marks(recordings.subjects)
    # Points marked as missing are one fault: they are not checked for others.
    unmarked = tuple(
        replace(subject, z=point_anomalies.without(subject.frequency_hz, subject.z, off)) if off.any() else subject
        for subject, off in zip(recordings.subjects, where, strict=True)
    )
    recordings = replace(recordings, subjects=unmarked)
    curves = [*map(_mark_finding, found), *_check_curves(recordings)]
    # A jump in one repetition makes the repetitions differ, which is not a second fault.
    jumped = {finding.subject for finding in curves if finding.id == "jump"}
    whole = [
        *_check_place(recordings, any(finding.id == "not_passive" for finding in curves)),
        *_check_units(recordings, curves),
    ]
    findings = [
        *read,
        *curves,
        *_check_duplicates(recordings),
        *_check_odd_subjects(recordings),
        *(finding for finding in _check_repetition_spread(recordings) if finding.subject not in jumped),
        *whole,
        *_check_parts(recordings, [*curves, *whole]),
        *_check_size(recordings),
    ]
    return tuple(sorted(findings, key=lambda finding: finding.severity == "note"))


def describe(recordings: Recordings) -> dict[str, object]:
    """Return a summary of a dataset in plain types.

    Parameters
    ----------
    recordings : Recordings

    Returns
    -------
    dict
        `title`, `unit`, `network`, `sha256`; `subjects`, a count; `repetitions`, `points`, `frequency_hz` and
        `magnitude`, each a list of smallest and largest, the last in the dataset's unit; `covariates`, their names.
    """
    subjects = recordings.subjects

    def extent(values: Callable[[Subject], Iterable[float]]) -> list[float] | None:
        ends = [value for subject in subjects for value in values(subject)]
        return [min(ends), max(ends)] if ends else None

    def magnitude(subject: Subject) -> tuple[float, float]:
        size = np.abs(subject.z)
        return float(size.min()), float(size.max())

    return {
        "title": recordings.title,
        "unit": recordings.unit,
        "network": recordings.network,
        "subjects": len(recordings),
        "repetitions": extent(lambda subject: [len(subject.repetitions)]),
        "points": extent(lambda subject: [subject.frequency_hz.size]),
        "frequency_hz": extent(lambda subject: (float(subject.frequency_hz[0]), float(subject.frequency_hz[-1]))),
        "magnitude": extent(magnitude),
        "covariates": sorted({name for subject in subjects for name in subject.covariates}),
        "sha256": recordings.sha256,
    }


def _check_reading(recordings: Recordings) -> Iterator[Finding]:
    """What was changed, dropped or not used when the files were read."""
    for warning in recordings.warnings:
        yield of_all("reading", warning)


def _check_names(recordings: Recordings) -> Iterator[Finding]:
    """Report subjects whose names differ only in case, spaces or underscores: one person may be two."""
    alike: dict[str, list[str]] = {}
    for name in recordings.names:
        alike.setdefault(re.sub(r"[\s_-]", "", name).casefold(), []).append(name)
    for names in alike.values():
        if len(names) > 1:
            message = (
                f"subjects {' and '.join(map(shown, names))} have names that differ only in case, spaces, underscores "
                "or hyphens; if they are one subject, give all of its rows one name"
            )
            yield of_all("subject_names", message, names[1])


def _check_network(recordings: Recordings) -> Iterator[Finding]:
    """Report a network notation that cannot be read: it would stop any fit that does not name another."""
    try:
        parse(recordings.network or "m1")
    except InputError as error:
        message = f"dataset.toml: the network cannot be used ({error}); correct it"
        yield of_all("network", message)


def _mark_finding(mark: Mark) -> Finding:
    subject, repetition, frequency = mark.points[0]
    value = f"{mark.value:g}" if mark.value.imag else f"{mark.value.real:g}"
    recordings = {point[:2] for point in mark.points}
    one = len(recordings) == 1
    many = "1 point" if len(mark.points) == 1 else f"{len(mark.points)} points"
    many += "" if one else f" of {len(recordings)} recordings"
    low, high = min(point[2] for point in mark.points), max(point[2] for point in mark.points)
    return Finding(
        id="mark",
        severity="warning",
        subject=subject if one else None,
        repetition=repetition if one else None,
        frequency_hz=(low, high),
        message=f'{mark.part} is exactly {value} at {many}, far from the curve around (the first: subject "{subject}", '
        f'repetition "{repetition}", {frequency:.4g} Hz); this looks like a code for missing data or a stuck channel: '
        "leave the cells empty",
    )


def _check_curves(recordings: Recordings) -> Iterator[Finding]:
    """Search every recording for outliers, jumps and stretches that are not passive."""
    outliers: list[Event] = []
    jumps: list[Event] = []
    stretches: list[Event] = []
    for subject in recordings.subjects:
        f, names = subject.frequency_hz, subject.repetitions
        off = point_anomalies.outliers(f, subject.z)
        clean = point_anomalies.without(f, subject.z, off)
        found, step = point_anomalies.jumps(f, clean)
        for j, i in np.argwhere(off).tolist():
            outliers.append(Event(subject.name, names[j], (float(f[i]), float(f[i])), ""))
        for j, i in np.argwhere(found).tolist():
            size = f"a factor of {np.exp(step[j, i].real):.3g} and {np.rad2deg(step[j, i].imag):.3g} deg"
            jumps.append(Event(subject.name, names[j], (float(f[i]), float(f[i + 1])), size))
        for j, runs in enumerate(point_anomalies.not_passive(f, clean)):
            because = explain(f, clean[j]) if runs else None
            for first, last in runs:
                part = float(np.mean(clean[j, first : last + 1].real / np.abs(clean[j, first : last + 1])))
                band = float(f[first]), float(f[last])
                stretches.append(Event(subject.name, names[j], band, f"{part:.2g}", because))
    total = sum(len(subject.repetitions) for subject in recordings.subjects)
    yield from group("not_passive", stretches, total, lambda _: "all", _not_passive_message)
    yield from group("jump", jumps, total, lambda event: event.band_hz, _jump_message)
    yield from group("outlier", outliers, total, lambda event: event.band_hz, _outlier_message)


def _not_passive_message(whose: str, where: str, events: list[Event]) -> str:
    worst = min(events, key=lambda event: float(event.detail)).detail
    by_recording = {(e.subject, e.repetition): e.because for e in events if e.because is not None}
    return sentence(whose, where, worst, list(by_recording.values()))


def _jump_message(whose: str, where: str, events: list[Event]) -> str:
    places = {event.band_hz for event in events}
    count = "a jump" if len(places) == 1 else f"{len(places)} jumps"
    size = f" by {events[0].detail}" if len(events) == 1 else ""
    return (
        f"{whose}: {count} of z{size} {where} (a lasting step); "
        "check gain range, phase sign and splicing of sweeps there, and correct or delete the part"
    )


def _outlier_message(whose: str, where: str, events: list[Event]) -> str:
    places = {event.band_hz for event in events}
    count = "1 point is far from its" if len(places) == 1 else f"{len(places)} points are far from their"
    return (
        f"{whose}: {count} neighbours {where}; check for mains hum and contact loss, and delete the rows that are wrong"
    )


def _check_duplicates(recordings: Recordings) -> Iterator[Finding]:
    for pair in duplicates(recordings.subjects):
        same = "identical" if pair.distance == 0 else f"the same within {pair.distance:.1g} of |z|"
        if pair.subject == pair.other_subject:
            whose = f'subject "{pair.subject}": repetitions "{pair.repetition}" and "{pair.other_repetition}"'
        else:
            whose = (
                f'subjects "{pair.subject}" (repetition "{pair.repetition}") and "{pair.other_subject}" '
                f'(repetition "{pair.other_repetition}")'
            )
        yield Finding(
            id="duplicate_subject",
            severity="warning",
            subject=pair.other_subject,
            repetition=pair.other_repetition,
            frequency_hz=None,
            message=f"{whose} are {same}; look for a file that was copied or exported twice and delete one",
        )


def _check_odd_subjects(recordings: Recordings) -> Iterator[Finding]:
    for odd in odd_subjects(recordings.subjects):
        yield Finding(
            id="odd_subject",
            severity="warning",
            subject=odd.name,
            repetition=None,
            frequency_hz=None,
            message=f'subject "{odd.name}": the whole curve is far from the others ({odd.factor:.3g} times the median '
            f"magnitude, {odd.phase_deg:+.3g} deg); "
            "check unit, sign and calibration of this recording, or leave the subject out",
        )


def _check_repetition_spread(recordings: Recordings) -> Iterator[Finding]:
    for name, spread, usual in repetition_spreads(recordings.subjects):
        yield Finding(
            id="repetition_spread",
            severity="warning",
            subject=name,
            repetition=None,
            frequency_hz=None,
            message=f'subject "{name}": the repetitions differ by {spread:.2g} of |z| where {usual:.2g} is usual; '
            "check that all are of the same subject and contact, and delete the faulty one",
        )


def _check_place(recordings: Recordings, explained: bool) -> Iterator[Finding]:
    """Force and motion of two places, or of two times, unless negative real parts are `explained` by that."""
    late = None if explained else late_channel(recordings)
    for kind, found in (("transfer", doubts_of_place(recordings)), ("lag", late)):
        if found is not None:
            yield of_all(kind, found[1], found[0])


def _check_units(recordings: Recordings, found: Sequence[Finding]) -> Iterator[Finding]:
    suspects = suspect_units(recordings.subjects, recordings.polar)
    if "phase_conjugated" in suspects:
        yield of_all(
            "phase_conjugated",
            "the phase agrees with the slope of the magnitude only if its sign is reversed; these seem to be "
            "complex conjugates, from the convention exp(-jwt) or from an analyser that subtracts phases the other "
            "way: change the sign of the imaginary part or of the phase",
        )
    if not suspects:
        yield from _check_conjugated(recordings, {finding.subject for finding in found})
    if "phase_in_radians" in suspects:
        yield of_all(
            "phase_in_radians",
            "the phases lie within 3.2 deg although such magnitudes have much larger ones; "
            "if the column phase_deg is in radians, multiply it by 180/pi",
        )
    if "magnitude_in_db" in suspects:
        yield of_all(
            "magnitude_in_db",
            "the slope of the magnitude agrees with the phase only if the magnitude is in dB; "
            "if it is, convert the column to 10^(dB/20)",
        )


def _check_conjugated(recordings: Recordings, faulty: Set[str | None]) -> Iterator[Finding]:
    """Single recordings that are complex conjugates, where those of the median person are not.

    A jump or a turned sign of part of a curve can look like one: `faulty` subjects have findings and are left out.
    """
    for subject in recordings.subjects:
        turned = () if subject.name in faulty else conjugated_repetitions(subject)
        if not turned:
            continue
        named = ", ".join(map(shown, turned))
        which = "" if turned == subject.repetitions else f", repetition{'s' if len(turned) > 1 else ''} {named}"
        message = (
            f"subject {shown(subject.name)}{which}: the phase agrees with the slope of the magnitude only if its sign "
            "is reversed, unlike that of the others; this seems to be a complex conjugate, from the convention "
            "exp(-jwt): change the sign of its imaginary part or phase"
        )
        yield of_all("phase_conjugated", message, subject.name)


def _check_parts(recordings: Recordings, found: Sequence[Finding]) -> Iterator[Finding]:
    """Real and imaginary part that do not belong together, where nothing that was found explains it."""
    explaining = {finding.subject for finding in found if finding.id in _EXPLAIN_PARTS}
    if None in explaining:
        return
    rest = [subject for subject in recordings.subjects if subject.name not in explaining]
    violating, tested = violations(rest)
    if tested >= COMMON_MINIMUM and len(violating) > COMMON * tested:
        worst = max(violating, key=lambda one: one.misfit)
        whose = f'{len(violating)} of {tested} subjects (the worst: subject "{worst.subject}")'
        more = "; so many at once indicate a fault of the rig or of the export, not of the subjects"
        yield of_all("kramers_kronig", _parts_message(whose, worst) + more)
        return
    for one in violating:
        yield of_all("kramers_kronig", _parts_message(f'subject "{one.subject}"', one), one.subject)


def _parts_message(whose: str, one: Violation) -> str:
    return (
        f"{whose}: real and imaginary part do not belong together: they are {one.misfit:.2g} of |z| away from any "
        "linear system that is causal and stays the same during the sweep (Kramers-Kronig relations), with noise of "
        f"{one.noise:.2g}; look for drift during the sweep, for a part or phase that was scaled, shifted by rows or "
        "turned"
    )


def _check_size(recordings: Recordings) -> Iterator[Finding]:
    if len(recordings) == 1:
        yield Finding(
            id="one_subject",
            severity="note",
            subject=recordings.subjects[0].name,
            repetition=None,
            frequency_hz=None,
            message="there is one subject, so that the dispersion between subjects cannot be estimated; "
            "add subjects to estimate it",
        )
    if recordings.repetitions_max == 1:
        known = all(subject.noise_sd is not None for subject in recordings.subjects)
        rough = "" if known else " and the noise is estimated from the roughness of the curves only"
        yield Finding(
            id="one_repetition",
            severity="note",
            subject=None,
            repetition=None,
            frequency_hz=None,
            message="each subject was measured once, so that the dispersion between repetitions cannot be estimated"
            f"{rough}; repeat the measurements to estimate {'it' if known else 'both'}",
        )
