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
