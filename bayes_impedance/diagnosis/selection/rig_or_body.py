r"""Rig or body, where the recordings cannot tell two explanations apart: bodies differ, devices do not.

- Where the best explanation is of the body but the recordings say that everybody has the same of it, one of the rig
  that they cannot tell from it comes first.
- Two entries may be one formula at one place, such as the mass of a fixture and that of tissue that moves with the
  contactor. Then all that is in question is whether people differ, :math:`\tau = 0` or not, and the odds are

  .. math:: \int p(\tau)\,L(\tau)\,d\tau \Big/ L(0), \qquad
            \ln\frac{\tau}{|\mu|} \sim N(\ln 0.35, (\ln 2)^2),

  with the likelihood L of :mod:`bayes_impedance.diagnosis.fit.normal_equations`, everybody's own coefficients
  integrated out, and p what people usually differ by, give or take a factor of two. The price by which other
  explanations are compared, half the logarithm of the number of recordings, asks of a dispersion to be as sure as an
  effect has to be. A mass that does differ, but is known in few people well enough to show it, would be called the
  fixture's by that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior, verdict_on_side
from bayes_impedance.diagnosis.fit.extend import has_shapes, with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refit, Refitter
from bayes_impedance.diagnosis.fit.model import TYPICAL_DISPERSION
from bayes_impedance.diagnosis.fit.normal_equations import marginal, quadratic
from bayes_impedance.diagnosis.selection.compare import FEWEST, RIVAL, better_of, is_separated, regrown
from bayes_impedance.diagnosis.selection.shortlist import Trial

_TYPICAL_SD = np.log(2.0)
_NODES = 41


def sided(refitter: Refitter, fit: Refit, ranked: Sequence[Trial], trials: Sequence[Trial], seed: int) -> list[Trial]:
    """The finalists with an explanation of the other side first, where that is the better name for the same thing.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without them.
    ranked : sequence of Trial
        The finalists, the best first.
    trials : sequence of Trial
        All that were tried.
    seed : int
    """
    if len(refitter.data) < FEWEST:
        return list(ranked)
    ranked = same_for_all(refitter, fit, ranked, trials, seed)
    return with_probable_twin(refitter, fit, ranked, trials, seed)


def same_for_all(
    refitter: Refitter, fit: Refit, ranked: Sequence[Trial], trials: Sequence[Trial], seed: int
) -> list[Trial]:
    """The finalists with an explanation by the rig first, if nothing but the name speaks for the body.

    Parameters are those of :func:`sided`.
    """
    leader = ranked[0]
    if leader.effect.side == "rig" or leader.pooling != "shared":
        return list(ranked)
    last = len(leader.fit.model.additions) - 1
    if verdict_on_side(dispersion_of_shared(leader.fit, last, seed)) != "rig":
        return list(ranked)
    possible = [t for t in (*ranked, *trials) if t.effect.side == "rig" and t.physical and np.isfinite(t.gain)]
    if not possible:
        return list(ranked)
    rig = max(possible, key=lambda t: t.gain)
    if rig.gain > leader.gain - RIVAL and rig not in ranked:
        rig = better_of(rig, regrown(rig, refitter.settle(rig.fit, seed, tries=2, rounds=1), fit))
    if is_separated(leader, rig):
        return list(ranked)
    return _first(rig, ranked)


def dispersion_of_shared(fit: Refit, addition: int, seed: int) -> np.ndarray:
    """Draws of how much people differ in a coefficient that was fitted as the same for all, relative to it."""
    model = with_pooling(fit.model, addition, "varying")
    column = model.columns(addition)[0] - model.n_elements
    return coefficient_posterior(replace(fit, model=model), seed).relative_dispersion[:, column]


def with_probable_twin(
    refitter: Refitter, fit: Refit, ranked: Sequence[Trial], trials: Sequence[Trial], seed: int
) -> list[Trial]:
    """The finalists with the other of two entries of one formula first, if it is the more probable one.

    Parameters are those of :func:`sided`.
    """
    leader = ranked[0]
    twins = [t for t in (*ranked, *trials) if _are_twins(leader, t) and t.physical and np.isfinite(t.gain)]
    if not twins:
        return list(ranked)
    twin = max(twins, key=lambda t: t.gain)
    rig = twin if twin.effect.side == "rig" else leader
    more_probable = "body" if log_odds_of_differing(rig.fit, len(rig.fit.model.additions) - 1) > 0 else "rig"
    if leader.effect.side == more_probable or (leader.effect.side == "body" and is_separated(leader, twin)):
        return list(ranked)
    if twin not in ranked:
        twin = better_of(twin, regrown(twin, refitter.settle(twin.fit, seed, tries=2, rounds=1), fit))
    return _first(twin, ranked)


def log_odds_of_differing(fit: Refit, addition: int) -> float:
    """Logarithm of the odds that people differ in a linear coefficient that was fitted as the same for all.

    Both are equally probable before the recordings.

    Parameters
    ----------
    fit : Refit
    addition : int
        Whose first parameter it is.
    """
    model = with_pooling(fit.model, addition, "varying")
    h, d, _ = quadratic(model, fit.data, fit.u, fit.equations, fit.population.covariance)
    size = np.abs(fit.u[:, model.n_elements :].mean(axis=0))
    unit = np.array([s if p.is_coefficient else 1.0 for s, p in zip(size, model.parameters, strict=True)])
    column = model.columns(addition)[0] - model.n_elements

    def log_likelihood(relative: float) -> float:
        tau = unit * [0.0 if p.shared else p.dispersion for p in model.parameters]
        tau[column] = relative * unit[column]
        return marginal(model, h, d, tau).log_density

    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    values = [log_likelihood(TYPICAL_DISPERSION * float(np.exp(_TYPICAL_SD * x))) for x in nodes]
    return float(logsumexp(values, b=weights / weights.sum())) - log_likelihood(0.0)


def _are_twins(one: Trial, other: Trial) -> bool:
    """Whether they are one formula at one place, of the rig and of the body, that has nothing but its coefficient."""
    a, b = one.effect, other.effect
    same = a.operation == b.operation and a.coefficients == b.coefficients
    return (
        bool(a.operation and same and {a.side, b.side} == {"rig", "body"} and not has_shapes(a))
        and one.candidate.place == other.candidate.place
    )


def _first(trial: Trial, ranked: Sequence[Trial]) -> list[Trial]:
    return [trial, *(t for t in ranked if t.fit.model.additions[-1].key != trial.fit.model.additions[-1].key)]
