"""Reading and writing datasets: what is accepted, and what exactly is said about what is not."""

from __future__ import annotations

import gzip
import hashlib
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import Recordings, Subject, read_recordings, write_recordings
from bayes_impedance.recordings.metadata import parse_unit

HEADER = "subject,repetition,frequency_hz,z_re,z_im\n"
GOOD = HEADER + "A,1,10,1.0,-0.5\nA,1,20,1.1,-0.4\nA,1,30,1.2,-0.3\nB,1,10,2.0,-0.5\nB,1,20,2.1,0.5\nB,1,30,2.2,1e0\n"
POLAR = "subject,repetition,frequency_hz,magnitude,phase_deg\nA,1,10,2,90\nA,1,20,3,0\nA,1,30,4,-60\n"


def dataset(
    folder: Path, recordings: str | bytes = GOOD, *, subjects: str | None = None, toml: str | None = None
) -> Path:
    content = recordings if isinstance(recordings, bytes) else recordings.encode()
    (folder / "recordings.csv").write_bytes(content)
    if subjects is not None:
        (folder / "subjects.csv").write_text(subjects, encoding="utf-8")
    if toml is not None:
        (folder / "dataset.toml").write_text(toml, encoding="utf-8")
    return folder


def subject(
    name: str = "A", repetitions: int = 2, points: int = 5, *, noise: bool = False, **covariates: float
) -> Subject:
    f = np.geomspace(3.0, 700.0, points)
    j = np.arange(1, repetitions + 1)[:, None]
    z = j / 3 + 2j * np.pi * f * 1e-3
    return Subject(
        name=name,
        frequency_hz=f,
        z=z,
        repetitions=tuple(map(str, j[:, 0])),
        noise_sd=np.abs(z) / 70 if noise else None,
        covariates=covariates,
    )


def recordings(*subjects: Subject) -> Recordings:
    return Recordings(title="Title", unit="N s/m", network="r1|m1", source="a source", licence="MIT", subjects=subjects)


# What is read


def test_reads_folder_without_description(tmp_path: Path) -> None:
    data = read_recordings(dataset(tmp_path))
    assert data.names == ("A", "B")
    assert len(data) == 2
    assert (data.title, data.unit, data.network, data.warnings) == (tmp_path.name, "N s/m", None, ())
    assert data.repetitions_max == 1
    assert data.frequency_range_hz == (10.0, 30.0)
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
    assert "reduced to the 3 that all have (of up to 5)" in warning


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


def test_unknown_key_and_scaled_unit_and_surplus_covariates(tmp_path: Path) -> None:
    toml = 'titel = "T"\nunit = "mN s/m"\nversion = 3\n[table]\nx = 1\n'
    data = read_recordings(dataset(tmp_path, subjects="subject,age\nA,1\nB,2\nC,3\n", toml=toml))
    surplus, titel, version, table, unit = data.warnings
    assert "no recordings of C" in surplus
    assert 'line 1: key "titel"' in titel
    assert 'did you mean "title"?' in titel
    assert 'line 3: key "version"' in version
    assert 'line 4: key "table"' in table
    assert "line 2" in unit
    assert "multiplied by 0.001" in unit
    assert data.subjects[0].z[0, 0] == pytest.approx(1e-3 - 0.5e-3j)


@pytest.mark.parametrize(
    ("spelling", "unit", "factor"),
    [
        ("N s/m", "N s/m", 1),
        ("N*s/m", "N s/m", 1),
        ("Ns/m", "N s/m", 1),
        ("N\u00b7s/m", "N s/m", 1),
        ("N s m^-1", "N s/m", 1),
        ("N s m\u207b\u00b9", "N s/m", 1),
        ("kg/s", "N s/m", 1),
        ("mN s/m", "N s/m", 1e-3),
        ("\u00b5N s/m", "N s/m", 1e-6),
        ("N s/mm", "N s/m", 1e3),
        ("g/s", "N s/m", 1e-3),
        ("dyn s/cm", "N s/m", 1e-3),
        ("Ohm", "ohm", 1),
        ("\u2126", "ohm", 1),
        ("\u03a9", "ohm", 1),
        ("mohm", "ohm", 1e-3),
        ("k\u03a9", "ohm", 1e3),
        ("MOhm", "ohm", 1e6),
        ("N m s/rad", "N m s/rad", 1),
        ("mN m s/rad", "N m s/rad", 1e-3),
        ("Pa s/m3", "Pa s/m3", 1),
        ("Pa\u00b7s/m\u00b3", "Pa s/m3", 1),
        ("kPa s/m^3", "Pa s/m3", 1e3),
        ("rayl", "Pa s/m", 1),
    ],
)
def test_units(spelling: str, unit: str, factor: float) -> None:
    kept, by = parse_unit(spelling, "here")
    assert kept == unit
    assert by == pytest.approx(factor)


