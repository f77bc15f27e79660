"""Evaluate the published curves of appendix A on the paper's grid: makes the datasets in data/appendix_a.

Run from the repository's root: python analyses/appendix_a/make.py
"""

import tomllib
from pathlib import Path

import numpy as np

from bayes_impedance.network.notation import PAPER_NETWORK
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.recordings.files import Recordings, Subject, write_recordings

DATA = Path(__file__).parents[2] / "data" / "appendix_a"
NAMES = {"sit": "SIT", "vf_median": "VFMedian"}
FREQUENCY_HZ = np.geomspace(5, 5000, 401)


def published_curve(entry: dict[str, list[float]]) -> np.ndarray:
    """The impedance in N s/m with the sign turned, so that the finger is passive."""
    printed = TransferFunction.from_coefficients(entry["numerator"], entry["denominator"])
    return -printed(2j * np.pi * FREQUENCY_HZ)


def dataset(title: str, curves: dict[str, np.ndarray]) -> Recordings:
    """Each curve as a subject with one repetition."""
    subjects = tuple(
        Subject(name=name, frequency_hz=FREQUENCY_HZ, z=z[None], repetitions=("1",)) for name, z in curves.items()
    )
    source = (
        "appendix A of the paper, coefficients.toml; evaluated at 401 points, sign turned: fitted curves, no recordings"
    )
    return Recordings(
        title=title,
        unit="N s/m",
        network=PAPER_NETWORK,
        source=source,
        licence="facts, not protected",
        subjects=subjects,
    )


def main() -> None:
    coefficients = tomllib.loads((DATA / "coefficients.toml").read_text(encoding="utf-8"))
    curves = {NAMES[key]: published_curve(entry) for key, entry in coefficients.items()}
    titles = {NAMES[key]: entry["title"] for key, entry in coefficients.items()}
    write_recordings(dataset("the two published curves of 71 fingertips", curves), DATA, significant_digits=8)
    for key, name in NAMES.items():
        one = dataset(f"published curve of 71 fingertips: {titles[name]}", {name: curves[name]})
        write_recordings(one, DATA / key, significant_digits=8)


if __name__ == "__main__":
    main()
