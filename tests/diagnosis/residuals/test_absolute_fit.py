"""A verdict is not only a comparison of explanations: what is wrong in absolute terms comes first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.residuals.absolute_fit import GROSS_ERROR, badly_described, copies, far_off, no_impedance
from bayes_impedance.diagnosis.verdict_types import Verdict
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.quality.negative_real_part import other_quantity
from bayes_impedance.recordings.files import Recordings

NETWORK = "n1|r1|m1"
CENTRAL = {"n1": 1e-3, "r1": 1.5, "m1": 1e-3}


def recordings(n: int) -> Recordings:
    population = VirtualPopulation(
        network=NETWORK, central=CENTRAL, between_persons=dict.fromkeys(CENTRAL, 0.2), noise_corner_hz=0.0
    )
    return simulate_recordings(population, n, 1, np.geomspace(5, 1000, 40), 1).recordings


def verdict_on(made: Recordings) -> Verdict:
    return diagnose(made, NETWORK, quick=True).verdict


def test_a_good_population_has_no_shortcoming() -> None:
    verdict = verdict_on(recordings(12))
    assert verdict.shortcomings == ()
    assert verdict.reliable
    assert verdict.summary.startswith("Nothing is missing")


@pytest.mark.long
@pytest.mark.parametrize("n", [2, 4, 12])
def test_one_flipped_person_is_not_described_to_within_the_noise(n: int) -> None:
    made = recordings(n)
    people = list(made.subjects)
    people[1] = replace(people[1], z=-people[1].z)
    verdict = verdict_on(replace(made, subjects=tuple(people)))
    assert "to within their noise" not in verdict.summary
    assert people[1].name in verdict.summary
    assert verdict.shortcomings


@pytest.mark.long
def test_conjugated_recordings_allow_no_conclusion() -> None:
    made = recordings(12)
    turned = replace(made, subjects=tuple(replace(s, z=s.z.conj()) for s in made.subjects))
    verdict = verdict_on(turned)
    assert not verdict.reliable
    assert verdict.summary.startswith("Nothing can be concluded: ")
    assert any("complex conjugates" in why for why in verdict.shortcomings)
    assert verdict.remarks[0] == verdict.shortcomings[0]


@pytest.mark.long
def test_copies_of_one_person_allow_no_conclusion() -> None:
    made = recordings(1)
    same = replace(made, subjects=tuple(replace(made.subjects[0], name=f"P{i}") for i in range(12)))
    verdict = verdict_on(same)
    assert not verdict.reliable
    assert "11 of 12 subjects are copies of others" in verdict.summary


def test_large_noise_is_no_gross_misfit() -> None:
    """Recordings with noise of 100 % differ from every network by as much."""
    assert far_off(np.full(5, 1.0), np.full(5, 1.0), "N s/m") == []
    assert "(force over velocity)" in far_off(np.full(5, 1.0), np.full(5, 30.0), "N s/m")[0]
    assert "(voltage over current)" in far_off(np.full(5, 1.0), np.full(5, 30.0), "ohm")[0]
    assert (
        far_off(np.full(5, 0.9 * GROSS_ERROR), np.full(5, 30.0), "N s/m") == []
    )  # a precise spectrum, a rough network


def test_one_copy_among_many_is_no_gross_fault() -> None:
    made = recordings(24)
    again = replace(made.subjects[0], name="again")
    assert copies(replace(made, subjects=(*made.subjects, again))) == []
    assert copies(made) == []


def test_people_whom_the_network_does_not_describe_are_named() -> None:
    names = [f"P{i}" for i in range(10)]
    assert badly_described(names, np.r_[np.ones(9), 1.8]) == []
    assert "(P9; residuals up to 40 times the noise)" in badly_described(names, np.r_[np.ones(9), 40.0])[0]
    assert badly_described(names, np.full(10, 40.0)) == []  # that is the network's fault and not one person's


def test_a_load_without_losses_is_no_other_quantity() -> None:
    """Its Re z is negative at every other point by noise, and by jw it would be positive where a spring rules."""
    central = {"n1": 1e-3, "m1": 0.02, "n2": 5e-3}
    population = VirtualPopulation(
        network="n1|(m1-n2)", central=central, between_persons=dict.fromkeys(central, 0.2), noise_corner_hz=0.0
    )
    made = simulate_recordings(population, 8, 1, np.geomspace(0.5, 60, 200), 1).recordings
    assert np.mean([s.z.real < 0 for s in made.subjects]) > 0.2
    assert no_impedance(made, "n1|(m1-n2)", True) == []


def test_a_quantity_whose_real_part_is_clearly_negative_is_one() -> None:
    """Apparent mass is negative where springs rule; who has described the recordings knows what they are."""
    made = recordings(8)
    changed = tuple(replace(s, z=s.z / (2j * np.pi * s.frequency_hz)) for s in made.subjects)
    (said,) = no_impedance(replace(made, subjects=changed), NETWORK, True)
    assert "divided or multiplied by jw" in said
    assert "describes them as apparent mass to" in said
    assert no_impedance(replace(made, subjects=changed), NETWORK, False) == []


def test_a_mass_behind_an_echo_is_no_other_quantity() -> None:
    """It is passive divided by jw, as every mass is, but the network describes it better as it is."""
    central = {"m1": 1.5e-3, "n1": 5.0, "r2": 0.02, "n2": 1.0}
    population = VirtualPopulation(
        network="m1|n1|(r2-n2)", central=central, between_persons=dict.fromkeys(central, 0.2), noise_corner_hz=0.0
    )
    made = simulate_recordings(population, 8, 1, np.geomspace(5, 2000, 84), 1).recordings
    echo = [1 - 0.16 * np.exp(-2j * np.pi * s.frequency_hz * 2.5e-4) for s in made.subjects]
    changed = tuple(replace(s, z=s.z * own) for s, own in zip(made.subjects, echo, strict=True))
    assert all(other_quantity(s) is not None for s in changed)
    assert no_impedance(replace(made, subjects=changed), "m1|n1|(r2-n2)", True) == []
