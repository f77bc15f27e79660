"""Whether the names that a search has found hold, or stand together for physics that has none.

A search among names puts anything smooth together from enough of them: by Foster and Prony every passive one-port is a
sum of resonances or of relaxations. Three things give this away:

- what the names leave is not small beside what they explain, and a small network without a name does more than they;
- several relaxations or resonances are found, and structure remains even so;
- two different names may stand for what is at the same place of the body: tissue that neither describes.

Then the verdict says ``unknown``, and what was found stands in for it. That structure remains is not enough by itself:
of real recordings precise enough no model is left standing, and the names that explain most of them are worth having.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import combinations

from bayes_impedance.mismatch.confirm import gain
from bayes_impedance.mismatch.diagnosis import OnePort
from bayes_impedance.mismatch.entries import rivals
from bayes_impedance.mismatch.held_out import people_gain
from bayes_impedance.mismatch.model import Addition
from bayes_impedance.mismatch.refit import Refitter
from bayes_impedance.mismatch.search import Found
from bayes_impedance.mismatch.unknown import Realised, realise

SERIES_TERMS = ("rig.resonance", "body.relaxation", "body.resonator")
"""Entries of which a sum can be any passive one-port."""

ONE_PORTS = (
    "body.springpot",
    "body.hysteresis",
    "body.relaxation",
    "body.resonator",
    "body.mass",
    "body.line",
    "body.bypass",
)
"""Entries that say what the tissue at one place is made of."""

_NAMED_SHARE = 0.9
_FEWEST = 10


def names_that_hold(
    refitter: Refitter,
    found: Found,
    rest: Realised | None,
    remains: bool,
    one_ports: Sequence[OnePort],
    seed: int,
    executor: Executor,
) -> tuple[Found, Realised | None]:
    """What was found, with the names that do not hold taken back.

    Parameters
    ----------
    refitter : Refitter
    found : Found
    rest : Realised or None
        Small network for what no name explains.
    remains : bool
        Whether structure remains beside the names.
    one_ports : sequence of OnePort
        Missing at each place before anything was added, best place first.
    seed : int
    executor : Executor

    Returns
    -------
    found : Found
        Without names, if they do not hold.
    unknown : Realised or None
        What has no name: all of it if no names hold.
    """
    own = found.final.model.additions[len(found.base.model.additions) :]
    named = gain(found.final, found.base)
    if rest is not None and named < _NAMED_SHARE * (named + rest.trial.gain):
        alone = realise(refitter, found.base, found.steps[0].residuals, one_ports, seed, executor)
        if alone is not None and alone.trial.gain > named:
            return _without_names(found), alone
    a_sum = remains and sum(addition.effect.id in SERIES_TERMS for addition in own) > 1
    if (a_sum or _two_names_at_one_place(found, own)) and len(refitter.data) >= _FEWEST:
        trial = rest.trial if rest is not None else next(s.chosen for s in reversed(found.steps) if s.chosen)
        whole = rest.trial.fit if rest is not None else found.final
        total, se = people_gain(refitter, found.base, whole, seed)
        return _without_names(found), Realised(replace(trial, fit=whole, gain=gain(whole, found.base)), total, se)
    return found, rest


def _two_names_at_one_place(found: Found, own: Sequence[Addition]) -> bool:
    tissue = [(a.effect.id, _possible_places(found, a)) for a in own if a.effect.id in ONE_PORTS]
    return any(a != b and at & there for (a, at), (b, there) in combinations(tissue, 2))


def _possible_places(found: Found, addition: Addition) -> set[str]:
    """Its place, and those at which the recordings might as well have it or what they cannot tell it from."""
    step = found.step_of(addition)
    others = [] if step is None else rivals(step)
    return {addition.place} | {trial.candidate.place for trial, _, separated in others if not separated}


def _without_names(found: Found) -> Found:
    return Found(found.base, found.base, found.steps[:1], None)
