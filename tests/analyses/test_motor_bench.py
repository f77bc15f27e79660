"""The motor bench: recordings from raw signals, and the low-pass of the velocity channel with the lag beside it."""

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA

from bayes_impedance.diagnosis.diagnose import diagnose
from bayes_impedance.quality.checks import check_recordings
from bayes_impedance.recordings.files import read_recordings, write_recordings

sys.path.insert(0, str(DATA.parent / "analyses" / "motor_bench"))  # as when the scripts are run
signals = importlib.import_module("bench_signals")

MEASURED_HZ = 20.39
"""Corner of the velocity channel over the differentiated encoder."""


def _made(folder: Path, kind: str, channel: str) -> Any:
    return signals.recordings_of(folder / "motor_bench" / f"MultisineType{kind}.mat", channel)


def _found(*data: Any) -> dict[str, float]:
    verdict = diagnose(data[0], simulation=data[1] if len(data) > 1 else None, quick=True).verdict
    return {
        entry.id: entry.parameters["corner" if "corner" in entry.parameters else "delay"].median
        for entry in verdict.physics
        if entry.kind == "effect"
    }


@pytest.mark.parametrize(("kind", "lines"), [("A", 240), ("B", 60)])
def test_both_channels_are_one_load_behind_a_low_pass(real_data: Path, kind: str, lines: int) -> None:
    one, other = (signals.averaged(_made(real_data, kind, channel)).subjects[0] for channel in signals.CHANNELS)
    assert one.z.shape == (1, lines)
    ratio = one.z[0] / other.z[0] / (1 + 1j * one.frequency_hz / MEASURED_HZ)
    np.testing.assert_allclose(ratio, 1, atol=0.03)


def test_a_drift_of_the_angle_does_not_leak(real_data: Path) -> None:
    """Periods agree, except for a few that were disturbed."""
    subject = _made(real_data, "A", "encoder").subjects[0]
    centre = np.median(subject.z.real, axis=0) + 1j * np.median(subject.z.imag, axis=0)
    away = np.median(np.abs(subject.z / centre - 1), axis=1)
    assert np.median(away) < 0.008
    assert subject.noise_sd is not None
    assert np.corrcoef(np.log(away), np.log(np.median(subject.noise_sd / np.abs(centre), axis=1)))[0, 1] > 0.8


@pytest.mark.parametrize("channel", ["velocity", "encoder"])
@pytest.mark.parametrize("kind", ["A", "B"])
def test_the_recordings_are_read_and_explained(real_data: Path, tmp_path: Path, kind: str, channel: str) -> None:
    data = read_recordings(write_recordings(_made(real_data, kind, channel), tmp_path))
    assert (data.subjects[0].z.real < 0).mean() > (0.85 if channel == "velocity" else 0.6)
    (text,) = [f.message for f in check_recordings(data) if f.id == "not_passive"]
    assert "so that the sign is right" in text
    assert "bayes-impedance diagnose" in text


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.parametrize("average", [False, True])
@pytest.mark.parametrize("kind", ["A", "B"])
def test_the_low_pass_is_named_with_the_lag_beside_it(real_data: Path, kind: str, average: bool) -> None:
    data = _made(real_data, kind, "velocity")
    found = _found(signals.averaged(data) if average else data)
    assert set(found) == {"rig.lowpass", "rig.delay"}
    # The mean's noise is 0.05 % while its lines scatter by 5 %, by friction: 3 % of the corner remain uncertain.
    assert -found["rig.lowpass"] == pytest.approx(MEASURED_HZ, rel=0.035 if average else 0.025)
    assert found["rig.delay"] == pytest.approx(-1.06e-4, rel=0.1)


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.parametrize("kind", ["A", "B"])
def test_against_the_encoder_the_low_pass_alone_is_named(real_data: Path, kind: str) -> None:
    found = _found(*(_made(real_data, kind, channel) for channel in signals.CHANNELS))
    assert set(found) == {"rig.lowpass"}
    assert -found["rig.lowpass"] == pytest.approx(MEASURED_HZ, abs=0.1)
