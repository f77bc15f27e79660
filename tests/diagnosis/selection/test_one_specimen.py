"""One person or one specimen: several things missing are named, from the right valley, and nothing beside them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.diagnosis.diagnose import Diagnosis, diagnose
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.files import Recordings, Subject, read_recordings

CELL = "r0|(r1-n1)|(r2-n2)"
CELL_VALUES = {"r0": 0.015, "r1": 0.01, "n1": 0.5, "r2": 0.02, "n2": 20.0}
FINGER = "(n3|r3)-(m2|r1|n1|(m1-(n2|r2)))"
FINGER_VALUES = {
    "n3": 8.4e-7, "r3": 46.5, "m2": 8.3e-4, "r1": 1.27, "n1": 9.9e-4, "m1": 0.035, "n2": 6.2e-3, "r2": 2.97
}  # fmt: skip


def one(claimed: str, network: str, values: dict[str, float], frequency: np.ndarray, repetitions: int) -> Recordings:
    """Recordings of one specimen, with noise of 0.3 %; elements of the claimed network change by 3 % in between."""
    kernel, rng = Kernel(parse(network)), np.random.default_rng(9)
    theta = np.array([float(p.u(values[p.name])) for p in kernel.parameters])
    changes = np.array([p.name in parse(claimed).elements for p in kernel.parameters]) * (repetitions > 1)
    z = kernel.impedance(theta + 0.03 * changes * rng.normal(size=(repetitions, theta.size)), frequency)
    z = z * (1 + 0.003 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)) / np.sqrt(2))
    names = tuple(str(j + 1) for j in range(repetitions))
    subject = Subject(name="a", repetitions=names, frequency_hz=frequency, z=z, noise_sd=None)
    return Recordings(subjects=(subject,), title=None, unit="N s/m", network=claimed, source=None, licence=None)


def named(diagnosis: Diagnosis) -> list[str]:
    return sorted(entry.id for entry in diagnosis.verdict.physics)


def test_the_right_valley_lies_far_from_that_of_the_network() -> None:
    """Without the springpot the skin seems two hundred times as compliant; from there its fit never arrives."""
    values = FINGER_VALUES | {"p9": 1.4, "a9": 0.44}
    data = one(FINGER, "(n3|r3)-(m2|r1|n1|(m1-(n2|r2))|p9^a9@50)", values, np.geomspace(5, 2000, 60), 3)
    diagnosis = diagnose(data, quick=True)
    assert named(diagnosis) == ["body.springpot"]
    (entry,) = diagnosis.verdict.physics
    assert entry.parameters["exponent"].median == pytest.approx(0.44, abs=0.03)


def test_an_inductance_and_two_power_laws_of_one_spectrum_are_named() -> None:
    """The inductance of the leads is seen at the upper end of the band alone, which cannot be held out."""
    network = "r0|(r1-p1^a1@200)|(r2-p2^a2@0.5)|m9"
    values = {"r0": 0.015, "r1": 0.01, "p1": 0.006, "a1": 0.25, "r2": 0.02, "p2": 0.012, "a2": 0.3, "m9": 2e-7}
    diagnosis = diagnose(one(CELL, network, values, np.geomspace(0.01, 10000, 80), 1), quick=True)
    names = named(diagnosis)
    assert names.count("body.springpot") == 2
    inductance = [e for e in diagnosis.verdict.physics if e.id != "body.springpot"]
    assert len(inductance) == 1
    assert {"rig.mass", "body.mass"} & {inductance[0].id, *(a.id for a in inductance[0].aliases)}
    assert diagnosis.after is not None
    assert np.median(diagnosis.after.subject_rms_relative) < 0.005


def test_nothing_is_named_where_nothing_is_missing() -> None:
    diagnosis = diagnose(one(CELL, CELL, CELL_VALUES, np.geomspace(0.01, 10000, 80), 1), quick=True)
    assert not diagnosis.verdict.mismatch


@pytest.mark.skipif("BAYES_IMPEDANCE_REAL_DATA" not in os.environ, reason="needs the real recordings")
def test_a_real_fuel_cell() -> None:
    """Two RC arcs leave 15 %. Its leads have an inductance, and its arcs are power laws."""
    diagnosis = diagnose(read_recordings(Path(os.environ["BAYES_IMPEDANCE_REAL_DATA"]) / "fuel_cell_1"), quick=True)
    names = named(diagnosis)
    assert names.count("body.springpot") == 2
    assert {"rig.mass", "rig.delay"} & set(names)
    assert diagnosis.after is not None
    assert np.median(diagnosis.after.subject_rms_relative) < 0.02
