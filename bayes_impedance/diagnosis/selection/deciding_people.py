"""Where a few people decide between two explanations, these are searched before it is believed.

If one explanation is right, most people are described better by it. Where most are described as well by either, and one
or two much better by the first, these have probably been left in another valley of the second: of 39 people with a
reflex one was 33 units of log evidence worse with it than with a reflex that follows velocity, at the fifth of the
damping that it should have, and the others agreed to within two; the truth was excluded. So whoever is far more apart
than most is searched from draws of the population in the explanation that describes him worse, with the network's
elements of the other one as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import CLIPPED, FEWEST_PEOPLE, SCATTERS, typical_gain
from bayes_impedance.diagnosis.selection.finalists import EQUAL, ROUNDS, SHARE, again, better_of, in_order
from bayes_impedance.diagnosis.selection.trial import Trial

_DRAWS = 12
"""Starts of each of these people from the population, half of them with the other explanation's elements. By choice: of
ten draws two found the valley of the person above."""


def where_few_decide(
    refitter: Refitter, fit: Refit, ranked: Sequence[Trial], effects: Sequence[Effect], seed: int
) -> list[Trial]:
    """Explanations of a step, best first, once the few who decide between the best and another one were searched.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without them.
    ranked : sequence of Trial
        Best first.
    effects : sequence of Effect
        The catalogue.
    seed : int
        Of the draws.
    """
    trials = list(ranked)
    if len(trials) < 2 or len(refitter.data) < FEWEST_PEOPLE:
        return trials
    for k in range(1, len(trials)):
        one, other = trials[0], trials[k]
        if other.gain < SHARE * one.gain:
            continue
        difference = one.fit.evidence - other.fit.evidence
        behind, ahead = who_decides(difference), who_decides(-difference)
        trials[k] = _searched(refitter, fit, other, one, behind, seed)
        trials[0] = _searched(refitter, fit, one, other, ahead, seed)
    return in_order(trials, effects)


def who_decides(difference: np.ndarray) -> np.ndarray:
    """Numbers of the people without whom one explanation would not be better; none if most agree that it is.

    Parameters
    ----------
    difference : ndarray, shape (N,)
        How much better the first describes each person, in log evidence.
    """
    if (
        not np.all(np.isfinite(difference))
        or difference.sum() <= 0
        or typical_gain(difference, of_most=True) > SCATTERS
    ):
        return np.zeros(0, dtype=int)
    return np.flatnonzero(difference > max(EQUAL, CLIPPED * float(np.median(np.abs(difference)))))


def _searched(refitter: Refitter, fit: Refit, trial: Trial, other: Trial, people: np.ndarray, seed: int) -> Trial:
    """The trial, with some people at better optima if they have any."""
    if not people.size:
        return trial
    grown, rng = trial.fit, np.random.default_rng(seed)
    varying, n = np.flatnonzero(~grown.model.shared), fit.model.n_elements
    factor = np.linalg.cholesky(grown.population.covariance)
    copied = np.repeat(people, _DRAWS)
    copies, rows = refitter.subset(copied), np.concatenate([np.flatnonzero(grown.owner == i) for i in copied])
    draws = grown.population.mu + rng.normal(size=(people.size * _DRAWS, varying.size)) @ factor.T
    start = grown.u[rows]
    start[:, varying] = draws[copies.owner]
    half = copies.owner % 2 == 0
    start[half, :n] = other.fit.u[rows][half, :n]
    ends = copies.fit(grown.model, start, grown.population, ROUNDS, hold_population=True, hold_additions=True)
    evidence = np.nan_to_num(ends.evidence, nan=-np.inf).reshape(people.size, _DRAWS)
    better, u = evidence.max(axis=1) > grown.evidence[people] + EQUAL, grown.u.copy()
    if not better.any():
        return trial
    for i in np.flatnonzero(better):
        u[grown.owner == people[i]] = ends.u[copies.owner == i * _DRAWS + int(np.argmax(evidence[i]))]
    return better_of(trial, again(trial, refitter.fit(grown.model, u, grown.population, ROUNDS), fit))
