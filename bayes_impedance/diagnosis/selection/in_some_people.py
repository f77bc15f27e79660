"""An effect that only some people have, searched from those who lack it.

Where some people have an effect and others have not, the model without it describes the others to within their noise,
and those who have it by elements that nobody has. Estimated from all, the population is then a mixture so wide that it
holds nobody: in one of 47 people, of whom 17 had a further layer, the standard deviation of a log mass was 5.1, people
with the layer had lost two elements altogether, and the derivative there said that a layer would explain nothing.

So the population is estimated from the people who are described and gain nothing by the best of what was tried, all
others are put among them, and what is looked at is what they have left there. Effects that are claimed of some people
only are refitted from that beginning. What they gain counts over the model of everybody, like any other explanation of
a step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.extend import has_shapes
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, LEAST_GAIN
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import best_shapes
from bayes_impedance.diagnosis.selection.trial import Trial, own_shapes, try_candidate
from bayes_impedance.results.misfit import MISFIT_SCALE

_FEWEST_MEMBERS = 3
"""People who are not described from whom an effect is looked for: one or two are outliers and not a group."""

_FEWEST_OTHERS = 8
"""People who are described from whom a population is estimated. By choice: of fewer a covariance says little."""

_ROUNDS = 40
"""Largest number of rounds of each fit. By choice: those who are put among the others begin far from their end."""


def in_some_people(
    refitter: Refitter, fit: Refit, effects: Sequence[Effect], tried: Sequence[Trial], seed: int
) -> list[Trial]:
    """Trials of the effects that only some people have, from the population of those whom the model describes.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without the effect.
    effects : sequence of Effect
    tried : sequence of Trial
        Of any effects in the same step: who gains by the best of them lacks something.
    seed : int

    Returns
    -------
    list of Trial
        Empty where everybody is described, or too few are.
    """
    some = [effect for effect in effects if effect.pooling == "some"]
    begin = among_the_described(refitter, fit, described(fit, tried), seed) if some else None
    if begin is None:
        return []
    numbers = [str(i + 1) for i in range(len(refitter.data))]
    screening = screen(begin, person_residuals(begin, numbers, refitter.executor), some, seed, refitter.executor)
    found = []
    for k in best_shapes(screening):
        candidate = screening.candidates[k]
        if has_shapes(candidate.effect):  # from one shape for all, people ended at no effect at all
            found.append(own_shapes(refitter, fit, screening, k, _ROUNDS, begin))
        else:
            found += try_candidate(refitter, fit, candidate, float(screening.size[k]), ("varying",), _ROUNDS, begin)
    return found


def described(fit: Refit, tried: Sequence[Trial]) -> np.ndarray:
    """Who is described without any of the effects that were tried, (N,): to within the noise, and no worse than with.

    A few percent of the noise, which no scale of the residuals shows, may be thirty units of log evidence: of ten of 52
    people with a layer residuals were large in one.
    """
    possible = [trial for trial in tried if trial.physical and np.isfinite(trial.gain)]
    well = fit.weight**-0.5 < MISFIT_SCALE
    if possible:
        best = max(possible, key=lambda trial: trial.gain)
        well &= best.fit.evidence - fit.evidence < LEAST_GAIN
    return np.asarray(well)


def among_the_described(refitter: Refitter, fit: Refit, well: np.ndarray, seed: int) -> Refit | None:
    """The fit with everybody held to the population of the people whom it describes; None if there are no two kinds.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    well : ndarray of bool, shape (N,)
        Who is described.
    seed : int
    """
    who = np.flatnonzero(well)
    if len(well) < FEWEST_PEOPLE or who.size < _FEWEST_OTHERS or (~well).sum() < _FEWEST_MEMBERS:
        return None
    rows = well[fit.owner]
    few = refitter.subset(who)
    own = few.settle(few.fit(fit.model, fit.u[rows], fit.population, _ROUNDS), seed, tries=3, rounds=1)
    start = fit.u.copy()
    start[:, fit.model.shared] = own.u[0, fit.model.shared]
    start[np.ix_(~rows, ~fit.model.shared)] = own.population.mu
    start[rows] = own.u
    return refitter.fit(fit.model, start, own.population, _ROUNDS, hold_population=True, hold_additions=True)
