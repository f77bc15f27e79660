r"""An effect of the measurement chain with a second one, in the place of what a search has found.

The search names first what describes most alone. Of two effects that act together either one alone may describe less
than a third thing with more freedom: a layer with diffusion, of which everybody has their own, described 31 people by
535 better than a compliance of the mount did, left no structure, and stood for that compliance with a low-pass. The
two are one number each for everybody, and 87 ahead of the layer. Nothing leads there from the layer: no second name is
looked for, and with one name there is nothing beside which another could be chosen. What a second effect takes from the
first may be far more than it seems, because everybody's elements can stand in for it: the low-pass is 9 standard errors
of these recordings if all elements are free, and 620 units of log evidence in a population of them.

So if something else than effects of the chain has been found, the best effects of the chain (the same for all, one
number each) are gone on from as if each had been found first, with one step more: among the effects of the chain, or
among all if structure is left, for then what was found is not all, or not it. The two are taken as the sum of two
effects is anywhere (:mod:`.richer_law`): if people agree about it, and the log evidence is larger by more than
:data:`.compare.LEAST_GAIN` and, where they are more names than there were, the logarithm of the number among which the
second was chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN, compare, log_evidence
from bayes_impedance.diagnosis.selection.exchange import Way
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import ALPHA

_TRIED = 2
"""Effects of the chain that are gone on from, best first. By choice: of two that act together one describes most."""

_BEYOND = 2.0
"""Gain that is hoped for from a second effect, in what its score promises (half its square), which is that of the first
step of a refit. By choice: where elements have moved far to take its place it is more (1.4 of the low-pass above)."""


def of_the_chain(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects that are one number for everybody and take nobody's place."""
    return tuple(e for e in effects if e.side == "rig" and e.operation and len(e.coefficients) == 1)


def chain_first(
    way: Way,
    step_among: Callable[..., Way],
    names: Sequence[str],
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
) -> Way:
    """The way with an effect of the chain and a second one instead, if they are better than what it has found.

    It is the same way if they are not, or if it has found effects of the chain alone.

    Parameters
    ----------
    way : Way
        That has ended.
    step_among : callable
        Makes one more step from a way among `effects`.
    names : sequence of str
        Of the people.
    effects : sequence of Effect
        Candidates.
    seed : int
    executor : Executor
    """
    first, chain = way.steps[0], of_the_chain(effects)
    found = way.fit.model.additions[len(way.base.model.additions) :]
    if first.chosen is None or all(addition.effect in chain for addition in found):
        return way
    unshown = way.steps[-1].unshown  # the end of what was found, though it has no name
    alone = len(found) == 1 and unshown is None
    now = unshown.weighed if unshown else first.chosen.weighed if alone else way.fit
    here = log_evidence(now)
    offered = effects if way.steps[-1].log_p < np.log(ALPHA) else chain
    begun = [t for t in first.trials if t.effect in chain and t.physical and np.isfinite(t.gain)]
    for trial in sorted(begun, key=lambda t: -t.gain)[:_TRIED]:
        others = tuple(effect for effect in offered if effect is not trial.effect)
        screening = screen(trial.fit, tuple(person_residuals(trial.fit, names, executor)), others, seed, executor)
        score = float(np.max(np.where(screening.physical, np.nan_to_num(np.abs(screening.z)), 0.0), initial=0.0))
        if log_evidence(trial.fit) + _BEYOND * 0.5 * score**2 < here:
            continue
        # Without the others, of which one that leaves nothing would be taken at once.
        begun_with = replace(first, chosen=trial, trials=())
        longer = step_among(Way(way.base, trial.fit, (begun_with,)), effects=others)
        if longer.steps[-1].chosen is None:
            continue
        least = LEAST_GAIN + (np.log(longer.steps[-1].offered) if alone else 0.0)
        if compare(longer.fit, now).decided and log_evidence(longer.fit) - here > least:
            return replace(longer, steps=(replace(first, chosen=trial), *longer.steps[1:]))
    return way
