"""Explanations of a step are measured before the leading one is believed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bayes_impedance.diagnosis.catalogue.effect import Candidate, registered
from bayes_impedance.diagnosis.selection import stepwise
from bayes_impedance.diagnosis.selection.few_people import may_follow
from bayes_impedance.diagnosis.selection.trial import Trial

EFFECTS = {e.id: e for e in registered() if e.form == ""} | {e.id: e for e in registered()}
RESONATOR, DELAY, MASS = (EFFECTS[k] for k in ("body.resonator", "rig.delay", "rig.mass"))
NOTHING: Any = None
WITHOUT: Any = SimpleNamespace(evidence=0.0, data=range(20))


def trial(effect: Any, evidence: float) -> Trial:
    addition = SimpleNamespace(key=(effect.id, effect.form, "port"))
    fit: Any = SimpleNamespace(evidence=evidence, model=SimpleNamespace(additions=(addition,)), name=effect.id)
    return Trial(candidate=Candidate(effect, "port", {}), pooling="varying", fit=fit, gain=evidence, physical=True)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Evidence of each effect with its own dispersions; what was measured is taken out."""
    found = {RESONATOR.id: 93.0, DELAY.id: 100.0, MASS.id: 20.0}

    def measure(_: Any, fit: Any, _seed: int) -> Any:
        return SimpleNamespace(**{**vars(fit), "evidence": found.pop(fit.name)})

    monkeypatch.setattr(stepwise, "measured", measure)
    monkeypatch.setattr(stepwise, "of_members", lambda *_: SimpleNamespace(mixture=None))
    monkeypatch.setattr(stepwise, "has_admissible_signs", lambda *_: True)
    monkeypatch.setattr(stepwise, "log_evidence", lambda fit: fit.evidence)
    return found


def contest(*trials: Trial) -> stepwise._Contest:
    return stepwise._Contest(NOTHING, WITHOUT, trials, list(EFFECTS.values()), 1)


def test_what_leads_only_before_it_is_measured_gives_way(measured: dict[str, float]) -> None:
    race = contest(trial(RESONATOR, 115.0), trial(DELAY, 99.0), trial(MASS, 20.0))
    leader = race.leader()
    assert leader is not None
    assert (leader.effect, leader.gain) == (DELAY, 100.0)
    assert list(measured) == [MASS.id]  # nobody asked what is far behind
    assert race.leader() is leader  # nothing is measured twice


def test_what_only_some_have_counts_by_the_mixture_if_that_is_more(
    measured: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    mixtures = {RESONATOR.id: SimpleNamespace(evidence=104.0), DELAY.id: SimpleNamespace(evidence=90.0)}
    monkeypatch.setattr(stepwise, "of_members", lambda _, fit, _seed: SimpleNamespace(mixture=mixtures[fit.name]))
    race = contest(trial(RESONATOR, 115.0), trial(DELAY, 105.0))
    leader = race.leader()
    assert leader is not None
    assert (leader.effect, leader.gain, leader.weighed) == (RESONATOR, 104.0, mixtures[RESONATOR.id])
    assert leader.fit is not leader.weighed  # the search goes on from the fit of everybody
    race.drop(leader)
    second = race.leader()
    assert second is not None
    assert (second.effect, second.gain, second.weighed) == (DELAY, 100.0, second.fit)


def test_who_is_dropped_does_not_lead_again(measured: dict[str, float]) -> None:
    race = contest(trial(RESONATOR, 115.0), trial(DELAY, 99.0))
    leader = race.leader()
    assert leader is not None
    race.drop(leader)
    second = race.leader()
    assert second is not None
    assert (second.effect, second.gain) == (RESONATOR, 93.0)
    race.drop(second)
    assert race.leader() is None
    assert measured == {MASS.id: 20.0}


def test_all_that_may_win_are_measured_and_the_others_when_they_lead(measured: dict[str, float]) -> None:
    far, ahead, near = trial(MASS, 60.0), trial(DELAY, 120.0), trial(RESONATOR, 115.0)
    race = contest(ahead, near, far)
    assert list(measured) == [MASS.id]
    known = race.among((ahead, near, far))
    assert sorted((t.effect.id, t.gain) for t in known if t.effect is not MASS) == [
        (RESONATOR.id, 93.0),
        (DELAY.id, 100.0),
    ]  # each once, as it was measured
    for _ in range(2):
        leader = race.leader()
        assert leader is not None
        race.drop(leader)
    third = race.leader()
    assert third is not None
    assert (third.effect, third.gain) == (MASS, 20.0)


def test_what_is_worth_nothing_is_not_measured(measured: dict[str, float]) -> None:
    assert contest(trial(MASS, 2.0)).measured == []
    assert contest().leader() is None
    assert list(measured) == [RESONATOR.id, DELAY.id, MASS.id]


def test_one_effect_at_one_place_is_measured_once(measured: dict[str, float]) -> None:
    race = contest(trial(DELAY, 98.0), trial(DELAY, 99.0))  # measured twice, it would not be in the list any more
    leader = race.leader()
    assert leader is not None
    assert leader.gain == 100.0
    race.drop(leader)
    assert race.leader() is None


def test_what_is_best_with_a_sign_that_it_cannot_have_counts_as_it_was(
    measured: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stepwise, "has_admissible_signs", lambda fit, _: fit.name != DELAY.id)
    delay = trial(DELAY, 95.0)
    race = contest(delay, trial(RESONATOR, 115.0))
    leader = race.leader()
    assert leader is not None
    assert (leader.effect, leader.gain) == (DELAY, 95.0)  # 100 as it was measured
    assert leader.fit is delay.fit
    assert DELAY.id not in measured


@pytest.mark.parametrize(
    ("found", "people", "any_kind", "by_frequencies"),
    [
        ((), 1, True, True),  # the first may be of any kind
        ((MASS,), 9, True, True),  # in whichever order the two are found
        ((RESONATOR,), 9, False, True),
        ((MASS, RESONATOR), 9, False, True),
        ((MASS,), 10, True, False),  # one number for everybody takes nobody's place
        ((RESONATOR,), 15, False, True),
        ((RESONATOR, DELAY), 23, True, False),  # as where another choice is made in place of a second of the body
        ((RESONATOR, RESONATOR, DELAY), 23, False, True),
    ],
)
def test_so_many_effects_of_the_body_as_there_are_people_for(
    found: tuple[Any, ...], people: int, any_kind: bool, by_frequencies: bool
) -> None:
    chain, effects = (DELAY, MASS), (DELAY, MASS, RESONATOR)
    possible, few = may_follow(found, effects, people)
    assert possible == (effects if any_kind else chain)
    assert few == by_frequencies
