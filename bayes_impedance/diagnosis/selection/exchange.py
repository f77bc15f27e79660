"""Earlier additions chosen anew, when later ones are known.

The first step names what explains most while everything else is still missing. There an effect with more freedom can
win because it takes part of the other effect's place: beside a high-pass that had not been found yet, a resonator that
differs between people was 7500 nats ahead of a resonance of the rig; with the high-pass it is 56 behind. And what the
step did not consider as a rival may be the truth: beside a residual mass that was still missing a relaxation with a
damper of 0.42 N s/m explained twice as much as the damping of the rig that was there. So after the search each addition
that was not chosen beside the others that are there now is left out, and one step of the search chooses anew beside
them; if that describes more than what was found, the search goes on from there. A choice that was far ahead of
everything else in comparison with what was found later is not made anew: such a step costs as much as the first.

That step begins at the elements that people have beside the addition. In the fit without it they stand in for it, and
refits from there do not arrive: where a law of the amplitude that explained 44 000 was left out, a hysteresis that
explains more was not found.

An addition that stood for an error of the wrong choice has no sense beside the right one: its coefficient may then have
the wrong sign, with which nothing is chosen. Where a hysteresis had been taken for a damping that follows the
amplitude, a resonator that mended that law had a negative mass beside the hysteresis, which could not be chosen though
it was 700 ahead. Such additions are removed, and the choice is made without them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from bayes_impedance.diagnosis.fit.evidence_surface import climbed
from bayes_impedance.diagnosis.fit.extend import columns_kept, rebuilt, shrunk, unphysical, with_last
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.lost_elements import lost_elements, with_lost_elements
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN, log_evidence
from bayes_impedance.diagnosis.selection.far_starts import network_from_afar
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import Trial

EXCHANGES = 3
"""Largest number of additions that are chosen anew. By choice: each costs as much as a further step or two."""

_FAR = 10.0
"""Ratio of a choice's lead to what later additions have brought, from which it is not made anew. By choice: it is not
one, for beside the later ones a rival gains more than they did (a power law that stood for a delay and a relaxation was
1409 ahead, the delay then brought 1346, and the relaxation in the power law's place another 3400)."""

_ROUNDS = 40
"""Rounds of a fit with elements that had been lost: that of a refit which begins at another one."""


@dataclass(frozen=True)
class Way:
    """Where a search has come to.

    Attributes
    ----------
    base, fit : Refit
        Of the model that it began with, and of the last one.
    steps : tuple of Step
        Between them.
    measured : bool
        Whether the last one is (:mod:`bayes_impedance.diagnosis.fit.measured`).
    """

    base: Refit
    fit: Refit
    steps: tuple[Step, ...]
    measured: bool = False


class StepFrom(Protocol):
    """Makes one more step from a way."""

    def __call__(self, way: Way, begin: Refit | None = None) -> Way:
        """The longer way; explanations are screened and begin at `begin`, a fit of the way's model, if given."""
        ...


def without(refitter: Refitter, fit: Refit, addition: int, seed: int) -> Refit:
    """The fit of the model without one of its additions, from the fit with it, where its evidence is largest.

    What was added may have taken the place of elements that the fit had lost: then they are searched, and where a wrong
    addition has driven elements away, all of the network's. A residual mass beside which a law of the amplitude had
    stood was 6300 behind, with the elements that it was left with, what it was with those of the network's search.
    """
    kept, model = _left(fit, addition)
    smaller = shrunk(refitter, fit, model, kept)
    begin = fit.u[:, columns_kept(fit.model, kept)]
    smaller = with_lost_elements(refitter, smaller, begin, lost_elements(fit), _ROUNDS)
    return climbed(refitter, network_from_afar(refitter, smaller, seed, _ROUNDS), seed)


def _left(fit: Refit, addition: int) -> tuple[list[int], Model]:
    """The other additions, and the model with them."""
    kept = [k for k in range(len(fit.model.additions)) if k != addition]
    return kept, rebuilt(fit.model, [fit.model.additions[k] for k in kept], kept)


def _elements_kept(refitter: Refitter, fit: Refit, addition: int) -> Refit:
    """The model without an addition, where everything else is as it is with it."""
    kept, model = _left(fit, addition)
    return shrunk(refitter, fit, model, kept, rounds=0)


def pruned(way: Way, fit: Refit) -> Way:
    """The way with a smaller model, of which some additions were removed, and without their steps."""
    if fit is way.fit:
        return way
    kept = _keys(fit)
    steps = tuple(step for step in way.steps if step.chosen is None or _key(step) in kept)
    return Way(way.base, fit, steps)


def exchanged(refitter: Refitter, way: Way, step_from: StepFrom, seed: int) -> tuple[Way, bool]:
    """Choose one addition anew beside the others, if that is better.

    Parameters
    ----------
    refitter : Refitter
    way : Way
        Of a search.
    step_from : callable
        Makes one more step from a way, beginning at a fit of its model if one is given.
    seed : int

    Returns
    -------
    way : Way
        With another addition, or with the same ones, which are then compared with what was tried beside the others
        that are there now.
    better : bool
        Whether an addition is another one.
    """
    made = [step for step in way.steps if step.chosen is not None]
    for k, step in enumerate(made):
        assert step.chosen is not None  # only such steps were made
        beside = _keys(way.fit) - {_key(step)}
        if _keys(step.before) == beside:
            continue
        later = log_evidence(way.fit) - log_evidence(step.chosen.fit)
        if _keys(step.before) < beside and _lead(step) > _FAR * max(later, LEAST_GAIN):
            continue
        others = (*made[:k], *made[k + 1 :])
        left_out = _index(way.fit, _key(step))
        smaller, begin = without(refitter, way.fit, left_out, seed), _elements_kept(refitter, way.fit, left_out)
        anew = step_from(Way(way.base, smaller, others), begin=begin)
        new = anew.steps[len(others)]
        if senseless := _senseless_beside(new) & {_key(other) for other in others}:
            for key in senseless:
                smaller = without(refitter, smaller, _index(smaller, key), seed)
                begin = _elements_kept(refitter, begin, _index(begin, key))
            others = tuple(other for other in others if _key(other) not in senseless)
            anew = step_from(Way(way.base, smaller, others), begin=begin)
            new = anew.steps[len(others)]
        if new.chosen is None:
            continue
        # What was tried beside the others is what it is compared with; the step's place and residuals stay.
        instead = replace(step, before=new.before, trials=new.trials, chosen=new.chosen)
        if log_evidence(anew.fit) > log_evidence(way.fit) + LEAST_GAIN:
            place = sum(1 for other in made[:k] if other in others)
            return replace(anew, steps=(*others[:place], instead, *others[place:])), True
        if senseless:
            continue
        again = [t for t in (new.chosen, *new.trials) if t.fit.model.additions[-1].key == _key(step)]
        if again:
            made[k] = replace(instead, chosen=_as_found(refitter, way.fit, again[0], new.before))
            last = way.steps[len(made) :]
            way = replace(way, steps=(*made, *last))
    return way, False


def without_senseless(refitter: Refitter, way: Way, longer: Way, step_from: StepFrom, seed: int) -> Way:
    """A longer way, or one without additions that have the wrong sign beside what describes most in its last step.

    A wrong first name may leave the truth only together with a sign which that name cannot have. The truth was no
    choice then: a delay with which a relaxation of the tissue would have been negative was 19 ahead of a compliance of
    the rig, which was taken, and a residual mass after it.

    Parameters
    ----------
    refitter : Refitter
    way : Way
        Before the last step.
    longer : Way
        With it.
    step_from : callable
        Makes one more step from a way.
    seed : int
    """
    of_the_way = {_key(step) for step in way.steps if step.chosen is not None}
    senseless = _senseless_beside(longer.steps[-1]) & of_the_way
    if not senseless:
        return longer
    smaller = begin = way.fit
    for key in sorted(senseless):
        smaller = without(refitter, smaller, _index(smaller, key), seed)
        begin = _elements_kept(refitter, begin, _index(begin, key))
    others = tuple(step for step in way.steps if _key(step) not in senseless)
    anew = step_from(Way(way.base, smaller, others), begin=begin)
    return anew if log_evidence(anew.fit) > log_evidence(longer.fit) + LEAST_GAIN else longer


def _as_found(refitter: Refitter, fit: Refit, trial: Trial, before: Refit) -> Trial:
    """A trial of an addition beside the others, or the fit that the search has come to if that describes more.

    What was tried may be far from rest: of a low-pass beside a residual mass, which the search had found and which
    gained 386 there, the trial was 8886 behind the mass alone, and all that was tried beside it ahead.
    """
    known = with_last(refitter, fit, _index(fit, trial.fit.model.additions[-1].key))
    gain = log_evidence(known) - log_evidence(before)
    if gain <= trial.gain:
        return trial
    return replace(trial, fit=known, pooling=known.model.additions[-1].pooling, gain=gain, physical=True, mixture=None)


def _index(fit: Refit, key: tuple[str, str, str]) -> int:
    return [addition.key for addition in fit.model.additions].index(key)


def _senseless_beside(step: Step) -> set[tuple[str, str, str]]:
    """Additions that have the wrong sign beside what describes most, if that itself has not."""
    trials = [t for t in (*step.trials, *([step.chosen] if step.chosen else [])) if np.isfinite(t.gain)]
    if not trials:
        return set()
    # By its evidence as it is fitted: what other dispersions would bring is foretold from afar where a sign is wrong.
    fit = max((t.fit for t in trials), key=lambda fit: float(fit.evidence.sum()))
    wrong = unphysical(fit)
    if len(fit.model.additions) - 1 in wrong:
        return set()
    return {fit.model.additions[i].key for i in wrong}


def _lead(step: Step) -> float:
    """By how much a step's choice was ahead of what was tried beside it."""
    assert step.chosen is not None  # only steps that chose something are compared
    others = (t.gain for t in step.trials if t.physical and t.fit.model.additions[-1].key != _key(step))
    return step.chosen.gain - max((gain for gain in others if np.isfinite(gain)), default=-np.inf)


def _key(step: Step) -> tuple[str, str, str]:
    assert step.chosen is not None  # only steps that chose something are compared
    return step.chosen.fit.model.additions[-1].key


def _keys(fit: Refit) -> set[tuple[str, str, str]]:
    return {addition.key for addition in fit.model.additions}
