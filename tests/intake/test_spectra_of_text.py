"""Spectra in text: every way of writing one impedance gives it, and what cannot be used is refused in one sentence."""

from pathlib import Path

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance, imported, table

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import read_recordings

F, Z = FREQUENCY, impedance()
S = 2j * np.pi * F
WAYS = {
    "dataset": (table({"frequency_hz": F, "z_re": Z.real, "z_im": Z.imag}), ()),
    "semicolons and commas": (table({"f [Hz]": F, "Re(Z)": Z.real, "Im(Z)": Z.imag}, ";", ","), ("--unit", "N s/m")),
    "tabs, descending": (table({"f": F[::-1], "Zreal": Z.real[::-1], "Zimag": Z.imag[::-1]}, "\t"), ()),
    "negative imaginary part": (table({"freq/kHz": F / 1e3, "Z'": Z.real, "-Z''": -Z.imag}), ()),
    "angular frequency": (table({"omega": 2 * np.pi * F, "z_re": Z.real, "z_im": Z.imag}), ()),
    "degrees": (
        table({"f_hz": F, "mag (m/s/N)": np.abs(1 / Z), "phase (deg)": np.angle(1 / Z, deg=True)}, " | "[1]),
        ("--columns", "magnitude=mag (m/s/N)", "phase=phase (deg)", "frequency=f_hz"),
    ),
    "decibels": (
        table({"f_hz": F, "mag_dB": 20 * np.log10(np.abs(S / Z)), "phase_rad": np.angle(S / Z)}),
        ("--form", "accelerance"),
    ),
    "turned sign": (table({"f": F, "z_re": -Z.real, "z_im": -Z.imag}), ("--negated",)),
    "exp(-jwt)": (table({"f": F, "z_re": Z.real, "z_im": -Z.imag}), ("--conjugated",)),
    "complex cells": (
        "f,H\n"
        + "".join(f"{f!r},{h.real!r}{h.imag:+.17g}i\n" for f, h in zip(F.tolist(), (1 / Z).tolist(), strict=True)),
        ("--unit", "m/(N s)"),
    ),
    "comment before the names": (
        "# measured today\n# f, Re_Z, Im_Z\n" + table({"f": F, "a": Z.real, "b": Z.imag})[6:],
        (),
    ),
    "row of units": (
        table({"Freq": F, "Re": (S * Z).real, "Im": (S * Z).imag}).replace("\n", "\nHz,N/m,N/m\n", 1),
        (),
    ),
    "columns by number": (
        table({"a": F, "b": Z.real, "c": Z.imag}),
        ("--columns", "frequency=1", "real=2", "imaginary=3", "--unit", "N s/m"),
    ),
    "apparent mass": (table({"f": F, "re": (Z / S).real * 1e3, "im": (Z / S).imag * 1e3}), ("--unit", "g")),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_every_way_of_writing_gives_the_same_impedance(way: str, encoding: str, tmp_path: Path) -> None:
    text, options = WAYS[way]
    (tmp_path / "P07.txt").write_bytes(text.encode(encoding))
    subject = imported(tmp_path, tmp_path / "P07.txt", *options)
    assert (subject.name, subject.repetitions) == ("P07", ("1",))
    np.testing.assert_allclose(subject.frequency_hz, F, rtol=1e-12)
    np.testing.assert_allclose(subject.z[0], Z, rtol=1e-12)


def test_guesses_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "P07.txt").write_text(WAYS["negative imaginary part"][0], encoding="utf-8")
    imported(tmp_path, tmp_path / "P07.txt")
    said = capsys.readouterr().out
    assert 'frequency from "freq/kHz" in kHz' in said
    assert "imaginary from \"-Z''\" (its negative)" in said
    assert "no unit is given; the values are taken to be impedance in N s/m" in said


def test_files_of_persons_and_their_repetitions(tmp_path: Path) -> None:
    for person, size in (("A", 1.0), ("B", 1.5)):
        for repetition in (1, 2):
            text = table({"f": F, "z_re": Z.real * repetition * size, "z_im": Z.imag})
            (tmp_path / f"{person}_{repetition}_cold.csv").write_text(text, encoding="utf-8")
    pattern = r"(?P<subject>[^_]+)_(?P<repetition>\d)_(?P<room>\w+)"
    files = sorted(map(str, tmp_path.glob("*.csv")))
    assert main(["import", *files, "-o", str(tmp_path / "out"), "--subject-from-name", pattern]) == 0
    subjects = read_recordings(tmp_path / "out").subjects
    assert [(s.name, s.repetitions) for s in subjects] == [("A", ("1", "2")), ("B", ("1", "2"))]
    np.testing.assert_allclose(subjects[1].z[1].real, 3 * Z.real)
    noted = (tmp_path / "out" / "repetitions.csv").read_text(encoding="utf-8")
    assert noted.splitlines()[:2] == ["subject,repetition,room", "A,1,cold"]


