"""Every population fit is examined: what is wrong is said with the elements that it spoils, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bayes_impedance.diagnosis.examine import examine
from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.fit import FitSettings, fit_population
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.adequacy import Adequacy

NETWORK = "n1|r1|m1"
# Chains that are long enough for a half width, which is all that is asked of them.
SHORT = FitSettings(draws=256, sampler=SamplerSettings(ensembles=2, burn_in=(60, 40), chunk=60, longest=120))
CENTRAL = {"n1": 1e-3, "r1": 1.5, "m1": 1e-3}

Change = Callable[[int, np.ndarray, np.ndarray], np.ndarray]
"""Of the person's number, frequencies (F,) and impedances (J, F)."""


def recordings(change: Change, n: int = 24, seed: int = 1) -> Recordings:
    population = VirtualPopulation(
        network=NETWORK, central=CENTRAL, between_persons=dict.fromkeys(CENTRAL, 0.2), noise_corner_hz=0.0
    )
    made = simulate_recordings(population, n, 1, np.geomspace(5, 1000, 40), seed).recordings
    changed = (replace(s, z=change(i, s.frequency_hz, s.z)) for i, s in enumerate(made.subjects))
    return replace(made, subjects=tuple(changed))


CHANGES: dict[str, Change] = {
    "nothing": lambda i, f, z: z,
    "conjugated": lambda i, f, z: z.conj(),
    "accelerance": lambda i, f, z: 2j * np.pi * f / z,
    "mobility": lambda i, f, z: 1 / z,
    "high-pass": lambda i, f, z: z * 1j * f / (1j * f + 3.0),
    "power law": lambda i, f, z: z + 0.3 * np.sqrt(1j * f / 50),
    "one flipped": lambda i, f, z: -z if i == 3 else z,
    "one a hundred times": lambda i, f, z: 100 * z if i == 3 else z,
    "one far away": lambda i, f, z: z + 15.0 if i == 3 else z,
    "two groups": lambda i, f, z: 2.5 * z if i % 3 == 0 else z,
}


@cache
def examined(change: str) -> Adequacy:
    return examine(fit_population(recordings(CHANGES[change]), NETWORK, settings=SHORT))


@pytest.mark.long
def test_good_populations_are_not_marked() -> None:
    """The screening alone speaks in one of a hundred by its level: of six, one may, and no element is marked."""
    all_found = [
        examine(fit_population(recordings(CHANGES["nothing"], seed=seed), NETWORK, settings=SHORT))
        for seed in range(1, 7)
    ]
    assert sum((found.gross, found.misfit) != ((), ()) for found in all_found) <= 1
    assert all(not found.bent and not found.gross for found in all_found)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "scores_say_so"), [(1, True), (2, False)])
def test_one_sweep_of_few_points_is_not_taken_for_missing_physics(seed: int, scores_say_so: bool) -> None:
    """Scores may say so: noise is known to 6 % at each frequency, and rises at the lowest. No refit gains."""
    made = simulate_recordings(FINGERTIP, 71, 1, np.geomspace(5, 5000, 51), seed).recordings
    found = examine(fit_population(made, settings=SHORT))
    assert (found.gross, found.misfit, found.bent) == ((), (), {})
    assert bool(found.log_p < np.log(0.01)) is scores_say_so


@pytest.mark.long
@pytest.mark.parametrize(
    "change", ["conjugated", "accelerance", pytest.param("mobility", marks=[pytest.mark.slow, pytest.mark.ci])]
)
def test_another_quantity_is_a_gross_misfit(change: str) -> None:
    found = examined(change)
    assert len(found.gross) == 1
    assert "each subject's own best fit deviates by" in found.gross[0]


@pytest.mark.parametrize(
    ("change", "spoilt"), [("high-pass", {"n1"}), ("power law", {"r1"})], ids=["high-pass", "power law"]
)
def test_missing_physics_is_said_with_the_elements_that_it_bends(change: str, spoilt: set[str]) -> None:
    found = examined(change)
    assert not found.gross
    assert "leaves out something" in found.misfit[0]
    assert "bayes-impedance diagnose" in found.misfit[0]
    assert spoilt <= set(found.bent) < set(CENTRAL)
    assert all(np.isfinite(change) for change in found.bent.values())
    assert found.effects


@pytest.mark.long
@pytest.mark.parametrize("change", ["one flipped", "one a hundred times", "one far away"])
def test_one_person_who_does_not_belong_is_named(change: str) -> None:
    found = examined(change)
    assert any("V04" in sentence for sentence in found.misfit)
    assert not any("p = 0)" in sentence for sentence in found.misfit)
    assert set(found.bent) == set(CENTRAL)


def test_two_groups_are_not_one_population() -> None:
    found = examined("two groups")
    assert any("form two groups" in sentence for sentence in found.misfit)
    assert set(found.bent) == set(CENTRAL)


@pytest.mark.long
def test_copies_are_not_people() -> None:
    one = recordings(CHANGES["nothing"], n=1)
    same = tuple(replace(one.subjects[0], name=f"P{i}") for i in range(6))
    found = examine(fit_population(replace(one, subjects=same), NETWORK, settings=SHORT))
    assert any("copies" in sentence for sentence in found.gross)


def test_one_person_alone_is_examined_too() -> None:
    good = examine(fit_population(recordings(CHANGES["nothing"], n=1), NETWORK, settings=SHORT))
    assert (good.gross, good.misfit) == ((), ())
    bad = examine(fit_population(recordings(CHANGES["power law"], n=1), NETWORK, settings=SHORT))
    assert "leaves out something" in bad.misfit[0]


def test_the_summary_has_no_number_that_json_lacks() -> None:
    assert Adequacy(bent={"n1": np.inf, "r1": 0.3}).summary()["bent"] == {"n1": None, "r1": 0.3}


def test_narrow_lines_elsewhere_in_everybody_are_located_and_said() -> None:
    """The spring has a mass; its standing waves are narrow, above 0.9 kHz and elsewhere in everybody.

    They are no noise of all, which would hide them from the location of structure (p = 1).
    """
    central, f, rng = {"n1": 1e-3, "r1": 50.0, "m1": 2e-3}, np.geomspace(5, 5000, 200), np.random.default_rng(3)
    population = VirtualPopulation(
        network=NETWORK, central=central, between_persons=dict.fromkeys(central, 0.05), noise=0.0, noise_corner_hz=0.0
    )
    made = simulate_recordings(population, 14, 1, f, 3).recordings
    spring, s = 1 / (2j * np.pi * f * central["n1"]), 2j * np.pi * f
    people = []
    for subject, mass in zip(made.subjects, 1e-4 * np.exp(0.5 * rng.normal(size=14)), strict=True):
        x = s * np.sqrt(mass * central["n1"])
        z = subject.z + spring * (x / np.tanh(x) - 1)
        people.append(replace(subject, z=z * (1 + 0.03 * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size)))))
    found = examine(fit_population(replace(made, subjects=tuple(people)), NETWORK, settings=SHORT))
    assert "leaves out something" in found.misfit[0]
    assert found.effects == ("body.line",)
    assert found.p_value < 1e-6
