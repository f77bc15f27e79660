"""Recordings that may be of no driving point; those that surely are not are refused when they are read."""

from __future__ import annotations

from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.recordings.driving_point import doubts, verdict_of


def doubts_of_place(recordings: Recordings) -> tuple[str | None, str] | None:
    """The subject if it is one, and what is said; None if nothing speaks against a driving point, or it is declared."""
    if recordings.place is not None:
        return None
    verdicts = {one.name: verdict_of(one.frequency_hz, one.mean) for one in recordings.subjects}
    said = doubts(verdicts)
    if said is None:
        return None
    found = [name for name, verdict in verdicts.items() if verdict != "driving"]
    one = found[0] if len(found) == 1 else None
    return one, f"{said}; check that force and motion are of one place"
