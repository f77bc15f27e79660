"""Files that were cut: an incomplete last row is an error, a person whose frequencies end early a remark."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from datasets import HEADER, dataset
from simulated_signals import Multisine

from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.quality.checks import check_recordings
from bayes_impedance.recordings.files import read_recordings
from bayes_impedance.recordings.shorter_grid import shorter_grids

FREQUENCIES = (5, 10, 20, 40, 80, 160)


def rows(who: str, *frequencies: int) -> str:
    scale = 1 + ord(who) / 100
    return "".join(f"{who},1,{f},{scale * 2:.5f},{scale * (f * 0.02 - 60 / f):.5f}\n" for f in frequencies)


WHOLE = HEADER + "".join(rows(who, *FREQUENCIES) for who in "ABC")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (WHOLE.rstrip("\n").rpartition(",")[0], "the last row has only 4 of 5 cells"),
        (WHOLE.rstrip("\n").rpartition(",")[0] + "\n", "the last row has only 4 of 5 cells"),
        (WHOLE.rstrip("\n").rpartition(",")[0] + ",", "the last cell is empty"),
        (WHOLE.rstrip("\n")[:-5], 'the last cell is "4.'),
        (WHOLE + "C", "the last row has only 1 of 5 cells"),
    ],
)
def test_an_incomplete_last_row_is_refused(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_recordings(dataset(tmp_path, content))
    row = content.rstrip("\n").count("\n") + 1
    assert f"recordings.csv, row {row}: {words}" in str(caught.value)
    assert "the file is cut short: export or copy it again" in str(caught.value)


def test_a_last_row_without_an_end_is_read(tmp_path: Path) -> None:
    assert len(read_recordings(dataset(tmp_path, WHOLE.rstrip("\n")))) == 3
    assert read_recordings(tmp_path).warnings == ()


def test_a_person_whose_frequencies_end_early_is_remarked_on(tmp_path: Path) -> None:
    content = HEADER + rows("A", *FREQUENCIES) + rows("B", *FREQUENCIES[:4]) + rows("C", *FREQUENCIES)
    (told,) = read_recordings(dataset(tmp_path, content)).warnings
    assert 'recordings.csv, row 11: subject "B" ends here: the frequencies end at 40 Hz after 4' in told
    assert "2 others have the same and go on, 6 to 160 Hz" in told
    assert "export or copy it again" in told
    assert told in [finding.message for finding in check_recordings(read_recordings(tmp_path))]


@pytest.mark.parametrize(
    "content",
    [
        HEADER + rows("A", *FREQUENCIES) + rows("B", *FREQUENCIES[:4]),  # of two, either may be meant
        HEADER + rows("A", *FREQUENCIES) + rows("B", *FREQUENCIES[1:]) + rows("C", *FREQUENCIES),  # no first part
        HEADER + rows("A", *FREQUENCIES) + rows("B", *FREQUENCIES[:4]) + rows("C", *FREQUENCIES[:4]),  # most end there
    ],
)
def test_other_grids_are_not_remarked_on(tmp_path: Path, content: str) -> None:
    assert read_recordings(dataset(tmp_path, content)).warnings == ()


def test_files_that_go_downwards_are_cut_at_low_frequencies(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for who, count in (("A", 6), ("B", 4), ("C", 6)):
        lines = rows(who, *FREQUENCIES[::-1][:count]).splitlines()
        text = "frequency_hz,z_re,z_im\n" + "\n".join(",".join(line.split(",")[2:]) for line in lines) + "\n"
        (tmp_path / f"{who}.csv").write_text(text, encoding="utf-8")
    files = [str(tmp_path / f"{who}.csv") for who in "ABC"]
    assert main(["import", *files, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "B.csv: the frequencies end at 20 Hz after 4, where 2 others have the same and go on, 6 to 5 Hz" in said
    upwards = (tmp_path / "B.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "B.csv").write_text("\n".join([upwards[0], *upwards[:0:-1]]) + "\n", encoding="utf-8")
    assert main(["import", *files, "-o", str(tmp_path / "out")]) == 0  # a sweep that began higher was not cut


def test_frequencies_that_an_instrument_reached_are_the_same_lines() -> None:
    rng, line = np.random.default_rng(1), np.geomspace(5, 500, 20)
    grids = [(name, line * np.exp(0.01 * rng.uniform(-1, 1, 20))) for name in "ABCDE"]
    assert shorter_grids(grids) == []
    ((name, said),) = shorter_grids([*grids, ("F", grids[0][1][:13])])
    assert name == "F"
    assert "after 13, where 5 others have the same" in said
    assert shorter_grids([*grids, ("F", np.geomspace(5, 300, 13))]) == []  # other lines


def test_import_refuses_it_unless_sweeps_were_stopped(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for who, count in (("A", 6), ("B", 4), ("C", 6)):
        lines = (HEADER + rows(who, *FREQUENCIES[:count])).splitlines()
        text = "\n".join(",".join(line.split(",")[2:]) for line in lines) + "\n"
        (tmp_path / f"{who}.csv").write_text(text, encoding="utf-8")
    files = [str(tmp_path / f"{who}.csv") for who in "ABC"]
    assert main(["import", *files, "-o", str(tmp_path / "out")]) == 2
    assert "B.csv: the frequencies end at 40 Hz after 4" in capsys.readouterr().err
    assert main(["import", *files, "-o", str(tmp_path / "out"), "--stopped-sweeps"]) == 0
    said = capsys.readouterr()
    assert "B.csv: the frequencies end at 40 Hz after 4" in said.out + said.err


@pytest.mark.parametrize("downwards", [False, True])
def test_of_two_files_the_shorter_one_is_remarked_on(
    tmp_path: Path, capsys: pytest.CaptureFixture, downwards: bool
) -> None:
    order = FREQUENCIES[::-1] if downwards else FREQUENCIES
    for who, count in (("A", 6), ("B", 4)):
        lines = (HEADER + rows(who, *order[:count])).splitlines()
        text = "\n".join(",".join(line.split(",")[2:]) for line in lines) + "\n"
        (tmp_path / f"{who}.csv").write_text(text, encoding="utf-8")
    assert main(["import", str(tmp_path), "-o", str(tmp_path.parent / f"two{downwards}")]) == 0
    ends, last = (20, 5) if downwards else (40, 160)
    said = capsys.readouterr().out
    assert f"B.csv: the frequencies end at {ends} Hz after 4, where those of {tmp_path / 'A.csv'} are the same" in said
    assert f"go on, 6 to {last} Hz; if the file was cut, export or copy it again" in said


@pytest.mark.parametrize(
    ("periods", "told"),
    [
        ((6, 4), "B.npz: the signals have 4000 samples, where the other file has 6000"),
        ((6, 4, 6), "B.npz: the signals have 4000 samples, where 2 others have 6000"),
        ((6, 4, 5), None),  # stopped by hand
        ((6, 6), None),
    ],
)
def test_shorter_signals_are_remarked_on(
    tmp_path: Path, capsys: pytest.CaptureFixture, periods: tuple[int, ...], told: str | None
) -> None:
    sines = Multisine()
    for i, count in enumerate(periods):
        force, x = sines.periods(count, i, noise=1e-3)
        scale = 1 + 0.2 * i
        np.savez(tmp_path / f"{'ABC'[i]}.npz", force=scale * force.ravel(), x=x.ravel(), fs=sines.rate_hz)
    channels = ["--force", "force[N]", "--motion", "x[m]"]
    assert main(["import", str(tmp_path), "-o", str(tmp_path.parent / "signals_out"), *channels, "--overwrite"]) == 0
    said = capsys.readouterr().out
    assert (told in said) if told else ("samples, where" not in said)


@pytest.mark.parametrize(
    ("left_out", "words"),
    [
        (2, 'subject "F", repetition "3": the frequencies end at 40 Hz after 4, where 17 others'),
        (6, 'subject "F" of the table has 2 of the 3 repetitions that all others have'),
        (13, 'subject "F", repetition "1": the frequencies end at'),
        (18, ""),
    ],
)
def test_one_table_of_many_that_was_cut_between_its_rows(
    left_out: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where a whole subject is missing nothing says so."""
    rng = np.random.default_rng(1)
    table = [
        f"{who},{j},{f},{rng.normal(2 + ord(who) / 9, 0.01):.5f},{rng.normal(f * 0.02 - 60 / f, 0.01):.5f}\n"
        for who in "ABCDEF"
        for j in (1, 2, 3)
        for f in FREQUENCIES
    ]
    file = tmp_path / "a.csv"
    file.write_text(HEADER + "".join(table[:-left_out]), encoding="utf-8")
    status = main(["import", str(file), "-o", str(tmp_path / "out")])
    told = capsys.readouterr()
    assert status == (2 if "frequencies end" in words else 0)
    assert words in told.err + told.out
    assert ("cut" in told.err + told.out) is bool(words)
