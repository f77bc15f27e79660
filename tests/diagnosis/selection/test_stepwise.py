"""The search: it finds what is concealed, stops where nothing is, takes back what is superfluous, keeps to its list."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiments import MASS, TOY, Experiment, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Coefficient, Effect, register, unregister
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.diagnosis.selection import stepwise
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.shortlist import ALPHA
from bayes_impedance.diagnosis.selection.step import SPREAD_PENALTY, Step
from bayes_impedance.diagnosis.selection.stepwise import (
    MOST_ADDITIONS,
    Found,
    is_no_list,
    rivals,
    search,
)
from bayes_impedance.diagnosis.selection.trial import Trial

DELAY, CORNER_HZ = 2e-5, 0.3

Change = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]

CONCEALED: dict[str, Change] = {
    "shared mass": lambda s, z, rng: z + s * MASS,
    "varying mass": lambda s, z, rng: z + s * MASS * np.exp(0.3 * rng.normal(size=len(z)))[:, None, None],
    "delay": lambda s, z, rng: z * np.exp(-s * DELAY),
    "high-pass": lambda s, z, rng: z * s / (s + 2 * np.pi * CORNER_HZ),
    "relaxation": lambda s, z, rng: z + 1 / (1 / 1.0 + s * 2e-3),
}

LIST = ("rig.mass", "rig.delay", "rig.highpass", "body.mass")


def experiment_with(concealed: Sequence[str], seed: int, n: int) -> Experiment:
    def hidden(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        for name in concealed:
            z = CONCEALED[name](s, z, rng)
        return z, np.zeros(len(z))

    return toy(*TOY, seed=seed, n=n, hidden=hidden)


def searched(experiment: Experiment, effects: Sequence[Effect], seed: int = 1) -> Found:
    base = experiment.fit()
    assert base.settled
    names = [str(i) for i in range(len(experiment.data))]
    with ThreadPoolExecutor(1) as executor:
        return search(experiment.refitter, base, names, effects, seed, executor, lambda *_: None)


@cache
def found(concealed: tuple[str, ...], seed: int = 1, n: int = 20, ids: tuple[str, ...] = LIST) -> Found:
    """Each of `ids` is an effect's, with its operation after a slash where there are several."""
    return searched(experiment_with(concealed, seed, n), [entry(*name.split("/")) for name in ids])


def named(found: Found) -> set[tuple[str, str, str]]:
    return {(a.effect.id, a.place, a.pooling) for a in found.final.model.additions}


# What is found


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    ("concealed", "expected"),
    [
        (("shared mass",), {("rig.mass", "port", "shared")}),
        (("varying mass",), {("body.mass", "port", "varying")}),
        (("delay", "high-pass"), {("rig.delay", "port", "shared"), ("rig.highpass", "port", "shared")}),
        (("varying mass", "high-pass"), {("body.mass", "port", "varying"), ("rig.highpass", "port", "shared")}),
    ],
    ids=lambda v: " and ".join(v) if isinstance(v, tuple) else "",
)
def test_what_is_concealed_is_found_and_nothing_else(concealed: tuple[str, ...], expected: set, seed: int) -> None:
    result = found(concealed, seed)
    assert named(result) == expected
    assert result.steps[-1].chosen is None
    for step in result.steps[:-1]:  # each is compared with what was tried beside the others
        assert step.chosen is not None
        beside = {a.key for a in result.final.model.additions} - {step.chosen.fit.model.additions[-1].key}
        assert {a.key for a in step.before.model.additions} == beside
    assert all(step.log_p < np.log(ALPHA) for step in result.steps[:-1])


@pytest.mark.parametrize("seed", range(1, 7))
def test_nothing_is_found_where_nothing_is_missing(seed: int) -> None:
    result = found((), seed)
    assert result.final is result.base
    assert [step.chosen for step in result.steps] == [None]
    # Refits are made only of what is significant after correction for all that were looked at.
    assert (result.steps[0].trials == ()) == (result.steps[0].log_p >= np.log(ALPHA))


