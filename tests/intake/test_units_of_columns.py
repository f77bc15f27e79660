"""Units in the names of columns: each column in its own is refused, and a unit that an option contradicts is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance, imported, table

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import read_recordings

F, Z = FREQUENCY, impedance()
MOBILITY = 1e3 / Z  # mm/s/N
ANGLE = np.angle(MOBILITY, deg=True)


def test_parts_in_different_units_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both were taken in the first one, and an imaginary part was wrong by a factor of a thousand."""
    file, out = tmp_path / "a.csv", tmp_path / "out"
    file.write_text(table({"f [Hz]": F, "Re [N s/m]": Z.real, "Im [N s/mm]": Z.imag / 1e3}), encoding="utf-8")
    assert main(["import", str(file), "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert 'real from "Re [N s/m]" in N s/m, but imaginary from "Im [N s/mm]" in N s/mm' in said
    assert "--unit" in said
    assert not out.exists()


def test_two_spellings_of_one_unit_are_one(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(table({"f [Hz]": F, "Re [kN·s·m⁻¹]": Z.real / 1e3, "Im [N s/mm]": Z.imag / 1e3}), encoding="utf-8")
    np.testing.assert_allclose(imported(tmp_path, file).z[0], Z)


def test_options_that_contradict_the_names_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "a.csv", tmp_path / "out"
    file.write_text(table({"f [kHz]": F, "Re [N s/mm]": Z.real, "Im [N s/mm]": Z.imag}), encoding="utf-8")
    assert main(["import", str(file), "-o", str(out), "--unit", "N s/m", "--frequency-unit", "Hz"]) == 0
    said = "".join(capsys.readouterr())
    assert "but --unit says N s/m, which was used" in said
    assert "but --frequency-unit says Hz, which was used" in said
    np.testing.assert_allclose(read_recordings(out).subjects[0].z[0], Z)
    agreeing = ["--unit", "kN s/m", "--frequency-unit", "kHz"]
    assert main(["import", str(file), "-o", str(out), *agreeing]) == 0
    assert "which was used" not in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    "columns",
    [
        {"Frequency [Hz]": F, "Mobility [mm/s/N]": abs(MOBILITY), "Phase [deg]": ANGLE},
        {"Frequency [Hz]": F, "Mobility magnitude [mm/s/N]": abs(MOBILITY), "Phase [°]": ANGLE % 360},
        {"Frequency [Hz]": F, "Mobility real [mm/s/N]": MOBILITY.real, "Mobility imag [mm/s/N]": MOBILITY.imag},
        {"f / Hz": F, "Re(Z) / (N·s/m)": Z.real, "Im(Z) / (N·s/m)": Z.imag},
        {"f / kHz": F / 1e3, "Betrag / (N s/m)": abs(Z), "Winkel / °": np.angle(Z, deg=True)},
    ],
)
def test_words_of_forms_and_strokes_before_units_are_read(columns: dict[str, np.ndarray], tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(table(columns), encoding="utf-8")
    np.testing.assert_allclose(imported(tmp_path, file).z[0], Z, rtol=1e-9)


def test_an_unknown_unit_behind_a_name_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "a.csv"
    file.write_text(table({"f [Hz]": F, "Re [N s/metre]": Z.real, "Im [N s/metre]": Z.imag}), encoding="utf-8")
    assert main(["import", str(file), "-o", str(tmp_path / "out")]) == 2
    assert '"N s/metre" behind a name is no known unit' in capsys.readouterr().err


def test_columns_that_are_not_used_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The second channel of an analyser is not lost silently."""
    file = tmp_path / "a.csv"
    more = {f"Re{k} [N s/m]": Z.real for k in range(2, 11)}
    file.write_text(table({"f [Hz]": F, "Re [N s/m]": Z.real, "Im [N s/m]": Z.imag, **more}), encoding="utf-8")
    assert main(["import", str(file), "-o", str(tmp_path / "out")]) == 0
    said = "".join(capsys.readouterr())
    assert 'not used: "Re2 [N s/m]"' in said
    assert "(and 3 more)" in said


def test_a_minority_of_conjugates_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    for k in range(5):
        z = Z * (1 + 0.1 * k)
        z = z.conj() if k == 3 else z
        (folder / f"P{k}.csv").write_text(table({"f [Hz]": F, "Re [N s/m]": z.real, "Im [N s/m]": z.imag}))
    assert main(["import", str(folder), "-o", str(tmp_path / "out")]) == 0
    assert 'subject "P3": the phase agrees' in "".join(capsys.readouterr())
