"""Which candidates of a scan are worth a refit: each effect's best shape, not one effect everywhere, not one score."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from experiments import TOY, Serial, entry, toy, with_mass

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect, registered
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.score_scan import Screening, screen
from bayes_impedance.diagnosis.selection.shortlist import BY_SPREAD, SHORTLIST, _elsewhere, best_shapes, shortlist
from bayes_impedance.diagnosis.selection.trial import Trial

PLACES = (
    "skin:(n2|r2)-tissue:(m1|n1|r1)",
    {"n2": 3e-5, "r2": 8.0, "m1": 2e-4, "n1": 1e-3, "r1": 2.0},
)
"""A network with five places at which springpots and relaxations differ."""


def own_resonances(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A resonance that lies elsewhere in everybody, between 30 and 600 Hz."""
    omega = 2 * np.pi * np.exp(rng.uniform(np.log(30), np.log(600), (len(z), 1, 1)))
    mass = 0.06 * np.abs(z).min() / omega
    return z + 1 / (1 / (s * mass) + 1 / (0.2 * mass * omega + mass * omega**2 / s)), np.zeros(len(z))


def opposite_masses(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A high-pass of the rig, and a mass that is too large in half of the people and too small in the others."""
    mass = 2e-5 * np.where(np.arange(len(z)) % 2, 1.1, -0.9)
    return (z + s * mass[:, None, None]) * s / (s + 2 * np.pi * 0.3), mass


@cache
def scanned(hidden: str, many_places: bool = False, n: int = 16) -> Screening:
    change = {"nothing": None, "mass": with_mass(0.3), "resonances": own_resonances, "opposite": opposite_masses}
    experiment = toy(*(PLACES if many_places else TOY), seed=1, n=n, hidden=change[hidden])
    fit = experiment.fit()
    residuals = person_residuals(fit, [str(i) for i in range(n)])
    return screen(fit, residuals, registered(), 1, Serial())


def key_of(candidate: Candidate) -> tuple[str, str, str]:
    return candidate.effect.id, candidate.effect.form, candidate.place


def strength_of(screening: Screening, by_spread: bool) -> np.ndarray:
    if by_spread:
        body = np.array([c.effect.side == "body" for c in screening.candidates])
        return np.where(body, -screening.log_p_spread, 0.0)
    return np.abs(np.nan_to_num(screening.z))


@pytest.mark.parametrize("physical_only", [True, False])
@pytest.mark.parametrize("by_spread", [True, False])
@pytest.mark.parametrize("hidden", ["mass", "resonances"])
def test_of_every_effect_at_every_place_the_best_shape_is_kept(
    hidden: str, by_spread: bool, physical_only: bool
) -> None:
    screening = scanned(hidden, many_places=True)
    strength = strength_of(screening, by_spread)
    if physical_only:
        strength = np.where(screening.physical, strength, 0.0)
    expected: dict[tuple[str, str, str], float] = {}
    for c, value in zip(screening.candidates, strength, strict=True):
        if value > 0:
            expected[key_of(c)] = max(expected.get(key_of(c), 0.0), float(value))
    order = best_shapes(screening, physical_only, by_spread)
    assert {key_of(screening.candidates[k]): float(strength[k]) for k in order} == expected
    assert len(order) == len(expected) > 10
    assert np.all(np.diff(strength[order]) <= 0)
    assert not physical_only or bool(np.all(screening.physical[order]))


def rows(*columns: tuple[str, str, str, float, float, float]) -> Screening:
    """Of candidates given by effect, operation, place, score, size and log p-value of the spread."""
    n = len(columns)
    z, size, log_p_spread = (np.array([row[k] for row in columns]) for k in (3, 4, 5))
    return Screening(
        candidates=tuple(Candidate(entry(row[0], row[1]), row[2], {"time_constant": 0.1 * k})
                         for k, row in enumerate(columns)),
        score=np.zeros((1, n)),
        information=np.ones((1, n)),
        z=z,
        size=size,
        spread=np.zeros(n),
        log_p_spread=log_p_spread,
        cosine=np.eye(n),
        visible=np.ones(n),
        effective=1.0,
    )  # fmt: skip


RELAXATION, SPRINGPOT, MASS = ("body.relaxation", ""), ("body.springpot", "beside_power"), ("rig.mass", "")


def test_shapes_that_cannot_be_seen_or_have_an_impossible_sign_are_none() -> None:
    screening = rows(
        (*RELAXATION, "a", 5.0, 1.0, 0.0),
        (*RELAXATION, "a", 9.0, -1.0, 0.0),
        (*RELAXATION, "a", 7.0, 1.0, 0.0),
        (*SPRINGPOT, "a", np.nan, np.nan, 0.0),
        (*MASS, "port", -6.0, -1.0, 0.0),
    )
    assert best_shapes(screening) == [2, 4]
    assert best_shapes(screening, physical_only=False) == [1, 4]


def test_an_effect_is_on_the_list_at_two_places_at_most() -> None:
    screening = rows(
        (*RELAXATION, "a", 50.0, 1.0, 0.0),
        (*RELAXATION, "b", 49.0, 1.0, 0.0),
        (*RELAXATION, "c", 48.0, 1.0, 0.0),
        (*SPRINGPOT, "c", 30.0, 1.0, 0.0),
        (*MASS, "port", 25.0, 1.0, 0.0),
    )
    assert shortlist(screening) == [0, 1, 3, 4]
    assert shortlist(screening, 3) == [0, 1, 3]


def test_what_explains_little_of_what_the_best_explains_is_not_on_the_list() -> None:
    screening = rows(
        (*RELAXATION, "a", 50.0, 1.0, 0.0), (*SPRINGPOT, "a", 25.0, 1.0, 0.0), (*MASS, "port", 5.0, 1.0, 0.0)
    )
    assert shortlist(screening) == [0, 1]


def test_what_differs_most_between_people_is_on_the_list_besides() -> None:
    """With room for it even if the list is full; of the body alone, and only if it differs beyond doubt."""
    screening = rows(
        (*MASS, "port", 50.0, 1.0, -500.0),
        (*RELAXATION, "a", 1.0, 1.0, -200.0),
        (*SPRINGPOT, "a", 1.0, 1.0, -300.0),
        ("body.line", "", "a", 1.0, 1.0, -100.0),
        ("body.reflex", "", "a", 1.0, 1.0, -2.0),
    )
    assert shortlist(screening) == [0, 2, 1, 3]
    assert shortlist(screening, 1) == [0, 2, 1, 3]
    doubtful = replace(screening, log_p_spread=np.full(5, -2.0))
    assert shortlist(doubtful) == [0]


def test_nothing_to_choose_from_is_an_empty_list() -> None:
    assert shortlist(rows((*RELAXATION, "a", 5.0, -1.0, 0.0))) == []


@pytest.mark.parametrize("hidden", ["nothing", "mass", "resonances", "opposite"])
def test_of_a_whole_catalogue_the_list_is_short_and_holds_the_best(hidden: str) -> None:
    screening = scanned(hidden, many_places=True)
    chosen = shortlist(screening)
    assert 0 < len(chosen) <= SHORTLIST + BY_SPREAD
    assert len(set(chosen)) == len(chosen)
    assert chosen[0] == best_shapes(screening)[0]
    keys = [key_of(screening.candidates[k]) for k in chosen]
    assert len(set(keys)) == len(keys)
    assert max(Counter((name, form) for name, form, _ in keys).values()) <= 4  # two by score, two by spread
    assert bool(np.all(screening.physical[chosen]))


def test_what_has_little_in_common_but_differs_in_everybody_is_on_the_list() -> None:
    """Its common score alone would not bring it there: half of the people pull the other way."""
    screening = scanned("opposite")
    assert "body.mass" in [screening.candidates[k].effect.id for k in shortlist(screening)]
    without_spread = replace(screening, log_p_spread=np.zeros_like(screening.log_p_spread))
    assert "body.mass" not in [screening.candidates[k].effect.id for k in shortlist(without_spread)]


def test_effects_that_could_lead_are_tried_everywhere() -> None:
    """The leader, what would be ahead if one person were described as the others are, and what a score promises."""
    n = 16
    experiment = toy(*PLACES, seed=1, n=n, hidden=with_mass(0.3))
    fit = experiment.fit()
    screening = screen(fit, person_residuals(fit, [str(i) for i in range(n)]), registered(), 1, Serial())
    shown = [screening.candidates[k] for k in best_shapes(screening)]
    first: dict[Effect, Candidate] = {}
    for candidate in shown:
        first.setdefault(candidate.effect, candidate)
    places = Counter(effect for effect, _ in {(c.effect, c.place) for c in shown})
    several = [effect for effect in first if places[effect] > 1][:3]
    assert len(several) == 3
    chi = fit.equations.chi.copy()
    chi[fit.owner == 0] *= 100
    misled = replace(fit, equations=replace(fit.equations, chi=chi))

    def trial(effect: Effect, gain: float, end: Refit) -> Trial:
        return Trial(candidate=first[effect], pooling="shared", fit=end, gain=gain, physical=True)

    leader, hopeful, behind = several
    most = 5 * float(np.nanmax(screening.z**2))
    trials = [trial(leader, most, fit), trial(hopeful, most - 20.0, misled), trial(behind, most - 20.0, fit)]
    found = _elsewhere(experiment.refitter, fit, screening, trials, None)
    assert {t.effect for t in found} == {leader, hopeful}
    promising = [k for k in best_shapes(screening) if screening.candidates[k].effect is behind]
    there = next(k for k in promising if screening.candidates[k].place != first[behind].place)
    z = screening.z.copy()
    z[there] = np.sign(z[there]) * np.sqrt(2 * 0.7 * most)
    found = _elsewhere(experiment.refitter, fit, replace(screening, z=z), trials, None)
    ours = [t.candidate.place for t in found if t.effect == behind]
    assert ours == [screening.candidates[there].place]
    for t in found:
        assert t.candidate.place != first[t.effect].place
        assert t.pooling == "shared"
