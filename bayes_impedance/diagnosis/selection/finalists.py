"""The best explanations of one step, refitted until they converge, so that their evidence can be compared.

The first refits share shapes between people and begin at the fit without the addition. That selects the explanations to
consider, but not the best: one person in a local optimum costs as much evidence as a wrong explanation does. Here the
best explanations are also fitted with shapes that differ between people, and every person is restarted to leave local
optima. The order is that of
:func:`~bayes_impedance.diagnosis.selection.compare.log_evidence`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.cold_start import beside_the_leader
from bayes_impedance.diagnosis.fit.exchanged_branches import with_branches_exchanged
from bayes_impedance.diagnosis.fit.extend import extended_start, has_shapes, is_physical, with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.majority import gathered
from bayes_impedance.diagnosis.fit.outliers_alone import BADLY
from bayes_impedance.diagnosis.fit.recordings_alone import recordings_alone
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.shape_starts import searched_shapes
from bayes_impedance.diagnosis.selection.compare import FEWEST_TO_VARY, LEAST_GAIN, log_evidence
from bayes_impedance.diagnosis.selection.far_starts import network_from_afar
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.shortlist import lookalike_trials, within_reach
from bayes_impedance.diagnosis.selection.trial import Trial, hoped_for

MOST = 4
"""Explanations that are refitted to convergence: each costs as much as all first refits together. In 31 steps with
concealed effects the best after convergence was among the first three of the first refits, and the first in 25."""

SHARE = 0.6
"""Fraction of the best gain that an explanation must have. In those 31 steps none overtook it from below 0.92."""

EQUAL = 1.0
"""Differences of log evidence below this one are rounding and convergence error; the catalogue's order decides then."""

_FIRST_SHARE, _FIRST_ROUNDS = 0.3, 8
"""Fraction of the leader's gain from which an explanation is also tried from the leader's elements before the best few
are chosen, and the rounds of that. By choice. A compliance of the rig whose refits began at the network's elements had
two thirds of the gain of a diffusion layer; from that layer's elements it was 111 ahead."""

ROUNDS = 40
"""Largest number of rounds of a refit that begins at the fit of another place: 11 of 12 converged."""


def finalists(
    refitter: Refitter, fit: Refit, trials: Sequence[Trial], effects: Sequence[Effect], seed: int
) -> list[Trial]:
    """The best trials, refitted to convergence, best first.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without them.
    trials : sequence of Trial
    effects : sequence of Effect
        The catalogue, in the order that decides between equally good explanations.
    seed : int
    """
    best: dict[tuple[str, str, str], Trial] = {}
    for trial in trials:
        key = trial.fit.model.additions[-1].key
        if trial.physical and np.isfinite(trial.gain) and (key not in best or best[key].gain < trial.gain):
            best[key] = trial
    order = sorted(best.values(), key=lambda t: -t.gain)
    if not order or order[0].gain <= LEAST_GAIN:
        return []
    order = sorted((_with_others_people(refitter, fit, t, order) for t in order), key=lambda t: -t.gain)
    order = sorted((_beside(refitter, fit, t, order[0], seed, _FIRST_ROUNDS) for t in order), key=lambda t: -t.gain)
    close = [t for t in order if t.gain > SHARE * order[0].gain]
    some = [t for t in order if t.effect.pooling == "some" and t not in close[:MOST]]
    grown = [_with_own_shapes(refitter, fit, t) for t in (*close[:MOST], *some[:1])]
    return _at_rest(refitter, fit, in_order(grown, effects), effects, seed)


def with_lookalikes(
    refitter: Refitter, fit: Refit, screening: Screening, ranked: Sequence[Trial], effects: Sequence[Effect], seed: int
) -> list[Trial]:
    """The finalists, best first, and what looks like the leader at its place, from where the leader came to rest."""
    if not ranked:
        return []
    own = [
        better_of(trial, again(trial, _searched(refitter, trial.fit, seed), fit))  # as the leader is
        if within_reach(trial, ranked[0].gain)
        else trial
        for trial in lookalike_trials(refitter, fit, screening, ranked[0])
    ]
    result = in_order([*ranked, *(t for t in own if t.physical and np.isfinite(t.gain))], effects)
    if all(result[0] is not trial for trial in ranked):
        result = _beside_a_new_leader(refitter, fit, result, effects, seed)
    return result


def _with_own_shapes(refitter: Refitter, fit: Refit, trial: Trial) -> Trial:
    """The trial with shapes that differ between people, if that is better."""
    varies = trial.effect.side == "body" and len(refitter.data) >= FEWEST_TO_VARY
    if not varies or trial.pooling == "free" or not has_shapes(trial.effect):
        return trial
    model = with_pooling(trial.fit.model, len(trial.fit.model.additions) - 1, "free")
    return better_of(trial, again(trial, refitter.fit(model, *extended_start(trial.fit, model), ROUNDS), fit))


