"""Forward selection of missing effects, a backward pass, and alternatives that cannot be separated.

Each step screens all candidates with the previous additions in the model, refits the most promising ones and keeps the
best. The search stops when no candidate is significant after correction for all that were tried, when none improves the
evidence, with too few people for more, or when only repeated sweeps could show what is missing (:mod:`.one_sweep`).
Where a choice leaves structure and another that it does not exclude leaves none, that one is chosen
(:mod:`.what_remains`), where a second one is not better than a richer law alone, that law (:mod:`.richer_law`), and
where one of the rig with a second one is better than what is in the body, these (:mod:`.chain_first`).
What is superfluous then is removed, earlier choices are made anew beside what is left (:mod:`.exchange`).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.extend import has_admissible_signs
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.diagnosis.fit.of_members import of_members
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.chain_first import chain_first
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, LEAST_GAIN, compare, log_evidence
from bayes_impedance.diagnosis.selection.cross_validation import clearly_gains, people_gain
from bayes_impedance.diagnosis.selection.deciding_people import where_few_decide
from bayes_impedance.diagnosis.selection.exchange import EXCHANGES, Way, exchanged, pruned, without
from bayes_impedance.diagnosis.selection.few_people import holds_beside, may_follow
from bayes_impedance.diagnosis.selection.finalists import MOST, SHARE, finalists, in_order, with_lookalikes
from bayes_impedance.diagnosis.selection.in_some_people import in_some_people
from bayes_impedance.diagnosis.selection.misfit import dependence
from bayes_impedance.diagnosis.selection.one_sweep import shown_by_repeated_sweeps, two_that_leave_nothing
from bayes_impedance.diagnosis.selection.richer_law import longer_or_richer, simple_and_richer
from bayes_impedance.diagnosis.selection.score_scan import Screening, screen
from bayes_impedance.diagnosis.selection.shortlist import ALPHA, from_afar, try_shortlist
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import Trial
from bayes_impedance.diagnosis.selection.what_remains import that_leaves_nothing
from bayes_impedance.runtime.progress import Progress

MOST_ADDITIONS = 4
"""Largest number of additions of one search. By choice: a mismatch that needs more is not a list of effects."""

_REPEATS = 3
"""Largest number of times that a step is repeated because the model without the addition had not converged. By
choice."""

_SECOND_CHANCES = 3
"""Explanations of a step that are compared with the model without them, best first, until one is decided. By choice."""


@dataclass(frozen=True)
class Found:
    """Result of the search.

    Attributes
    ----------
    base, final : Refit
    steps : tuple of Step
        In order; the last step added nothing.
    """

    base: Refit
    final: Refit
    steps: tuple[Step, ...]

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
    way: Way | None = None,
) -> Found:
    """Find what is missing.

    Parameters
    ----------
    refitter : Refitter
    base : Refit
        The network alone, or with additions that are known.
    names : sequence of str
        Of the people.
    effects : sequence of Effect
    seed : int
    executor : Executor
    progress : callable
    begin : Refit, optional
        Fit of the same model as `base`, at which the first step screens and starts its refits.
    way : Way, optional
        The first step of this search, if it is made already (:func:`first_step`).
    """
    simple, richer = simple_and_richer(effects)
    forward = partial(_forward, refitter, names=names, effects=simple, seed=seed, executor=executor, progress=progress)
    step_from = partial(forward, steps_left=1)
    if way is None:
        way = step_from(Way(base, base, ()), begin=begin)

    def ended(way: Way) -> Way:
        while way.steps[-1].chosen is not None:
            way = longer_or_richer(refitter, way, step_from, names, simple, richer, seed, executor)
        return way

    way = ended(way)
    way = ended(two_that_leave_nothing(way, step_from, names, simple, seed, executor))
    if not is_no_list(way):
        way = ended(chain_first(way, step_from, names, simple, seed, executor))
    for _ in range(EXCHANGES):
        way = pruned(way, _backward(refitter, way.base, way.fit, seed))
        if is_no_list(way):
            break
        way, better = exchanged(refitter, way, step_from, seed)
        if not better:
            break
        way = forward(way)
    else:
        way = pruned(way, _backward(refitter, way.base, way.fit, seed))
    final = way.fit
    if final.model.additions and not way.measured:
        final = measured(refitter, final, seed)
    progress("looking for what is missing", MOST_ADDITIONS + 1, MOST_ADDITIONS + 1)
    return Found(way.base, final, way.steps)


def first_step(
    refitter: Refitter,
    base: Refit,
    names: Sequence[str],
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
    progress: Progress,
    begin: Refit | None = None,
) -> Way:
    """The first step of a search, with the parameters of :func:`search`, which may go on from it."""
    simple, _ = simple_and_richer(effects)
    return _forward(refitter, Way(base, base, ()), names, simple, seed, executor, progress, begin, steps_left=1)


def is_no_list(way: Way) -> bool:
    """Whether as many effects as may be found leave structure: then it is not worth the time to choose each anew."""
    last = way.steps[-1]
    return len(way.steps) > MOST_ADDITIONS and last.chosen is None and last.log_p < np.log(ALPHA)


def _forward(
    refitter: Refitter,
    way: Way,
    names: Sequence[str],
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
    progress: Progress,
    begin: Refit | None = None,
    steps_left: int = MOST_ADDITIONS + 1,
) -> Way:
    """At most so many steps from there, until nothing is significant, or better, any more."""
    most = MOST_ADDITIONS
    base, fit, steps, is_measured = way.base, way.fit, list(way.steps), way.measured
    number, repeats = len(steps), 0
    known: tuple[Trial, ...] = ()  # explanations of this step, from before the model without them was better fitted
    last = min(most, number + steps_left - 1)
    while number <= last:
        progress("looking for what is missing", number, most + 1)
        found = [s.chosen.effect for s in steps if s.chosen]
        possible, few = may_follow(found, effects, len(refitter.data))
        residuals = tuple(person_residuals(fit, names, executor))
        if begin is None:
            screening = screen(fit, residuals, possible, seed, executor)
        else:
            screening = screen(begin, person_residuals(begin, names, executor), possible, seed, executor)
        step = Step(before=fit, residuals=residuals, screening=screening)
        structured = step.log_p < np.log(ALPHA)
        just_made = bool(steps) and steps[-1].after is fit  # where a choice is made anew, steps are of other fits
        if structured and just_made:
            other = that_leaves_nothing(steps[-1], names, possible, seed, executor)
            if other is not None:
                steps[-1], fit = other, other.after
                continue
        if number < most and structured:
            trials, ranked = _explanations(refitter, fit, screening, possible, seed, begin, known)
            contest = _Contest(refitter, fit, ranked, possible, seed)
            chosen, better, unpredictive = None, None, False
            for _ in range(_SECOND_CHANCES):
                trial = contest.leader()
                if trial is None:
                    break
                better = _without_last(refitter, fit, trial.fit) if repeats < _REPEATS else None
                if better is not None:
                    break
                better_than_without = compare(trial.weighed, fit)
                # Of a few members the scatter of a mixture's gain is as large as itself: either account will do.
                decided = better_than_without.decided or compare(trial.fit, fit).decided
                if decided and (number == 0 or _earns_its_place(refitter, fit, trial.fit, seed, possible, few)):
                    trial = replace(trial, gain=better_than_without.difference)
                    unshown = shown_by_repeated_sweeps(refitter, trial, step, seed, executor)
                    if unshown is None:
                        chosen, is_measured = trial, True
                    else:
                        step = replace(step, unshown=unshown, refused=trial)
                    break
                unpredictive |= decided and not few
                contest.drop(trial)
            if better is not None:  # no physics was missing: the smaller model had not converged
                repeats += 1
                base = better if fit is base else base
                fit = better
                known = contest.among(trials)
                continue
            unpredictive &= chosen is None
            step = replace(step, trials=contest.among(trials), chosen=chosen, unpredictive=unpredictive)
        if begin is not None:
            begin = None
            if step.chosen is None:
                continue
        steps.append(step)
        if step.chosen is None:
            break
        fit = step.chosen.fit
        number, known = number + 1, ()
    return Way(base, fit, tuple(steps), is_measured)


def _earns_its_place(
    refitter: Refitter, fit: Refit, grown: Refit, seed: int, effects: Sequence[Effect], few: bool
) -> bool:
    """Whether a further addition predicts what was held out: people, or frequencies of so few.

    Structure that the first leaves has many ways to resemble some effect. One that does not predict would cost a step
    more, and all choices made anew beside it, before its name is withdrawn.
    """
    if few:
        return holds_beside(refitter, fit, grown, seed, effects)
    return clearly_gains(*people_gain(refitter, fit, grown, seed))


def _explanations(
    refitter: Refitter,
    fit: Refit,
    screening: Screening,
    effects: Sequence[Effect],
    seed: int,
    begin: Refit | None,
    known: Sequence[Trial],
) -> tuple[list[Trial], list[Trial]]:
    """All trials of a step, and the best ones at rest.

    Where only the fit without them has become another one, those that are known have come to rest already, and what
    they gain over it counts anew. Only candidates that were not tried are.
    """
    known = [replace(t, gain=log_evidence(t.weighed) - log_evidence(fit)) for t in known]
    tried = {(t.effect, t.candidate.place) for t in known}
    fresh = try_shortlist(refitter, fit, screening, begin, tried)
    if not known:
        fresh += from_afar(refitter, fit, effects, seed, screening)
        fresh += in_some_people(refitter, fit, effects, fresh, seed)
        ranked = finalists(refitter, fit, fresh, effects, seed)
        ranked = with_lookalikes(refitter, fit, screening, ranked, effects, seed)
        return fresh, where_few_decide(refitter, fit, ranked, effects, seed)
    possible = [t for t in known if t.physical and np.isfinite(t.gain)]
    hopeful = [t for t in fresh if t.gain > max((k.gain for k in possible), default=-np.inf) * SHARE]
    ranked = finalists(refitter, fit, hopeful, effects, seed) if hopeful else []
    best: dict[tuple[str, str, str], Trial] = {}
    for trial in sorted((*possible, *ranked), key=lambda t: -t.gain):
        best.setdefault(trial.fit.model.additions[-1].key, trial)
    enough = [t for t in best.values() if t.gain > LEAST_GAIN]
    best_few = in_order(enough, effects)[:MOST] if enough else []
    return [*known, *fresh], where_few_decide(refitter, fit, best_few, effects, seed)


class _Contest:
    """Explanations of a step, measured before one of them is believed.

    With the dispersions that its posterior shows, where its evidence is largest, an explanation may describe people
    worse than with those of the quick refits, or better: of resonators at two places one was 131 behind, and is 62
    ahead. In 24 first steps of ``analyses/other_worlds`` the order changed in two, by -42 to +179 units of log
    evidence for single explanations, and measuring all that might win took 1.7 s a step. Others are measured if they
    come to lead. One that is best with a sign which it cannot have counts as it was: a second path took a third of a
    network's damper back, because the damper alone is distributed a little otherwise.
    """

    def __init__(
        self, refitter: Refitter, fit: Refit, ranked: Sequence[Trial], effects: Sequence[Effect], seed: int
    ) -> None:
        self.refitter, self.fit, self.effects, self.seed = refitter, fit, effects, seed
        # Of one effect at one place the best: measured, another of it was at most 0.8 better.
        best: dict[tuple[str, str, str], Trial] = {}
        for trial in sorted(ranked, key=lambda t: -t.gain):
            best.setdefault(trial.fit.model.additions[-1].key, trial)
        self.trials = list(best.values())
        self.measured: list[Trial] = []
        least = max(SHARE * max((trial.gain for trial in ranked), default=0.0), LEAST_GAIN)
        for trial in best.values():
            if trial.gain > least:
                self._measure(trial)

    def leader(self) -> Trial | None:
        """The best explanation, measured; None if there is none."""
        while self.trials:
            trial = in_order(self.trials, self.effects)[0]
            if any(known is trial for known in self.measured):
                return trial
            self._measure(trial)
        return None

    def among(self, trials: Sequence[Trial]) -> tuple[Trial, ...]:
        """All explanations of a step, those that were measured only so."""
        keys = {trial.fit.model.additions[-1].key for trial in self.measured}
        return (*(t for t in (*trials, *self.trials) if t.fit.model.additions[-1].key not in keys), *self.measured)

    def _measure(self, trial: Trial) -> None:
        grown = measured(self.refitter, trial.fit, self.seed)
        if not has_admissible_signs(grown, len(grown.model.additions) - 1):
            grown = trial.fit
        self.drop(trial)
        enough = len(self.fit.data) >= FEWEST_PEOPLE
        mixture = of_members(self.refitter, grown, self.seed).mixture if enough else None
        if mixture is not None and log_evidence(mixture) <= log_evidence(grown):
            mixture = None
        gain = log_evidence(mixture or grown) - log_evidence(self.fit)
        trial = replace(trial, fit=grown, gain=gain, mixture=mixture)
        self.trials.append(trial)
        self.measured.append(trial)

    def drop(self, trial: Trial) -> None:
        """An explanation that is out of the contest."""
        self.trials = [other for other in self.trials if other is not trial]


def _without_last(refitter: Refitter, fit: Refit, grown: Refit) -> Refit | None:
    """Refit without the last addition from the larger model's estimates; None if it is not better than `fit`."""
    columns = [grown.model.kernel.elements.index(name) for name in fit.model.kernel.elements]
    again = refitter.fit(fit.model, grown.u[:, columns], fit.population)
    return again if again.evidence.sum() > fit.evidence.sum() + LEAST_GAIN else None


