"""Between explanations that the evidence does not tell apart, the one that leaves nothing.

The evidence of two explanations says which of them is the better one, not whether either is right. A wrong one with
shapes that differ between people may come within a few units of the right one, or ahead of it by chance, and still
leave structure in the residuals, for which a further name is then looked for. The right one leaves none. A delay was
4.5 +- 7.1 behind a resonator in 25 people: the resonator left structure (p = 1e-9) and the delay none (p = 0.4).

Only explanations that are not excluded are asked, and only where the chosen one leaves structure. If all leave some, or
physics is missing besides, the choice stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import compare
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import ALPHA
from bayes_impedance.diagnosis.selection.step import Step


def that_leaves_nothing(
    step: Step, names: Sequence[str], effects: Sequence[Effect], seed: int, executor: Executor
) -> Step | None:
    """The step with another choice: the best explanation that its own does not exclude and that leaves no structure.

    None if there is none.

    Parameters
    ----------
    step : Step
        Whose choice leaves structure.
    names : sequence of str
        Of the people.
    effects : sequence of Effect
        Candidates for what remains.
    seed : int
    executor : Executor
    """
    chosen = step.chosen
    if chosen is None:
        return None
    possible = [t for t in step.trials if t.physical and t.fit.settled and t.fit is not chosen.fit]
    for trial in sorted(possible, key=lambda t: -t.gain):
        if compare(chosen.weighed, trial.weighed).separated or not compare(trial.weighed, step.before).decided:
            continue
        if not leaves_structure(trial.fit, names, effects, seed, executor):
            return replace(step, chosen=trial)
    return None


def leaves_structure(
    fit: Refit, names: Sequence[str], effects: Sequence[Effect], seed: int, executor: Executor
) -> bool:
    """Whether a candidate is significant in the residuals of a fit."""
    residuals = tuple(person_residuals(fit, names, executor))
    step = Step(before=fit, residuals=residuals, screening=screen(fit, residuals, effects, seed, executor))
    return bool(step.log_p < np.log(ALPHA))
