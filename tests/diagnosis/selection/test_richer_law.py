"""One richer law in the place of a simple one that leaves structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiments import TOY, Serial, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.selection import richer_law
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN
from bayes_impedance.diagnosis.selection.richer_law import longer_or_richer, simple_and_richer
from bayes_impedance.diagnosis.selection.shortlist import ALPHA
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.stepwise import Found, search
from bayes_impedance.errors import InputError

N = 14
FREQUENCY = np.geomspace(2, 2000, 41)
NAMES = ("body.springpot", "body.relaxation", "body.diffusion", "body.broad_relaxation", "rig.delay")
EFFECTS = tuple(e for e in registered() if e.id in NAMES and (e.id != "body.springpot" or e.operation != "power"))

Law = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""s (F,) and everybody's factor (N, 1, 1) to the impedance that is beside the network (N, 1, F)."""


def broad(s: np.ndarray, own: np.ndarray) -> np.ndarray:
    """A power law of exponent 0.5 that ends in a spring at 60 Hz."""
    return 6.0 * own * (s / 400) ** -0.5 / (1 + (s / (2 * np.pi * 60)) ** 0.5)


def layer(s: np.ndarray, own: np.ndarray) -> np.ndarray:
    x = np.sqrt(s / (2 * np.pi * 5))
    return 6.0 * own * np.tanh(x) / x


def power_law(s: np.ndarray, own: np.ndarray) -> np.ndarray:
    return 3.0 * own * (s / 400) ** -0.5


def found(law: Law, delay: float = 0.0, effects: tuple[Effect, ...] = EFFECTS) -> Found:
    def hidden(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        own = np.exp(0.3 * rng.normal(size=(len(z), 1, 1)))
        return (z + law(s, own)) * np.exp(-s * delay), own[:, 0, 0]

    experiment = toy(*TOY, seed=3, n=N, noise=0.003, hidden=hidden, frequency_hz=FREQUENCY)
    people = [str(i) for i in range(N)]
    return search(experiment.refitter, experiment.fit(), people, effects, 1, Serial(), lambda *_: None)


def named(result: Found) -> list[tuple[str, str]]:
    return [(a.effect.id, a.place) for a in result.final.model.additions]


@pytest.mark.long
@pytest.mark.parametrize(("law", "name"), [(broad, "body.broad_relaxation"), (layer, "body.diffusion")])
def test_one_law_describes_what_a_simple_one_leaves(law: Law, name: str) -> None:
    simple = found(law, effects=simple_and_richer(EFFECTS)[0])
    assert ("body.springpot", "port") in named(simple)
    assert simple.steps[-1].log_p < np.log(ALPHA)
    result = found(law)
    assert named(result) == [(name, "port")]
    assert result.steps[-1].chosen is None
    assert result.final.settled


@pytest.mark.long
def test_where_a_simple_law_leaves_nothing_no_richer_one_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(richer_law, "try_shortlist", lambda *_: pytest.fail("nothing is left"))
    result = found(power_law)
    assert named(result) == [("body.springpot", "port")]
    assert all(not t.effect.refines for step in result.steps for t in step.trials)


@pytest.mark.long
def test_what_is_missing_besides_is_found_beside_the_simple_law() -> None:
    assert sorted(named(found(power_law, delay=4e-5))) == [("body.springpot", "port"), ("rig.delay", "port")]


@pytest.mark.parametrize(("beyond", "two"), [(0.1, True), (-0.1, False)])
def test_two_effects_stand_if_they_are_ahead_by_more_than_the_choice_of_the_second(
    monkeypatch: pytest.MonkeyPatch, beyond: float, two: bool
) -> None:
    """With twenty effects at their places, ln 20 and the least gain."""
    steps = tuple(SimpleNamespace(chosen=object(), log_p=-100.0, offered=20) for _ in range(2))
    way: Any = SimpleNamespace(base="base", fit="simple", steps=steps[:1])
    longer: Any = SimpleNamespace(base="base", fit="two", steps=steps)
    evidence = {"two": np.log(20) + LEAST_GAIN + beyond, "law": 0.0}
    monkeypatch.setattr(richer_law, "without_senseless", lambda _refitter, _way, longer, *_: longer)
    monkeypatch.setattr(richer_law, "_richer", lambda *_: SimpleNamespace(after="law"))
    monkeypatch.setattr(richer_law, "leaves_structure", lambda *_: False)
    monkeypatch.setattr(richer_law, "exchanged", lambda _refitter, longer, *_: (longer, False))
    monkeypatch.setattr(richer_law, "log_evidence", lambda fit: evidence[fit])
    nothing: Any = None
    found = longer_or_richer(nothing, way, lambda *_: longer, (), (), (), 1, nothing)
    assert found.fit == ("two" if two else "law")
    assert len(found.steps) == (2 if two else 1)


def test_a_step_is_offered_each_effect_at_each_place_once() -> None:
    effects = [SimpleNamespace(id=name, form=form) for name, form in (("a", ""), ("b", ""), ("b", "other"))]
    tried = [SimpleNamespace(effect=effect, place=place) for effect in effects for place in ("port", "n1")]
    screening: Any = SimpleNamespace(candidates=[*tried, *tried])  # each with two shapes
    before: Any = None
    assert Step(before=before, residuals=(), screening=screening).offered == 6


def test_an_effect_waits_only_for_a_simpler_one_that_is_there() -> None:
    simple, waiting = simple_and_richer(EFFECTS)
    assert {e.id for e in waiting} == {"body.diffusion", "body.broad_relaxation"}
    assert {e.id for e in simple} == set(NAMES) - {"body.broad_relaxation"}
    assert simple_and_richer(waiting) == (waiting, ())
    assert simple_and_richer((entry("rig.mass"), *waiting)) == ((entry("rig.mass"), *waiting), ())


def test_what_an_effect_refines_is_a_tuple_of_ids() -> None:
    with pytest.raises(InputError, match=r'refines is "body\.relaxation", but must be a tuple of ids'):
        replace(entry("rig.mass"), refines="body.relaxation")  # type: ignore[arg-type]
