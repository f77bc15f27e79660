"""Each choice but the last is made anew beside the others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.selection import exchange
from bayes_impedance.diagnosis.selection.exchange import Way, exchanged
from bayes_impedance.diagnosis.selection.shortlist import Trial
from bayes_impedance.diagnosis.selection.step import Step

EFFECTS = {effect.id: effect for effect in registered()}
RESONATOR, RESONANCE, HIGHPASS, DELAY = (
    EFFECTS[k] for k in ("body.resonator", "rig.resonance", "rig.highpass", "rig.delay")
)
NOTHING: Any = None


def fit_of(*names: str) -> Any:
    return SimpleNamespace(name="+".join(names), model=SimpleNamespace(additions=names), settled=True)


def trial_of(effect: Effect, gain: float, *before: str) -> Trial:
    candidate = SimpleNamespace(effect=effect, place="port")
    return Trial(cast(Any, candidate), "shared", fit_of(*before, effect.id), gain, True)


def step_of(chosen: Trial | None, *trials: Trial, before: Any = None) -> Step:
    every = trials if chosen is None else (chosen, *trials)
    return Step(before or fit_of(), (), NOTHING, every, chosen)


FIRST = step_of(trial_of(RESONATOR, 100.0), trial_of(DELAY, 30.0))
SECOND = step_of(trial_of(HIGHPASS, 50.0, RESONATOR.id), before=fit_of(RESONATOR.id))
LAST = step_of(None)
WAY: Any = Way(fit_of(), fit_of(RESONATOR.id, HIGHPASS.id), (FIRST, SECOND, LAST), NOTHING)


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits without an addition have its name left out; their evidence is in their posterior's place."""

    def left(_: Any, fit: Any, addition: int) -> Any:
        names = list(fit.model.additions)
        del names[addition]
        return fit_of(*names)

    evidence = {
        "rig.highpass+rig.resonance": 56.0,
        "rig.highpass+rig.delay": 2.0,
        "rig.highpass": 0.0,
        WAY.fit.name: 0.0,
    }
    monkeypatch.setattr(exchange, "without", left)
    monkeypatch.setattr(exchange, "log_evidence", lambda fit: evidence[fit.name])


class OneStep:
    """One more step that finds an effect, or nothing."""

    def __init__(self, effect: Effect | None) -> None:
        self.effect = effect
        self.asked: list[Any] = []

    def __call__(self, way: Any) -> Way:
        self.asked.append(way)
        if self.effect is None:
            return Way(way.base, way.fit, (*way.steps, LAST), NOTHING)
        before = way.fit.model.additions
        new = step_of(trial_of(self.effect, 90.0, *before), trial_of(RESONATOR, 34.0, *before), before=way.fit)
        return Way(way.base, fit_of(*before, self.effect.id), (*way.steps, new), cast(Any, "its own"))


@pytest.mark.usefixtures("without")
def test_what_is_better_beside_the_later_ones_takes_the_place_of_the_earlier_choice() -> None:
    step_from = OneStep(RESONANCE)
    way: Any = exchanged(NOTHING, WAY, step_from)
    assert [(w.fit.model.additions, w.steps) for w in step_from.asked] == [((HIGHPASS.id,), (SECOND,))]
    assert way.fit.model.additions == (HIGHPASS.id, RESONANCE.id)
    assert way.posterior == "its own"
    first, second = way.steps
    assert second is SECOND
    assert first.chosen is not None
    assert first.chosen.effect is RESONANCE
    assert [t.effect for t in first.trials] == [RESONANCE, RESONATOR]
    assert first.before.name == HIGHPASS.id
    assert first.residuals is FIRST.residuals


@pytest.mark.usefixtures("without")
@pytest.mark.parametrize("effect", [DELAY, None], ids=["hardly better", "nothing"])
def test_the_choice_stays_where_nothing_is_clearly_better(effect: Effect | None) -> None:
    step_from = OneStep(effect)
    assert exchanged(NOTHING, WAY, step_from) is None
    assert len(step_from.asked) == 1


def test_one_choice_has_nothing_that_comes_later() -> None:
    step_from = OneStep(RESONANCE)
    for steps in ((FIRST, LAST), (LAST,)):
        way = Way(fit_of(), fit_of(), steps, NOTHING)
        assert exchanged(NOTHING, way, step_from) is None
    assert step_from.asked == []
