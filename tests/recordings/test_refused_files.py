"""Files that are refused: each with the row and the remedy that the message must name."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import pytest
from datasets import GOOD, HEADER, POLAR, dataset

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import read_recordings

# Each: content, then what the message must say.

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
        "subject,repetitions,frequency_hz,z_re,z_im\nA,1,1,1,0\n",
        ["row 1", '"repetition" is missing', 'rename "repetitions" if it is that'],
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
    "semicolons": (
        GOOD.replace(",", ";"),
        ["row 1", "separated by semicolons", "to commas, or make", "bayes-impedance import"],
    ),
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
        ["100% of the rows", "row 2", "negative real part", 'sign = "passive negative" in', "not force per velocity"],
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
    said = 'positive real part although the sign is "passive negative"; if [a-z ]*, write sign = "passive positive"'
    with pytest.raises(InputError, match=said):
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
