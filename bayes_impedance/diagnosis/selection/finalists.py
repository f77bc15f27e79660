"""The best explanations of one step, brought to rest so that they can be compared on equal terms.

The first refits hold shapes the same for everybody and begin wherever the model without the addition has ended. That
shows which explanations are in question, but not which is best: a person left in a local optimum costs as much as a
wrong explanation does. Here the best explanations are also tried with shapes that differ between people, and everybody
is given the chance to leave a local optimum. The order is that of
:func:`~bayes_impedance.diagnosis.selection.compare.log_evidence`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.extend import extended_start, has_shapes, is_physical, with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import FEWEST_TO_VARY, LEAST_GAIN, log_evidence
from bayes_impedance.diagnosis.selection.shortlist import Trial

MOST = 4
"""Explanations that are brought to rest: each costs as much as all first refits together. In 31 steps with concealed
effects the best at rest was among the first three of the first refits, and the first in 25."""

_SHARE = 0.6
"""Of the best one's gain that an explanation must have. In those 31 steps none overtook it from below 0.92."""

_EQUAL = 1.0
"""Differences of log evidence that rounding and the end of an iteration make; the catalogue's order decides then."""

_RIVAL = 10.0
"""A rival that is further behind the leader before both are at rest is not worth more refits."""

_ROUNDS = 40
"""Of a refit that begins where another place has ended: 11 of 12 came to rest."""


def finalists(
    refitter: Refitter, fit: Refit, trials: Sequence[Trial], effects: Sequence[Effect], seed: int
) -> list[Trial]:
    """The best trials, at rest, the best first.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without them.
    trials : sequence of Trial
    effects : sequence of Effect
        The catalogue in its order, which decides between explanations that are equally good.
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
    close = [t for t in order if t.gain > _SHARE * order[0].gain]
    some = [t for t in order if t.effect.pooling == "some" and t not in close[:MOST]]
    grown = [_with_own_shapes(refitter, fit, t) for t in (*close[:MOST], *some[:1])]
    return _at_rest(refitter, fit, in_order(grown, effects), effects, seed)


def _with_own_shapes(refitter: Refitter, fit: Refit, trial: Trial) -> Trial:
    """The trial with shapes that differ between people, if that is better."""
    varies = trial.effect.side == "body" and len(refitter.data) >= FEWEST_TO_VARY
    if not varies or trial.pooling == "free" or not has_shapes(trial.effect):
        return trial
    model = with_pooling(trial.fit.model, len(trial.fit.model.additions) - 1, "free")
    return _better_of(trial, _again(trial, refitter.fit(model, *extended_start(trial.fit, model), _ROUNDS), fit))


def _at_rest(
    refitter: Refitter, fit: Refit, ranked: Sequence[Trial], effects: Sequence[Effect], seed: int
) -> list[Trial]:
    """The finalists with everybody at rest: the same effect at another place begins where the best one has ended."""
    leader = _again(ranked[0], refitter.settle(ranked[0].fit, seed), fit)
    result = [leader]
    for trial in ranked[1:]:
        if trial.effect == leader.effect:
            model = with_pooling(trial.fit.model, len(trial.fit.model.additions) - 1, leader.pooling)
            grown = refitter.fit(model, leader.fit.u, leader.fit.population, _ROUNDS)
            result.append(_better_of(trial, _again(trial, grown, fit)))
        elif trial.gain > ranked[0].gain - _RIVAL:  # the leader's before it was at rest
            result.append(_settled(refitter, fit, trial, seed, tries=2, rounds=1))
        else:
            result.append(trial)
    result = in_order(result, effects)
    if result[0] is not leader:
        result[0] = _settled(refitter, fit, result[0], seed, tries=3, rounds=2)
    return result


def in_order(trials: Sequence[Trial], effects: Sequence[Effect]) -> list[Trial]:
    """Best first; of equally good ones the one that stands first in the catalogue: the simpler, and the rig's."""
    rank = {effect: i for i, effect in enumerate(effects)}
    top = max(t.gain for t in trials)
    return sorted(
        trials,
        key=lambda t: (0, rank.get(t.effect, len(rank)), -t.gain) if t.gain > top - _EQUAL else (1, 0, -t.gain),
    )


def _settled(refitter: Refitter, fit: Refit, trial: Trial, seed: int, tries: int, rounds: int) -> Trial:
    return _better_of(trial, _again(trial, refitter.settle(trial.fit, seed, tries=tries, rounds=rounds), fit))


def _again(trial: Trial, grown: Refit, fit: Refit) -> Trial:
    """A trial with another fit of it; `fit` is without it."""
    pooling = grown.model.additions[-1].pooling
    gain = log_evidence(grown) - log_evidence(fit)
    return replace(trial, pooling=pooling, fit=grown, gain=gain, physical=is_physical(grown))


def _better_of(old: Trial, new: Trial) -> Trial:
    """The new trial if it is physical and ahead, else the old one."""
    return new if new.physical and new.gain > old.gain else old
