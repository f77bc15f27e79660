"""Recordings and subjects in memory: means, selection, checks of their arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from datasets import recordings, subject

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import Subject, write_recordings


def test_mean_and_select() -> None:
    data = recordings(subject("A"), subject("B", 1), subject("C", 4))
    np.testing.assert_allclose(data.subjects[0].mean.real, 0.5)
    assert data.repetitions_max == 4
    assert data.select(["C", "A"]).names == ("C", "A")
    assert data.select(["C"]).title == "Title"
    with pytest.raises(InputError, match='subject "D" is not among the 3'):
        data.select(["D"])
    with pytest.raises(InputError, match="selected twice"):
        data.select(["A", "A"])


def test_select_suggests() -> None:
    with pytest.raises(InputError, match='did you mean "S12"'):
        recordings(subject("S12"), subject("X")).select(["S13"])


def test_no_subjects(tmp_path: Path) -> None:
    none = recordings()
    assert len(none) == none.repetitions_max == 0
    with pytest.raises(InputError, match="no subjects to write"):
        write_recordings(none, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": ""}, "must not be empty"),
        ({"name": " A"}, "padded"),
        ({"repetitions": ("1", "a\nb")}, "control characters"),
        ({"repetitions": ("1", "1")}, "same name"),
        ({"repetitions": ("1",)}, "z has shape"),
        ({"frequency_hz": np.array([1.0, 3.0, 2.0, 4.0, 5.0])}, "ascend"),
        ({"frequency_hz": np.arange(5.0)}, "above zero"),
        ({"frequency_hz": np.ones((5, 1))}, "must have shape"),
        ({"noise_sd": np.ones((1, 5))}, "noise_sd has shape"),
    ],
)
def test_subject_checks_itself(change: dict[str, object], words: str) -> None:
    good = subject()
    with pytest.raises(ValueError, match=words):
        Subject(**{"name": "A", "frequency_hz": good.frequency_hz, "z": good.z, "repetitions": ("1", "2"), **change})  # type: ignore[arg-type]


def test_two_subjects_of_one_name() -> None:
    with pytest.raises(ValueError, match="same name"):
        recordings(subject(), subject())
