"""One person or one specimen: what is missing is named from the right valley, and nothing beside it."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.diagnosis.diagnose import Diagnosis, diagnose
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.files import Recordings, Subject

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


def test_nothing_is_named_where_nothing_is_missing() -> None:
    diagnosis = diagnose(one(CELL, CELL, CELL_VALUES, np.geomspace(0.01, 10000, 80), 1), quick=True)
    assert not diagnosis.verdict.mismatch
