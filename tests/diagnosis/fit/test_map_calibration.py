"""The error of a calibration at each frequency, estimated from all recordings and removed before a search."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from conftest import THREE_ELEMENTS

from bayes_impedance.diagnosis.examine import examine
from bayes_impedance.diagnosis.fit.calibration_error import without_calibration_error
from bayes_impedance.diagnosis.fit.map_calibration import map_error, removed
from bayes_impedance.intake.simulated_rig import SimulatedRig
from bayes_impedance.intake.two_port import two_port
from bayes_impedance.population.fit import QUICK_SETTINGS, fit_population
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings

FREQUENCY_HZ = np.geomspace(10, 1000, 20)
S = 2j * np.pi * FREQUENCY_HZ
SPREAD = dict.fromkeys(("m1", "r1", "n1"), 0.05)
PEOPLE = replace(THREE_ELEMENTS, between_persons=SPREAD, between_repetitions=dict.fromkeys(SPREAD, 0.02), noise=0.0)
NOISE = 0.01


def corrected(seed: int, late_s: float = 0.0) -> tuple[Recordings, list[np.ndarray]]:
    """People behind a rig, corrected with noisy runs of known masses; and what they are."""
    rng, rig = np.random.default_rng(seed), SimulatedRig()

    def noisy(h: np.ndarray) -> np.ndarray:
        return np.asarray(h + NOISE * np.abs(h) * (rng.normal(size=h.shape) + 1j * rng.normal(size=h.shape)))

    loads = S * np.array([[0.0], [0.01], [0.05]])
    exact = np.array([rig.measured(FREQUENCY_HZ, load) for load in loads])
    found = two_port(FREQUENCY_HZ, loads, noisy(exact), NOISE * np.abs(exact), len(loads))
    made = simulate_recordings(PEOPLE, 12, 2, FREQUENCY_HZ, seed).recordings
    truth, subjects = [one.z * np.exp(-S * late_s) for one in made.subjects], []
    for one, z in zip(made.subjects, truth, strict=True):
        exact = np.array([rig.measured(FREQUENCY_HZ, each) for each in z])
        h = noisy(exact)
        noise = NOISE * np.abs(exact) * found.noise_factor(h)
        subjects.append(replace(one, z=found.load(h), noise_sd=noise))
    return replace(made, subjects=tuple(subjects), calibration_map=found.recorded), truth


def estimated(recordings: Recordings) -> tuple[float, Recordings]:
    with ThreadPoolExecutor(1) as executor:
        found = map_error(recordings, None, 1, executor, lambda *_: None)
    assert found is not None
    return found.probability, removed(recordings, found)


def common(recordings: Recordings, truth: list[np.ndarray]) -> float:
    """Size of the error that all have in common, over that of z."""
    off = [np.mean((one.z - z) / np.abs(z), axis=0) for one, z in zip(recordings.subjects, truth, strict=True)]
    return float(np.sqrt(np.mean(np.abs(np.mean(off, axis=0)) ** 2)))


@pytest.mark.parametrize("seed", range(3))
def test_what_all_have_in_common_is_removed(seed: int) -> None:
    """Up to what the elements of the network take of it."""
    recordings, truth = corrected(seed)
    probability, clean = estimated(recordings)
    assert probability > 0.001
    assert clean.calibration_map is None
    assert common(clean, truth) < 0.5 * common(recordings, truth)


def test_what_the_network_lacks_is_improbable_and_stays() -> None:
    recordings, _ = corrected(1, late_s=1e-4)
    assert estimated(recordings)[0] < 1e-6
    with ThreadPoolExecutor(1) as executor:
        inside = without_calibration_error(recordings, None, 1, executor, lambda *_: None)
    assert "Nothing was removed" in inside.remarks[0]
    for one, given in zip(inside.recordings.subjects, recordings.subjects, strict=True):
        np.testing.assert_array_equal(one.z, given.z)
        assert one.noise_sd is not None
        assert given.noise_sd is not None
        assert np.all(one.noise_sd >= given.noise_sd)


def test_a_diagnosis_is_given_what_is_left() -> None:
    recordings, truth = corrected(2)
    with ThreadPoolExecutor(1) as executor:
        inside = without_calibration_error(recordings, None, 1, executor, lambda *_: None)
        unknown = replace(recordings, subjects=tuple(replace(one, noise_sd=None) for one in recordings.subjects))
        without_noise = without_calibration_error(unknown, None, 1, executor, lambda *_: None)
    assert "removed before the search" in inside.remarks[0]
    assert common(inside.recordings, truth) < common(recordings, truth)
    again = inside.as_given(inside.recordings)
    assert again.calibration_map is recordings.calibration_map
    np.testing.assert_array_equal(again.subjects[0].z, recordings.subjects[0].z)
    assert "not all recordings come with their noise" in without_noise.remarks[0]


@pytest.mark.slow
def test_a_fit_that_carries_it_on_is_not_said_to_misfit() -> None:
    """With the calibration taken as exact its error is a misfit."""
    recordings, _ = corrected(1)
    said = []
    for own in (recordings, replace(recordings, calibration_map=None)):
        fit = fit_population(own, settings=QUICK_SETTINGS, seed=1, workers=1)
        said.append(bool(examine(fit, workers=1).misfit))
    assert said == [False, True]
