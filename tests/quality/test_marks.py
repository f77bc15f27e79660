"""Marks for missing values, and what was left aside on reading, are findings of the check."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from datasets import GOOD, dataset
from faulty_recordings import change, only, simulate, warnings

from bayes_impedance.quality.checks import check_recordings
from bayes_impedance.quality.marks import marks
from bayes_impedance.recordings.files import read_recordings


@pytest.mark.parametrize("value", [0, 9999, -999, 9999 + 9999j, 99999j, 1e38, 1e38 + 1e38j, 3.4028235e38, 32767])
@pytest.mark.parametrize("count", [1, 2, 25])
def test_what_programs_write_for_no_value_is_pointed_at(value: complex, count: int) -> None:
    def edit(z: np.ndarray) -> None:
        z[1, 60 : 60 + count] = value

    finding = only(change(simulate(), 3, edit), "mark")
    assert (finding.subject, finding.repetition) == ("S03", "2")
    assert f"{count} point" in finding.message
    assert "leave the cells empty" in finding.message


@pytest.mark.parametrize("part", ["real", "imag"])
def test_a_mark_in_one_column_only(part: str) -> None:
    def edit(z: np.ndarray) -> None:
        getattr(z, part)[1, 20:30] = 0.0

    finding = only(change(simulate(), 3, edit), "mark")
    assert finding.message.startswith("Re z is exactly 0" if part == "real" else "Im z is exactly 0")


def test_a_stuck_number_counts_if_it_repeats_and_once_is_an_outlier() -> None:
    def stuck(z: np.ndarray) -> None:
        z[0, 50:54] = 47.11 - 3j

    def once(z: np.ndarray) -> None:
        z[0, 50] = 47.11 - 3j

    assert "47.11-3j" in only(change(simulate(), 3, stuck), "mark").message
    assert only(change(simulate(), 3, once), "outlier").subject == "S03"


def test_a_magnitude_with_any_phase_is_a_mark() -> None:
    def edit(z: np.ndarray) -> None:
        z[0, 50:53] = 7777.0 * np.exp(1j * np.array([0.1, 0.4, -0.7]))

    assert "|z| is exactly 7777" in only(change(simulate(), 3, edit), "mark").message


def test_a_constant_recording_is_a_mark() -> None:
    def edit(z: np.ndarray) -> None:
        z[2] = 4.0

    assert [finding.id for finding in warnings(change(simulate(subjects=3), 1, edit))].count("mark") == 1


def test_recordings_of_few_digits_have_no_marks() -> None:
    data = simulate(subjects=6)
    coarse = tuple(
        replace(s, z=np.round(s.z.real, 1) + 1j * np.round(s.z.imag, 1)) for s in simulate(subjects=6, seed=4).subjects
    )
    assert not marks(data.subjects)[0]
    # Rounded to 0.1, thousands of numbers repeat; all are where the curve is.
    assert not marks(coarse)[0]


def test_what_was_left_aside_on_reading_is_a_finding(tmp_path: Path) -> None:
    folder = dataset(tmp_path, GOOD.replace("\nB,1,10", "\nA,1,40,1.3,\nB,1,10"), toml='networc = "m1|r1"\n')
    found = {finding.id: finding.message for finding in check_recordings(read_recordings(folder))}
    told = [finding.message for finding in check_recordings(read_recordings(folder)) if finding.id == "reading"]
    assert any("1 of 7 rows have no finite value" in message for message in told)
    assert any('key "networc" is not used; did you mean "network"?' in message for message in told)
    assert "network" not in found


def test_a_network_that_cannot_be_read_is_a_finding(tmp_path: Path) -> None:
    data = read_recordings(dataset(tmp_path, toml='network = "m1||r1"\n'))
    assert "character 4" in next(f.message for f in check_recordings(data) if f.id == "network")
