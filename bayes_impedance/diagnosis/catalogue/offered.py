"""Which effects of the catalogue recordings can show.

An element that changes in the course of a sweep, or with the amplitude of the motion, multiplies the impedance of its
place by a real function of frequency. In one sweep of each person frequency, time and amplitude go together, and any
other dependence on frequency is the same curve. Such effects are offered where most people were recorded again. An
element that follows its own motion is always offered: its function of frequency is the network's
(:mod:`bayes_impedance.diagnosis.selection.one_sweep`).

**Direction of sweeps.** With q, the part of a sweep's time that has passed, an element that changes by exp(x q)
has at each frequency, in a sweep downwards, 1 - q of the sweep upwards (the time law is the same read from the other
end). So exp(x (1 - q)) = exp(x) exp(-x q): downwards the same curve describes it, of a change -x, and the element at
the low end of the band is that at the end of the sweep. In sweeps of both directions it is two curves, which one effect
for all repetitions does not describe, and it is not offered. Directions are those noted in ``repetitions.csv``
(:func:`bayes_impedance.recordings.circumstances.sweep_directions`); without them sweeps are taken to go upwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.recordings.circumstances import DOWN, UP, sweep_directions
from bayes_impedance.recordings.dataset import Recordings

_DURING = "sweep"
"""Operation of what changes during a sweep."""


def offered(effects: Sequence[Effect], recordings: Recordings) -> tuple[Effect, ...]:
    """The effects that such recordings can show, in their order."""
    repeated, both = _repeated(recordings), _both(recordings)
    return tuple(
        effect
        for effect in effects
        if (repeated or not effect.needs_repetitions) and not (both and effect.operation == _DURING)
    )


def withheld(recordings: Recordings) -> tuple[str, ...]:
    """Ids of the catalogue's effects that such recordings cannot show."""
    kept = offered(registered(), recordings)
    return tuple(sorted({effect.id for effect in registered() if effect not in kept}))


def not_shown(recordings: Recordings) -> tuple[str, ...]:
    """The same with the reason, in words."""
    why = "in sweeps of both directions" if _repeated(recordings) else "in one sweep of each"
    still = {effect.id for effect in offered(registered(), recordings)}
    others = dict.fromkeys(still, " by any other law than that of its own motion")
    return tuple(f"{name}{others.get(name, '')} {why}" for name in withheld(recordings))


def about_direction(recordings: Recordings, found: Sequence[str]) -> tuple[str, ...]:
    """What the noted directions of sweeps mean for a verdict, in sentences.

    Parameters
    ----------
    recordings : Recordings
    found : sequence of str
        Ids of the effects that were found.
    """
    changing = {effect.id for effect in registered() if effect.operation == _DURING}
    directions = sweep_directions(recordings.subjects)
    if _both(recordings):
        return (
            "Sweeps of both directions are noted. What changes during a sweep is another curve in each of them and was "
            "not looked for; an element that follows the direction from repetition to repetition, or the amplitude, "
            "may be that. A dataset of the sweeps of one direction shows it.",
        )
    if directions == {DOWN} and changing & set(found):
        return (
            "All sweeps are noted to go downwards. The change of what changes during the sweep is from the low end of "
            "the band to the high one: in time it has the opposite sign.",
        )
    return ()


def _repeated(recordings: Recordings) -> bool:
    return recorded_again([len(s.repetitions) for s in recordings.subjects])


def recorded_again(repetitions: Sequence[int] | np.ndarray) -> bool:
    """Whether most people were recorded more than once, from the number of each one's recordings."""
    return bool(2 * np.sum(np.asarray(repetitions) > 1) > len(repetitions))


def _both(recordings: Recordings) -> bool:
    return sweep_directions(recordings.subjects) == {UP, DOWN}
