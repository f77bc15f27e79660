"""The last round: the best explanations, each with the freedom that it needs, compared on equal terms.

The first refits hold a coefficient's dispersion at a typical value, let shapes differ between people or not, and begin
wherever the model without them has ended. That is enough to see which explanations are in question, but not to choose
between them: the one that happens to have the right dispersion would win. Here

- shapes may differ between people where that is worth its parameters,
- dispersions go to their posterior medians,
- everybody is given the chance to leave a local optimum, at the same effect's other places too, and
- a coefficient that is absent in some people is not punished for not being normal
  (:mod:`bayes_impedance.diagnosis.fit.spike_slab`).

Whose the best one is, the rig's or the body's, is looked at last
(:mod:`bayes_impedance.diagnosis.selection.rig_or_body`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.extend import (
    LEAST_GAIN,
    extended_start,
    gain,
    is_physical,
    with_measured_dispersions,
    with_pooling,
)
from bayes_impedance.diagnosis.fit.fitter import Refit, Refitter
from bayes_impedance.diagnosis.fit.spike_slab import members
from bayes_impedance.diagnosis.selection.shortlist import Trial

MOST = 4
_SHARE = 0.6
_CLOSE = 1.0
RIVAL = 10.0
"""A rival that is further behind is not worth more refits."""

_ROUNDS = 40
FEWEST, _FEWEST_TO_VARY = 10, 3


def finalists(refitter: Refitter, fit: Refit, trials: Sequence[Trial], seed: int) -> list[Trial]:
    """The best trials, refitted on equal terms, the best first.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without them.
    trials : sequence of Trial
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
    grown = [ripened(refitter, fit, t, seed) for t in (*close[:MOST], *some[:1])]
    grown = [t for t in grown if t.gain > LEAST_GAIN]
    return in_order(grown) if grown else []


def ripened(refitter: Refitter, fit: Refit, trial: Trial, seed: int) -> Trial:
    """The trial with own shapes if they are worth it, and with its dispersions estimated."""
    effect, last = trial.effect, len(trial.fit.model.additions) - 1
    if effect.side == "rig" or len(refitter.data) < _FEWEST_TO_VARY:
        return trial
    best = trial
    if trial.pooling != "shared":
        best = better_of(trial, regrown(trial, _ripe(refitter, trial.fit, seed), fit))
    if trial.pooling != "free" and any(c.link != "linear" for c in effect.coefficients[1:]):
        model = with_pooling(trial.fit.model, last, "free")
        grown = refitter.fit(model, *extended_start(trial.fit, model), 30)
        free = regrown(trial, _ripe(refitter, grown, seed), fit)
        if free.physical and free.gain > best.gain + LEAST_GAIN:
            return free
    return best


def _ripe(refitter: Refitter, grown: Refit, seed: int) -> Refit:
    return with_measured_dispersions(refitter, grown, coefficient_posterior(grown, seed))


def at_rest(refitter: Refitter, fit: Refit, ranked: Sequence[Trial], seed: int) -> list[Trial]:
    """The best of the finalists with everybody at rest, and its close rivals too: the best first.

    A person in a local optimum costs as much as a wrong explanation does. The same effect at another place begins where
    the best one has ended, other effects look for better optima on their own.
    """
    leader = regrown(ranked[0], refitter.settle(ranked[0].fit, seed), fit)
    result = [leader]
    for trial in ranked[1:]:
        if trial.effect == leader.effect:
            model = with_pooling(trial.fit.model, len(trial.fit.model.additions) - 1, leader.pooling)
            again = regrown(trial, refitter.fit(model, leader.fit.u, leader.fit.population, _ROUNDS), fit)
            result.append(better_of(trial, again))
        elif trial.gain > ranked[0].gain - RIVAL:  # the leader's before it was at rest
            result.append(better_of(trial, regrown(trial, refitter.settle(trial.fit, seed, tries=2, rounds=1), fit)))
        else:
            result.append(trial)
    result = in_order(result)
    if result[0] is not leader:
        result[0] = better_of(
            result[0], regrown(result[0], refitter.settle(result[0].fit, seed, tries=3, rounds=2), fit)
        )
    return result


def is_separated(leader: Trial, rival: Trial) -> bool:
    """Whether the evidence of a rival is behind by more than three (20 to 1), and by twice its scatter over people."""
    difference = leader.fit.evidence - rival.fit.evidence
    se = np.sqrt(difference.size) * difference.std(ddof=1) if difference.size > 1 else 0.0
    behind = leader.gain - rival.gain
    return bool(behind > LEAST_GAIN and behind > 2 * se)


def in_order(trials: Sequence[Trial]) -> list[Trial]:
    """Best first; of equally good ones the one that stands first in the catalogue: the simpler, and the rig's."""
    rank = {effect: i for i, effect in enumerate(registered())}
    top = max(t.gain for t in trials)
    return sorted(
        trials,
        key=lambda t: (0, rank.get(t.effect, len(rank)), -t.gain) if t.gain > top - _CLOSE else (1, 0, -t.gain),
    )


def regrown(trial: Trial, grown: Refit, fit: Refit) -> Trial:
    """A trial with another fit of it; `fit` is without it."""
    pooling = grown.model.additions[-1].pooling
    return replace(trial, pooling=pooling, fit=grown, gain=whole_gain(grown, fit), physical=is_physical(grown))


def better_of(old: Trial, new: Trial) -> Trial:
    """The new trial if it is physical and ahead, else the old one."""
    return new if new.physical and new.gain > old.gain else old


def whole_gain(grown: Refit, fit: Refit) -> float:
    """Gain of evidence, with what it gains that some people have nothing of the last addition."""
    total = gain(grown, fit)
    last = len(grown.model.additions) - 1
    addition = grown.model.additions[last]
    if addition.pooling == "shared" or not addition.effect.operation or len(grown.data) < FEWEST:
        return total
    who = members(grown, last)
    return total + max(who.gain - 0.5 * float(np.log(len(grown.u))), 0.0) * who.only_some