def _at_rest(
    refitter: Refitter, fit: Refit, ranked: Sequence[Trial], effects: Sequence[Effect], seed: int
) -> list[Trial]:
    """The finalists after convergence; the leader's effect at another place begins at the leader's fit.

    Other effects also begin at the leader's elements: an element that the model without either had driven away may
    have come back beside one of them only.
    """
    leader = again(ranked[0], _searched(refitter, ranked[0].fit, seed), fit)
    result = [leader]
    for trial in ranked[1:]:
        if trial.effect == leader.effect:
            model = with_pooling(trial.fit.model, len(trial.fit.model.additions) - 1, leader.pooling)
            grown = refitter.fit(model, leader.fit.u, leader.fit.population, ROUNDS)
            result.append(better_of(trial, again(trial, grown, fit)))
        else:
            trial = _beside(refitter, fit, trial, leader, seed, ROUNDS)
            result.append(_settled(refitter, fit, trial, seed, tries=2, rounds=1))
    result = in_order(result, effects)
    if result[0] is not leader:
        result[0] = _settled(refitter, fit, result[0], seed, tries=3, rounds=2)
        result = _beside_a_new_leader(refitter, fit, result, effects, seed)
    return result


def _beside_a_new_leader(
    refitter: Refitter, fit: Refit, ranked: Sequence[Trial], effects: Sequence[Effect], seed: int
) -> list[Trial]:
    """The trials, best first, also begun at the elements of the first of them, which has come from behind.

    Its valley may be better for the others as well: a resonator that began at the elements of a line with a free end
    came to rest 470 ahead of it, in a valley where the line, which was there, is 28 ahead of the resonator.
    """
    return in_order([_beside(refitter, fit, trial, ranked[0], seed, ROUNDS) for trial in ranked], effects)


def _beside(refitter: Refitter, fit: Refit, trial: Trial, leader: Trial, seed: int, rounds: int) -> Trial:
    """The trial, or a better one that begins at the elements of the leader, if there is one.

    People for whom the leader's elements are not the right ones are searched before the two are compared: one of 65,
    whom the leader's start left in another valley, was 4200 nats, and the trial stayed in a valley that was 470 behind.
    """
    if trial.effect == leader.effect or trial.gain < _FIRST_SHARE * leader.gain:
        return trial
    found = again(trial, refitter.fit(trial.fit.model, *beside_the_leader(trial.fit, leader.fit), rounds), fit)
    if found.gain < trial.gain < hoped_for(found, BADLY):
        found = again(trial, refitter.settle(found.fit, seed, tries=1, rounds=1), fit)
    return better_of(trial, found)


def _with_others_people(refitter: Refitter, fit: Refit, trial: Trial, trials: Sequence[Trial]) -> Trial:
    """The trial, where people whom another trial describes better begin at that one's elements, if that is better.

    Which people are in another valley is chance, and not the same in all trials: one person of 55, whom the mass that
    was there had left in one, cost it 866 nats.
    """
    possible = [t for t in trials if t.gain > _FIRST_SHARE * max(other.gain for other in trials)]
    if all(t is not trial for t in possible):
        return trial
    grown = trial.fit
    evidence = np.array([np.nan_to_num(t.fit.evidence, nan=-np.inf) for t in possible])
    donor = np.argmax(evidence, axis=0)
    better = evidence.max(axis=0) > grown.evidence + EQUAL
    if not better.any():
        return trial
    varying = np.flatnonzero(~fit.model.shared)
    start = grown.u.copy()
    for i in np.flatnonzero(better):
        rows = np.ix_(grown.owner == i, varying)
        start[rows] = possible[donor[i]].fit.u[rows]
    tried = refitter.fit(grown.model, start, grown.population, _FIRST_ROUNDS, hold_population=True, hold_additions=True)
    taken = tried.evidence > grown.evidence + EQUAL
    if not taken.any():
        return trial
    start = np.where(taken[grown.owner, None], tried.u, grown.u)
    return better_of(trial, again(trial, refitter.fit(grown.model, start, grown.population, ROUNDS), fit))


def in_order(trials: Sequence[Trial], effects: Sequence[Effect]) -> list[Trial]:
    """Best first; of equally good ones the first in the catalogue, which lists simpler effects and the rig's first."""
    rank = {effect: i for i, effect in enumerate(effects)}
    top = max(t.gain for t in trials)
    return sorted(
        trials,
        key=lambda t: (0, rank.get(t.effect, len(rank)), -t.gain) if t.gain > top - EQUAL else (1, 0, -t.gain),
    )


def _settled(refitter: Refitter, fit: Refit, trial: Trial, seed: int, tries: int, rounds: int) -> Trial:
    return better_of(trial, again(trial, _searched(refitter, trial.fit, seed, tries, rounds), fit))


def _searched(refitter: Refitter, fit: Refit, seed: int, tries: int = 6, rounds: int = 3) -> Refit:
    """The fit after a search for better optima of the network, of people, of their shapes and of recordings."""
    fit = with_branches_exchanged(refitter, network_from_afar(refitter, fit, seed, ROUNDS), ROUNDS)
    fit = searched_shapes(refitter, refitter.settle(fit, seed, tries=tries, rounds=rounds))
    return gathered(refitter, recordings_alone(refitter, fit))


def again(trial: Trial, grown: Refit, fit: Refit) -> Trial:
    """The trial with another fit of the same model; `fit` is that of the model without the addition."""
    pooling = grown.model.additions[-1].pooling
    gain = log_evidence(grown) - log_evidence(fit)
    return replace(trial, pooling=pooling, fit=grown, gain=gain, physical=is_physical(grown), mixture=None)


def better_of(old: Trial, new: Trial) -> Trial:
    """The new trial if it is physical and gains more, else the old one."""
    return new if new.physical and new.gain > old.gain else old
