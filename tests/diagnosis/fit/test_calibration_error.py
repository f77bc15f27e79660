"""The calibration's own error, estimated and removed before a diagnosis: it is no finding, and hides none."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import erfc, exp, pi, sqrt

import numpy as np
import pytest
from small_diagnoses import CASES, FREQUENCY, Case

from bayes_impedance.diagnosis import Diagnosis, diagnose, registered
from bayes_impedance.diagnosis.fit.calibration_error import (
    Corrected,
    deviations_of,
    largest_deviation,
    probability_of,
    without_calibration_error,
)
from bayes_impedance.network import Kernel, parse
from bayes_impedance.recordings.calibration import CommonError
from bayes_impedance.recordings.files import Recordings

DELAY = 2e-5
"""Of the force channel in the recordings of ``small_diagnoses``."""


def left(delay_sd: float) -> CommonError:
    """What a calibration leaves of a gain, a delay and a mass."""
    return CommonError(
        network="gain[g_rig*](delay[d_rig*](offset[m_rig*](NETWORK)))",
        parameters=("g_rig", "d_rig", "m_rig"),
        mean=np.array([1.0, 0.0, 0.0]),
        sd=np.array([0.01, delay_sd, 1e-6]),
        correlation=np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.3], [0.0, 0.3, 1.0]]),
        share=0.99,
    )


CHANGES = {"delay": CASES["shared"].change, "relaxation": CASES["varying"].change}


def people(change: str | None, error: CommonError | None) -> Recordings:
    return replace(Case(change=None if change is None else CHANGES[change]).recordings(), calibration=error)


def diagnosed(change: str | None, error: CommonError | None) -> Diagnosis:
    allowed = [effect for effect in registered() if effect.id in ("rig.delay", "rig.mass", "body.relaxation")]
    return diagnose(people(change, error), effects=allowed, quick=True, workers=1, seed=1)


def corrected(recordings: Recordings) -> Corrected:
    with ThreadPoolExecutor(1) as executor:
        return without_calibration_error(recordings, None, 1, executor, lambda *_: None)


def named(diagnosis: Diagnosis) -> list[str]:
    return [entry.id for entry in diagnosis.verdict.physics]


def test_an_error_within_the_calibrations_uncertainty_is_no_finding() -> None:
    assert named(diagnosed("delay", None)) == ["rig.delay"]
    carried = diagnosed("delay", left(DELAY))
    assert named(carried) == []
    assert "removed before the search" in carried.verdict.remarks[0]
    assert "(+1.0 sd)" in carried.verdict.remarks[0]
    limit = {entry.id: entry.above for entry in carried.verdict.detectable}
    assert limit["rig.delay"] > largest_deviation(left(DELAY)) * DELAY


def test_a_larger_error_is_found_and_said_to_be_the_calibrations() -> None:
    carried = diagnosed("delay", left(DELAY / 20))
    assert named(carried) == ["rig.delay"]
    median = carried.verdict.physics[0].parameters["delay"].median
    assert median == pytest.approx(DELAY, rel=0.02)
    said = next(remark for remark in carried.verdict.remarks if "may be an error of the calibration" in remark)
    assert "sd)" in said
    assert any("take the calibration as exact" in remark for remark in carried.verdict.remarks)


@pytest.mark.long
def test_what_the_calibration_cannot_explain_is_found_alone() -> None:
    """Alone, the rig takes up a part of the relaxation, which a search that held it there would find as a delay."""
    taken = corrected(people("relaxation", left(DELAY)))
    assert abs(taken.deviations[1]) > 0.5
    carried = diagnosed("relaxation", left(DELAY))
    assert named(carried) == ["body.relaxation"]
    assert any(remark.startswith("No error of the calibration, however large") for remark in carried.verdict.remarks)


def test_nothing_is_removed_for_an_improbable_error() -> None:
    recordings = people("delay", left(DELAY / 20))
    found = corrected(recordings)
    assert found.deviations[1] == pytest.approx(20, rel=0.05)
    assert "improbable under the calibration" in found.remarks[0]
    for own, given in zip(found.recordings.subjects, recordings.subjects, strict=True):
        np.testing.assert_array_equal(own.z, given.z)


def test_it_is_said_where_the_network_with_what_was_found_cannot_be_fitted() -> None:
    """Recordings stay as they are then, and what was found may be off by what the rig has taken of it."""
    found = corrected(people("delay", left(DELAY)))
    assert len(found.remarks) == 1
    with ThreadPoolExecutor(1) as executor:
        again = found.with_found(parse("m1|r1|n1|m_rig"), 1, executor, lambda *_: None)
    assert again.recordings is found.recordings
    assert again.remarks[0] == found.remarks[0]
    assert "could not be estimated again with what was found" in again.remarks[1]
    assert "m_rig" in again.remarks[1]


def test_what_is_removed_is_the_rig() -> None:
    """Recordings within a rig of known parameters come back, with their noise."""
    load = people(None, None)
    error = left(DELAY)
    rig = {"g_rig": 1.012, "d_rig": 1.5e-5, "m_rig": 2e-6}
    s = 2j * np.pi * FREQUENCY
    sd = 0.01 * np.abs(load.subjects[0].z)

    def seen(z: np.ndarray) -> np.ndarray:
        return np.asarray(rig["g_rig"] * np.exp(-s * rig["d_rig"]) * (z + s * rig["m_rig"]))

    kernel = Kernel(parse(error.around("r1")).holding(rig))
    np.testing.assert_allclose(kernel.impedance(np.zeros((1, 1)), FREQUENCY)[0], seen(np.ones(FREQUENCY.size)))
    subjects = [replace(one, z=seen(one.z), noise_sd=rig["g_rig"] * np.ones((2, 1)) * sd[0]) for one in load.subjects]
    found = corrected(replace(load, subjects=tuple(subjects), calibration=error))
    values = found.values
    for own, one in zip(found.recordings.subjects, load.subjects, strict=True):
        factor = values["g_rig"] * np.exp(-s * values["d_rig"])
        expected = seen(one.z) / factor - s * values["m_rig"]
        np.testing.assert_allclose(own.z, expected, rtol=1e-9)
        assert own.noise_sd is not None
        np.testing.assert_allclose(own.noise_sd[1], rig["g_rig"] / values["g_rig"] * sd[0], rtol=1e-9)
    # The gain is known from the calibration alone; delay and mass from the recordings too.
    assert values["d_rig"] == pytest.approx(rig["d_rig"], rel=0.05)


def test_deviations_are_those_of_the_calibration() -> None:
    error = left(1e-6)
    apart = deviations_of(error, {"g_rig": np.exp(0.02), "d_rig": -3e-6, "m_rig": 0.0})
    np.testing.assert_allclose(apart, [2.0, -3.0, 0.0])
    square = 4 + 9 / (1 - 0.3**2)
    assert probability_of(error, apart) == pytest.approx(_chi_square_tail(square), rel=1e-9)
    least = largest_deviation(error)
    assert probability_of(replace(error, correlation=np.eye(3)), np.array([least, 0.0, 0.0])) == pytest.approx(0.01)


def _chi_square_tail(x: float) -> float:
    """Of three degrees of freedom, in closed form."""
    return erfc(sqrt(x / 2)) + sqrt(2 * x / pi) * exp(-x / 2)


def test_a_network_that_has_the_rig_already_is_taken_out_of_it() -> None:
    recordings = people("delay", left(DELAY))
    inside = str(corrected(recordings).network)
    with ThreadPoolExecutor(1) as executor:
        network = left(DELAY).around("m1|r1|n1")
        again = without_calibration_error(recordings, network, 1, executor, lambda *_: None)
    assert str(again.network) == inside == "m1|r1|n1"


def test_one_person_has_the_calibrations_error_too() -> None:
    recordings = people("delay", left(DELAY))
    found = corrected(replace(recordings, subjects=recordings.subjects[:1]))
    assert found.values["d_rig"] == pytest.approx(DELAY, rel=0.1)
