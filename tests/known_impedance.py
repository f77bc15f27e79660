"""One impedance, written in many ways by tests of the intake."""

from pathlib import Path

import numpy as np

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import Subject, read_recordings

FREQUENCY = np.geomspace(5.0, 5000.0, 25)


def impedance(frequency_hz: np.ndarray = FREQUENCY) -> np.ndarray:
    """A mass of 1 g, a damper of 2 N s/m and a spring of 800 N/m, one upon the other."""
    s = 2j * np.pi * frequency_hz
    return 1e-3 * s + 2.0 + 800.0 / s


def imported(folder: Path, *arguments: object) -> Subject:
    """The only subject of a dataset that a successful import has written."""
    assert main(["import", *map(str, arguments), "-o", str(folder / "imported"), "--overwrite"]) == 0
    (subject,) = read_recordings(folder / "imported").subjects
    return subject


def table(columns: dict[str, np.ndarray], separator: str = ",", decimal: str = ".") -> str:
    """A table of text with all digits."""
    rows = zip(*(map(repr, map(float, column)) for column in columns.values()), strict=True)
    lines = [separator.join(cell.replace(".", decimal) for cell in row) for row in rows]
    return "\n".join([separator.join(columns), *lines]) + "\n"


def spectra_written(folder: Path) -> tuple[np.ndarray, np.ndarray, dict[str, str]]:
    """Frequencies and impedance of a dataset of one recording, and what is noted of it, as they stand in the files.

    The reader of datasets refuses some of them: the motor bench's Re z is below zero at most frequencies.
    """
    rows = np.loadtxt(folder / "recordings.csv", delimiter=",", skiprows=1, usecols=(2, 3, 4))
    noted = folder / "repetitions.csv"
    names, values = noted.read_text(encoding="utf-8").splitlines() if noted.exists() else ("", "")
    return rows[:, 0], rows[:, 1] + 1j * rows[:, 2], dict(zip(names.split(","), values.split(","), strict=True))