@pytest.mark.parametrize(
    ("concealed", "seed", "truth"),
    [("shared mass", 1, MASS), ("varying mass", 2, MASS)],
)
def test_the_coefficient_is_what_was_concealed(concealed: str, seed: int, truth: float) -> None:
    result = found((concealed,), seed)
    mass = coefficient_posterior(result.final, 1).central[:, 0] * result.final.model.additions[0].effect.coefficients[
        0
    ].scale(result.final.model.scales)
    # The mean of 20 people who differ by 0.3 is known to 7 %.
    tolerance = 5 * mass.std() + (0.2 * truth if concealed.startswith("varying") else 0.0)
    assert abs(mass.mean() - truth) < tolerance
    assert mass.std() < 0.15 * truth


def test_with_the_right_addition_no_other_coefficient_seems_to_vary() -> None:
    result = found(("shared mass",), 1, 24, ("rig.mass", "body.line"))
    assert named(result) == {("rig.mass", "port", "shared")}
    assert result.steps[-1].log_p > np.log(ALPHA)


# What is taken out again, and when it ends


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_what_took_the_place_of_two_things_is_exchanged_for_one_of_them(seed: int) -> None:
    """A relaxation explains most while the mass is still missing."""
    effects = [entry(k) for k in ("rig.mass", "rig.damping", "body.relaxation", "body.resonator")]
    elements = {"n1": 2.5e-4, "r1": 4.2, "m1": 4.5e-4, "n2": 6.3e-6}
    two = toy(
        "n1|((r1|m1)-n2)", elements, seed=seed, n=20, noise=0.0035, frequency_hz=np.geomspace(20, 9400, 101),
        hidden=lambda s, z, _: (z + 0.42 - 5.4e-6 * s, np.zeros(20)),
    )  # fmt: skip
    result = searched(two, effects)
    assert named(result) == {("rig.mass", "port", "shared"), ("rig.damping", "port", "shared")}
    assert {s.chosen.effect.id for s in result.steps if s.chosen} == {"rig.mass", "rig.damping"}


SUM = ("rig.delay", "body.relaxation", "body.springpot/beside_power")


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_later_additions_make_superfluous_is_taken_out_again(seed: int) -> None:
    """A power law is the best single explanation of a delay and a relaxation together, and of neither alone."""
    result = found(("delay", "relaxation"), seed, 24, SUM)
    assert named(result) == {("rig.delay", "port", "shared"), ("body.relaxation", "port", "varying")}
    for addition in result.final.model.additions:
        assert result.step_of(addition) is not None


@pytest.mark.parametrize(("n", "most"), [(4, 1), (8, 1), (15, 1), (16, 2)])
def test_the_number_of_effects_of_the_body_is_limited_by_the_number_of_people(n: int, most: int) -> None:
    """One for eight people; there is always room for one."""
    result = found(("relaxation", "varying mass"), 1, n, ("body.mass", "body.relaxation"))
    assert len(result.final.model.additions) == most
    last = result.steps[-1]
    assert last.chosen is None
    assert last.trials == ()
    assert most <= MOST_ADDITIONS


@pytest.mark.parametrize("n", [4, 8, 16])
def test_effects_of_the_chain_are_not_limited_by_the_number_of_people(n: int) -> None:
    """They are one number for everybody, and have to hold on held-out frequencies."""
    result = found(("delay", "high-pass", "relaxation"), 1, n, ("rig.delay", "rig.highpass", "body.relaxation"))
    assert sorted(a.effect.id for a in result.final.model.additions) == ["body.relaxation", "rig.delay", "rig.highpass"]


def test_the_same_seed_gives_the_same_result() -> None:
    experiment, effects = experiment_with(("varying mass", "high-pass"), 1, 20), [entry(name) for name in LIST]
    one, other = searched(experiment, effects), searched(experiment, effects)
    assert named(one) == named(other)
    np.testing.assert_array_equal(one.final.u, other.final.u)
    np.testing.assert_array_equal(one.final.evidence, other.final.evidence)
    assert [s.log_p for s in one.steps] == [s.log_p for s in other.steps]
    assert [[t.gain for t in s.trials] for s in one.steps] == [[t.gain for t in s.trials] for s in other.steps]


# The list


