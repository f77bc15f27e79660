"""An effect of the measurement chain and a second one take the place of what is in the body only if they are better."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.selection import chain_first as module
from bayes_impedance.diagnosis.selection.chain_first import chain_first, of_the_chain
from bayes_impedance.network.notation import PAPER_NETWORK
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings

EFFECTS = registered()
BY_ID = {effect.id: effect for effect in EFFECTS}
DIFFUSION, MOUNT, LOWPASS, MASS = (
    BY_ID[k] for k in ("body.diffusion", "rig.series_compliance", "rig.lowpass", "rig.mass")
)
OTHERS = len(of_the_chain(EFFECTS)) - 1
BARE = SimpleNamespace(model=SimpleNamespace(additions=()), evidence=0.0)


def additions_of(*effects: Any) -> tuple[Any, ...]:
    return tuple(SimpleNamespace(effect=effect) for effect in effects)


def trial(effect: Any, evidence: float, physical: bool = True) -> Any:
    fit = SimpleNamespace(model=SimpleNamespace(additions=additions_of(effect)), evidence=evidence)
    return SimpleNamespace(effect=effect, gain=evidence, physical=physical, fit=fit, weighed=fit)


class Search:
    """A search in fakes: the score that is left beside each effect, and what the second step describes."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, score: float, second: float | None, structured: bool = False
    ) -> None:
        self.went_from: list[Any] = []
        self.second, self.structured = second, structured
        self.last = SimpleNamespace(chosen=None, log_p=-1000.0 if structured else 0.0, unshown=None)
        scores, admissible = np.array([0.5, np.nan, 1e3, -score]), np.array([True, True, False, True])
        monkeypatch.setattr(module, "person_residuals", lambda *_: ())
        monkeypatch.setattr(module, "screen", lambda *_: SimpleNamespace(z=scores, physical=admissible))
        monkeypatch.setattr(module, "log_evidence", lambda fit: fit.evidence)
        monkeypatch.setattr(
            module, "compare", lambda one, other: SimpleNamespace(decided=one.evidence > other.evidence + 3)
        )
        monkeypatch.setattr(module, "Way", lambda base, fit, steps: SimpleNamespace(base=base, fit=fit, steps=steps))
        monkeypatch.setattr(module, "replace", lambda item, **changes: SimpleNamespace(**{**vars(item), **changes}))

    def step(self, way: Any, effects: Any) -> Any:
        begun = way.steps[0].chosen.effect
        self.went_from.append(begun)
        assert way.fit is way.steps[0].chosen.fit
        assert way.steps[0].trials == ()
        assert set(effects) == set(EFFECTS if self.structured else of_the_chain(EFFECTS)) - {begun}
        if self.second is None:
            return SimpleNamespace(base=way.base, fit=way.fit, steps=(*way.steps, SimpleNamespace(chosen=None)))
        fit = SimpleNamespace(model=SimpleNamespace(additions=additions_of(begun, LOWPASS)), evidence=self.second)
        return SimpleNamespace(
            base=way.base, fit=fit, steps=(*way.steps, SimpleNamespace(chosen=LOWPASS, offered=OTHERS))
        )

    def result(self, chosen: Any, *others: Any, fit: Any = None) -> tuple[Any, Any]:
        first = SimpleNamespace(chosen=chosen, trials=(*others, *([chosen] if chosen else [])))
        fit = fit or (chosen.fit if chosen else BARE)
        way = SimpleNamespace(base=BARE, fit=fit, steps=(first, self.last))
        return way, chain_first(way, self.step, ("a", "b"), EFFECTS, 1, None)  # type: ignore[arg-type]


def test_effects_of_the_chain_are_one_number_for_everybody() -> None:
    ids = {effect.id for effect in of_the_chain(EFFECTS)}
    assert {"rig.mass", "rig.delay", "rig.lowpass", "rig.highpass", "rig.series_compliance"} <= ids
    assert all(name.startswith("rig.") for name in ids)
    assert not {"rig.resonance", "rig.semi_inductance", "rig.mains"} & ids


