r"""One richer law in the place of a simple one that leaves structure, before a second name is looked for.

A process that relaxes with many time constants, such as a power law that ends in a spring, is nearly a power law, or
one relaxation, over a part of the band. Whichever of the two is found first leaves structure, a second name takes that
up, and two names stand for one thing. A law with one parameter more (:attr:`.Effect.refines`) describes it alone.

It contains the simple laws, or comes near to them, so that among the candidates of every step it would be another name
for each of them, which recordings that ask for nothing richer cannot exclude. So it is tried only where a simple one
has been chosen and leaves structure, and it is taken only if it is better and leaves no structure itself.

**One law or two effects.** The other explanation is the simple law with the further effect that the search finds beside
it, each chosen anew beside the other. That effect was chosen among the K at their places that were tried. If each of
these is as probable as the others before the recordings are looked at, an explanation with one name more has 1/K of the
probability of one without: it is taken if its log evidence is larger by more than :math:`\ln K` and
:data:`.compare.LEAST_GAIN`. Of a layer with diffusion in 68 people a film with a relaxation had 4.4 more (K = 28), and
of a power law with a second path one broad relaxation had 7.7 less (K = 43).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN, compare, log_evidence
from bayes_impedance.diagnosis.selection.exchange import EXCHANGES, StepFrom, Way, exchanged, without_senseless
from bayes_impedance.diagnosis.selection.finalists import SHARE, again, finalists
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import ALPHA, try_shortlist
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import hoped_for
from bayes_impedance.diagnosis.selection.what_remains import leaves_structure


def simple_and_richer(effects: Sequence[Effect]) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """Effects that are tried in every step, and those that wait for one that they refine, both in their order.

    One of which no simpler one is among them is tried in every step.
    """
    simple = {effect.id for effect in effects if not effect.refines}
    waiting = tuple(effect for effect in effects if simple & set(effect.refines))
    return tuple(effect for effect in effects if effect not in waiting), waiting


def longer_or_richer(
    refitter: Refitter,
    way: Way,
    step_from: StepFrom,
    names: Sequence[str],
    effects: Sequence[Effect],
    richer: Sequence[Effect],
    seed: int,
    executor: Executor,
) -> Way:
    """The way with one step more, or with a richer law in the place of its last choice.

    Parameters
    ----------
    refitter : Refitter
    way : Way
        Whose last step has chosen something.
    step_from : callable
        Makes one more step from a way.
    names : sequence of str
        Of the people.
    effects : sequence of Effect
        Candidates for what remains.
    richer : sequence of Effect
        Those that refine another one.
    seed : int
    executor : Executor
    """
    longer = without_senseless(refitter, way, step_from(way), step_from, seed)
    if len(longer.steps) <= len(way.steps):
        return longer
    step = longer.steps[len(way.steps) - 1]  # whose choice may have become another one
    if not longer.steps[-1].log_p < np.log(ALPHA):
        return longer
    better = _richer(refitter, step, richer, seed, executor)
    if better is None or leaves_structure(better.after, names, effects, seed, executor):
        return longer
    anew = longer.steps[-1].chosen is not None
    for _ in range(EXCHANGES * anew):
        longer, anew = exchanged(refitter, longer, step_from, seed)
        if not anew:
            break
    several = log_evidence(longer.fit) - log_evidence(better.after)
    if several > np.log(longer.steps[-1].offered) + LEAST_GAIN:
        return longer
    return Way(way.base, better.after, (*way.steps[:-1], better), measured=True)


def _richer(refitter: Refitter, step: Step, richer: Sequence[Effect], seed: int, executor: Executor) -> Step | None:
    """The step with a richer law as its choice; None if there is none that is better."""
    chosen = step.chosen
    wanted = [] if chosen is None else [effect for effect in richer if chosen.effect.id in effect.refines]
    if chosen is None or not wanted:
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
    return replace(step, trials=(*step.trials, *ranked), chosen=ranked[0], richer=screening)
