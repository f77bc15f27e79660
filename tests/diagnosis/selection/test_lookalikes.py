"""Effects that look like the leading one: who they are, and that their refits arrive where the leader's did."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiments import entry, recovered, screened, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.selection import finalists
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.lookalikes import MOST, from_the_leader, lookalikes
from bayes_impedance.diagnosis.selection.trial import Trial

R, TIME = 1.5, 3e-3


def relaxing(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    r = R * np.exp(0.2 * rng.normal(size=len(z)))
    return z + (r[:, None, None] / (1 + s * TIME)), r


@pytest.fixture(scope="module")
def experiment():
    return toy("m1|r1", {"m1": 2e-3, "r1": 2.0}, seed=3, n=16, hidden=relaxing)


def test_lookalikes_are_other_effects_of_the_same_place(experiment) -> None:
    screening = screened(experiment.fit())
    (leader,) = [
        c
        for c in screening.candidates
        if c.effect.id == "body.relaxation" and c.place == "port" and 0.4 < c.shape["time_constant"] / TIME < 1.0
    ][:1]
    found = lookalikes(screening, leader)
    assert 1 <= len(found) <= MOST
    assert "body.squeeze_film" in [c.effect.id for c in found]
    # The rig has no relaxation, which would be the leader's counterpart.
    assert all(c.place == "port" and c.effect.side == "body" and c.effect != leader.effect for c in found)
    elsewhere = Candidate(leader.effect, "nowhere", leader.shape)
    assert lookalikes(screening, elsewhere) == []


@pytest.mark.parametrize(
    ("leading", "other", "pooling"),
    [("body.resonator", "rig.resonance", "shared"), ("rig.resonance", "body.resonator", "varying")],
)
def test_the_same_law_on_the_other_side_is_compared(experiment, leading: str, other: str, pooling: str) -> None:
    """Only whether people differ tells them apart: it is fitted from the leader, with the pooling of its side."""
    fit = experiment.fit()
    screening = screened(fit)
    at_port = [c for c in screening.candidates if c.place == "port"]
    leader = next(c for c in at_port if c.effect.id == leading)
    candidate = lookalikes(screening, leader)[-1]
    assert candidate.effect.id == other
    model = extended(fit.model, leader, "shared" if leading == "rig.resonance" else "varying", 1e-4)
    begun = experiment.refitter.fit(model, *extended_start(fit, model), 3)
    grown = from_the_leader(experiment.refitter, begun, candidate, 3)
    assert [(a.effect.id, a.pooling) for a in grown.model.additions] == [(other, pooling)]


@pytest.mark.parametrize("pooling", ["shared", "varying", "free"])
def test_a_lookalike_arrives_where_the_leader_did(experiment, pooling: str) -> None:
    """From far away: the scan's shape is wrong by a factor of 30, and the leader's is taken."""
    fit, refitter = experiment.fit(), experiment.refitter
    model = extended(fit.model, Candidate(entry("body.relaxation"), "port", {"time_constant": TIME}), "shared", R)
    leader = refitter.fit(model, *extended_start(fit, model), 40)
    if pooling != "shared":
        model = extended(fit.model, Candidate(entry("body.relaxation"), "port", {"time_constant": TIME}), pooling, R)
        leader = refitter.fit(model, *extended_start(leader, model), 40)
    gain = log_evidence(leader) - log_evidence(fit)
    assert gain > 100
    film = Candidate(entry("body.squeeze_film"), "port", {"time_constant": 30 * TIME})
    grown = from_the_leader(refitter, leader, film, 30)
    assert [a.effect.id for a in grown.model.additions] == ["body.squeeze_film"]
    assert grown.model.additions[0].pooling == pooling
    assert 0.8 * gain < log_evidence(grown) - log_evidence(fit) < gain
    # Without a shape that could differ, only the coefficient does.
    mass = from_the_leader(refitter, leader, Candidate(entry("body.mass"), "port", {}), 5)
    assert mass.model.additions[0].pooling == ("varying" if pooling == "free" else pooling)


def test_a_lookalike_of_a_later_addition_keeps_the_earlier_ones(experiment) -> None:
    damped = recovered(experiment, entry("rig.delay"), "port", "shared")
    relaxation = Candidate(entry("body.relaxation"), "port", {"time_constant": TIME})
    model = extended(damped.model, relaxation, "varying", R)
    leader = experiment.refitter.fit(model, *extended_start(damped, model), 40)
    grown = from_the_leader(
        experiment.refitter, leader, Candidate(entry("body.squeeze_film"), "port", {"time_constant": TIME}), 30
    )
    assert [a.effect.id for a in grown.model.additions] == ["rig.delay", "body.squeeze_film"]
    assert log_evidence(grown) - log_evidence(damped) > 0.8 * (log_evidence(leader) - log_evidence(damped))


def test_only_what_could_come_near_the_leader_is_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lookalike with a tenth of the leader's gain is searched where one person is described a hundred times worse."""

    def trial_of(gain: float, scales: list[float]) -> Any:
        fit = SimpleNamespace(weight=np.array(scales) ** -2.0, data=[SimpleNamespace(count=200.0)] * len(scales))
        candidate: Any = SimpleNamespace(effect=entry("body.mass"), place="port")
        return Trial(candidate=candidate, pooling="varying", fit=fit, gain=gain, physical=True)  # type: ignore[arg-type]

    leader, near, far = (trial_of(gain, [1.0, 1.0, 1.0]) for gain in (1000.0, 700.0, 100.0))
    behind = trial_of(100.0, [1.0, 1.0, 100.0])
    searched: list[Any] = []
    nothing: Any = None
    monkeypatch.setattr(finalists, "lookalike_trials", lambda *_: [near, far, behind])
    monkeypatch.setattr(finalists, "_searched", lambda _, fit, __: searched.append(fit))
    monkeypatch.setattr(finalists, "again", lambda trial, *_: trial)
    found = finalists.with_lookalikes(nothing, nothing, nothing, [leader], (), 1)
    assert len(searched) == 2
    assert all(a is b.fit for a, b in zip(searched, (near, behind), strict=True))
    assert [trial.gain for trial in found] == [1000.0, 700.0, 100.0, 100.0]