@pytest.mark.parametrize(
    ("spelling", "words"),
    [
        ("mm", "a displacement"),
        ("N/m", "a stiffness"),
        ("dB", "a level"),
        ("m/(N s)", "a mobility"),
        ("S", "an admittance"),
        ("furlong", "is unknown"),
        ("", "is unknown"),
        ("ns/m", "is unknown"),
    ],
)
def test_refused_units(spelling: str, words: str) -> None:
    with pytest.raises(InputError, match="an impedance F/v is expected") as caught:
        parse_unit(spelling, "dataset.toml, line 7")
    message = str(caught.value)
    assert words in message
    assert "line 7" in message
    assert all(f'"{unit}"' in message for unit in ("N s/m", "ohm", "N m s/rad", "Pa s/m3"))


# What is refused. Each: content, then what the message must say.

Bad = tuple[str | bytes, list[str]]
BAD_RECORDINGS: dict[str, Bad] = {
    "empty": ("", ["is empty"]),
    "only_blank_lines": ("\n\n", ["is empty"]),
    "only_header": (HEADER, ["no rows of data", "below row 1"]),
    "only_header_and_blank": (HEADER + ",,,,\n\n", ["no rows of data"]),
    "blank_first_row": ("\n" + GOOD, ["row 1", "put the column names into row 1"]),
    "no_header": (GOOD.removeprefix(HEADER), ["row 1", '"1" is a number', "insert a row of column names"]),
    "no_subject": (GOOD.replace("subject,", "who,"), ["row 1", '"subject" is missing', "who", "add it"]),
    "no_repetition": (
        "subject,frequency_hz,z_re,z_im\nA,1,1,0\n",
        ["row 1", '"repetition" is missing', "add it, with 1 in every row"],
    ),
    "renamed_frequency": (
        GOOD.replace("frequency_hz", "frequency"),
        ["row 1", '"frequency_hz" is missing', 'rename "frequency"'],
    ),
    "no_z_im": (GOOD.replace("z_im", "x"), ["row 1", '"z_im" is missing', "or give magnitude and phase_deg"]),
    "no_values": (
        "subject,repetition,frequency_hz\nA,1,1\n",
        ["row 1", '"z_re" is missing', "or give magnitude and phase_deg"],
    ),
    "phase_of_unknown_unit": (
        POLAR.replace("phase_deg", "phase_rad"),
        ["row 1", '"phase_deg" is missing', "in degrees", 'rename "phase_rad"'],
    ),
    "mixed_pair": (
        "subject,repetition,frequency_hz,z_re,phase_deg\nA,1,1,1,1\n",
        ["row 1", '"z_im" is missing'],
    ),
    "column_twice": (GOOD.replace("z_im", "z_re"), ["row 1", '"z_re" appears twice', "rename or delete"]),
    "text": (GOOD.replace("2.1,", "abc,"), ["row 6", 'z_re is "abc"', "not a number", "correct it"]),
    "text_frequency": (GOOD.replace("A,1,20", "A,1,20 Hz"), ["row 3", 'frequency_hz is "20 Hz"']),
    "text_after_gap": (GOOD.replace("1.1,", ",").replace("2.1,", "abc,"), ["row 6", 'z_re is "abc"']),
    "text_after_blank_rows": (GOOD.replace("B,1,20,2.1", "\n\nB,1,20,abc"), ["row 8", 'z_re is "abc"']),
    "underscore": (GOOD.replace("2.1,", "1_000,"), ["row 6", 'z_re is "1_000"']),
    "semicolons": (GOOD.replace(",", ";"), ["row 1", "separated by semicolons", "to commas"]),
    "semicolons_and_decimal_commas": (
        GOOD.replace(",", ";").replace(".", ","),
        ["row 1", "separated by semicolons", "decimal points"],
    ),
    "tabs": (GOOD.replace(",", "\t"), ["row 1", "separated by tabs"]),
    "decimal_commas": (GOOD.replace(".", ","), ["row 2", "7 cells but 5 columns", "decimal points"]),
    "quoted_decimal_commas": (GOOD.replace("2.1,", '"2,1",'), ["row 6", 'z_re is "2,1"', "decimal points"]),
    "short_row": (GOOD.replace("2.1,", ""), ["row 6", "4 cells but 5 columns", "add the missing cells"]),
    "open_quote": (GOOD.replace("B,1,20", '"B,1,20'), ["row 6", "quotation marks", "correct the row"]),
    "negative_frequency": (GOOD.replace("B,1,10", "B,1,-10"), ["row 5", "frequency_hz is -10", "above zero"]),
    "zero_frequency": (GOOD.replace("B,1,10", "B,1,0"), ["row 5", "frequency_hz is 0", "correct or delete"]),
    "unsorted": (
        GOOD.replace("B,1,20", "B,1,40"),
        ["row 7", "falls from 40 to 30", 'subject "B", repetition "1"', "sort"],
    ),
    "descending": (
        HEADER + "A,1,3,1,0\nA,1,2,1,0\nA,1,1,1,0\n",
        ["row 3", "falls from 3 to 2", "sort each recording by ascending frequency"],
    ),
    "duplicate": (
        GOOD.replace("B,1,30", "B,1,10"),
        ["row 7", "10 Hz was already given in row 5", 'subject "B"', "different repetitions"],
    ),
    "first_duplicate_of_two": (
        HEADER + "B,1,1,1,0\nA,1,1,1,0\nB,1,2,1,0\nA,1,1,1,0\nB,1,2,1,0\n",
        ["row 5", "1 Hz was already given in row 3", 'subject "A"'],
    ),
    "negative_magnitude": (POLAR.replace("20,3", "20,-3"), ["row 3", "magnitude is -3", "dB"]),
    "zero_noise": (
        "subject,repetition,frequency_hz,z_re,z_im,noise_sd\nA,1,1,1,0,1\nA,1,2,1,0,0\n",
        ["row 3", "noise_sd is 0", "above zero", "leave the column out"],
    ),
    "no_name": (GOOD.replace("B,1,20", " ,1,20"), ["row 6", "subject is empty", "give the name"]),
    "no_repetition_name": (GOOD.replace("B,1,20", "B,,20"), ["row 6", "repetition is empty"]),
    "line_break_in_name": (GOOD.replace("B,", '"B\nC",'), ["row 5", "line break", "remove it"]),
    "nothing_finite": (HEADER + "A,1,1,nan,0\nA,1,2,,0\n", ["row 2", "no row has a finite number", "fill them in"]),
    "two_points": (GOOD.replace("B,1,30,2.2,1e0\n", ""), ["row 5", 'subject "B"', "2 usable frequencies", "complete"]),
    "wrong_sign": (
        GOOD.replace(",1.", ",-1.").replace(",2.", ",-2."),
        ["100% of the rows", "row 2", "negative real part", 'write sign = "passive negative" in', "dataset.toml"],
    ),
    "little_in_common": (
        HEADER + "".join(f"A,{r},{f + r / 10},1,0\n" for r in (1, 2) for f in range(1, 9)) + "A,3,1,1,0\n",
        ["row 2", 'subject "A"', "up to 8 frequencies, of which only 0", "the same frequencies"],
    ),
    "binary": (b"PK\x03\x04\0\0\0\0", ["binary", "export the data as CSV"]),
    "latin1": (GOOD.replace("B,", "J\u00f6rg,").encode("latin-1"), ["row 5", "not UTF-8", "0xf6", "save it as"]),
    "utf16": (GOOD.encode("utf-16"), ["UTF-16", "save it as"]),
    "cut_gzip": (gzip.compress(GOOD.encode())[:-12], ["gzip", "damaged or cut short", "compress it again"]),
}


