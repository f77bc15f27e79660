"""A choice that was made beside other additions than those that are there now is made anew."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.selection import exchange
from bayes_impedance.diagnosis.selection.exchange import Way, exchanged, pruned, without_senseless
from bayes_impedance.diagnosis.selection.richer_law import longer_or_richer
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import Trial

EFFECTS = {effect.id: effect for effect in registered()}
RESONATOR, RESONANCE, HIGHPASS, DELAY, MASS = (
    EFFECTS[k] for k in ("body.resonator", "rig.resonance", "rig.highpass", "rig.delay", "rig.mass")
)
NOTHING: Any = None


def fit_of(*names: str, evidence: float = 0.0) -> Any:
    additions = tuple(SimpleNamespace(key=(name, "", "port"), pooling="shared") for name in names)
    own = np.array([evidence])
    return SimpleNamespace(name="+".join(names), model=SimpleNamespace(additions=additions), settled=True, evidence=own)


def names_of(fit: Any) -> tuple[str, ...]:
    return tuple(addition.key[0] for addition in fit.model.additions)


def trial_of(effect: Effect, gain: float, *before: str) -> Trial:
    candidate = SimpleNamespace(effect=effect, place="port")
    return Trial(
        candidate=cast(Any, candidate), pooling="shared", fit=fit_of(*before, effect.id), gain=gain, physical=True
    )


def step_of(chosen: Trial | None, *trials: Trial, before: Any = None) -> Step:
    every = trials if chosen is None else (chosen, *trials)
    return Step(before=before or fit_of(), residuals=(), screening=NOTHING, trials=every, chosen=chosen)


FIRST = step_of(trial_of(RESONATOR, 100.0), trial_of(DELAY, 30.0))
SECOND = step_of(trial_of(HIGHPASS, 50.0, RESONATOR.id), before=fit_of(RESONATOR.id))
LAST = step_of(None)
WAY: Any = Way(fit_of(), fit_of(RESONATOR.id, HIGHPASS.id), (FIRST, SECOND, LAST), True)


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits without an addition have its name left out; their evidence follows from the names."""

    def left(_: Any, fit: Any, addition: int, _seed: int) -> Any:
        names = list(names_of(fit))
        del names[addition]
        return fit_of(*names)

    def kept(_: Any, fit: Any, addition: int) -> Any:
        fit = left(_, fit, addition, 0)
        fit.kept = True
        return fit

    def last(_: Any, fit: Any, addition: int) -> Any:
        names = list(names_of(fit))
        return fit_of(*(*names[:addition], *names[addition + 1 :], names[addition]))

    evidence = {
        f"{HIGHPASS.id}+{RESONATOR.id}": 34.5,
        "rig.highpass+rig.resonance": 56.0,
        "rig.highpass+rig.delay": 2.0,
        "rig.highpass": 0.0,
        "rig.resonance": 1.0,
        WAY.fit.name: 0.0,
        "": -100.0,
        RESONATOR.id: -80.0,
        f"{RESONATOR.id}+{HIGHPASS.id}": 0.0,
    }
    monkeypatch.setattr(exchange, "without", left)
    monkeypatch.setattr(exchange, "with_last", last)
    monkeypatch.setattr(exchange, "_elements_kept", kept)
    monkeypatch.setattr(exchange, "log_evidence", lambda fit: evidence[fit.name])
    monkeypatch.setattr(exchange, "unphysical", lambda fit: [])


class OneStep:
    """One more step that finds an effect, or nothing."""

    def __init__(self, effect: Effect | None) -> None:
        self.effect = effect
        self.asked: list[Any] = []
        self.begun: list[Any] = []

    def __call__(self, way: Any, begin: Any = None) -> Way:
        self.asked.append(way)
        self.begun.append(begin)
        if self.effect is None:
            return Way(way.base, way.fit, (*way.steps, LAST))
        before = names_of(way.fit)
        new = step_of(trial_of(self.effect, 90.0, *before), trial_of(RESONATOR, 34.0, *before), before=way.fit)
        return Way(way.base, fit_of(*before, self.effect.id), (*way.steps, new), True)


