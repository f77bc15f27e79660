"""One richer law in the place of a simple one that leaves structure, before a second name is looked for.

A process that relaxes with many time constants, such as a power law that ends in a spring, is nearly a power law, or
one relaxation, over a part of the band. Whichever of the two is found first leaves structure, a second name takes that
up, and two names stand for one thing. A law with one parameter more (:attr:`.Effect.refines`) describes it alone.

It contains the simple laws, or comes near to them, so that among the candidates of every step it would be another name
for each of them, which recordings that ask for nothing richer cannot exclude. So it is tried only where a simple one
has been chosen and leaves structure. It is taken if it is better, leaves no structure itself, and is not excluded by
the simple law with the further effect that the search finds beside it: if one law describes as much as two effects do,
it is the one that has to be assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.selection.compare import compare
from bayes_impedance.diagnosis.selection.exchange import Way
from bayes_impedance.diagnosis.selection.finalists import SHARE, again, finalists
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import ALPHA, try_shortlist
from bayes_impedance.diagnosis.selection.trial import hoped_for
from bayes_impedance.diagnosis.selection.what_remains import leaves_structure


def simple_and_richer(effects: Sequence[Effect]) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """Effects that are tried in every step, and those that wait for one that they refine, both in their order.

    One of which no simpler one is among them is tried in every step.
    """
    simple = {effect.id for effect in effects if not effect.refines}
    waiting = tuple(effect for effect in effects if simple & set(effect.refines))
    return tuple(effect for effect in effects if effect not in waiting), waiting


def with_richer_law(
    refitter: Refitter,
    way: Way,
    longer: Way,
    names: Sequence[str],
    effects: Sequence[Effect],
    richer: Sequence[Effect],
    seed: int,
    executor: Executor,
) -> Way | None:
    """The way with a richer law as its last choice; None if there is none that should be there.

    Parameters
    ----------
    refitter : Refitter
    way : Way
        Whose last step has chosen something.
    longer : Way
        The same with one step more.
    names : sequence of str
        Of the people.
    effects : sequence of Effect
        Candidates for what remains.
    richer : sequence of Effect
        Those that refine another one.
    seed : int
    executor : Executor
    """
    step, after = longer.steps[len(way.steps) - 1], longer.steps[-1]
    chosen = step.chosen
    if chosen is None or not after.log_p < np.log(ALPHA):
        return None
    wanted = [effect for effect in richer if chosen.effect.id in effect.refines]
    if not wanted:
        return None
    screening = screen(step.before, step.residuals, wanted, seed, executor)
    trials = try_shortlist(refitter, step.before, screening)
    if max((hoped_for(t) for t in trials if t.physical), default=-np.inf) < SHARE * chosen.gain:
        return None
    ranked = [
        again(trial, measured(refitter, trial.fit, seed), step.before)
        for trial in finalists(refitter, step.before, trials, wanted, seed)
    ]
    ranked = sorted((t for t in ranked if t.physical and np.isfinite(t.gain)), key=lambda t: -t.gain)
    if not ranked or not compare(ranked[0].fit, chosen.weighed).decided:
        return None
    if after.chosen is not None and compare(after.chosen.weighed, ranked[0].fit).separated:
        return None
    if leaves_structure(ranked[0].fit, names, effects, seed, executor):
        return None
    step = replace(step, trials=(*step.trials, *ranked), chosen=ranked[0], richer=screening)
    return Way(way.base, ranked[0].fit, (*way.steps[:-1], step), measured=True)
