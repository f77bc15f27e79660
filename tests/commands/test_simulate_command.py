"""The job behind ``simulate``: recordings and their truth, the same again from the same seed, refused options."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_impedance.commands.simulate import SPECTRA, TRUTH_FILE, simulate_dataset
from bayes_impedance.errors import InputError
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import read_recordings

BAND = (5.0, 500.0)
USUAL: dict[str, Any] = {
    "population": None,
    "n_subjects": 3,
    "n_repetitions": 2,
    "n_points": 11,
    "band_hz": BAND,
    "noise": None,
    "seed": 4,
}


def simulated(out: Path, **changes: Any) -> list[str]:
    return simulate_dataset(out, **USUAL | changes)


def test_the_recordings_are_those_of_the_population(tmp_path: Path) -> None:
    lines = simulated(tmp_path / "out")
    frequency = np.geomspace(*BAND, 11)
    expected = simulate_recordings(FINGERTIP, 3, 2, frequency, 4)
    found = read_recordings(tmp_path / "out").in_memory()
    assert found.names == expected.recordings.names
    for one, other in zip(found.subjects, expected.recordings.subjects, strict=True):
        np.testing.assert_allclose(one.frequency_hz, frequency, rtol=1e-5)
        np.testing.assert_allclose(one.z, other.z, rtol=2e-5)  # six digits of each part
    truth = json.loads((tmp_path / "out" / TRUTH_FILE).read_text(encoding="utf-8"))
    assert truth == json.loads(json.dumps(expected.truth))
    assert lines == [f"3 virtual subjects in {tmp_path / 'out'}, the truth in {tmp_path / 'out' / TRUTH_FILE}"]


def test_numbers_that_are_not_given_are_the_usual_ones(tmp_path: Path) -> None:
    """The paper's numbers of subjects and frequencies."""
    simulated(tmp_path, n_subjects=None, n_points=None, n_repetitions=1)
    found = read_recordings(tmp_path)
    assert (len(found), found.subjects[0].frequency_hz.size) == SPECTRA == (71, 401)


def test_the_truth_of_a_simulation_is_a_population(tmp_path: Path) -> None:
    """Its dispersions include the contact force, whose exponents are zero then: from there on nothing changes."""
    simulated(tmp_path / "first")
    simulated(tmp_path / "second", population=tmp_path / "first" / TRUTH_FILE)
    simulated(tmp_path / "third", population=tmp_path / "second" / TRUTH_FILE)
    first, second, third = (json.loads((tmp_path / n / TRUTH_FILE).read_text()) for n in ("first", "second", "third"))
    for name, element in first["elements"].items():
        assert second["elements"][name] == pytest.approx(element | {"contact_force_exponent": 0.0})
        assert third["elements"][name] == pytest.approx(second["elements"][name])
    one, other = (read_recordings(tmp_path / name).in_memory() for name in ("second", "third"))
    for a, b in zip(one.subjects, other.subjects, strict=True):
        np.testing.assert_allclose(a.z, b.z, rtol=2e-5)


def test_noise_replaces_that_of_the_population(tmp_path: Path) -> None:
    """Without it, each repetition is that of the elements alone; with it, they differ by about so much."""
    truth = simulate_recordings(replace(FINGERTIP, noise=1e-9), 3, 2, np.geomspace(*BAND, 11), 4).recordings
    simulated(tmp_path, noise=1e-9)
    for a, b in zip(read_recordings(tmp_path).in_memory().subjects, truth.subjects, strict=True):
        np.testing.assert_allclose(a.z, b.z, rtol=2e-5)
    assert json.loads((tmp_path / TRUTH_FILE).read_text(encoding="utf-8"))["noise"]["relative_sd"] == 1e-9


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"band_hz": (10.0, 5.0)}, "give 0 < low < high and at least 3 points"),
        ({"band_hz": (0.0, 5.0)}, "give 0 < low < high"),
        ({"n_points": 2}, "with 2 points"),
        ({"signals": True, "noise": 0.01}, "leave one of them out"),
        ({"n_repetitions": 0}, "at least one subject and one repetition"),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_anything_is_written(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        simulated(tmp_path / "out", **changes)
    assert not (tmp_path / "out").exists()


def test_a_user_s_dataset_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text("title = 'mine'", encoding="utf-8")
    with pytest.raises(InputError, match="was not written by this package"):
        simulated(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["dataset.toml"]
    simulated(tmp_path, overwrite=True)
    assert len(read_recordings(tmp_path)) == 3
    simulated(tmp_path, n_subjects=4)  # it is ours now
    assert len(read_recordings(tmp_path)) == 4
