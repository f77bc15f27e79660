"""Earlier choices are compared with their rivals once later additions are known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.selection import stepwise
from bayes_impedance.diagnosis.selection.exchange import rival_beginnings
from bayes_impedance.diagnosis.selection.shortlist import Trial
from bayes_impedance.diagnosis.selection.step import Step

EFFECTS = {effect.id: effect for effect in registered()}
RESONATOR, RESONANCE, HIGHPASS = (EFFECTS[k] for k in ("body.resonator", "rig.resonance", "rig.highpass"))
DELAY = EFFECTS["rig.delay"]


def fit_of(*names: str) -> Any:
    return SimpleNamespace(name="+".join(names), model=SimpleNamespace(additions=names), settled=True)


def trial_of(effect: Effect, gain: float, *before: str, physical: bool = True) -> Trial:
    candidate = SimpleNamespace(effect=effect, place="port")
    return Trial(cast(Any, candidate), "shared", fit_of(*before, effect.id), gain, physical)


def step_of(chosen: Trial | None, *trials: Trial) -> Step:
    every = trials if chosen is None else (chosen, *trials)
    return Step(cast(Any, fit_of()), (), cast(Any, None), every, chosen)


FIRST = step_of(
    trial_of(RESONATOR, 100.0),
    trial_of(DELAY, 30.0),
    trial_of(RESONANCE, 80.0),
    trial_of(RESONANCE, 90.0),
    trial_of(HIGHPASS, 70.0),
    trial_of(DELAY, np.nan),
)
SECOND = step_of(trial_of(HIGHPASS, 50.0, RESONATOR.id), trial_of(DELAY, 45.0, RESONATOR.id))
LAST = step_of(None)


def test_rivals_of_all_choices_but_the_last_begin_again_with_the_effects_that_came_later() -> None:
    found = list(rival_beginnings([FIRST, SECOND, LAST]))
    assert [([s.chosen.effect.id for s in steps if s.chosen], [e.id for e in later]) for steps, later in found] == [
        ([RESONANCE.id], [HIGHPASS.id])  # the high-pass is no rival of the first step: it comes later anyway
    ]
    ((steps, _),) = found
    assert steps[0].chosen is not None
    assert steps[0].chosen.gain == 90.0  # the better one of the two
    assert steps[0].trials == FIRST.trials


def test_what_has_the_wrong_sign_or_explains_little_is_no_rival() -> None:
    first = step_of(trial_of(RESONATOR, 100.0), trial_of(RESONANCE, 90.0, physical=False), trial_of(DELAY, 49.0))
    assert list(rival_beginnings([first, SECOND, LAST])) == []


def test_one_choice_has_nothing_that_comes_later() -> None:
    assert list(rival_beginnings([FIRST, LAST])) == []
    assert list(rival_beginnings([])) == []


@pytest.mark.parametrize(("rival_is_better", "expected"), [(True, RESONANCE.id), (False, RESONATOR.id)])
def test_the_search_goes_on_from_a_rival_that_is_better_beside_the_later_ones(
    rival_is_better: bool, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    evidence = {"body.resonator+rig.highpass": 0.0, "rig.resonance+rig.highpass": 56.0 if rival_is_better else 2.0}
    asked: list[tuple[str, ...]] = []

    def forward(_: Any, way: Any, *, effects: Any, **others: Any) -> Any:
        asked.append(tuple(e.id for e in effects))
        if not way.steps:
            return replace(way, fit=fit_of(RESONATOR.id, HIGHPASS.id), steps=(FIRST, SECOND, LAST), posterior=object())
        second = step_of(trial_of(HIGHPASS, 60.0, way.fit.name))
        return replace(way, fit=fit_of(way.fit.name, HIGHPASS.id), steps=(*way.steps, second, LAST), posterior=object())

    monkeypatch.setattr(stepwise, "_forward", forward)
    monkeypatch.setattr(stepwise, "_backward", lambda refitter, base, fit, seed: fit)
    monkeypatch.setattr(stepwise, "log_evidence", lambda fit: evidence[fit.name])
    nothing: Any = None
    every = (RESONATOR, RESONANCE, HIGHPASS)
    found = stepwise.search(nothing, fit_of(), (), every, 1, nothing, lambda *_: None)
    assert found.final.model.additions == (expected, HIGHPASS.id)
    assert found.steps[0].chosen is not None
    assert found.steps[0].chosen.effect.id == expected
    assert asked[1] == (HIGHPASS.id,)
    assert len(asked) == (3 if rival_is_better else 2)