def user_effect(side: str) -> Effect:
    """A mass under a user's name."""
    return Effect(
        id=f"{side}.users_mass",
        name="mass",
        side=side,
        pooling="shared" if side == "rig" else "varying",
        places=("port",),
        formula="z + s m",
        story="s",
        look_for="l",
        separates="s",
        source="ours",
        operation="add",
        coefficients=(Coefficient("users_mass", "m"),),
    )


@contextmanager
def also_registered(effect: Effect) -> Iterator[None]:
    register(effect)
    try:
        yield
    finally:
        unregister(effect)


@pytest.mark.parametrize("concealed", ["shared mass", "varying mass"])
def test_only_effects_of_the_list_are_tried(concealed: str) -> None:
    """The best explanation of a mass is a mass, of the rig or of the body: it is registered and not on the list."""
    ids = {"rig.delay", "rig.highpass", "body.relaxation"}
    with also_registered(user_effect("rig")):
        result = searched(experiment_with((concealed,), 1, 16), [entry(name) for name in sorted(ids)])
    assert result.final is not result.base
    for step in result.steps:
        assert {c.effect.id for c in step.screening.candidates} <= ids
        assert {t.effect.id for t in step.trials} <= ids
        if step.chosen is not None:
            assert step.chosen.effect.id in ids
            assert {trial.effect.id for trial, _, _ in rivals(step)} <= ids
    assert {effect_id for effect_id, _, _ in named(result)} <= ids


def test_what_is_registered_and_not_on_the_list_changes_nothing() -> None:
    experiment, effects = experiment_with(("shared mass",), 1, 16), [user_effect("body")]
    alone = searched(experiment, effects)
    with also_registered(user_effect("rig")):
        beside = searched(experiment, effects)
    assert named(beside) == named(alone)


def test_rivals_are_other_explanations_with_how_far_they_are_behind() -> None:
    result = found(("shared mass",), 1)
    step = result.steps[0]
    assert step.chosen is not None
    rows = rivals(step)
    keys = [(t.effect.id, t.effect.form, t.candidate.place) for t, _, _ in rows]
    assert len(set(keys)) == len(keys) > 0
    assert step.chosen.fit.model.additions[-1].key not in keys
    assert [behind for _, behind, _ in rows] == sorted(behind for _, behind, _ in rows)
    for trial, behind, separated in rows:
        assert trial.physical
        assert behind == pytest.approx(step.chosen.gain - trial.gain)
        assert not separated or behind > 0
    by_id = {t.effect.id: (behind, separated) for t, behind, separated in rows}
    assert by_id["rig.delay"][1]  # no mass, and thousands behind
    assert by_id["rig.delay"][0] > 100
    assert by_id["body.mass"][0] < by_id["rig.delay"][0]


# Step and Found


def test_a_further_effect_that_predicts_nobody_else_is_not_added(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepwise, "people_gain", lambda *_: (1.9, 1.0))
    result = searched(experiment_with(("varying mass", "high-pass"), 1, 20), [entry(name) for name in LIST])
    assert len(result.final.model.additions) == 1
    last = result.steps[-1]
    assert last.chosen is None
    assert last.unpredictive
    assert not result.steps[0].unpredictive


def step_with(rows: Sequence[tuple[str, float, float, float]], effective: float = 1.0) -> Step:
    """Of candidates given by effect, score, size and log p-value of the spread."""
    base = found(("shared mass",), 1).base
    z, size, log_p_spread = (np.array([row[k] for row in rows], dtype=float) for k in (1, 2, 3))
    n = len(rows)
    screening = Screening(
        candidates=tuple(Candidate(entry(row[0]), "port", {}) for row in rows),
        score=np.zeros((1, n)),
        information=np.ones((1, n)),
        z=z,
        size=size,
        spread=np.zeros(n),
        log_p_spread=log_p_spread,
        cosine=np.eye(n),
        visible=np.ones(n),
        effective=effective,
    )
    return Step(before=base, residuals=(), screening=screening)