def _backward(refitter: Refitter, base: Refit, fit: Refit, seed: int) -> Refit:
    """Remove additions that later ones have made superfluous."""
    first = len(base.model.additions)
    while len(fit.model.additions) > first + 1:
        smaller = (without(refitter, fit, k, seed) for k in range(first, len(fit.model.additions)))
        best = max(smaller, key=log_evidence)
        if compare(fit, best).decided:
            best = refitter.settle(
                best, seed, tries=3, rounds=1
            )  # a person in another optimum looks like the need of one more effect
            if compare(fit, best).decided:
                return fit
        fit = best
    return fit


_MOST_ALIASES = 12
"""Largest number of rivals in a verdict. By choice: a reader will not go through more."""


def rivals(step: Step, remaining: Sequence[PersonResiduals] = ()) -> list[tuple[Trial, float, bool]]:
    """Rivals of a step's choice, each with its deficit of log evidence and whether the choice excludes it.

    Parameters
    ----------
    step : Step
        With a choice, or there are none.
    remaining : sequence of PersonResiduals
        Of the final model, if structure remains in them.
    """
    assert step.chosen is not None  # steps without a choice have no rivals
    chosen = step.chosen
    best: dict[tuple[str, str, str], Trial] = {}
    for trial in step.trials:
        if not trial.physical or not np.isfinite(trial.gain):
            continue
        key = (trial.effect.id, trial.effect.form, trial.candidate.place)
        if key == chosen.fit.model.additions[-1].key:
            continue
        if key not in best or best[key].gain < trial.gain:
            best[key] = trial
    result = []
    for trial in best.values():
        alike = dependence(chosen.fit, trial.fit, remaining) if remaining else 1.0
        result.append((trial, float(chosen.gain - trial.gain), compare(chosen.weighed, trial.weighed, alike).separated))
    return sorted(result, key=lambda row: row[1])[:_MOST_ALIASES]
