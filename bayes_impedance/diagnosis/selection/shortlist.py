"""The best candidates of the scan, each refitted with the whole population.

A coefficient of the rig is tried as one that all people share, a coefficient of the body as one that varies between
people. The candidate with the largest gain in log evidence (:func:`.compare.log_evidence`) leads.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.extend import has_shapes
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.lost_elements import lost_elements
from bayes_impedance.diagnosis.fit.outliers_alone import BADLY
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection import far_starts
from bayes_impedance.diagnosis.selection.level_starts import from_level
from bayes_impedance.diagnosis.selection.lookalikes import from_the_leader, lookalikes
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.trial import (
    Trial,
    from_cold,
    hoped_for,
    own_shapes,
    poolings_for,
    trial_of,
    try_candidate,
)

ALPHA = 0.01
"""Family-wise error rate of one screening. By choice."""

SHORTLIST = 8
"""Candidates that are refitted because of their common score. By choice: each costs as much as fitting the network."""

_LEAST_SHARE = 0.4
"""Of the largest score: a candidate below it explains less than a sixth (0.4 squared) of what the best one does."""

_PLACES_EACH = 2
"""Places at which one effect is tried in the first round. By choice: what could lead is tried at all others
afterwards."""

BY_SPREAD = 4
"""Candidates that are refitted because their coefficients differ between people. By choice, as `SHORTLIST`."""

_CLEARLY_VARIES = -10.0
"""Corrected log p-value (4.5e-5) of the spread over people below which starts with each person's own shape are
tried. It decides on starts only, so it has to be rare rather than exact."""

_FIRST_ROUNDS, _MORE_ROUNDS = 8, 22
"""Rounds of a first refit, and of those that are not far behind after it. By choice: 30 in all."""

_FAR_BEHIND = 40.0
"""Log evidence that a refit which has not converged is not expected to make up. By choice."""

_OUT_OF_REACH = 0.4
"""Share of the best gain that may be missing, if everybody were described as well as the median person, where an effect
with poles of its own, or one that looks like the leader, is still searched further: what has less than 0.6 of the best
gain is no finalist (:mod:`.finalists`)."""


def best_shapes(screening: Screening, physical_only: bool = True, by_spread: bool = False) -> list[int]:
    """Index of the best shape for every effect and place, best first.

    Parameters
    ----------
    screening : Screening
    physical_only : bool
        Only coefficients with an admissible sign.
    by_spread : bool
        Rank effects of the body by how much their coefficients differ between people, instead of by their common score.
    """
    strength = np.abs(np.nan_to_num(screening.z))
    if by_spread:
        body = np.array([c.effect.side == "body" for c in screening.candidates], dtype=bool)
        strength = np.where(body, -screening.log_p_spread, 0.0)
    if physical_only:
        strength = np.where(screening.physical, strength, 0.0)
    best: dict[tuple[str, str, str], int] = {}
    for k in np.argsort(-strength, kind="stable"):
        c = screening.candidates[k]
        if strength[k] > 0:
            best.setdefault((c.effect.id, c.effect.form, c.place), int(k))
    return list(best.values())


def shortlist(screening: Screening, n: int = SHORTLIST) -> list[int]:
    """Candidates worth a refit.

    These are the candidates that explain a large part of what the best one explains, and those of the others whose
    coefficients differ most between people, each effect at two places at most: a resonance at a different frequency in
    each person has no common score.
    """
    order = best_shapes(screening)
    strength = np.abs(screening.z)
    chosen: list[int] = []
    places: dict[Effect, int] = {}
    for k in order:
        effect = screening.candidates[k].effect
        if strength[k] < _LEAST_SHARE * strength[order[0]] or len(chosen) == n:
            break
        if places.get(effect, 0) < _PLACES_EACH:
            places[effect] = places.get(effect, 0) + 1
            chosen.append(k)
    tried = {(screening.candidates[k].effect, screening.candidates[k].place) for k in chosen}
    by_spread: dict[Effect, int] = {}
    for k in best_shapes(screening, by_spread=True):
        candidate = screening.candidates[k]
        if sum(by_spread.values()) == BY_SPREAD or screening.log_p_spread[k] > _CLEARLY_VARIES:
            break
        if (candidate.effect, candidate.place) not in tried and by_spread.get(candidate.effect, 0) < _PLACES_EACH:
            by_spread[candidate.effect] = by_spread.get(candidate.effect, 0) + 1
            chosen.append(k)
    return chosen


def try_shortlist(
    refitter: Refitter,
    fit: Refit,
    screening: Screening,
    begin: Refit | None = None,
    tried: Collection[tuple[Effect, str]] = (),
) -> list[Trial]:
    """Refit the shortlist, and then the effects that could lead at all remaining places.

    The refits begin at `begin` if given, else at `fit`. If effects were `tried` at their places, only others are.
    """
    trials: list[Trial] = []
    for k in shortlist(screening):
        candidate = screening.candidates[k]
        if (candidate.effect, candidate.place) in tried:
            continue
        differs = bool(screening.log_p_spread[k] < _CLEARLY_VARIES)
        poolings = poolings_for(candidate.effect, len(refitter.data), differs)
        trials += try_candidate(refitter, fit, candidate, float(screening.size[k]), poolings, _FIRST_ROUNDS, begin)
        if candidate.effect.side == "body" and "varying" in poolings and has_shapes(candidate.effect) and differs:
            trials.append(own_shapes(refitter, fit, screening, k, _FIRST_ROUNDS, begin))
    trials = _continued(refitter, fit, trials)
    if tried:
        return trials
    trials += _from_levels(refitter, fit, screening)
    return trials + _elsewhere(refitter, fit, screening, trials, begin)


def _elsewhere(
    refitter: Refitter, fit: Refit, screening: Screening, trials: Sequence[Trial], begin: Refit | None
) -> list[Trial]:
    """Effects that could lead, at the places where they were not tried.

    That is the leader, and what would be ahead of it if the people whom it describes badly were described as well as
    the median person: at a wrong place it is chance which people are in other valleys. And it is what a score promises
    to be as good there: a gain of half of its square, if the log likelihood is quadratic and nobody differs.
    """
    best = {t.effect: t for t in sorted(_possible(trials), key=lambda t: t.gain)}
    if not best:
        return []
    leader = max(best.values(), key=lambda t: t.gain)
    found: list[Trial] = []
    of_others: list[Trial] = []
    for k in best_shapes(screening):
        other = screening.candidates[k]
        known = best.get(other.effect)
        promised = 0.5 * screening.z[k] ** 2 > (1 - _OUT_OF_REACH) * leader.gain
        if known is None or (hoped_for(known, BADLY) < leader.gain and not promised):
            continue
        if (other.place, known.pooling) in {(t.candidate.place, t.pooling) for t in trials if t.effect == other.effect}:
            continue
        rounds = _FIRST_ROUNDS + (_MORE_ROUNDS if known is leader else 0)
        if known.pooling == "free":
            trial = own_shapes(refitter, fit, screening, k, rounds, begin)
        else:
            trial = try_candidate(refitter, fit, other, float(screening.size[k]), (known.pooling,), rounds, begin)[-1]
        (found if known is leader else of_others).append(trial)
    return found + _continued(refitter, fit, of_others, leader.gain)


def _possible(trials: Sequence[Trial]) -> list[Trial]:
    return [t for t in trials if t.physical and np.isfinite(t.gain)]


def _from_levels(refitter: Refitter, fit: Refit, screening: Screening) -> list[Trial]:
    """Effects with poles of their own, from the coefficients on a grid that are most probable."""
    rounds, found = _FIRST_ROUNDS + _MORE_ROUNDS, []
    for level in screening.levels:
        grown = from_level(refitter, fit, level, rounds)
        found.append(from_cold(refitter, fit, trial_of(level.candidate, "varying", grown, fit), rounds))
    return found


def within_reach(trial: Trial, best_gain: float) -> bool:
    """Whether searching for better optima could bring a trial near the best gain."""
    return hoped_for(trial) > best_gain - max(_FAR_BEHIND, _OUT_OF_REACH * best_gain)


def lookalike_trials(refitter: Refitter, fit: Refit, screening: Screening, leader: Trial) -> list[Trial]:
    """What looks like the leader at its place, from where the leader ended."""
    if not leader.effect.operation:
        return []
    found = []
    for candidate in lookalikes(screening, leader.candidate):
        grown = from_the_leader(refitter, leader.fit, candidate, _FIRST_ROUNDS + _MORE_ROUNDS)
        found.append(trial_of(candidate, grown.model.additions[-1].pooling, grown, fit))
    return found


def from_afar(
    refitter: Refitter, fit: Refit, effects: Sequence[Effect], seed: int, screening: Screening | None = None
) -> list[Trial]:
    """Trials of effects at the port that do not begin at the network (:mod:`.far_starts`).

    All of them are made if it does not describe the recordings at all, or has lost elements: driven away from
    everybody's values, or to where most people's recordings do not feel them. Otherwise those of delays and filters
    that the elements hide from the scan.
    """
    candidates = far_starts.at_the_port(fit, effects)
    if not far_starts.wholly_off(fit) and (refitter.one_person or not lost_elements(fit).any()):
        candidates = [] if screening is None else far_starts.absorbed(candidates, screening)
    found = []
    for candidate in candidates:
        begun = far_starts.refits_from_afar(refitter, fit, candidate, seed, _FIRST_ROUNDS)
        best = max(begun, key=lambda g: float(g.evidence.sum()))
        if not best.settled:
            best = refitter.fit(best.model, best.u, best.population, _MORE_ROUNDS)
        found.append(trial_of(candidate, best.model.additions[-1].pooling, best, fit))
    return found


def _continued(refitter: Refitter, fit: Refit, trials: list[Trial], best_gain: float = -np.inf) -> list[Trial]:
    """The trials that are not far behind, with people started at the median person, and with more rounds.

    `best_gain` is that of other trials.

    People whom the model without the addition has left in another optimum than most stay there otherwise, and the order
    of the trials would be that of how many stay.
    """
    best_gain = max([best_gain, *(t.gain for t in _possible(trials))])
    if not np.isfinite(best_gain):
        return trials
    enough = best_gain - max(_FAR_BEHIND, (1 - _LEAST_SHARE) * best_gain)
    result = []
    for trial in trials:
        if trial.gain > enough:
            grown = refitter.settle(trial.fit, 0, tries=1, rounds=1)  # the median person: nothing is drawn
            if not grown.settled:
                grown = refitter.fit(grown.model, grown.u, grown.population, _MORE_ROUNDS)
            if grown is not trial.fit:
                trial = trial_of(trial.candidate, trial.pooling, grown, fit)
        result.append(trial)
    return result
