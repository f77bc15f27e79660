"""The best explanations are compared where each describes people best, not where its own search happened to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.finalists import _beside, finalists
from bayes_impedance.diagnosis.selection.trial import Trial

TWINS = ("(n1-r1)|(n2-r2)", {"n1": 3e-5, "r1": 2.0, "n2": 1e-3, "r2": 1.0})
"""Another optimum: the two branches change places."""


@pytest.fixture(scope="module")
def twins() -> Experiment:
    return toy(*TWINS, seed=4, tau=0.1)


def trial_of(experiment: Experiment, fit: Refit, effect_id: str, apart: np.ndarray) -> tuple[Trial, Trial]:
    """A trial in which some people (bool) are in the other optimum, and the one in which nobody is."""
    refitter = experiment.refitter
    candidate = Candidate(entry(effect_id), "port", {})
    model = extended(fit.model, candidate, "shared", 0.0)
    good = refitter.fit(model, *extended_start(fit, model), 40)
    grown = refitter.fit(model, in_the_other_optimum(good, apart), good.population, 40) if apart.any() else good
    grown_trial, good_trial = (
        Trial(candidate=candidate, pooling="shared", fit=f, gain=log_evidence(f) - log_evidence(fit), physical=True)
        for f in (grown, good)
    )
    return grown_trial, good_trial


def in_the_other_optimum(good: Refit, people: np.ndarray) -> np.ndarray:
    names = good.model.network.elements
    there = [names.index(name) for name in ("n2", "r2", "n1", "r1")]
    here = [names.index(name) for name in ("n1", "r1", "n2", "r2")]
    u, rows = good.u.copy(), people[good.owner]
    u[np.ix_(rows, here)] = good.u[np.ix_(rows, there)]
    return u


def test_a_rival_in_another_valley_than_the_leader_begins_at_the_leaders_elements(
    twins: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everybody's best optimum beside one effect was unknown beside the other, and the difference decided."""
    refitter, good_fit = twins.refitter, twins.fit()
    fit = replace(good_fit, evidence=good_fit.evidence - 100)  # so that every effect seems worth a place
    # Without restarts: people stay in the valley in which they begin.
    monkeypatch.setattr(refitter, "settle", lambda fit, *_, **__: fit)
    leader, _ = trial_of(twins, fit, "rig.delay", np.zeros(20, dtype=bool))
    rival, wanted = trial_of(twins, fit, "rig.mass", np.arange(20) < 10)
    assert wanted.gain > rival.gain + 20
    effects = [leader.effect, rival.effect]
    ended = {t.effect.id: t for t in finalists(refitter, fit, [leader, rival], effects, 1)}
    assert ended["rig.mass"].gain == pytest.approx(wanted.gain, abs=1)


def test_people_begin_where_another_explanation_describes_them_better(
    twins: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither of the two has everybody in the right valley, and together they have."""
    refitter, good_fit = twins.refitter, twins.fit()
    fit = replace(good_fit, evidence=good_fit.evidence - 100)
    monkeypatch.setattr(refitter, "settle", lambda fit, *_, **__: fit)
    first, first_wanted = trial_of(twins, fit, "rig.delay", np.arange(20) == 3)
    second, second_wanted = trial_of(twins, fit, "rig.mass", (np.arange(20) == 7) | (np.arange(20) == 12))
    assert first.gain < first_wanted.gain - 1
    assert second.gain < second_wanted.gain - 1
    effects = [first.effect, second.effect]
    ended = {t.effect.id: t for t in finalists(refitter, fit, [first, second], effects, 1)}
    assert ended["rig.delay"].gain == pytest.approx(first_wanted.gain, abs=1)
    assert ended["rig.mass"].gain == pytest.approx(second_wanted.gain, abs=1)


@pytest.mark.parametrize("badly", [True, False])
def test_people_whom_the_leaders_elements_do_not_suit_are_searched_before_it_is_compared(
    twins: Experiment, monkeypatch: pytest.MonkeyPatch, badly: bool
) -> None:
    """One person in another valley hid a valley of the population that is better; what nobody hides is not searched."""
    refitter, good_fit = twins.refitter, twins.fit()
    fit = replace(good_fit, evidence=good_fit.evidence - 100)
    nobody = np.zeros(20, dtype=bool)
    leader, _ = trial_of(twins, fit, "rig.delay", nobody)
    good, _ = trial_of(twins, fit, "rig.mass", nobody)
    chi = good.fit.equations.chi.copy()
    chi[good.fit.owner == 4] *= 100 if badly else 1
    one_off = replace(
        good.fit,
        evidence=good.fit.evidence - 200.0 * (np.arange(20) == 4),
        equations=replace(good.fit.equations, chi=chi),
    )
    held = replace(good, gain=good.gain - 50)
    searched = []

    def settle(fit: Refit, *_: object, **__: object) -> Refit:
        searched.append(fit)
        return good.fit

    monkeypatch.setattr(refitter, "fit", lambda *_, **__: one_off)
    monkeypatch.setattr(refitter, "settle", settle)
    found = _beside(refitter, fit, held, replace(leader, gain=held.gain), 1, 8)
    assert bool(searched) is badly
    assert found.gain == pytest.approx(good.gain if badly else held.gain)
