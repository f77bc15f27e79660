"""From lagged and filtered recordings, most of them with Re z < 0, to the names and sizes of what the chain does."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from lagged_recordings import Chain, delayed, drive, filtered_motion

from bayes_impedance.diagnosis.diagnose import diagnose
from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.selection.far_starts import wholly_off
from bayes_impedance.diagnosis.selection.few_people import residuals_that_say_one_thing
from bayes_impedance.population.simulate import Simulation
from bayes_impedance.recordings.dataset import Recordings


def _both(s: np.ndarray, z: np.ndarray) -> np.ndarray:
    return delayed(1e-4)(s, filtered_motion(20.0)(s, z))


def _medians(recordings: Recordings, simulation: Recordings | None = None) -> dict[str, float]:
    verdict = diagnose(recordings, simulation=simulation, quick=True).verdict
    return {entry.id: next(iter(entry.parameters.values())).median for entry in verdict.physics}


def test_a_lag_of_a_drive_is_named() -> None:
    found = _medians(drive(delayed(1e-4)))
    assert found == {"rig.delay": pytest.approx(-1e-4, rel=0.1)}


@pytest.mark.long
def test_a_low_pass_and_a_lag_of_one_recording_are_both_named() -> None:
    recordings = drive(_both)
    assert (recordings.subjects[0].z.real < 0).mean() > 0.8
    found = _medians(recordings)
    assert set(found) == {"rig.lowpass", "rig.delay"}
    assert -1 / (2 * np.pi * found["rig.lowpass"]) == pytest.approx(20.0, rel=0.03)
    assert found["rig.delay"] == pytest.approx(-1e-4, rel=0.1)


@pytest.mark.long
def test_against_recordings_with_the_lag_the_low_pass_alone_is_named() -> None:
    found = _medians(drive(_both), drive(delayed(1e-4), seed=4))
    assert set(found) == {"rig.lowpass"}
    assert -1 / (2 * np.pi * found["rig.lowpass"]) == pytest.approx(20.0, rel=0.03)


def test_nothing_is_named_without_lag() -> None:
    assert _medians(drive(lambda s, z: z)) == {}


@pytest.mark.long
@pytest.mark.parametrize("lag", [0.0, pytest.param(1e-5, marks=[pytest.mark.slow, pytest.mark.ci])])
def test_a_low_pass_within_the_band_of_a_population(small_simulation: Simulation, lag: float) -> None:
    """The derivatives of the network's fit do not show it: the search begins far from the network."""

    def changed(s: np.ndarray, z: np.ndarray) -> np.ndarray:
        return delayed(lag)(s, filtered_motion(20.0)(s, z))

    data = small_simulation.recordings
    people = tuple(replace(s, z=changed(2j * np.pi * s.frequency_hz, s.z)) for s in data.subjects)
    found = _medians(replace(data, subjects=people))
    assert set(found) == ({"rig.lowpass", "rig.delay"} if lag else {"rig.lowpass"})
    assert -1 / (2 * np.pi * found["rig.lowpass"]) == pytest.approx(20.0, rel=0.03)
    if lag:
        assert found["rig.delay"] == pytest.approx(-lag, rel=0.1)


def test_points_with_negative_real_parts_take_part() -> None:
    """Without them other elements would follow: the fit is that of all points."""
    recordings = drive(delayed(1e-4))
    with ThreadPoolExecutor(2) as executor:
        fitted = fit_network(recordings, "delay[d1=-1e-4](m1|r1|((m2|r2)-(n1|r3)))", 1, executor, lambda *_: None)
    (data,) = fitted.fit.data
    assert data.z.shape == (1, 2, recordings.subjects[0].frequency_hz.size)
    assert (data.z[0, 0] < 0).sum() > 40
    values = np.exp(fitted.fit.u[0])
    elements = dict(zip(fitted.fit.model.network.elements, values, strict=False))
    assert elements["m1"] == pytest.approx(5e-3, rel=0.03)
    assert elements["n1"] == pytest.approx(1.8e-3, rel=0.03)


@pytest.mark.parametrize(("chain", "expected"), [(delayed(1e-4), False), (filtered_motion(20.0), True)])
def test_only_what_the_network_does_not_describe_at_all_is_wholly_off(chain: Chain, expected: bool) -> None:
    recordings = drive(chain)
    with ThreadPoolExecutor(2) as executor:
        fitted = fit_network(recordings, None, 1, executor, lambda *_: None)
    assert wholly_off(fitted.fit) == expected


def test_noise_says_one_thing_each_and_structure_many() -> None:
    with ThreadPoolExecutor(2) as executor:
        noise = fit_network(drive(lambda s, z: z), None, 1, executor, lambda *_: None)
        lag = fit_network(drive(delayed(1e-4)), None, 1, executor, lambda *_: None)
    assert residuals_that_say_one_thing(noise.fit) < 2
    assert residuals_that_say_one_thing(lag.fit) > 5
