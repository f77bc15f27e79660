"""The best explanations are compared where each describes people best, not where its own search happened to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.finalists import finalists
from bayes_impedance.diagnosis.selection.shortlist import Trial

TWINS = ("(n1-r1)|(n2-r2)", {"n1": 3e-5, "r1": 2.0, "n2": 1e-3, "r2": 1.0})
"""Another optimum: the two branches change places."""


def test_a_rival_in_another_valley_than_the_leader_begins_at_the_leaders_elements(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Everybody's best optimum beside one effect was unknown beside the other, and the difference decided."""
    experiment = toy(*TWINS, seed=4, tau=0.1)
    refitter, good_fit = experiment.refitter, experiment.fit()
    fit = replace(good_fit, evidence=good_fit.evidence - 100)  # so that every effect seems worth a place
    # Without restarts: people stay in the valley in which they begin.
    monkeypatch.setattr(refitter, "settle", lambda fit, *_, **__: fit)
    half = np.arange(20) < 10

    def trial(effect_id: str, apart: bool) -> tuple[Trial, Trial]:
        candidate = Candidate(entry(effect_id), "port", {})
        model = extended(fit.model, candidate, "shared", 0.0)
        u, population = extended_start(fit, model)
        good = refitter.fit(model, u, population, 40)
        end = in_the_other_optimum(good, half) if apart else good.u
        grown = refitter.fit(model, end, good.population, 40)
        return tuple(  # type: ignore[return-value]
            Trial(candidate, "shared", f, log_evidence(f) - log_evidence(fit), True) for f in (grown, good)
        )

    def in_the_other_optimum(good: Refit, people: np.ndarray) -> np.ndarray:
        names = good.model.network.elements
        there = [names.index(name) for name in ("n2", "r2", "n1", "r1")]
        here = [names.index(name) for name in ("n1", "r1", "n2", "r2")]
        u, rows = good.u.copy(), people[good.owner]
        u[np.ix_(rows, here)] = good.u[np.ix_(rows, there)]
        return u

    leader, _ = trial("rig.delay", apart=False)
    rival, wanted = trial("rig.mass", apart=True)
    assert wanted.gain > rival.gain + 20
    effects = [leader.effect, rival.effect]
    ended = {t.effect.id: t for t in finalists(refitter, fit, [leader, rival], effects, 1)}
    assert ended["rig.mass"].gain == pytest.approx(wanted.gain, abs=1)
