"""Columns of text among covariates are categories or left out with a word; without repetitions everybody has one."""

from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.diagnosis import search_covariates
from bayes_impedance.errors import InputError
from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.recordings import Recordings, read_recordings, write_recordings
from bayes_impedance.recordings.categories import indicators_of, is_categorical

PEOPLE = ("A", "B", "C", "D", "E", "F")
ROWS = "".join(f"{who},{f},1.5,0.5\n" for who in PEOPLE for f in (10, 20, 40))


def read(folder: Path, column: str, cells: tuple[str, ...]) -> Recordings:
    (folder / "recordings.csv").write_text("subject,frequency_hz,z_re,z_im\n" + ROWS, encoding="utf-8")
    table = "".join(f"{who},{i},{cell}\n" for i, (who, cell) in enumerate(zip(PEOPLE, cells, strict=True)))
    (folder / "subjects.csv").write_text(f"subject,age_y,{column}\n" + table, encoding="utf-8")
    return read_recordings(folder)


def test_without_repetitions_everybody_was_measured_once(tmp_path: Path) -> None:
    recordings = read(tmp_path, "x", ("1",) * 6)
    assert [subject.repetitions for subject in recordings.subjects] == [("1",)] * 6
    (tmp_path / "recordings.csv").write_text("subject,frequency_hz,z_re,z_im\n" + ROWS + "A,10,2,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r'10 Hz was already given in row 2.*subject "A"'):
        read_recordings(tmp_path)


def test_a_column_of_words_is_a_category(tmp_path: Path) -> None:
    recordings = read(tmp_path, "hand", ("right", "left", "left", "", "right", "right"))
    values = [subject.covariates["hand=right"] for subject in recordings.subjects]
    np.testing.assert_array_equal(values, [1, 0, 0, np.nan, 1, 1])
    assert set(recordings.subjects[0].covariates) == {"age_y", "hand=right"}
    (said,) = (w for w in recordings.warnings if "category" in w)
    assert 'hand=right (1 if so) against "left"' in said
    again = read_recordings(write_recordings(recordings, tmp_path / "again"))
    assert again.subjects[4].covariates == recordings.subjects[4].covariates


def test_three_values_are_two_differences_from_the_first() -> None:
    cells = np.array(["c", " b", "a", "a", "b", "c", "n/a", "c"], dtype=object)
    assert is_categorical(cells)
    found, said = indicators_of("x", cells)
    np.testing.assert_array_equal(found["x=b"], [0, 1, 0, 0, 1, 0, np.nan, 0])
    np.testing.assert_array_equal(found["x=c"], [1, 0, 0, 0, 0, 1, np.nan, 1])
    assert said == 'x is text, and used as category: x=b and x=c (1 if so) against "a"'


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        (("Ann", "Bob", "Cat", "Dan", "Eve", "Fay"), "6 different values for 6 subjects"),
        (("yes",) * 6, '"yes" for all subjects'),
        (("see log", "", "", "", "", ""), '"see log" for all subjects'),
    ],
)
def test_what_is_no_category_is_left_out_with_a_word(tmp_path: Path, cells: tuple[str, ...], said: str) -> None:
    recordings = read(tmp_path, "remark", cells)
    assert set(recordings.subjects[0].covariates) == {"age_y"}
    assert any(said in warning and "is not used" in warning for warning in recordings.warnings)


@pytest.mark.parametrize("cells", [("1", "2", "3", "x", "y", "4"), ("1", "2", "3o", "4", "5", "6")])
def test_a_word_among_numbers_is_a_mistake(tmp_path: Path, cells: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="which is not a number"):
        read(tmp_path, "force_n", cells)


def test_decimal_commas_are_no_words(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="decimal comma"):
        read(tmp_path, "force_n", ('"1,5"',) * 3 + ('"2,5"',) * 3)


@pytest.mark.parametrize(
    ("cells", "kept"),
    [
        (("20 kg", "21 kg", "22 kg", "23 kg", "24 kg", "25 kg"), False),
        (("20 kg", "20 kg", "20 kg", "25 kg", "25 kg", "25 kg"), True),
    ],
)
def test_numbers_with_a_unit_are_pointed_out(tmp_path: Path, cells: tuple[str, ...], kept: bool) -> None:
    """They are text, and what they mean would be lost, or be two groups, without this word."""
    recordings = read(tmp_path, "mass", cells)
    assert ("mass=25 kg" in recordings.subjects[0].covariates) == kept
    (said,) = recordings.warnings
    assert said.endswith('all its cells are numbers with "kg" behind them: leave that out, and it is a number')


def test_why_a_column_is_no_covariate_is_said_where_one_is_asked_for(tmp_path: Path) -> None:
    recordings = read(tmp_path, "mass", ("20 kg", "21 kg", "22 kg", "23 kg", "24 kg", "25 kg"))
    with pytest.raises(InputError, match=r'"mass" cannot be used: .*subjects.csv: mass is text .*numbers with "kg"'):
        standardised_covariates(recordings, ("mass",))
    with pytest.raises(InputError, match=r'"weight" is not in the dataset'):
        standardised_covariates(recordings, ("weight",))
    only = (tmp_path / "subjects.csv").read_text(encoding="utf-8").splitlines()
    without = [",".join(cell for k, cell in enumerate(line.split(",")) if k != 1) for line in only]
    (tmp_path / "subjects.csv").write_text("\n".join(without) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"no covariates: .*subjects.csv: mass is text"):
        search_covariates(read_recordings(tmp_path), "r1")
