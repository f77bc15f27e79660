"""Forward selection of what is missing, a backward pass, and what cannot be told apart.

Each step looks at all candidates with what was found before in place, refits the most promising with the whole
population and keeps the best one. It stops when no candidate is significant after correction for all that were tried,
when none improves the evidence, or when the people are too few for more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.mismatch.coefficients import CoefficientPosterior
from bayes_impedance.mismatch.confirm import ALPHA, LEAST_GAIN, Trial, gain, try_shortlist
from bayes_impedance.mismatch.effects import Effect
from bayes_impedance.mismatch.finalists import at_rest, finalists, measured, rebuilt, whole_gain
from bayes_impedance.mismatch.model import Addition, Model
from bayes_impedance.mismatch.refit import Refit, Refitter
from bayes_impedance.mismatch.residuals import PersonResiduals
from bayes_impedance.mismatch.screen import Screening, person_residuals, screen
from bayes_impedance.mismatch.sides import sided

MOST_ADDITIONS = 4
_PEOPLE_PER_ADDITION = 8
_REPEATS = 3
_FEWEST = 10
_SURE = 3.0
_SECOND_CHANCES = 3

SPREAD_PENALTY = float(np.log(100.0))
"""The spread between people is held to a stricter level: noise of another shape in some people looks like it."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Step:
    """One step of the forward selection.

    Attributes
    ----------
    before : Refit
        Without the addition.
    residuals : tuple of PersonResiduals
        Of that.
    screening : Screening
        Of that.
    trials : tuple of Trial
        Everything that was refitted.
    chosen : Trial or None
        What was added.
    """

    before: Refit
    residuals: tuple[PersonResiduals, ...]
    screening: Screening
    trials: tuple[Trial, ...]
    chosen: Trial | None

    @property
    def log_p(self) -> float:
        """Smallest corrected log p-value among candidates with a possible sign, of a common size or of its spread."""
        s = self.screening
        z = np.where(s.physical, np.nan_to_num(s.z), 0.0)
        body = np.array([c.effect.side == "body" for c in s.candidates], dtype=bool)
        spread = float(np.min(np.where(body & s.physical, s.log_p_spread, 0.0), initial=0.0))
        return min(float(s.log_p(np.abs(z).max(initial=0.0))), spread + SPREAD_PENALTY)


@dataclass(frozen=True)
class Found:
    """Where the search ended.

    Attributes
    ----------
    base, final : Refit
    steps : tuple of Step
        The last one found nothing more.
    posterior : CoefficientPosterior or None
        Joint posterior of everything that was added, from the quadratic expansion.
    """

    base: Refit
    final: Refit
    steps: tuple[Step, ...]
    posterior: CoefficientPosterior | None

    def step_of(self, addition: Addition) -> Step | None:
        """The step in which an addition was found."""
        for step in self.steps:
            if step.chosen is not None and step.chosen.fit.model.additions[-1].key == addition.key:
                return step
        return None


