"""What only repeated sweeps could show, where people were swept once.

In one sweep of each person frequency, time and amplitude go together. An element that changes in the course of the
sweep, or with an amplitude of any form, is there a real function of frequency that multiplies it, and no reason for it
can be named: such effects are not offered (:mod:`bayes_impedance.diagnosis.catalogue.offered`). But they may be what is
missing, and then another effect that bends the curves in a similar way leads among those that are offered. So what is
to be named is compared with them first. If one of them is certainly better, the element changes, nobody can say why,
and nothing is named.

How an element moves under a constant force is told by the network itself, with its resonances; only the size of the
change and the knee are free. An element that follows its own motion is therefore offered in one sweep too, and named if
all that is not offered is excluded at its place.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.catalogue.offered import recorded_again
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.selection.compare import compare
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
