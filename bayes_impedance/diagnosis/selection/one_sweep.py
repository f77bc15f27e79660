"""An element that follows its own motion, in people who were swept once.

In one sweep of each person frequency, time and amplitude go together. What changes with time, or with an amplitude of
any form, is a real function of frequency that multiplies an element, and is not offered there
(:mod:`bayes_impedance.diagnosis.catalogue.offered`). How an element moves under a constant force is told by the network
itself, with its resonances, and only the size of the change and the knee are free. Such an effect is believed in one
sweep if it is told apart from all that is not offered, at the same place. Otherwise the element changes, and nobody can
say why: nothing is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import compare
from bayes_impedance.diagnosis.selection.finalists import again, finalists
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import try_shortlist
from bayes_impedance.diagnosis.selection.trial import Trial


def needs_another_sweep(
    refitter: Refitter, fit: Refit, trial: Trial, residuals: Sequence[PersonResiduals], seed: int, executor: Executor
) -> bool:
    """Whether an explanation is not told apart from those that only repeated sweeps can show.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without it.
    trial : Trial
        At rest.
    residuals : sequence of PersonResiduals
        Of `fit`.
    seed : int
    executor : Executor
    """
    recorded = np.bincount(fit.owner)
    repeated = 2 * np.sum(recorded > 1) > recorded.size
    if repeated or not (trial.effect.operation and trial.effect.traits.follows_motion):
        return False
    others = tuple(effect for effect in registered() if effect.needs_repetitions)
    screening = screen(fit, residuals, others, seed, executor, places=(trial.candidate.place,))
    rivals = finalists(
        refitter, fit, [trial, *try_shortlist(refitter, fit, screening)], (trial.effect, *others), seed
    )
    own = (again(t, measured(refitter, t.fit, seed), fit) for t in rivals if t.effect in others)
    return any(not compare(trial.weighed, rival.weighed).separated for rival in own)