@pytest.mark.parametrize(("content", "words"), BAD_RECORDINGS.values(), ids=BAD_RECORDINGS.keys())
def test_bad_recordings(tmp_path: Path, content: str | bytes, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        read_recordings(dataset(tmp_path, content))
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "recordings.csv"))
    assert "\n" not in message
    for word in words:
        assert word in message
    # A row that is named is the one expected and no other.
    expected = next((word for word in words if re.fullmatch(r"row \d+", word)), None)
    named = re.findall(r"row \d+", message)
    assert named[:1] == ([expected] if expected else named[:1])


@pytest.mark.parametrize("value", ["1_0", "0x10", "1,5", "--1", "1e", "\u22121"])
def test_no_text_becomes_a_number(tmp_path: Path, value: str) -> None:
    with pytest.raises(InputError, match="row 6"):
        read_recordings(dataset(tmp_path, GOOD.replace("2.1,", f'"{value}",')))


def test_wrong_sign_declared_negative(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match='positive real part although the sign is "passive negative"; write sign = "pas'
    ):
        read_recordings(dataset(tmp_path, toml='sign = "passive negative"'))


def test_some_negative_real_parts_are_no_wrong_sign(tmp_path: Path) -> None:
    text = HEADER + "".join(f"A,1,{f},{1 if f > 5 else -1},9\n" for f in range(1, 11))
    assert read_recordings(dataset(tmp_path, text)).subjects[0].z[0, 0] == -1 + 9j