@pytest.mark.parametrize("structured", [False, True])
def test_two_that_describe_more_take_the_place_of_one(structured: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The best effect of the chain is gone on from, and what was tried beside it stays what it is compared with.

    The second one may be any effect where structure is left.
    """
    search = Search(monkeypatch, score=35.0, second=1090.0, structured=structured)
    chosen, mount = trial(DIFFUSION, 1000.0), trial(MOUNT, 500.0)
    way, found = search.result(chosen, trial(MASS, 400.0), mount, trial(LOWPASS, 900.0, physical=False))
    assert search.went_from == [MOUNT]
    assert found.fit.evidence == 1090.0
    assert found.steps[0].chosen is mount
    assert found.steps[0].trials == way.steps[0].trials
    assert found.steps[1].chosen is LOWPASS


@pytest.mark.parametrize(("more", "taken"), [(3.1, False), (np.log(OTHERS) + 2.9, False), (np.log(OTHERS) + 3.1, True)])
def test_a_sum_has_to_pay_for_the_choice_of_the_second(
    more: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = Search(monkeypatch, score=30.0, second=1000.0 + more)
    way, found = search.result(trial(DIFFUSION, 1000.0), trial(MOUNT, 900.0))
    assert (found is not way) == taken


def test_no_more_than_two_are_gone_on_from_and_the_one_stays_if_nothing_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = Search(monkeypatch, score=30.0, second=None)
    way, found = search.result(trial(DIFFUSION, 1000.0), trial(MASS, 300.0), trial(MOUNT, 900.0), trial(LOWPASS, 800.0))
    assert search.went_from == [MOUNT, LOWPASS]
    assert found is way


def test_what_cannot_reach_the_one_is_not_gone_on_from(monkeypatch: pytest.MonkeyPatch) -> None:
    """A score of 9 promises 40 units of log evidence, twice of which are hoped for."""
    search = Search(monkeypatch, score=9.0, second=2000.0)
    way, found = search.result(trial(DIFFUSION, 1000.0), trial(MOUNT, 910.0))
    assert not search.went_from
    assert found is way
    _, found = search.result(trial(DIFFUSION, 1000.0), trial(MOUNT, 925.0))
    assert found.fit.evidence == 2000.0


def test_nothing_is_tried_if_nothing_was_found_or_effects_of_the_chain_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    search = Search(monkeypatch, score=30.0, second=2000.0)
    for chosen in (None, trial(LOWPASS, 1000.0)):
        way, found = search.result(chosen, trial(MOUNT, 900.0))
        assert found is way
    assert not search.went_from


@pytest.mark.parametrize(("more", "taken"), [(2.9, False), (3.1, True)])
def test_two_in_the_place_of_two_have_no_choice_to_pay_for(
    more: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compared with all that was found, not with the first of it."""
    search = Search(monkeypatch, score=30.0, second=1200.0 + more)
    chosen, mount = trial(DIFFUSION, 1000.0), trial(MOUNT, 900.0)
    both = SimpleNamespace(model=SimpleNamespace(additions=additions_of(DIFFUSION, MASS)), evidence=1200.0)
    way, found = search.result(chosen, mount, fit=both)
    assert (found is not way) == taken


@pytest.mark.parametrize(("more", "taken"), [(2.9, False), (3.1, True)])
def test_a_change_without_a_name_that_was_found_beside_the_first_counts(
    more: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of what was found is the fit with it, so two are not better because it has no name."""
    search = Search(monkeypatch, score=30.0, second=1200.0 + more)
    search.last.unshown = trial(MASS, 1200.0)
    way, found = search.result(trial(DIFFUSION, 1000.0), trial(MOUNT, 900.0))
    assert (found is not way) == taken


@pytest.mark.long
def test_a_delay_with_a_compliance_of_the_mount_is_no_mass_of_the_body() -> None:
    """Tissue that moves along, of which everybody has their own, describes more than either of the two alone."""
    people = VirtualPopulation(
        network=f"delay[d1*](n9*-({PAPER_NETWORK}))",
        central={"n3": 2.9e-4, "r3": 4.93, "m2": 0.0293, "r1": 7.9, "n1": 1.7e-4, "m1": 0.385, "n2": 6.3e-4, "r2": 53.8}
        | {"n9": 1.43e-6, "d1": -2.63e-5},
        between_persons={"n3": 0.4, "r3": 0.37, "m2": 0.19, "r1": 0.15, "n1": 0.44, "m1": 0.2, "n2": 0.37, "r2": 0.16},
        noise=0.0043,
        noise_corner_hz=3.2,
    )
    recordings = simulate_recordings(people, 16, 1, np.geomspace(0.81, 636, 60), seed=1).recordings
    found = diagnose(recordings, PAPER_NETWORK, quick=True, seed=1).verdict.physics
    names = [{entry.id, *(alias.id for alias in entry.aliases if not alias.separated)} for entry in found]
    assert len(names) == 2
    assert any("rig.delay" in one for one in names)  # sixty points hardly tell it from a low-pass
    assert any("rig.series_compliance" in one for one in names)
