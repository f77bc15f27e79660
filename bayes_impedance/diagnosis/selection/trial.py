"""Refits of the model with one candidate added, and what they gain.

Where the candidate has a shape, such as a frequency, everybody begins at the same one or at their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.cold_start import cold_start, driven_away, lost_alone
from bayes_impedance.diagnosis.fit.extend import extended, extended_start, is_physical
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, FEWEST_TO_VARY, log_evidence
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.person.likelihood import SCALE_SHAPE

_OWN_SHAPE_KNOWN = 12.0
"""Chi-square of one person's own best shape above which that shape is a start: by chance 5e-4 for one shape, so below
1 % for a grid of a dozen."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A refit of one candidate.

    Attributes
    ----------
    candidate : Candidate
    pooling : str
    fit : Refit
    gain : float
        Of log evidence over the model without it (:func:`.compare.log_evidence`).
    physical : bool
        Whether the fitted coefficient has an admissible sign.
    mixture : Refit, optional
        Fit in which only some people have it, where its evidence is the larger one
        (:mod:`bayes_impedance.diagnosis.fit.of_members`).
    """

    candidate: Candidate
    pooling: str
    fit: Refit
    gain: float
    physical: bool
    mixture: Refit | None = None

    @property
    def weighed(self) -> Refit:
        """The fit by whose evidence it is compared with other explanations."""
        return self.mixture or self.fit

    @property
    def effect(self) -> Effect:
        """The candidate's effect."""
        return self.candidate.effect


def try_candidate(
    refitter: Refitter,
    fit: Refit,
    candidate: Candidate,
    size: float,
    poolings: Sequence[str],
    rounds: int = 30,
    begin: Refit | None = None,
) -> list[Trial]:
    """Refit the model with one candidate added.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without it.
    candidate : Candidate
    size : float
        One-step estimate of the coefficient, because a branch cannot start at zero.
    poolings : sequence of str
    rounds : int
    begin : Refit, optional
        Fit of the model without it at which the refits begin; `fit` if not given.
    """
    # The coefficient is linear: at zero the larger model is the smaller one, and the elements follow from there.
    model = extended(fit.model, candidate, "shared", size)
    grown = refitter.fit(model, *extended_start(begin or fit, model), rounds)
    trials = [trial_of(candidate, "shared", grown, fit)]
    for pooling in poolings:
        if pooling != "shared":
            model = extended(fit.model, candidate, pooling, size)
            grown = refitter.fit(model, *extended_start(trials[-1].fit, model), rounds)
            trials.append(trial_of(candidate, pooling, grown, fit))
    return [from_cold(refitter, fit, t, rounds) for t in trials if t.pooling in poolings]


def from_cold(refitter: Refitter, fit: Refit, trial: Trial, rounds: int) -> Trial:
    """The best of a trial and of cold starts, if the model without the addition has driven elements away."""
    if not driven_away(fit).any():
        return trial
    best = trial
    for start in (cold_start, lost_alone):
        u, population = start(fit, trial.fit)
        if refitter.one_person:  # no population: mean and covariance are those of the prior, and stay so
            population = trial.fit.population
        cold = refitter.fit(trial.fit.model, u, population, rounds)
        other = trial_of(trial.candidate, trial.pooling, cold, fit)
        best = other if (other.physical, other.gain) > (best.physical, best.gain) else best
    return best


def own_shapes(
    refitter: Refitter, fit: Refit, screening: Screening, k: int, rounds: int = 30, begin: Refit | None = None
) -> Trial:
    """Refit with shapes that differ between people, each person starting at the shape with the best own score.

    A resonance at a different frequency in each person cannot be found from a common start. Coefficients start at most
    at what changes the impedance by its magnitude: beyond it, the derivative says nothing about their size.
    """
    chosen = screening.candidates[k]
    effect = chosen.effect
    same = [i for i, c in enumerate(screening.candidates) if c.effect == effect and c.place == chosen.place]
    b, m = screening.score[:, same], screening.information[:, same]
    strength = np.where(b > 0, b**2 / np.maximum(m, 1e-300), 0.0)
    own = np.argmax(strength, axis=1)
    sure = strength.max(axis=1) > _OWN_SHAPE_KNOWN
    model = extended(fit.model, chosen, "free", float(screening.size[k]))
    u, population = extended_start(begin or fit, model)
    scales, columns = model.scales, model.columns(len(model.additions) - 1)
    mu = population.mu.copy()
    rows = np.arange(len(own))
    people = np.flatnonzero(sure) if sure.sum() > 2 else rows
    size = float(np.sum(b[people, own[people]]) / np.sum(m[people, own[people]]))
    varying = np.flatnonzero(~model.shared)
    for coefficient, column in zip(effect.coefficients, columns, strict=True):
        if coefficient.link == "linear":
            values = np.full(len(own), np.clip(size / coefficient.scale(scales), -1.0, 1.0))
        else:
            shapes = [coefficient.unbounded(screening.candidates[i].shape[coefficient.name], scales) for i in same]
            values = np.array(shapes)[own]
            values = np.where(sure, values, np.median(values[people]))
        u[:, column] = values[fit.owner]
        mu[int(np.flatnonzero(varying == column)[0])] = values.mean()
    grown = refitter.fit(model, u, replace(population, mu=mu), rounds)
    return from_cold(refitter, fit, trial_of(chosen, "free", grown, fit), rounds)


def trial_of(candidate: Candidate, pooling: str, grown: Refit, fit: Refit) -> Trial:
    """The trial of a candidate: `grown` is the fit with it and `fit` the one without."""
    return Trial(
        candidate=candidate,
        pooling=pooling,
        fit=grown,
        gain=log_evidence(grown) - log_evidence(fit),
        physical=is_physical(grown),
    )


def hoped_for(trial: Trial, at_least: float = 1.0) -> float:
    """The gain if everybody were described as well as the median person: what searching for better optima can bring.

    Only people whose noise scale is so many times the median person's are counted.
    """
    scale = trial.fit.weight**-0.5
    relative = scale / np.median(scale)
    exponent = SCALE_SHAPE + np.array([data.count for data in trial.fit.data])
    return trial.gain + float(np.sum(2 * exponent * np.log(np.where(relative > at_least, relative, 1.0))))


def poolings_for(effect: Effect, n_people: int, differs: bool = False) -> tuple[str, ...]:
    """Pooling of a coefficient: that of the rig is shared, that of the body varies.

    Where a coefficient of the rig clearly differs between people, some of them may have been recorded otherwise.
    """
    if effect.side == "rig" and differs and effect.operation and n_people >= FEWEST_PEOPLE:
        return ("shared", "varying")
    return ("shared",) if effect.side == "rig" or n_people < FEWEST_TO_VARY else ("varying",)
