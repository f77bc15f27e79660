"""Explanations that the evidence does not tell apart, of which one leaves structure."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from experiments import MASS, TOY, Experiment, Serial, entry, recovered, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate, registered
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection import stepwise
from bayes_impedance.diagnosis.selection.exchange import Way
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import Trial
from bayes_impedance.diagnosis.selection.what_remains import leaves_structure, that_leaves_nothing

N = 12
NAMES = [f"P{i + 1}" for i in range(N)]
EFFECTS = [e for e in registered() if e.id in ("rig.mass", "rig.delay", "rig.damping")]


@pytest.fixture(scope="module")
def world() -> Experiment:
    def mass(s: np.ndarray, z: np.ndarray, _: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return z + 3 * MASS * s, np.full(N, 3 * MASS)

    return toy(*TOY, seed=5, n=N, hidden=mass)


def trial(experiment: Experiment, name: str, before: Refit) -> Trial:
    fit = recovered(experiment, entry(name), "port", "shared")
    gain = float(fit.evidence.sum() - before.evidence.sum())
    return Trial(
        candidate=Candidate(entry(name), "port", {}),
        pooling="shared",
        fit=replace(fit, settled=True),
        gain=gain,
        physical=True,
    )


@pytest.fixture(scope="module")
def step(world: Experiment) -> Step:
    before = world.fit()
    residuals = tuple(person_residuals(before, NAMES))
    trials = tuple(trial(world, name, before) for name in ("rig.mass", "rig.delay"))
    return Step(
        before=before, residuals=residuals, screening=screen(before, residuals, EFFECTS, 1, Serial()), trials=trials
    )


def beside(step: Step, evidence: np.ndarray) -> Step:
    """The step with the delay chosen, and with that evidence of each person for it."""
    mass, delay = step.trials
    near = replace(delay, fit=replace(delay.fit, evidence=evidence), gain=mass.gain)
    return replace(step, trials=(mass, near), chosen=near)


def test_the_truth_leaves_nothing_and_another_explanation_does(step: Step) -> None:
    mass, delay = step.trials
    assert not leaves_structure(mass.fit, NAMES, EFFECTS, 1, Serial())
    assert leaves_structure(delay.fit, NAMES, EFFECTS, 1, Serial())


def test_of_two_that_are_not_told_apart_the_one_that_leaves_nothing_is_found(step: Step) -> None:
    mass, _ = step.trials
    equal = beside(step, mass.fit.evidence + np.where(np.arange(N) % 2, 1.0, -0.8))
    other = that_leaves_nothing(equal, NAMES, EFFECTS, 1, Serial())
    assert other is not None
    assert other.chosen is mass


def test_what_is_excluded_or_has_not_come_to_rest_is_not_asked(step: Step) -> None:
    mass, _ = step.trials
    ahead = beside(step, mass.fit.evidence + 5.0)
    assert that_leaves_nothing(ahead, NAMES, EFFECTS, 1, Serial()) is None
    equal = beside(step, mass.fit.evidence + np.where(np.arange(N) % 2, 1.0, -0.8))
    moving = replace(mass, fit=replace(mass.fit, settled=False))
    assert that_leaves_nothing(replace(equal, trials=(moving, equal.trials[1])), NAMES, EFFECTS, 1, Serial()) is None
    assert that_leaves_nothing(replace(equal, chosen=None), NAMES, EFFECTS, 1, Serial()) is None


def test_beside_other_additions_the_steps_of_other_fits_are_not_asked(
    world: Experiment, step: Step, monkeypatch: pytest.MonkeyPatch
) -> None:
    mass, delay = step.trials
    monkeypatch.setattr(
        stepwise, "that_leaves_nothing", lambda *_: pytest.fail("the way's fit is not of its last step")
    )
    way = Way(step.before, step.before, (replace(step, chosen=delay),))
    forward = partial(stepwise._forward, world.refitter, names=NAMES, effects=EFFECTS, seed=1, executor=Serial())
    longer = forward(way, progress=lambda *_: None, begin=step.before, steps_left=1)
    chosen = longer.steps[-1].chosen
    assert chosen is not None
    assert chosen.effect is mass.effect
