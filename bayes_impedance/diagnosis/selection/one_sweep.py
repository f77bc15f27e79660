"""What only repeated sweeps could show, where people were swept once.

In one sweep of each person frequency, time and amplitude go together. An element that changes in the course of the
sweep, or with an amplitude of any form, is there a real function of frequency that multiplies it, and no reason for it
can be named: such effects are not offered (:mod:`bayes_impedance.diagnosis.catalogue.offered`). But they may be what is
missing, and then another effect that bends the curves in a similar way leads among those that are offered. So what is
to be named is compared with them first. If one of them is certainly better, the element changes, nobody can say why,
and nothing is named. Unless two effects are missing: a change of free form describes something of both, and more than
either alone. It leaves structure then, and if the effect that it forbids to name leaves none with a second one, and the
two are certainly better than the change with a second effect beside it, they are named.

How an element moves under a constant force is told by the network itself, with its resonances; only the size of the
change and the knee are free. An element that follows its own motion is therefore offered in one sweep too, and named if
all that is not offered is excluded at its place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.catalogue.offered import recorded_again
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import compare
from bayes_impedance.diagnosis.selection.exchange import Way
from bayes_impedance.diagnosis.selection.finalists import again, finalists
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import ALPHA, try_shortlist
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import Trial


def shown_by_repeated_sweeps(
    refitter: Refitter, trial: Trial, step: Step, seed: int, executor: Executor
) -> Trial | None:
    """The best explanation among those that only repeated sweeps can show, if it forbids to name this one.

    None where most people were recorded again.

    Parameters
    ----------
    refitter : Refitter
    trial : Trial
        What is to be named, at rest.
    step : Step
        Of which it is the choice.
    seed : int
    executor : Executor
    """
    fit = step.before
    if recorded_again(np.bincount(fit.owner)):
        return None
    follows = trial.effect.follows_motion
    others = tuple(effect for effect in registered() if effect.needs_repetitions)
    places = (trial.candidate.place,) if follows else None
    screening = screen(fit, step.residuals, others, seed, executor, places)
    if not Step(before=fit, residuals=step.residuals, screening=screening).log_p < np.log(ALPHA):
        return None
    possible = [trial, *try_shortlist(refitter, fit, screening)]
    ranked = [t for t in finalists(refitter, fit, possible, (trial.effect, *others), seed) if t.effect in others]
    rivals = sorted((again(t, measured(refitter, t.fit, seed), fit) for t in ranked), key=lambda t: -t.gain)
    for rival in rivals:
        if follows and not compare(trial.weighed, rival.weighed).separated:
            return rival
        if compare(rival.weighed, trial.weighed).separated:
            return rival
    return None


def two_that_leave_nothing(
    way: Way,
    step_from: Callable[[Way], Way],
    names: Sequence[str],
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
) -> Way:
    """The way with what it was forbidden to name and a second effect, if only the two leave no structure.

    It is the same way if nothing was forbidden.

    Parameters
    ----------
    way : Way
        That has ended.
    step_from : callable
        Makes one more step from a way among `effects`.
    names : sequence of str
        Of the people.
    effects : sequence of Effect
        Candidates.
    seed : int
    executor : Executor
    """
    last = way.steps[-1]
    if last.unshown is None or last.refused is None:
        return way

    def leaves_structure(fit: Refit) -> bool:
        residuals = tuple(person_residuals(fit, names, executor))
        screening = screen(fit, residuals, effects, seed, executor)
        return bool(Step(before=fit, residuals=residuals, screening=screening).log_p < np.log(ALPHA))

    def gone_on(chosen: Trial) -> Way:
        # Without the others, of which one that leaves nothing would be taken at once.
        begun = replace(last, chosen=chosen, trials=(), unshown=None, refused=None)
        return step_from(Way(way.base, chosen.fit, (*way.steps[:-1], begun), True))

    if not leaves_structure(last.unshown.fit):
        return way
    two = gone_on(last.refused)
    if two.steps[-1].chosen is None or leaves_structure(two.fit):
        return way
    if not compare(two.fit, gone_on(last.unshown).fit).separated:
        return way
    begun = replace(last, chosen=last.refused, unshown=None, refused=None)
    return replace(two, steps=(*way.steps[:-1], begun, *two.steps[len(way.steps) :]))