def test_long_tables_zero_hertz_gaps_and_sweeps_up_and_down(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    f = np.concatenate([[0.0], F, F[::-1]])
    z = np.concatenate([[1.0], Z, Z[::-1] * 1.5])
    rows = [f"007,{a!r},{b.real!r},{b.imag!r}" for a, b in zip(f.tolist(), z.tolist(), strict=True)]
    other = [f"008,{a!r},{2 * b.real!r},{b.imag!r}" for a, b in zip(f[1:26].tolist(), z[1:26].tolist(), strict=True)]
    text = "\n".join(["person,freq,z_re,z_im", *rows, "008,5.0,,", *other])
    (tmp_path / "all.csv").write_text(text, encoding="utf-8")
    assert main(["import", str(tmp_path / "all.csv"), "-o", str(tmp_path / "out")]) == 0
    first, second = read_recordings(tmp_path / "out").subjects
    assert (first.name, first.repetitions, second.repetitions) == ("007", ("1", "2"), ("1",))
    np.testing.assert_allclose(first.z, [Z, 1.5 * Z])
    said = capsys.readouterr().out
    for word in ("0 Hz left out", "each time is a repetition", "1 of 26 rows have no finite value"):
        assert word in said


def test_noise_from_a_column_and_from_coherence(tmp_path: Path) -> None:
    sd = np.full(F.size, 0.02)
    (tmp_path / "a.csv").write_text(table({"f": F, "z_re": Z.real, "z_im": Z.imag, "noise_sd": sd}), encoding="utf-8")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.csv").noise_sd, [sd])
    (tmp_path / "b.csv").write_text(
        table({"f": F, "z_re": Z.real, "z_im": Z.imag, "coherence": sd * 0 + 0.9}), encoding="utf-8"
    )
    assert imported(tmp_path, tmp_path / "b.csv").noise_sd is None
    with_noise = imported(tmp_path, tmp_path / "b.csv", "--averages", 8)
    np.testing.assert_allclose(with_noise.noise_sd, [np.abs(Z) * np.sqrt(0.1 / (2 * 7 * 0.9))])
    kept = (tmp_path / "imported" / "coherence.csv").read_text(encoding="utf-8").splitlines()
    assert kept[:2] == ["subject,repetition,frequency_hz,coherence", "b,1,5.0,0.9"]
    assert "noise_degrees_of_freedom\nb,1,14\n" in (tmp_path / "imported" / "repetitions.csv").read_text()


def test_noise_of_few_averages_in_a_column_is_moderated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a smooth noise, five averages show one that scatters by chance; the averages say so."""
    sd = 0.02 * np.sqrt(np.random.default_rng(1).chisquare(8, F.size) / 8)
    (tmp_path / "a.csv").write_text(table({"f": F, "z_re": Z.real, "z_im": Z.imag, "noise_sd": sd}), encoding="utf-8")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.csv").noise_sd, [sd])
    moderated = imported(tmp_path, tmp_path / "a.csv", "--averages", 5).noise_sd
    assert np.std(np.log(moderated / 0.02)) < 0.7 * np.std(np.log(sd / 0.02))
    assert "noise_sd of 8 degrees of freedom was moderated" in capsys.readouterr().out


def test_the_recipe_makes_the_same_dataset_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text(table({"f": F, "re": Z.real, "im": -Z.imag}), encoding="utf-8")
    columns = ("--columns", "frequency=f", "imaginary=-im", "real=re")
    imported(tmp_path, tmp_path / "a.csv", "--unit", "N s/m", "--title", 'A "title"', *columns)
    assert main(["import", "--again", str(tmp_path / "imported"), "-o", str(tmp_path / "again")]) == 0
    for name in ("recordings.csv", "dataset.toml"):
        assert (tmp_path / "imported" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
    assert "has changed" not in capsys.readouterr().out
    (tmp_path / "a.csv").write_text(table({"f": F, "re": Z.real, "im": -2 * Z.imag}), encoding="utf-8")
    again = ["import", "--again", str(tmp_path / "imported" / "dataset.toml"), "-o", str(tmp_path / "again")]
    assert main(again) == 0
    assert "a.csv: has changed since the first import" in capsys.readouterr().out


GOOD = table({"f": F, "z_re": Z.real, "z_im": Z.imag})
REFUSED = {
    "empty": (b"", (), "the file is empty"),
    "blank": (b" \n\n", (), "the file is empty"),
    "binary": (bytes(range(256)) * 40, (), "binary file"),
    "no numbers": (b"a,b,c\nx,y,z\n", (), "no rows of numbers"),
    "truncated": (GOOD.encode()[:-25], (), "row 26: there is 1 cell, but"),
    "short row": (GOOD.replace("\n5.0,", "\n", 1).encode(), (), "cells, but"),
    "text for a number": (GOOD.replace("5.0", "five", 1).encode(), (), 'row 2: f is "five"'),
    "unknown form": (table({"f": F, "re": Z.real, "im": Z.imag}).encode(), (), "no unit says what"),
    "unclear phase": (
        table({"f": F, "mag": abs(Z), "phase": np.angle(Z)}).encode(),
        ("--unit", "N s/m"),
        "unit of the phase",
    ),
    "no frequency": (
        table({"a": F, "z_re": Z.real, "z_im": Z.imag}).encode(),
        (),
        "no column is clearly the frequency",
    ),
    "signals without units": (
        table({"t": F, "force": Z.real, "velocity": Z.imag}).encode(),
        (),
        "if these are signals over time, name force and motion by --force NAME[UNIT] and --motion NAME[UNIT]",
    ),
    "two real parts": (table({"f": F, "z_re": F, "Re(Z)": F, "z_im": F}).encode(), (), "may each be the real"),
    "two-sided": (
        table({"f": F - 100, "z_re": Z.real, "z_im": Z.imag}).encode(),
        (),
        "below zero; delete the negative half",
    ),
    "negative magnitude": (
        table({"f": F, "|Z|": -abs(Z), "phase_deg": F * 0}).encode(),
        (),
        "row 2: the magnitude is",
    ),
    "two lines": ("\n".join(GOOD.splitlines()[:3]).encode(), (), "2 usable frequencies"),
    "mixed marks": (b"f;z_re;z_im\n1,5;1.5;2\n2,5;1.5;2\n3,5;1.5;2\n", (), "the decimal mark is not clear"),
    "wrong role": (GOOD.encode(), ("--columns", "frequenzy=f"), "there is no role"),
    "wrong column": (GOOD.encode(), ("--columns", "frequency=g"), "there is no such column"),
    "wrong unit": (GOOD.encode(), ("--unit", "N/s"), "none of a driving point"),
    "unit against form": (GOOD.encode(), ("--unit", "N/m", "--form", "mobility"), "not of mobility"),
    "wrong frequency unit": (GOOD.encode(), ("--frequency-unit", "kg"), "no unit of frequency"),
    "pattern": (GOOD.encode(), ("--subject-from-name", "(?P<who>.)"), "no group named subject"),
    "pattern that is none": (GOOD.encode(), ("--subject-from-name", "(?P<subject>"), "no regular expression"),
    "pattern without match": (GOOD.encode(), ("--subject-from-name", "(?P<subject>Q)"), "does not match"),
    "recipe": (GOOD.encode(), ("--recipe", "gamri"), 'did you mean "gamry"'),
    "recipe and columns": (GOOD.encode(), ("--recipe", "gamry", "--columns", "real=z_re"), "exclude each other"),
    "averages": (GOOD.encode(), ("--averages", "1"), "whole number from 2"),
    "encoding": (GOOD.encode(), ("--encoding", "klingon"), "is unknown"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_what_cannot_be_used_is_refused_and_nothing_written(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, options, sentence = REFUSED[fault]
    (tmp_path / "a.csv").write_bytes(data)
    assert main(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "out"), *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert sentence in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "no SOURCE is given"),
        (("none.csv",), "there is no such file"),
        (("a.csv", "a.csv"), "named twice"),
        (("a.csv", "other/a.csv", "--subject-from-name", "(?P<subject>a)(?P<repetition>)"), "of 25 frequencies"),
        (("a.csv", "--again", "."), "exclude each other"),
        (("--again", "."), "there is no such file"),
        (("a.csv", "ohm.csv"), "into different datasets"),
        (("empty",), "has no files"),
        (("old.xls",), "save it as .xlsx"),
    ],
)
def test_sources_that_do_not_go_together(
    arguments: tuple[str, ...],
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "empty").mkdir()
    Path("a.csv").write_text(GOOD, encoding="utf-8")
    Path("old.xls").write_text("x", encoding="utf-8")
    Path("ohm.csv").write_text(table({"f": F, "Re(Z)/Ohm": Z.real, "Im(Z)/Ohm": Z.imag}), encoding="utf-8")
    Path("other/a.csv").write_text(table({"f": F * 1.5, "z_re": Z.real, "z_im": Z.imag}), encoding="utf-8")
    assert main(["import", *arguments, "-o", "out"]) == 2
    assert sentence in capsys.readouterr().err
    assert not Path("out").exists()


def test_a_dataset_of_somebody_else_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(GOOD, encoding="utf-8")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "subjects.csv").write_text("subject,age\na,30\n", encoding="utf-8")
    assert main(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "out")]) == 2
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["subjects.csv"]


@pytest.mark.parametrize(("sign", "options"), [(-1, ()), (1, ("--conjugated",))])
def test_complex_conjugates_are_refused(
    sign: int, options: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "P07.txt").write_text(table({"f": F, "z_re": Z.real, "z_im": sign * Z.imag}))
    assert main(["import", str(tmp_path / "P07.txt"), *options, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "complex conjugates" in said
    assert "--conjugated" in said
    assert not (tmp_path / "out").exists()


def test_a_wrong_sign_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "a.csv", tmp_path / "out"
    file.write_text(table({"f [Hz]": F, "Re [N s/m]": -Z.real, "Im [N s/m]": -Z.imag}), encoding="utf-8")
    assert main(["import", str(file), "-o", str(out)]) == 2
    assert "give --negated" in capsys.readouterr().err
    assert not out.exists()
    np.testing.assert_allclose(imported(tmp_path, file, "--negated").z[0], Z)


@pytest.mark.parametrize(("last", "status"), [("12", 2), ("-12.345678", 0)])
def test_a_file_that_ends_in_the_middle_of_a_number(
    last: str, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "a.csv", tmp_path / "out"
    rows = [f"{f:.6f},{z.real:.12f},{z.imag:+.{12 + k % 2}f}" for k, (f, z) in enumerate(zip(F, Z, strict=True))]
    rows[-1] = rows[-1].rpartition(",")[0] + f",{last}"
    file.write_text("f [Hz],Re [N s/m],Im [N s/m]\n" + "\n".join(rows), encoding="utf-8")
    assert main(["import", str(file), "-o", str(out)]) == status
    said = "".join(capsys.readouterr())
    assert ("it is cut short" in said, "it may be cut short" in said) == (status == 2, status == 0)


@pytest.mark.parametrize(("form", "cut"), [("{:.6f}", (1, 3, 5)), ("{:.5e}", (4, 6))])
def test_a_file_of_one_format_that_ends_in_the_middle_of_a_number_is_refused_wherever_it_ends(
    form: str, cut: tuple[int, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "a.csv", tmp_path / "out"
    rows = [",".join(map(form.format, (f, z.real, z.imag))) for f, z in zip(F.tolist(), Z.tolist(), strict=True)]
    whole = "f [Hz],Re [N s/m],Im [N s/m]\n" + "\n".join(rows)
    file.write_text(whole, encoding="utf-8")
    assert main(["import", str(file), "-o", str(out / "whole")]) == 0
    for lost in cut:
        file.write_text(whole[:-lost], encoding="utf-8")
        assert main(["import", str(file), "-o", str(out / str(lost))]) == 2
        assert "it is cut short" in capsys.readouterr().err


def test_parentheses_inside_of_the_brackets_of_a_unit(tmp_path: Path) -> None:
    h = S / Z
    columns = {"f [Hz]": F, "Magnitude [(m/s^2)/N]": np.abs(h), "Phase [deg]": np.angle(h, deg=True)}
    (tmp_path / "a.csv").write_text(table(columns), encoding="utf-8")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.csv").z[0], Z, rtol=1e-9)