@pytest.mark.usefixtures("without")
def test_what_is_better_beside_the_later_ones_takes_the_place_of_the_earlier_choice() -> None:
    step_from = OneStep(RESONANCE)
    way, better = exchanged(NOTHING, WAY, step_from, 1)
    assert better
    assert [(names_of(w.fit), w.steps) for w in step_from.asked] == [((HIGHPASS.id,), (SECOND,))]
    assert [(names_of(begin), begin.kept) for begin in step_from.begun] == [((HIGHPASS.id,), True)]
    assert names_of(way.fit) == (HIGHPASS.id, RESONANCE.id)
    assert way.measured
    first, second = way.steps
    assert second is SECOND
    assert first.chosen is not None
    assert first.chosen.effect is RESONANCE
    assert [t.effect for t in first.trials] == [RESONANCE, RESONATOR]
    assert first.before.name == HIGHPASS.id
    assert first.residuals is FIRST.residuals


@pytest.mark.usefixtures("without")
def test_the_choice_stays_where_nothing_is_found() -> None:
    step_from = OneStep(None)
    assert exchanged(NOTHING, WAY, step_from, 1) == (WAY, False)
    assert len(step_from.asked) == 1


@pytest.mark.usefixtures("without")
def test_a_choice_that_stays_is_compared_with_what_was_tried_beside_the_others() -> None:
    way, better = exchanged(NOTHING, WAY, OneStep(DELAY), 1)
    assert not better
    assert way.fit is WAY.fit
    first, second, last = way.steps
    assert first.chosen is not None
    assert first.chosen.effect is RESONATOR
    assert first.before.name == HIGHPASS.id
    assert [t.effect for t in first.trials] == [DELAY, RESONATOR]
    assert (second, last) == (SECOND, LAST)
    # What was tried gained 34; the fit that the search had come to is 34.5 ahead of the high-pass alone.
    assert first.chosen.gain == pytest.approx(34.5)
    assert names_of(first.chosen.fit) == (HIGHPASS.id, RESONATOR.id)


@pytest.mark.usefixtures("without")
def test_what_was_tried_counts_where_it_describes_more_than_the_known_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    evidence, less = exchange.log_evidence, f"{HIGHPASS.id}+{RESONATOR.id}"
    monkeypatch.setattr(exchange, "log_evidence", lambda fit: 33.0 if fit.name == less else evidence(fit))
    chosen = exchanged(NOTHING, WAY, OneStep(DELAY), 1)[0].steps[0].chosen
    assert chosen is not None
    assert chosen.gain == pytest.approx(34.0)


