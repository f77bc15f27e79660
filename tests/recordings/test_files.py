"""Reading datasets: what is accepted, and what is accepted with a warning."""

from __future__ import annotations

import gzip
import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from datasets import GOOD, HEADER, POLAR, assert_same, dataset, recordings, subject

from bayes_impedance.recordings import csv_table
from bayes_impedance.recordings.files import read_recordings, write_recordings

# What is read


def test_reads_folder_without_description(tmp_path: Path) -> None:
    data = read_recordings(dataset(tmp_path))
    assert data.names == ("A", "B")
    assert len(data) == 2
    assert (data.title, data.unit, data.network, data.warnings) == (tmp_path.name, "N s/m", None, ())
    assert data.repetitions_max == 1
    np.testing.assert_array_equal(data.subjects[1].z, [[2.0 - 0.5j, 2.1 + 0.5j, 2.2 + 1j]])
    assert data.subjects[0].noise_sd is None
    assert not data.polar


def test_reads_polar(tmp_path: Path) -> None:
    data = read_recordings(dataset(tmp_path, POLAR))
    np.testing.assert_allclose(data.subjects[0].z[0], [2j, 3, 2 - 2j * np.sqrt(3)], atol=1e-15)
    assert data.polar


def test_reads_description(tmp_path: Path) -> None:
    toml = 'title = "T"\nunit = "kg/s"\nsign = "passive positive"\nnetwork = "r1"\nsource = "S"\nlicence = "L"\n'
    data = read_recordings(dataset(tmp_path, toml=toml))
    assert (data.title, data.unit, data.network, data.source, data.licence) == ("T", "N s/m", "r1", "S", "L")
    assert data.warnings == ()


@pytest.mark.parametrize("name", ["one.csv", "one.csv.gz", "recordings.csv"])
def test_reads_one_file(tmp_path: Path, name: str) -> None:
    content = GOOD.encode()
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    data = read_recordings(str(tmp_path / name))
    assert data.names == ("A", "B")
    assert data.title == (tmp_path.name if name == "recordings.csv" else "one")
    assert data.sha256 == hashlib.sha256(content).hexdigest()


def test_recordings_csv_stands_for_its_folder(tmp_path: Path) -> None:
    dataset(tmp_path, toml='unit = "ohm"')
    assert read_recordings(tmp_path / "recordings.csv").unit == "ohm"


def test_other_file_is_not_described_by_its_folder(tmp_path: Path) -> None:
    dataset(tmp_path, toml='unit = "ohm"').joinpath("other.csv").write_text(GOOD)
    assert read_recordings(tmp_path / "other.csv").unit == "N s/m"


def test_digest_covers_all_files(tmp_path: Path) -> None:
    covariates, toml = "subject,age_y\nA,30\nB,40\n", 'title = "T"\n'
    data = read_recordings(dataset(tmp_path, subjects=covariates, toml=toml))
    assert data.sha256 == hashlib.sha256((GOOD + covariates + toml).encode()).hexdigest()


def test_names_stay_text(tmp_path: Path) -> None:
    text = HEADER + "".join(f"{s},{r},{f},1,0\n" for s in ("007", "NA", "1e3") for r in ("01", "1") for f in (1, 2, 3))
    data = read_recordings(dataset(tmp_path, text))
    assert data.names == ("007", "NA", "1e3")
    assert data.subjects[0].repetitions == ("01", "1")


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + GOOD,
        GOOD.replace("\n", "\r\n"),
        GOOD.replace(HEADER, " Subject , REPETITION, frequency_hz ,z_re,\tz_im \n"),
        GOOD.replace("A,1", " A , 1"),
        GOOD.replace("B,1,10", "\nB,1,10") + "\n\n,,,,\n",
        GOOD.replace("A,", '"A",'),
        GOOD.rstrip("\n"),
    ],
    ids=["bom", "crlf", "header", "padding", "blank_rows", "quotes", "no_newline"],
)
def test_harmless_variants(tmp_path: Path, text: str) -> None:
    data = read_recordings(dataset(tmp_path, text))
    assert data.names == ("A", "B")
    np.testing.assert_array_equal(data.subjects[1].z, [[2.0 - 0.5j, 2.1 + 0.5j, 2.2 + 1j]])
    assert data.warnings == ()


def test_subjects_may_be_interleaved_and_on_different_grids(tmp_path: Path) -> None:
    rows = [f"{s},1,{f * (2 if s == 'B' else 1)},{f},0\n" for f in (1, 2, 3) for s in "BA"]
    data = read_recordings(dataset(tmp_path, HEADER + "".join(rows)))
    assert data.names == ("B", "A")
    np.testing.assert_array_equal(data.subjects[0].frequency_hz, [2, 4, 6])
    np.testing.assert_array_equal(data.subjects[1].frequency_hz, [1, 2, 3])


def test_noise_is_by_subject(tmp_path: Path) -> None:
    text = HEADER.strip() + ",noise_sd\n"
    text += "".join(f"A,1,{f},1,0,0.{f}\n" for f in (1, 2, 3)) + "".join(f"B,1,{f},1,0,\n" for f in (1, 2, 3))
    data = read_recordings(dataset(tmp_path, text, toml='unit = "mN s/m"'))
    assert data.subjects[0].noise_sd is not None
    np.testing.assert_allclose(data.subjects[0].noise_sd, [[1e-4, 2e-4, 3e-4]])
    assert data.subjects[1].noise_sd is None


