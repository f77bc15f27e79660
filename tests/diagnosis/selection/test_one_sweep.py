"""What one sweep of each person can show of an element that is not constant, and what it cannot."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from experiments import entry

from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.catalogue.offered import not_shown, offered
from bayes_impedance.diagnosis.verdict_types import Verdict
from bayes_impedance.recordings.dataset import Recordings, Subject

PEOPLE, FREQUENCY = 14, np.geomspace(3.0, 300.0, 90)
NETWORK = "m1|r1|n1"
CENTRE = {"m1": 1.5e-3, "r1": 0.25, "n1": 1.1e-3}


def recordings(what: str, repetitions: int = 1, seed: int = 3) -> Recordings:
    """People with a spring that follows its own motion, or that drifts, or with neither."""
    rng = np.random.default_rng(seed)
    s, f = 2j * np.pi * FREQUENCY, FREQUENCY
    passed = np.log(f / f[0]) / np.log(f[-1] / f[0])
    subjects = []
    for i in range(PEOPLE):
        person = np.log(list(CENTRE.values())) + 0.25 * rng.normal(size=3)
        change = 0.3 * np.exp(0.2 * rng.normal())
        rows = []
        for _ in range(repetitions):
            m1, r1, n1 = np.exp(person + 0.02 * rng.normal(size=3))
            motion = np.abs(1 / (s * m1 + r1 + 1 / (s * n1)) / s) / 2.0e-3  # of the port, which is the spring's too
            factor = {
                "motion": np.exp(-change * motion**2 / (1 + motion**2)),
                "drift": np.exp(change * passed),
                "nothing": np.ones(f.size),
            }[what]
            z = s * m1 + r1 + factor / (s * n1)
            rows.append(z * (1 + 0.006 * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size))))
        names = tuple(str(j) for j in range(repetitions))
        subjects.append(Subject(name=f"P{i}", frequency_hz=f, z=np.array(rows), repetitions=names))
    return Recordings(title="", unit="N s/m", network=NETWORK, source="", licence="", subjects=tuple(subjects))


def two_at_once(people: int = 24, seed: int = 3) -> Recordings:
    """People whose spring has a hysteresis, and who have a relaxation beside everything."""
    rng, s, subjects = np.random.default_rng(seed), 2j * np.pi * FREQUENCY, []
    for i in range(people):
        m1, r1, n1 = np.exp(np.log(list(CENTRE.values())) + 0.25 * rng.normal(size=3))
        loss, damping, time = np.array([0.4, 2.0, 0.02]) * np.exp(0.25 * rng.normal(size=3))
        z = s * m1 + r1 + (1 + 1j * loss) / (s * n1) + damping / (1 + s * time)
        z = z * (1 + 0.006 * (rng.normal(size=s.size) + 1j * rng.normal(size=s.size)))
        subjects.append(Subject(name=f"P{i}", frequency_hz=FREQUENCY, z=z[None], repetitions=("0",)))
    return Recordings(title="", unit="N s/m", network=NETWORK, source="", licence="", subjects=tuple(subjects))


@cache
def verdict_of(what: str, repetitions: int = 1) -> Verdict:
    return diagnose(recordings(what, repetitions), quick=True, workers=1).verdict


@pytest.mark.parametrize("repetitions", [1, pytest.param(3, marks=pytest.mark.long)])
def test_a_spring_that_follows_its_own_motion_is_named(repetitions: int) -> None:
    verdict = verdict_of("motion", repetitions)
    (found,) = verdict.physics
    assert (found.id, found.place) == ("body.amplitude", "n1")
    assert not [alias.id for alias in found.aliases if not alias.separated]
    change, knee = found.parameters["change"], found.parameters["knee"]
    assert abs(change.median + 0.3) < change.q95 - change.q05 < 0.15
    assert abs(knee.median - 2.0e-3) < knee.q95 - knee.q05 < 1.5e-3


def test_a_drift_is_not_taken_for_it_and_nobody_says_why_the_spring_changes() -> None:
    verdict = verdict_of("drift")
    (found,) = verdict.physics
    assert (found.id, found.place) == ("unknown", "n1")
    assert "changes along the sweep" in verdict.summary
    assert "Sweeps in both directions" in found.story
    assert found.network == ""
    gain = verdict.improvement.elpd_gain if verdict.improvement is not None else None
    assert gain is not None
    assert gain > 100


@pytest.mark.long
def test_a_drift_in_repeated_sweeps_has_its_name() -> None:
    (found,) = verdict_of("drift", 3).physics
    assert (found.id, found.place) == ("body.drift", "n1")


@pytest.mark.long
def test_a_change_along_the_sweep_that_leaves_structure_does_not_stand_for_two_effects() -> None:
    """It describes more than either of them alone, and less than both."""
    verdict = diagnose(two_at_once(), quick=True, workers=1).verdict
    assert [(found.id, found.place) for found in verdict.physics] == [
        ("body.hysteresis", "n1"),
        ("body.relaxation", "port"),
    ]


@pytest.mark.parametrize("repetitions", [1, 2])
def test_nothing_is_said_of_elements_that_are_constant(repetitions: int) -> None:
    assert not verdict_of("nothing", repetitions).physics


def test_only_the_law_of_the_own_motion_is_offered_in_one_sweep() -> None:
    both = (entry("body.amplitude"), entry("body.amplitude", "own_motion"))
    assert [effect.operation for effect in offered(both, recordings("nothing"))] == ["own_motion"]
    assert offered(both, recordings("nothing", 2)) == both
    said = not_shown(recordings("nothing"))
    assert "body.drift in one sweep of each" in said
    assert "body.amplitude by any other law than that of its own motion in one sweep of each" in said
    assert not_shown(recordings("nothing", 2)) == ()