def test_the_p_value_of_a_step_is_that_of_its_best_possible_candidate() -> None:
    from scipy.stats import norm

    def of(z: float, candidates: float = 1.0) -> float:
        return float(np.log(2 * candidates) + norm.logsf(abs(z)))

    signed, unsigned = "rig.mass", "rig.series_compliance"
    assert step_with([(signed, 4.0, 1.0, 0.0), (unsigned, 5.0, 1.0, 0.0)]).log_p == pytest.approx(of(5))
    assert step_with([(signed, -4.0, -1.0, 0.0)]).log_p == pytest.approx(of(4))
    # A sign that the effect cannot have, and what cannot be seen, do not count.
    assert step_with([(signed, 4.0, 1.0, 0.0), (unsigned, -9.0, -1.0, 0.0)]).log_p == pytest.approx(of(4))
    assert step_with([(signed, 4.0, 1.0, 0.0), (signed, np.nan, np.nan, 0.0)]).log_p == pytest.approx(of(4))
    # Many candidates have their price.
    assert step_with([(signed, 4.0, 1.0, 0.0)], effective=50).log_p == pytest.approx(of(4, 50))
    assert step_with([(signed, 0.1, 1.0, 0.0)], effective=50).log_p == 0.0


def test_a_spread_between_people_counts_for_the_body_alone_and_at_a_stricter_level() -> None:
    body, rig = "body.mass", "rig.series_compliance"
    assert step_with([(body, 0.0, 1.0, -30.0)]).log_p == pytest.approx(-30 + SPREAD_PENALTY)
    assert step_with([(rig, 0.0, 1.0, -30.0)]).log_p == pytest.approx(0.0)
    assert step_with([(body, 0.0, -1.0, -30.0)]).log_p == pytest.approx(0.0)
    assert SPREAD_PENALTY > 0


def test_the_step_of_an_addition_is_the_one_that_chose_it() -> None:
    result = found(("varying mass", "high-pass"), 1)
    for addition in result.final.model.additions:
        step = result.step_of(addition)
        assert step is not None
        assert step.chosen is not None
        assert step.chosen.effect == addition.effect
        # Pooling does not matter: it may have changed since.
        assert result.step_of(replace(addition, pooling="shared")) is step
    mine = [result.step_of(a) for a in result.final.model.additions]
    assert mine[0] is not mine[1]
    assert result.step_of(Addition(effect=entry("rig.delay"), place="port", pooling="shared")) is None
    assert result.step_of(replace(result.final.model.additions[0], place="elsewhere")) is None


def way_of(made: int, log_p: float) -> Any:
    """A search that chose so often, and then nothing."""
    steps = [SimpleNamespace(chosen=object(), log_p=-99.0)] * made
    return SimpleNamespace(steps=(*steps, SimpleNamespace(chosen=None, log_p=log_p)))


def test_as_many_as_may_be_found_with_structure_beside_them_are_no_list() -> None:
    assert is_no_list(way_of(MOST_ADDITIONS, -50.0))
    assert not is_no_list(way_of(MOST_ADDITIONS, np.log(0.5)))
    assert not is_no_list(way_of(MOST_ADDITIONS - 1, -50.0))


def test_explanations_stay_where_only_the_fit_without_them_is_a_better_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """What they gain counts from the better fit, and only what was not tried is refitted."""
    delay, mass = entry("rig.delay"), entry("rig.mass")

    def trial(effect: Effect, evidence: float, gain: float) -> Trial:
        addition = SimpleNamespace(key=(effect.id, effect.form, "port"))
        fit: Any = SimpleNamespace(evidence=evidence, model=SimpleNamespace(additions=(addition,)))
        return Trial(candidate=Candidate(effect, "port", {}), pooling="shared", fit=fit, gain=gain, physical=True)

    asked: list[Any] = []

    def shortlisted(*arguments: Any) -> list[Trial]:
        asked.append(arguments[-1])
        return []

    monkeypatch.setattr(stepwise, "log_evidence", lambda fit: fit.evidence)
    monkeypatch.setattr(stepwise, "try_shortlist", shortlisted)
    nothing: Any = None
    better: Any = SimpleNamespace(evidence=-100.0)
    known = (trial(delay, -50.0, 500.0), trial(mass, -120.0, 430.0))
    trials, ranked = stepwise._explanations(nothing, better, nothing, [delay, mass], 1, None, known)
    assert asked == [{(delay, "port"), (mass, "port")}]
    assert [t.gain for t in trials] == [50.0, -20.0]
    assert [t.effect for t in ranked] == [delay]  # the mass is no explanation any more
