"""Files that do not hold what their number says: one person again and again, a sweep that ends early, two commas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.intake.one_person import ALIKE, difference
from bayes_impedance.recordings import read_recordings

FREQUENCY = np.geomspace(5.0, 500.0, 60)
S = 2j * np.pi * FREQUENCY
CENTRE = np.array([2e-3, 0.3, 1e-3])


def curves(rng: np.random.Generator, files: int, spread: float, noise: float) -> np.ndarray:
    """Mass, damper and spring of objects that differ by `spread` in each, with relative noise."""
    m, r, n = (CENTRE * np.exp(spread * rng.normal(size=(files, 3)))).T[..., None]
    z = S * m + r + 1 / (S * n)
    sd = noise / np.sqrt(2)
    return np.asarray(z * (1 + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))))


def written(folder: Path, z: np.ndarray, name: str = "file{}.csv") -> Path:
    folder.mkdir()
    for i, own in enumerate(z):
        rows = [f"{f:.8g},{x.real:.8g},{x.imag:.8g}\n" for f, x in zip(FREQUENCY, own, strict=True)]
        (folder / name.format(i)).write_text("frequency_hz,z_re,z_im\n" + "".join(rows))
    return folder


@pytest.mark.parametrize("noise", [0.001, 0.01, 0.05])
def test_one_object_is_alike_apart_from_noise(noise: float) -> None:
    rng = np.random.default_rng(1)
    assert max(difference(FREQUENCY, curves(rng, 71, 0.0, noise)) for _ in range(20)) < ALIKE


@pytest.mark.parametrize("noise", [0.001, 0.05, 0.3])
@pytest.mark.parametrize("files", [3, 16, 71])
def test_a_finger_that_was_put_down_again_is_another_recording(noise: float, files: int) -> None:
    rng = np.random.default_rng(2)
    assert min(difference(FREQUENCY, curves(rng, files, 0.05, noise)) for _ in range(50)) > ALIKE


def test_the_difference_is_that_of_the_objects() -> None:
    """A level that differs by 4 % between many objects: the bound lies above it, by its error of a tenth."""
    rng = np.random.default_rng(3)
    z = curves(rng, 400, 0.0, 0.01) * np.exp(0.04 * rng.normal(size=(400, 1)))
    assert 0.04 < difference(FREQUENCY, z) < 0.046


def test_one_person_in_71_files_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path / "files", curves(np.random.default_rng(4), 71, 0.0, 0.01))
    out = tmp_path / "out"
    assert main(["import", str(files), "-o", str(out)]) == 2
    assert "71 files are taken for as many subjects by their names" in capsys.readouterr().err
    assert not out.exists()
    assert main(["import", str(files), "-o", str(out), "--subject-from-name", "(?P<subject>.+)"]) == 0
    assert len(read_recordings(out)) == 71
    pattern = r"(?P<subject>file)(?P<repetition>\d+)"
    assert main(["import", str(files), "-o", str(out), "--overwrite", "--subject-from-name", pattern]) == 0
    assert [len(one.repetitions) for one in read_recordings(out).subjects] == [71]


@pytest.mark.parametrize(
    ("spread", "options", "told"),
    [
        (0.04, (), True),
        (0.3, (), False),
        (0.04, ("--unit", "ohm"), False),
        (0.04, ("--subject-from-name", "(?P<subject>.+)"), False),
    ],
)
def test_a_finger_that_was_put_down_again_is_pointed_out(
    spread: float, options: tuple[str, ...], told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """People differ by more; cells of one kind do not, and who says what the names are is believed."""
    files = written(tmp_path / "files", curves(np.random.default_rng(8), 20, spread, 0.01))
    assert main(["import", str(files), "-o", str(tmp_path / "out"), *options]) == 0
    assert ("as one finger does that is put down again" in capsys.readouterr().out) is told


@pytest.mark.parametrize(("again", "told"), [(0.03, True), (0.3, False)])
def test_names_of_repetitions_are_pointed_out(
    again: float, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Five people in three files each; or fifteen people who only have such names."""
    rng = np.random.default_rng(7)
    people = np.log(CENTRE) + 0.3 * rng.normal(size=(5, 1, 3)) + again * rng.normal(size=(5, 3, 3))
    m, r, n = np.exp(people).reshape(15, 3).T[..., None]
    z = S * m + r + 1 / (S * n)
    folder = written(tmp_path / "files", z)
    for i in range(15):
        (folder / f"file{i}.csv").rename(folder / f"P{i // 3}_{i % 3 + 1}.csv")
    assert main(["import", str(folder), "-o", str(tmp_path / "out")]) == 0
    said = "".join(capsys.readouterr())
    assert ("15 subjects have names in 5 groups" in said) == told
    pattern = r"(?P<subject>.+?)[^\dA-Za-z]*(?P<repetition>\d+)$"
    assert (pattern in said) == told
    assert main(["import", str(folder), "-o", str(tmp_path / "five"), "--subject-from-name", pattern]) == 0
    assert [len(one.repetitions) for one in read_recordings(tmp_path / "five").subjects] == [3] * 5
    assert "groups that differ" not in "".join(capsys.readouterr())


@pytest.mark.parametrize("name", ["file{}.csv", "P_{}.csv"])
def test_a_file_that_was_cut_between_rows_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A person, or a repetition among others."""
    files = written(tmp_path / "files", curves(np.random.default_rng(5), 6, 0.2, 0.01), name)
    cut, out = files / name.format(3), tmp_path / "out"
    cut.write_text("".join(cut.read_text().splitlines(keepends=True)[:41]))
    command = ["import", str(files), "-o", str(out)]
    if "_" in name:
        command += ["--subject-from-name", r"(?P<subject>[^_]+)_(?P<repetition>\d+)"]
    assert main(command) == 2
    told = capsys.readouterr().err
    assert f"{cut}: the frequencies end at" in told
    assert "5 others have the same and go on" in told
    assert not out.exists()
    assert main([*command, "--stopped-sweeps"]) == 0
    assert min(one.frequency_hz.size for one in read_recordings(out).subjects) == 40
    assert main(["import", "--again", str(out), "-o", str(tmp_path / "again")]) == 0


@pytest.mark.parametrize("digits", [".8g", ".4f"])
def test_decimal_commas_beside_commas_are_refused(
    digits: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    z = curves(np.random.default_rng(6), 1, 0.0, 0.01)[0]
    rows = [f"{f:{digits}},{x.real:{digits}},{x.imag:{digits}}\n" for f, x in zip(FREQUENCY, z, strict=True)]
    file = tmp_path / "a.csv"
    file.write_text("frequency_hz,z_re,z_im\n" + "".join(rows).replace(".", ","))
    assert main(["import", str(file), "-o", str(tmp_path / "out")]) == 2
    assert "decimal commas, and commas between the columns too" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    # Columns without decimals beside them, and numbers that happen to have none.
    long = "".join(f"P1,1,{row}" for row in rows).replace(".", ",")
    for content in (long, long.replace(",0000\n", "\n")):
        file.write_text("subject,repetition,frequency_hz,z_re,z_im\n" + content)
        assert main(["import", str(file), "-o", str(tmp_path / "out")]) == 2
        assert "decimal commas, and commas between the columns too" in capsys.readouterr().err


def test_whole_numbers_below_a_title_are_no_decimals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text(
        "Recorder, run 5\n" + "".join(f"{i},{i * 7 % 13},{i * 5 % 11}\n" for i in range(50))
    )
    assert main(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "out")]) == 2
    assert "no column is clearly the frequency (found: column 1, column 2, column 3)" in capsys.readouterr().err