def search(
    refitter: Refitter,
    base: Refit,
    names: Sequence[str],
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
    progress: Progress,
    begin: Refit | None = None,
) -> Found:
    """Find what is missing.

    Parameters
    ----------
    refitter : Refitter
    base : Refit
        The network alone, or with what is known to belong to it.
    names : sequence of str
        Of the people.
    effects : sequence of Effect
    seed : int
    executor : Executor
    progress : callable
    begin : Refit, optional
        Of the same model as `base`: where the first step looks and where its refits begin, if it finds something there.
    """
    most = min(MOST_ADDITIONS, max(1, len(refitter.data) // _PEOPLE_PER_ADDITION))
    fit, steps, posterior = base, list[Step](), None
    number = repeats = 0
    while number <= most:
        progress("looking for what is missing", number, most + 1)
        residuals = tuple(person_residuals(fit, names, executor))
        if begin is None:
            screening = screen(fit, residuals, effects, seed, executor)
        else:
            screening = screen(begin, person_residuals(begin, names, executor), effects, seed, executor)
        step = Step(fit, residuals, screening, (), None)
        if number < most and step.log_p < np.log(ALPHA):
            trials = try_shortlist(refitter, fit, screening, begin)
            ranked = finalists(refitter, fit, trials, seed)
            ranked = at_rest(refitter, fit, ranked, seed) if ranked else []
            ranked = sided(refitter, fit, ranked, trials, seed) if ranked else []
            chosen, better = None, None
            for trial in ranked[:_SECOND_CHANCES]:
                grown, measure = measured(refitter, trial.fit, seed)
                better = _without_last(refitter, fit, grown) if repeats < _REPEATS else None
                if better is not None:
                    break
                grown_gain = whole_gain(grown, fit)
                if grown_gain > LEAST_GAIN and _sure(grown, measure) and _shared_by_many(grown, fit):
                    chosen, posterior = replace(trial, fit=grown, gain=grown_gain), measure
                    break
            if better is not None:  # it was not physics that was missing but convergence
                repeats += 1
                base = better if fit is base else base
                fit = better
                continue
            step = replace(step, trials=(*trials, *ranked), chosen=chosen)
        if begin is not None:
            begin = None
            if step.chosen is None:
                continue
        steps.append(step)
        if step.chosen is None:
            break
        fit = step.chosen.fit
        number += 1
    final = _backward(refitter, base, fit)
    if final is not fit and final.model.additions:
        final, posterior = measured(refitter, final, seed)
    progress("looking for what is missing", most + 1, most + 1)
    return Found(base, final, tuple(steps), posterior if final.model.additions else None)


def _without_last(refitter: Refitter, fit: Refit, grown: Refit) -> Refit | None:
    """The fit without the last addition, begun where the larger model has ended; None if that is no better."""
    columns = [grown.model.kernel.elements.index(name) for name in fit.model.kernel.elements]
    again = refitter.fit(fit.model, grown.u[:, columns], fit.population)
    return again if again.evidence.sum() > fit.evidence.sum() + LEAST_GAIN else None


def _sure(fit: Refit, posterior: CoefficientPosterior) -> bool:
    """Whether the coefficient of the last addition is surely not zero."""
    last = len(fit.model.additions) - 1
    columns = [
        c - fit.model.n_elements
        for c in fit.model.columns(last)
        if fit.model.parameters[c - fit.model.n_elements].is_coefficient
    ]
    if not columns or fit.model.additions[last].effect.pooling == "some":
        return True  # a branch has no zero; who has a layer and who has not was tested already
    draws = posterior.central[:, columns]
    return bool(np.any(np.abs(draws.mean(axis=0)) > _SURE * draws.std(axis=0)))


def _shared_by_many(grown: Refit, fit: Refit) -> bool:
    """Whether the gain exceeds its scatter over people: what one person gains is a local optimum and not physics."""
    difference = grown.evidence - fit.evidence
    if difference.size < _FEWEST or grown.model.additions[-1].effect.pooling == "some":
        return True
    return bool(difference.sum() > 2 * np.sqrt(difference.size) * difference.std(ddof=1))


def _backward(refitter: Refitter, base: Refit, fit: Refit) -> Refit:
    """Take out what later additions have made superfluous."""
    first = len(base.model.additions)
    while len(fit.model.additions) > first + 1:
        losses = []
        for k in range(first, len(fit.model.additions)):
            kept = [i for i in range(len(fit.model.additions)) if i != k]
            model = rebuilt(fit.model, [fit.model.additions[i] for i in kept], kept)
            smaller = _shrunk(refitter, fit, model, kept)
            losses.append((gain(fit, smaller), smaller))
        loss, smaller = min(losses, key=lambda pair: pair[0])
        if loss > LEAST_GAIN:
            return fit
        fit = smaller
    return fit


def _shrunk(refitter: Refitter, fit: Refit, model: Model, kept: Sequence[int]) -> Refit:
    """The fit of a model with fewer additions, whose parameters carry other numbers in their names."""
    columns = list(range(fit.model.n_elements)) + sorted(c for k in kept for c in fit.model.columns(k))
    u = fit.u[:, columns]
    varying_old = np.flatnonzero(~fit.model.shared)
    positions = [int(np.flatnonzero(varying_old == c)[0]) for c in columns if not fit.model.shared[c]]
    population = fit.population
    smaller = replace(
        population,
        mu=population.mu[positions],
        covariance=population.covariance[np.ix_(positions, positions)],
        rho=population.rho[positions],
    )
    return refitter.fit(model, u, smaller)
