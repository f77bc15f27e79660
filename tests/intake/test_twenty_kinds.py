"""One impedance in files of many kinds, written by the libraries that others use: each gives it with one command.

The kinds and their commands are the table of docs/import.md.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from kinds_of_files import KINDS, SINES, F, Z
from known_impedance import imported

import bayes_impedance
from bayes_impedance.commands.cli import main


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_gives_the_same_impedance(name: str, tmp_path: Path) -> None:
    kind = KINDS[name]
    kind.write(tmp_path / kind.file)
    subject = imported(tmp_path, tmp_path / kind.file, *kind.options)
    frequency = np.array(SINES.lines) * 2.0 if kind.signals else F
    truth = SINES.impedance() if kind.signals else Z
    np.testing.assert_allclose(subject.frequency_hz, frequency, rtol=kind.precision)
    np.testing.assert_allclose(subject.z[0], truth, rtol=kind.precision)


def test_the_page_has_every_kind_with_its_command() -> None:
    page = (Path(bayes_impedance.__file__).parents[1] / "docs" / "import.md").read_text(encoding="utf-8")
    found = {}
    for line in page.splitlines():
        match = re.fullmatch(r"\| (.+?) \| `(.+?)` \|.*\|", line)
        if match:
            found[match[1]] = match[2].replace("'", "").split()
    assert set(found) == set(KINDS)
    for name, kind in KINDS.items():
        words = (
            " ".join(("bayes-impedance", "import", kind.file, *kind.options, "-o", "DATASET")).replace("'", "").split()
        )
        assert found[name] == words, name


TEXT = (".csv", ".txt", ".tsv", ".z", ".dta", ".mpt")
BINARY = [name for name, kind in KINDS.items() if Path(kind.file).suffix.lower() not in TEXT]


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize("fault", ["empty", "cut", "garbage"])
def test_damaged_files_are_refused_in_one_sentence(
    name: str, fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind = KINDS[name]
    file = tmp_path / kind.file
    kind.write(file)
    whole = file.read_bytes()
    # A third: formats of many records are readable up to where they are cut, and then lack what is needed.
    damaged = {"empty": b"", "cut": whole[: len(whole) // 30], "garbage": bytes(range(255, 0, -1)) * 20}[fault]
    file.write_bytes(damaged)
    assert main(["import", str(file), "-o", str(tmp_path / "out"), *kind.options]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {file}")
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


# Text of a row that is cut off between two rows is whole; test_cut_files.py has it among files that are longer.
BY_ROWS = ("Touchstone",)


@pytest.mark.parametrize("name", [name for name in BINARY if name not in BY_ROWS])
@pytest.mark.parametrize("part", [0.3, 0.77, 0.97])
def test_binary_files_and_those_with_counts_are_refused_wherever_they_are_cut(
    name: str, part: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind = KINDS[name]
    file = tmp_path / kind.file
    kind.write(file)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(len(whole) * part)])
    assert main(["import", str(file), "-o", str(tmp_path / "out"), *kind.options]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert re.search("cut short|damaged", said)
    assert not (tmp_path / "out").exists()


def test_a_sound_of_unknown_length_is_read(tmp_path: Path) -> None:
    kind = KINDS["sound"]
    file = tmp_path / kind.file
    kind.write(file)
    whole = file.read_bytes()
    file.write_bytes(whole[:4] + b"\xff\xff\xff\xff" + whole[8:])
    assert imported(tmp_path, file, *kind.options).z.size == len(SINES.lines)


def test_a_touchstone_that_ends_inside_of_a_number_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.s1p"
    KINDS["Touchstone"].write(file)
    text = file.read_text(encoding="utf-8").rstrip("\n")
    row = text.count("\n") + 1
    file.write_text(text[: text.rindex(" ") + 4], encoding="utf-8")
    assert main(["import", str(file), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f"a.s1p, row {row}: the file ends with" in said
    assert "it is cut short" in said


def test_labview_rows_beyond_those_that_the_header_counts_are_read(tmp_path: Path) -> None:
    kind = KINDS["LabVIEW"]
    file = tmp_path / kind.file
    kind.write(file)
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("Samples\t4000\t4000", "Samples\t1000\t1000"), encoding="utf-8")
    assert imported(tmp_path, file, *kind.options).z.size == len(SINES.lines)


LIBRARIES = {"xlsx": "openpyxl", "uff": "pyuff", "tdms": "nptdms", "wav": "soundfile"}


@pytest.mark.parametrize(("suffix", "library"), LIBRARIES.items())
def test_a_missing_library_is_named_with_its_command(
    suffix: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, library, None)
    (tmp_path / f"a.{suffix}").write_bytes(b"something")
    assert main(["import", str(tmp_path / f"a.{suffix}"), "-o", str(tmp_path / "out")]) == 2
    assert "pip install 'bayes_impedance[intake]'" in capsys.readouterr().err
