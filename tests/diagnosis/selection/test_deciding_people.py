"""A few people who decide between two explanations are searched before they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import TOY, Experiment, entry, recovered, toy, with_mass

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.deciding_people import where_few_decide, who_decides
from bayes_impedance.diagnosis.selection.trial import Trial

PERSON = 3


def test_one_far_apart_decides_and_many_who_agree_do_not() -> None:
    rng = np.random.default_rng(1)
    difference = rng.normal(size=39) * 0.2
    difference[28] = 33.0
    np.testing.assert_array_equal(who_decides(difference), [28])
    assert not who_decides(-difference).size  # the other one is not better
    assert not who_decides(2.0 + difference).size  # everybody says so
    assert not who_decides(np.where(np.arange(39) == 28, np.inf, 0.0)).size


@pytest.fixture(scope="module")
def world() -> Experiment:
    return toy(*TOY, seed=1, n=20, hidden=with_mass(0.3))


def _trial(effect: Effect, grown: Refit, fit: Refit) -> Trial:
    candidate = Candidate(effect, "port", {})
    return Trial(
        candidate=candidate,
        pooling=grown.model.additions[-1].pooling,
        fit=grown,
        gain=log_evidence(grown) - log_evidence(fit),
        physical=True,
    )


def _lost(world: Experiment, grown: Refit) -> Refit:
    """The same fit with the elements of one person off by 3 %, and left there."""
    u = grown.u.copy()
    u[grown.owner == PERSON, : grown.model.n_elements] -= 0.03
    return world.refitter.fit(grown.model, u, grown.population, 0)


@pytest.mark.parametrize("who", ["the rival's", "the leader's"])
def test_whoever_was_left_in_a_wrong_valley_is_found(world: Experiment, who: str) -> None:
    fit = world.fit()
    body, rig = entry("body.mass"), entry("rig.mass")
    one = _trial(body, recovered(world, body, "port", "varying"), fit)
    other = _trial(body, one.fit, fit)
    lost = replace(one, fit=_lost(world, one.fit))
    lost = replace(lost, gain=log_evidence(lost.fit) - log_evidence(fit))
    assert one.fit.evidence[PERSON] - lost.fit.evidence[PERSON] > 20
    ranked = [one, lost] if who == "the rival's" else [lost, other]
    found = where_few_decide(world.refitter, fit, ranked, [body, rig], seed=1)
    for trial in found:
        assert trial.fit.evidence[PERSON] == pytest.approx(one.fit.evidence[PERSON], abs=0.5)


def test_nobody_is_searched_where_all_agree(world: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    fit = world.fit()
    body, rig = entry("body.mass"), entry("rig.mass")
    ranked = [_trial(e, recovered(world, e, "port", e.pooling), fit) for e in (body, rig)]
    monkeypatch.setattr(world.refitter.__class__, "fit", lambda *_: pytest.fail("somebody was searched"))
    assert where_few_decide(world.refitter, fit, ranked, [body, rig], seed=1) == ranked