BAD_SUBJECTS: dict[str, tuple[str, list[str]]] = {
    "duplicate": ("subject,age\nA,1\nB,2\nA,3\n", ["row 4", 'subject "A" appears twice', "one row"]),
    "no_subject": ("name,age\nA,1\nB,2\n", ["row 1", '"subject" is missing', "name, age", "add it"]),
    "empty_name": ("subject,age\nA,1\n,2\n", ["row 3", "subject is empty"]),
    "text": ("subject,age,sex\nA,1,0\nB,2,female\n", ["row 3", 'sex is "female"', "not a number"]),
    "absent": ("subject,age\nA,1\n", ['subject "B"', "row 5", "is missing here", "add a row"]),
    "empty": ("", ["is empty"]),
    "wide": ("subject,age\nA,1,2\n", ["row 2", "3 cells but 2 columns"]),
}


@pytest.mark.parametrize(("content", "words"), BAD_SUBJECTS.values(), ids=BAD_SUBJECTS.keys())
def test_bad_subjects(tmp_path: Path, content: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        read_recordings(dataset(tmp_path, subjects=content))
    assert str(caught.value).startswith(str(tmp_path / "subjects.csv"))
    for word in words:
        assert word in str(caught.value)


BAD_TOML: dict[str, tuple[str, list[str]]] = {
    "syntax": ('title = "T"\nunit = N s/m\n', ["line 2 is not valid TOML", "correct it"]),
    "unfinished": ('title = "T', ["not valid TOML", "line"]),
    "key_twice": ('title = "T"\ntitle = "U"\n', ["line 2 is not valid TOML"]),
    "type": ('title = "T"\n\nsource = 3\n', ["line 3", "source is 3", "quotation marks"]),
    "table": ("[network]\nx = 1\n", ["line 1", "network is", "must be text"]),
    "unit": ('title = "T"\nunit = "N/m"\n', ["line 2", '"N/m" belongs to a stiffness', "F/v"]),
    "sign": ('sign = "positive"\n', ["line 1", '"positive" is unknown', '"passive positive"', '"passive negative"']),
}


@pytest.mark.parametrize(("content", "words"), BAD_TOML.values(), ids=BAD_TOML.keys())
def test_bad_toml(tmp_path: Path, content: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        read_recordings(dataset(tmp_path, toml=content))
    assert str(caught.value).startswith(str(tmp_path / "dataset.toml"))
    for word in words:
        assert word in str(caught.value)


def test_toml_in_another_encoding(tmp_path: Path) -> None:
    dataset(tmp_path).joinpath("dataset.toml").write_bytes('title = "T"\nsource = "J\u00f6rg"'.encode("latin-1"))
    with pytest.raises(InputError, match=r"dataset\.toml, row 2: the text is not UTF-8"):
        read_recordings(tmp_path)


def test_missing_path(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: there is no such file or folder; check the path"):
        read_recordings(tmp_path / "nowhere")


def test_folder_without_recordings(tmp_path: Path) -> None:
    with pytest.raises(
        InputError,
        match=r"has no recordings\.csv, recordings\.csv\.gz or recordings\.parquet; put the recordings there",
    ):
        read_recordings(tmp_path)


def test_folder_with_both(tmp_path: Path) -> None:
    dataset(tmp_path).joinpath("recordings.csv.gz").write_bytes(gzip.compress(GOOD.encode()))
    with pytest.raises(InputError, match=r"has both .* delete the wrong one"):
        read_recordings(tmp_path)


# Subject and Recordings


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
    assert np.isnan(none.frequency_range_hz).all()
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


# Writing


def assert_same(one: Recordings, other: Recordings, rtol: float = 0.0) -> None:
    for name in ("title", "unit", "network", "source", "licence", "names"):
        assert getattr(one, name) == getattr(other, name)
    for a, b in zip(one.subjects, other.subjects, strict=True):
        assert a.repetitions == b.repetitions
        np.testing.assert_array_equal(a.frequency_hz, b.frequency_hz)
        np.testing.assert_allclose(a.z.view(float), b.z.view(float), rtol=rtol)
        assert (a.noise_sd is None) == (b.noise_sd is None)
        if a.noise_sd is not None and b.noise_sd is not None:
            np.testing.assert_allclose(a.noise_sd, b.noise_sd, rtol=rtol)
        for name in {*a.covariates, *b.covariates}:
            np.testing.assert_equal(b.covariates.get(name, np.nan), a.covariates.get(name, np.nan))


@pytest.mark.parametrize("compress", [False, True])
def test_round_trip(tmp_path: Path, compress: bool) -> None:
    data = recordings(
        subject("A", noise=True, age_y=31.0, Force=0.1), subject("B, jr", 1, 7, age_y=np.nan), subject('"C"', 3, 3)
    )
    assert write_recordings(data, tmp_path / "a" / "b", compress=compress) == tmp_path / "a" / "b"
    files = {path.name for path in (tmp_path / "a" / "b").iterdir()}
    assert files == {"recordings.csv.gz" if compress else "recordings.csv", "subjects.csv", "dataset.toml"}
    again = read_recordings(tmp_path / "a" / "b")
    assert_same(data, again)
    assert len(again.sha256) == 64


def test_digest_does_not_depend_on_compression(tmp_path: Path) -> None:
    data = recordings(subject(age=1.0))
    folders = [write_recordings(data, tmp_path / str(compress), compress=compress) for compress in (False, True)]
    assert len({read_recordings(folder).sha256 for folder in folders}) == 1


def test_same_data_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = write_recordings(recordings(subject()), tmp_path / "1", compress=True) / "recordings.csv.gz"
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 86400)
    second = write_recordings(recordings(subject()), tmp_path / "2", compress=True) / "recordings.csv.gz"
    assert first.read_bytes() == second.read_bytes()


def test_significant_digits(tmp_path: Path) -> None:
    data = recordings(subject(noise=True))
    again = read_recordings(write_recordings(data, tmp_path, significant_digits=4))
    assert_same(data, again, rtol=6e-4)
    assert not np.array_equal(data.subjects[0].z, again.subjects[0].z)


def test_writing_replaces_a_dataset(tmp_path: Path) -> None:
    write_recordings(recordings(subject("A", age=1.0)), tmp_path, compress=True)
    (tmp_path / "report.html").write_text("kept")
    write_recordings(recordings(subject("B")), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"recordings.csv", "dataset.toml", "report.html"}
    assert read_recordings(tmp_path).names == ("B",)


def test_no_half_written_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_recordings(recordings(subject("A")), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    write = Path.write_bytes

    def full_disk(path: Path, content: bytes) -> int:
        if "dataset" in path.name:
            raise OSError(28, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_recordings(recordings(subject("B")), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


_texts = st.text(st.characters(codec="utf-8"), max_size=20)
_names = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=8)
_positive = st.floats(1e-12, 1e12)
_reals = st.floats(-1e12, 1e12).map(lambda value: value + 0.0)


@st.composite
def _subjects(draw: st.DrawFn) -> tuple[Subject, ...]:
    subjects = []
    for name in draw(st.lists(_names, min_size=1, max_size=3, unique=True)):
        f = np.array(sorted(draw(st.sets(_positive, min_size=3, max_size=6))))
        repetitions = draw(st.lists(st.sampled_from(["1", "02", "x"]), min_size=1, max_size=3, unique=True).map(sorted))
        shape = len(repetitions), f.size
        values = st.lists(_positive, min_size=f.size * shape[0], max_size=f.size * shape[0])
        real, noise = (np.reshape(draw(values), shape) for _ in range(2))
        imaginary = np.reshape(draw(st.lists(_reals, min_size=real.size, max_size=real.size)), shape)
        z = real + 1j * imaginary
        covariates = draw(st.dictionaries(st.sampled_from(["age_y", "Force N"]), _reals))
        subjects.append(
            Subject(
                name=name,
                frequency_hz=f,
                z=z,
                repetitions=tuple(repetitions),
                noise_sd=noise if draw(st.booleans()) else None,
                covariates=covariates,
            )
        )
    return tuple(subjects)


@settings(max_examples=60, deadline=None)
@given(subjects=_subjects(), title=_texts, source=_texts, compress=st.booleans())
def test_round_trip_of_anything(
    tmp_path_factory: pytest.TempPathFactory, subjects: tuple[Subject, ...], title: str, source: str, compress: bool
) -> None:
    data = Recordings(
        title=title.strip() or "T", unit="ohm", network=None, source=source, licence="", subjects=subjects
    )
    folder = write_recordings(data, tmp_path_factory.mktemp("round"), compress=compress)
    again = read_recordings(folder)
    # Repetitions come back in the order in which their names first appear in the file.
    order = [name for subject in subjects for name in subject.repetitions]
    for subject in again.subjects:
        assert list(subject.repetitions) == sorted(subject.repetitions, key=order.index)
    by_name = {subject.name: dict(zip(subject.repetitions, subject.z, strict=True)) for subject in again.subjects}
    for subject in subjects:
        for repetition, z in zip(subject.repetitions, subject.z, strict=True):
            np.testing.assert_array_equal(by_name[subject.name][repetition], z)
    if all(list(s.repetitions) == sorted(s.repetitions, key=order.index) for s in subjects):
        assert_same(data, again)


# Speed and weight


def test_importing_is_light() -> None:
    code = "import sys, bayes_impedance.recordings.files, bayes_impedance.quality.checks; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "numpy" in modules
    assert not {"pandas", "scipy", "numba", "emcee", "arviz", "matplotlib"} & set(modules)


def test_a_dataset_of_the_papers_size_comes_back(tmp_path: Path) -> None:
    data = recordings(*(subject(f"S{i:02d}", 3, 401) for i in range(71)))
    write_recordings(data, tmp_path, compress=True)
    assert_same(data, read_recordings(tmp_path))


@pytest.mark.skipif(not os.environ.get("BAYES_IMPEDANCE_REAL_DATA"), reason="BAYES_IMPEDANCE_REAL_DATA is not set")
@pytest.mark.parametrize(("name", "subjects", "points"), [("battery_130", 130, 57), ("fuel_cell_1", 1, 66)])
def test_real_data(tmp_path: Path, name: str, subjects: int, points: int) -> None:
    data = read_recordings(Path(os.environ["BAYES_IMPEDANCE_REAL_DATA"]) / name)
    assert len(data) == subjects
    assert {subject.z.shape for subject in data.subjects} == {(1, points)}
    assert (data.unit, data.network, data.warnings) == ("ohm", "r0|(r1-n1)|(r2-n2)", ())
    assert_same(data, read_recordings(write_recordings(data, tmp_path)))
