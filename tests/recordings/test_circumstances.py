"""repetitions.csv: read with the recordings, written back, refused in one sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.recordings.circumstances import circumstances_csv, sweep_direction, sweep_directions
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.files import read_recordings, write_recordings

ROWS = "subject,repetition,frequency_hz,z_re,z_im\n" + "".join(
    f"{subject},{repetition},{f},{1 + f / 100},{f / 10}\n"
    for subject in ("A", "B", "C", "D")
    for repetition in ("1", "2")
    for f in (10, 20, 30, 40)
)
NOTED = "subject,repetition,force_n,sweep\n" + "".join(
    f"{subject},{repetition},{force},{'up' if repetition == 1 else 'down'}\n"
    for subject, force in (("A", 1.5), ("B", 2.5), ("C", ""), ("D", 0.5))
    for repetition in (1, 2)
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "recordings.csv").write_text(ROWS)
    (tmp_path / "repetitions.csv").write_text(NOTED)
    return tmp_path


def test_circumstances_are_of_each_repetition(folder: Path) -> None:
    recordings = read_recordings(folder)
    assert [s.circumstances["force_n"].tolist() for s in recordings.subjects[:2]] == [[1.5, 1.5], [2.5, 2.5]]
    assert np.isnan(recordings.subjects[2].circumstances["force_n"]).all()
    assert recordings.subjects[0].circumstances["sweep=up"].tolist() == [1.0, 0.0]
    said = " / ".join(recordings.warnings)
    assert "force_n is missing for 2 of 8 repetitions, the first in row 6" in said
    assert "sweep is text, and used as category: sweep=up (1 if so) against" in said


def test_they_belong_to_the_digest_of_the_data_and_stay_with_parts_of_them(folder: Path) -> None:
    with_them = read_recordings(folder)
    (folder / "repetitions.csv").unlink()
    without = read_recordings(folder)
    assert without.sha256 != with_them.sha256
    assert without.subjects[0].circumstances == {}
    part = with_them.select(["B"]).subjects[0].at(np.array([0, 1, 2]))
    assert part.circumstances["force_n"].tolist() == [2.5, 2.5]


def test_written_they_are_read_back_and_a_dataset_without_has_no_table(folder: Path, tmp_path: Path) -> None:
    recordings = read_recordings(folder)
    again = read_recordings(write_recordings(recordings, tmp_path / "again"))
    for one, other in zip(recordings.subjects, again.subjects, strict=True):
        assert one.circumstances.keys() == other.circumstances.keys()
        for name, values in one.circumstances.items():
            np.testing.assert_array_equal(other.circumstances[name], values)
    bare = replace(recordings, subjects=tuple(replace(s, circumstances={}) for s in recordings.subjects))
    write_recordings(bare, tmp_path / "again")
    assert not (tmp_path / "again" / "repetitions.csv").exists()
    assert circumstances_csv(bare.subjects) is None


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (NOTED.replace("repetition", "trial"), 'row 1: column "repetition" is missing'),
        (NOTED.replace("B,1,", "A,1,"), 'row 4: subject "A", repetition "1" appears twice (first in row 2)'),
        (NOTED.replace("B,1,2.5", "B,1,2;5"), 'row 4: force_n is "2;5", which is not a number'),
        (NOTED.replace("B,1,2.5", "B,,2.5"), "row 4: repetition is empty"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_row(
    folder: Path, table: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "repetitions.csv").write_text(table)
    with pytest.raises(InputError) as refused:
        read_recordings(folder)
    assert said in str(refused.value)
    assert main(["check", str(folder)]) == 2
    assert said in capsys.readouterr().err


def test_rows_without_recordings_and_recordings_without_a_row_are_said(folder: Path) -> None:
    (folder / "repetitions.csv").write_text(NOTED.replace("D,2,0.5,down", "E,1,0.5,down"))
    recordings = read_recordings(folder)
    said = " / ".join(recordings.warnings)
    assert 'there are no recordings of subject "E", repetition "1"' in said
    assert 'has no row for subject "D", repetition "2"' in said
    assert np.isnan(recordings.subjects[3].circumstances["force_n"][1])


def test_how_the_impedance_was_estimated_is_no_circumstance(folder: Path) -> None:
    (folder / "repetitions.csv").write_text(NOTED.replace("force_n", "noise_degrees_of_freedom"))
    assert list(read_recordings(folder).subjects[0].circumstances) == ["sweep=up"]


def test_values_are_one_for_each_repetition() -> None:
    with pytest.raises(ValueError, match="force_n has shape"):
        Subject(
            name="A",
            frequency_hz=np.array([1.0, 2.0, 3.0]),
            z=np.ones((2, 3), dtype=complex),
            repetitions=("1", "2"),
            circumstances={"force_n": np.ones(3)},
        )


@pytest.mark.parametrize(
    ("name", "direction"),
    [
        ("sweep_direction=up", "up"),
        ("SweepDirection=descending", "down"),
        ("direction of sweep=Downwards", "down"),
        ("sweep=rising", "up"),
        ("sweep=chirp", None),
        ("excitation=up", None),
        ("sweep_direction", None),
    ],
)
def test_directions_of_sweeps_are_recognised(name: str, direction: str | None) -> None:
    assert sweep_direction(name) == direction


@pytest.mark.parametrize("words", [("up", "down"), ("down", "down"), ("ascending", "ascending")])
def test_directions_of_sweeps_are_kept(words: tuple[str, str], folder: Path) -> None:
    """Also where all have the same, which is no category."""
    rows = "".join(f"{subject},{k + 1},{words[k]}\n" for subject in "ABCD" for k in range(2))
    (folder / "repetitions.csv").write_text(f"subject,repetition,sweep_direction\n{rows}")
    recordings = read_recordings(folder)
    expected = {"down" if word == "down" else "up" for word in words}
    assert sweep_directions(recordings.subjects) == expected
    assert not any("not used" in warning for warning in recordings.warnings)
    again = read_recordings(write_recordings(recordings, folder / "again"))
    assert sweep_directions(again.subjects) == expected