def test_negative_sign_is_turned(tmp_path: Path) -> None:
    text = GOOD.replace(",1.", ",-1.").replace(",2.", ",-2.")
    data = read_recordings(dataset(tmp_path, text, toml='sign = "Passive  negative"'))
    np.testing.assert_array_equal(data.subjects[0].z, [[1 + 0.5j, 1.1 + 0.4j, 1.2 + 0.3j]])
    assert any("multiplied by -1" in warning for warning in data.warnings)


def test_covariates(tmp_path: Path) -> None:
    data = read_recordings(dataset(tmp_path, subjects="subject,age_y,Force_N\nB,30,\nA,40.5,1e-1\n"))
    assert data.subjects[0].covariates == {"age_y": 40.5, "Force_N": 0.1}
    assert data.subjects[1].covariates["age_y"] == 30
    assert np.isnan(data.subjects[1].covariates["Force_N"])
    (warning,) = data.warnings
    assert "Force_N is missing for 1 of 2" in warning
    assert "row 2" in warning


def test_infinite_covariate_is_missing(tmp_path: Path) -> None:
    data = read_recordings(dataset(tmp_path, subjects="subject,age_y\nA,30\nB,inf\n"))
    assert np.isnan(data.subjects[1].covariates["age_y"])
    assert "age_y is missing for 1 of 2 subjects, the first in row 3" in data.warnings[0]


def test_subjects_csv_without_covariates_may_be_short(tmp_path: Path) -> None:
    assert read_recordings(dataset(tmp_path, subjects="subject\nA\n")).subjects[1].covariates == {}


# What is read with a warning


def test_incomplete_rows_are_dropped(tmp_path: Path) -> None:
    text = GOOD + "B,1,40,nan,1\nB,1,50,1,\nB,1,60,inf,1\nB,1,70,1,N/A\nB,1,,1,1\nC,1,10,NaN,NaN\n"
    data = read_recordings(dataset(tmp_path, text))
    assert data.names == ("A", "B")
    assert data.subjects[1].frequency_hz.size == 3
    rows, lost = data.warnings
    assert "6 of 12 rows" in rows
    assert "row 8" in rows
    assert 'subject "C", repetition "1"' in lost


def test_different_grids_of_repetitions_are_reduced(tmp_path: Path) -> None:
    first = "".join(f"A,1,{f},{f},0\n" for f in (1, 2, 3, 4, 5))
    second = "".join(f"A,2,{f},{10 * f},0\n" for f in (2, 3, 5, 6))
    data = read_recordings(dataset(tmp_path, HEADER + first + second))
    np.testing.assert_array_equal(data.subjects[0].frequency_hz, [2, 3, 5])
    np.testing.assert_array_equal(data.subjects[0].z, [[2, 3, 5], [20, 30, 50]])
    (warning,) = data.warnings
    assert "row 2" in warning
    assert "reduced to the 3 that are common to all (of up to 5)" in warning


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD.replace("z_im\n", "z_im,comment\n").replace("1e0", "1e0,").replace("5\n", "5,hello\n"), None),
        (GOOD.replace("z_im\n", "z_im,phase_deg\n"), ["phase_deg", "z_re and z_im"]),
    ],
)
def test_extra_columns(tmp_path: Path, text: str, words: list[str] | None) -> None:
    header, *rows = text.splitlines()
    text = "\n".join([header, *(row if row.count(",") == 5 else row + ",7" for row in rows)])
    (warning,) = read_recordings(dataset(tmp_path, text)).warnings
    for word in words or ['column "comment" is not used']:
        assert word in warning


# The cost of reading


def test_cells_are_looked_at_one_by_one_only_where_one_is_no_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Columns of numbers are converted as whole arrays; one empty cell sends its own column through the slow path."""
    slowly: list[str] = []
    number = csv_table._number

    def counted(cell: str, table: csv_table.Table, column: str, index: int) -> float:
        slowly.append(column)
        return number(cell, table, column, index)

    monkeypatch.setattr(csv_table, "_number", counted)
    data = recordings(*(subject(f"S{i:02d}", 3, 41) for i in range(7)))
    again = read_recordings(write_recordings(data, tmp_path))
    assert_same(data, again)
    assert slowly == []
    text = (tmp_path / "recordings.csv").read_text(encoding="utf-8")
    *rows, last = text.rstrip("\n").split("\n")
    (tmp_path / "recordings.csv").write_text("\n".join([*rows, last[: last.rindex(",") + 1]]) + "\n", encoding="utf-8")
    assert len(read_recordings(tmp_path).warnings) >= 1
    assert slowly == ["z_im"] * (7 * 3 * 41)


def test_importing_is_light() -> None:
    code = "import sys, bayes_impedance.recordings.files, bayes_impedance.quality.checks; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "numpy" in modules
    assert not {"pandas", "scipy", "numba", "emcee", "arviz", "matplotlib"} & set(modules)