@pytest.mark.usefixtures("without")
def test_what_has_the_wrong_sign_beside_the_best_is_removed_and_the_choice_made_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside a resonance the high-pass has no sense, and the resonance cannot be chosen before it is removed."""
    senseless = fit_of(HIGHPASS.id, RESONANCE.id, evidence=90.0)
    evidence = exchange.log_evidence
    monkeypatch.setattr(exchange, "log_evidence", lambda fit: 30.0 if fit.name == RESONANCE.id else evidence(fit))
    monkeypatch.setattr(exchange, "unphysical", lambda fit: [0] if fit is senseless else [])
    best = replace(trial_of(RESONANCE, 90.0), fit=senseless, physical=False)
    asked = []

    def step_from(way: Any, begin: Any = None) -> Way:
        asked.append(names_of(way.fit))
        assert names_of(begin) == names_of(way.fit)
        if way.fit.name == HIGHPASS.id:
            foretold = replace(trial_of(MASS, 1e5, HIGHPASS.id), physical=False)  # of other dispersions than its own
            found = step_of(trial_of(DELAY, 20.0, HIGHPASS.id), best, foretold, before=way.fit)
            return Way(way.base, fit_of(HIGHPASS.id, DELAY.id), (*way.steps, found))
        return Way(way.base, fit_of(RESONANCE.id), (*way.steps, step_of(trial_of(RESONANCE, 90.0))))

    way, better = exchanged(NOTHING, WAY, step_from, 1)
    assert better
    assert asked == [(HIGHPASS.id,), ()]
    assert names_of(way.fit) == (RESONANCE.id,)
    assert [step.chosen.effect for step in way.steps if step.chosen is not None] == [RESONANCE]


@pytest.mark.usefixtures("without")
def test_a_choice_of_the_wrong_sign_itself_removes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exchange, "unphysical", lambda fit: [0, 1])
    step_from = OneStep(RESONANCE)
    exchanged(NOTHING, WAY, step_from, 1)
    assert [names_of(way.fit) for way in step_from.asked] == [(HIGHPASS.id,)]


@pytest.mark.usefixtures("without")
@pytest.mark.parametrize(("alone", "left_out"), [(20.0, True), (2.0, False)])
def test_a_step_leaves_out_what_has_the_wrong_sign_beside_what_describes_most(
    monkeypatch: pytest.MonkeyPatch, alone: float, left_out: bool
) -> None:
    """Beside a high-pass the resonator has no sense: the high-pass alone, if that is better than what may be beside."""
    senseless = fit_of(RESONATOR.id, HIGHPASS.id, evidence=90.0)
    own = {HIGHPASS.id: alone, f"{RESONATOR.id}+{DELAY.id}": 0.0, RESONATOR.id: -80.0}
    monkeypatch.setattr(exchange, "log_evidence", lambda fit: own[fit.name])
    monkeypatch.setattr(exchange, "unphysical", lambda fit: [0] if fit is senseless else [])
    way: Any = Way(fit_of(), fit_of(RESONATOR.id), (FIRST,))
    best = replace(trial_of(HIGHPASS, 90.0, RESONATOR.id), fit=senseless, physical=False)
    beside = Way(way.base, fit_of(RESONATOR.id, DELAY.id), (FIRST, step_of(trial_of(DELAY, 20.0, RESONATOR.id), best)))
    other = Way(way.base, fit_of(HIGHPASS.id), (step_of(trial_of(HIGHPASS, 90.0)),))
    asked = []

    def step_from(way: Any, begin: Any = None) -> Way:
        asked.append((names_of(way.fit), None if begin is None else begin.kept))
        return beside if way.steps else other

    found = without_senseless(NOTHING, way, step_from(way), step_from, 1)
    assert found is (other if left_out else beside)
    assert asked == [((RESONATOR.id,), None), ((), True)]
    if left_out:
        assert longer_or_richer(NOTHING, way, step_from, (), (), (), 1, NOTHING) is other


def test_a_choice_that_was_made_beside_the_others_stays() -> None:
    step_from = OneStep(RESONANCE)
    for way in (
        Way(fit_of(), fit_of(RESONATOR.id), (FIRST, LAST)),
        Way(fit_of(), fit_of(), (LAST,)),
    ):
        assert exchanged(NOTHING, way, step_from, 1) == (way, False)
    assert step_from.asked == []


@pytest.mark.usefixtures("without")
def test_the_last_choice_is_made_anew_once_an_earlier_one_was_removed() -> None:
    """It was made beside a resonator that is not there any more."""
    way = pruned(WAY, fit_of(HIGHPASS.id))
    assert way.steps == (SECOND, LAST)
    assert not way.measured
    step_from = OneStep(RESONANCE)
    exchanged(NOTHING, way, step_from, 1)
    assert [names_of(w.fit) for w in step_from.asked] == [()]
    assert pruned(WAY, WAY.fit) is WAY


@pytest.mark.usefixtures("without")
def test_a_choice_that_was_far_ahead_of_everything_stays() -> None:
    """Its nearest rival lacked 890, and what came later brought 80."""
    far = step_of(trial_of(RESONATOR, 900.0), trial_of(DELAY, 10.0))
    step_from = OneStep(RESONANCE)
    way: Any = Way(WAY.base, WAY.fit, (far, SECOND, LAST))
    assert exchanged(NOTHING, way, step_from, 1) == (way, False)
    assert step_from.asked == []
