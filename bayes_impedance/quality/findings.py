"""What the checks say: one result of a check, and results that most recordings share put together."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from bayes_impedance.display import heading, joined, lines, short
from bayes_impedance.quality.negative_real_part import Explanation

COMMON = 0.5
"""Fraction of recordings above which an event at the same place is attributed to the apparatus and reported once. By
choice: subjects do not share such events."""
COMMON_MINIMUM = 4
"""Fewest recordings for this rule. By choice: of three recordings two are more than half, which may be chance."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One result of the checks that should be inspected.

    Attributes
    ----------
    id : str
        Kind: reading, network, subject_names, mark, not_passive, jump, outlier, duplicate_subject, odd_subject,
        repetition_spread, transfer, lag, phase_conjugated, phase_in_radians, magnitude_in_db, kramers_kronig,
        one_subject, one_repetition.
    severity : {"note", "warning"}
        A note says what cannot be estimated; a warning says what may be wrong.
    subject, repetition : str or None
        The recording concerned; None if the finding concerns all.
    frequency_hz : (float, float) or None
        Band in Hz; None if the finding concerns the whole curve.
    message : str
        One sentence with a remedy.
    """

    id: str
    severity: Literal["note", "warning"]
    subject: str | None
    repetition: str | None
    frequency_hz: tuple[float, float] | None
    message: str

    def __repr__(self) -> str:
        where = [self.subject or "all subjects"]
        where += [f"repetition {self.repetition}"] if self.repetition is not None else []
        where += ["{:.4g} to {:.4g} Hz".format(*self.frequency_hz)] if self.frequency_hz is not None else []
        return f"<Finding {self.id} ({self.severity}): {short(', '.join(where))}>"

    def _repr_html_(self) -> str:
        return joined(heading(repr(self).strip("<>")), lines([self.message]))


@dataclass(frozen=True)
class Event:
    """One fault at one place of one recording, before events are grouped into findings."""

    subject: str
    repetition: str
    band_hz: tuple[float, float]
    detail: str
    because: Explanation | None = None


def of_all(kind: str, message: str, subject: str | None = None) -> Finding:
    """A warning of whole curves, of everybody unless a subject is given."""
    return Finding(id=kind, severity="warning", subject=subject, repetition=None, frequency_hz=None, message=message)


def group(
    kind: str,
    events: list[Event],
    total: int,
    place: Callable[[Event], object],
    message: Callable[[str, str, list[Event]], str],
) -> Iterator[Finding]:
    """Make one finding of events that most recordings share, and one for each remaining recording.

    Parameters
    ----------
    kind : str
        `Finding.id`.
    events : list of Event
    total : int
        Number of recordings.
    place : callable
        Key of an event's place; events with equal keys count as the same.
    message : callable
        Makes the finding's text from the recordings concerned, the band, and the events.
    """
    by_place: dict[object, list[Event]] = {}
    for event in events:
        by_place.setdefault(place(event), []).append(event)
    rest: dict[tuple[str, str], list[Event]] = {}
    for same in by_place.values():
        recordings = {(event.subject, event.repetition) for event in same}
        if total >= COMMON_MINIMUM and len(recordings) > COMMON * total:
            band = _hull(same)
            whose = f"{len(recordings)} of {total} recordings"
            text = (
                f"{message(whose, _band(band), same)}; so many at once indicate a fault of the rig, not of the subjects"
            )
            yield Finding(id=kind, severity="warning", subject=None, repetition=None, frequency_hz=band, message=text)
            continue
        for event in same:
            rest.setdefault((event.subject, event.repetition), []).append(event)
    for (subject, repetition), own in rest.items():
        band = _hull(own)
        text = message(f'subject "{subject}", repetition "{repetition}"', _band(band), own)
        yield Finding(
            id=kind, severity="warning", subject=subject, repetition=repetition, frequency_hz=band, message=text
        )


def _hull(events: list[Event]) -> tuple[float, float]:
    return min(event.band_hz[0] for event in events), max(event.band_hz[1] for event in events)


def _band(band_hz: tuple[float, float]) -> str:
    low, high = (f"{value:.4g}" for value in band_hz)
    return f"at {low} Hz" if low == high else f"between {low} and {high} Hz"
