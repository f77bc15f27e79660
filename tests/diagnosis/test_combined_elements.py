"""What was found has an element beside one of its kind in the network: only their combination can be determined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import THREE_ELEMENTS

from bayes_impedance.diagnosis import diagnose, registered
from bayes_impedance.population.simulate import simulate_recordings

PEOPLE = replace(THREE_ELEMENTS, between_repetitions={})


@pytest.mark.long
def test_a_bypass_beside_a_damper_ends_with_a_remark() -> None:
    """A second path to ground has a spring and a damper; the network has a damper there and lacks the spring.

    The posterior of the extended network is that of the sum of both dampers, and was asked for each.
    """
    bypass = [e for e in registered() if e.id == "body.bypass" and e.operation == "bypass"]
    recordings = simulate_recordings(PEOPLE, 8, 1, np.geomspace(20, 2000, 24), seed=3).recordings
    diagnosis = diagnose(recordings, "m1|r1", effects=bypass, seed=1, workers=1)
    assert [entry.id for entry in diagnosis.verdict.physics] == ["body.bypass"]
    (said,) = (remark for remark in diagnosis.verdict.remarks if "determine only" in remark)
    assert "r1 + r2" in said
    assert "Laplace's approximation" in said
    assert diagnosis.fit is not None
    assert "r1_r2" in diagnosis.fit.kernel.elements
    stiffness = diagnosis.verdict.physics[0].parameters["stiffness"].median
    assert np.isclose(stiffness, 1 / PEOPLE.central["n1"], rtol=0.2)


def test_of_a_bypass_beside_a_damper_only_the_spring_is_found() -> None:
    recordings = simulate_recordings(PEOPLE, 8, 1, np.geomspace(20, 2000, 24), seed=3).recordings
    bypass = [effect for effect in registered() if effect.id == "body.bypass"]
    diagnosis = diagnose(recordings, "m1|r1", effects=bypass, seed=1, workers=1, quick=True)
    (entry,) = diagnosis.verdict.physics
    assert list(entry.parameters) == ["stiffness"]
    assert not any("determine only" in remark for remark in diagnosis.verdict.remarks)
    assert np.isclose(entry.parameters["stiffness"].median, 1 / PEOPLE.central["n1"], rtol=0.2)
