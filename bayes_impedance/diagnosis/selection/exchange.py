"""Rivals of earlier additions, to be looked at again when later ones are known.

The first step names what explains most while everything else is still missing. There an effect with more freedom can
win because it takes part of the other effect's place: beside a high-pass that had not been found yet, a resonator that
differs between people was 7500 nats ahead of a resonance of the rig; with the high-pass it is 56 behind. So after the
search, each step's rivals are followed by the effects of the later additions, and if these describe more together than
what was found, the search goes on from the rival.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.selection.shortlist import Trial
from bayes_impedance.diagnosis.selection.step import Step

_MOST = 2
"""Rivals of each step that are tried. By choice: each costs a step of the search for every later addition."""

_SHARE = 0.5
"""Fraction of the choice's gain that a rival must have. By choice: what explains less than half of it is not what the
choice stands for."""


def rival_beginnings(steps: Sequence[Step]) -> Iterator[tuple[list[Step], tuple[Effect, ...]]]:
    """Beginnings of a search in which the last choice is a rival, each with the effects that were added later.

    Parameters
    ----------
    steps : sequence of Step
        Of a search.
    """
    made = [step for step in steps if step.chosen is not None]
    for k, step in enumerate(made[:-1]):
        later = dict.fromkeys(s.chosen.effect for s in made[k + 1 :] if s.chosen is not None)
        for rival in _rivals(step):
            if rival.effect not in later:
                yield [*made[:k], replace(step, chosen=rival)], tuple(later)


def _rivals(step: Step) -> list[Trial]:
    """The best other explanations of a step, each at its best place."""
    assert step.chosen is not None  # the caller has only steps with a choice
    best: dict[str, Trial] = {}
    for trial in sorted(step.trials, key=lambda t: -np.nan_to_num(t.gain, nan=-np.inf)):
        enough = trial.physical and trial.gain > _SHARE * step.chosen.gain
        if enough and trial.effect != step.chosen.effect:
            best.setdefault(trial.effect.id, trial)
    return list(best.values())[:_MOST]
