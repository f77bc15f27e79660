"""Elements that follow the drive level noted of the repetitions: found, named, and not claimed where there is nothing.

Nothing here says how large the noise is at which level; at lower levels it is often larger.
"""

from __future__ import annotations

import numpy as np
import pytest
from experiments import TOY, toy
from populations_of_likelihoods import mostly, rarely

from bayes_impedance.diagnosis.heterogeneity.tests import find_structures
from bayes_impedance.diagnosis.heterogeneity.trends import regressors_of
from bayes_impedance.diagnosis.verdict.structure_entries import structure_entry
from bayes_impedance.diagnosis.verdict_types import Physics
from bayes_impedance.recordings.circumstances import is_amplitude
from bayes_impedance.recordings.dataset import Recordings, Subject

LEVELS = np.array([1.0, 2.0, 4.0])
NAME = "drive_level_v"


def entries(
    seed: int,
    slope: float,
    *,
    n: int = 20,
    levels: int = 3,
    rising: bool = False,
    noisier: float = 0.0,
    drift: float = 0.0,
    name: str = NAME,
) -> tuple[Physics, ...]:
    """Entries for a population whose damper follows the level by a power, and the number of the repetition.

    `noisier` is noise in addition at the lowest level, relative to the impedance, which falls as 1/level.
    """
    rng = np.random.default_rng([24, seed])
    level = np.array([LEVELS[:levels] if rising else rng.permutation(LEVELS[:levels]) for _ in range(n)])

    def hidden(_s: np.ndarray, z: np.ndarray, noise: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        factor = level**slope * np.exp(drift * np.arange(levels))
        z = z + z.real * (factor[..., None] - 1)
        more = noise.normal(size=z.shape) + 1j * noise.normal(size=z.shape)
        return z + noisier / level[..., None] * np.abs(z) * more, factor[:, 0]

    experiment = toy(*TOY, seed=seed, n=n, repetitions=levels, hidden=hidden)
    subjects = tuple(
        Subject(
            name=f"P{i}",
            frequency_hz=d.omega / (2 * np.pi),
            z=d.z[:, 0] + 1j * d.z[:, 1],
            repetitions=tuple(str(j) for j in range(levels)),
            circumstances={name: level[i]},
        )
        for i, d in enumerate(experiment.data)
    )
    given = Recordings(title="", unit="N s/m", network=None, source="", licence="", subjects=subjects)
    fit = experiment.refitter.fit(experiment.model, experiment.u, experiment.population, 80)
    structures, _ = find_structures(fit, given, False, 1)
    return tuple(structure_entry(s, experiment.model.network.elements, given.names) for s in structures)


@pytest.mark.parametrize(("noisier", "levels"), [(0.0, 3), (0.03, 3), (0.0, 2)])
def test_an_element_that_follows_the_level_is_found_with_its_exponent(noisier: float, levels: int) -> None:
    trials, found, inside = 12, 0, 0
    for seed in range(trials):
        named = [e for e in entries(seed, 0.15, noisier=noisier, levels=levels) if e.id == "body.amplitude"]
        for entry in named:
            assert (entry.kind, entry.place, entry.covariate) == ("trend", "r1", NAME)
            slope = entry.parameters["slope"]
            assert slope.unit == ""  # an exponent, of two levels too
            found += 1
            inside += slope.q05 < 0.15 < slope.q95
            assert entry.aliases == ()
    assert mostly(found, trials, 0.9)
    assert mostly(inside, trials, 0.85)


@pytest.mark.long
@pytest.mark.parametrize("noisier", [0.0, 0.03])
def test_levels_without_effect_raise_no_alarm(noisier: float) -> None:
    """Four families of tests at 0.003 each, in 24 populations; two alarms would be 1 in 30."""
    alarms = [e.id for seed in range(24) for e in entries(1000 + seed, 0.0, noisier=noisier)]
    assert "body.amplitude" not in alarms
    assert rarely(len(alarms), 24, 0.012)


def test_a_drift_with_levels_in_random_order_is_no_effect_of_amplitude() -> None:
    for seed in range(8):
        named = entries(2000 + seed, 0.0, drift=0.1)
        assert "body.amplitude" not in [e.id for e in named]
        assert "body.drift" in [e.id for e in named]
        assert not any(e.aliases for e in named)


def test_levels_that_rise_with_the_repetitions_are_named_with_their_rival() -> None:
    (entry,) = entries(3, 0.15, rising=True)
    (rival,) = entry.aliases
    assert {entry.id, rival.id} == {"body.amplitude", "body.drift"}
    assert not rival.separated
    assert abs(rival.elpd_behind) < 1.0
    assert "random order" in rival.would_separate


@pytest.mark.parametrize(("slope", "grows"), [(0.3, True), (-0.3, False)])
def test_it_is_said_in_words_of_the_field(slope: float, grows: bool) -> None:
    (entry,) = entries(5, slope)
    assert entry.name == f"r1 {'grows' if grows else 'falls'} with the amplitude, noted as {NAME}"
    assert ("turbulent flow" if grows else "friction") in entry.story
    assert f"where {NAME} is doubled" in entry.story


def test_what_is_no_level_is_a_circumstance_like_any_other() -> None:
    (entry,) = entries(6, 0.3, name="contact_force_n")
    assert entry.id == "body.covariate"
    assert entry.name == "r1 follows contact_force_n from repetition to repetition"


@pytest.mark.parametrize(
    "name",
    [
        *("drive_level_v", "drive_v", "DriveLevel", "excitation_g", "amplitude_mm", "vibration_magnitude"),
        *("shaker_gain_v", "drive level [V]", "stroke-mm", "drive=high", "excitation_level=low"),
    ],
)
def test_names_of_amplitudes(name: str) -> None:
    assert is_amplitude(name)


@pytest.mark.parametrize(
    "name",
    [
        *("contact_force_n", "temperature_c", "shaker", "shaker_id", "shaker_no", "shaker=B", "excitation=sweep"),
        *("driver", "screwdriver", "level", "time_of_day_h", "sweep=up"),
    ],
)
def test_names_of_other_circumstances(name: str) -> None:
    assert not is_amplitude(name)


def test_two_levels_are_a_ratio_and_two_codes_are_none_and_decibels_are_logarithms() -> None:
    two = np.array([1.0, 2.0] * 5)
    found = regressors_of({"drive_v": two, "group": two, "drive_db": 10 * two, "drive_zero": two - 1}, [])
    assert {name: transform for name, (_, transform) in found.items()} == {
        "drive_v": "log",
        "group": "linear",
        "drive_db": "linear",
        "drive_zero": "linear",
    }


def test_one_level_for_everybody_is_said_to_be_the_same() -> None:
    remarks: list[str] = []
    assert regressors_of({NAME: np.full(30, 2.0)}, remarks, "repetitions") == {}
    assert remarks == [f"covariate '{NAME}' is the same for all repetitions"]
