"""Which effects of the catalogue recordings can show.

An element that changes in the course of a sweep, or with the amplitude of the motion, multiplies the impedance of its
place by a real function of frequency. In one sweep of each person frequency, time and amplitude go together, and any
other dependence on frequency is the same curve. Such effects are offered where most people were recorded again.
"""

from __future__ import annotations

from collections.abc import Sequence

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.recordings.dataset import Recordings


def offered(effects: Sequence[Effect], recordings: Recordings) -> tuple[Effect, ...]:
    """The effects that such recordings can show, in their order."""
    again = sum(len(s.repetitions) > 1 for s in recordings.subjects)
    repeated = 2 * again > len(recordings.subjects)
    return tuple(effect for effect in effects if repeated or not effect.needs_repetitions)


def withheld(recordings: Recordings) -> tuple[str, ...]:
    """Ids of the catalogue's effects that such recordings cannot show."""
    kept = offered(registered(), recordings)
    return tuple(sorted({effect.id for effect in registered() if effect not in kept}))
