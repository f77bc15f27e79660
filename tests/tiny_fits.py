"""A fit of seconds by the command, for tests of what happens around a fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from conftest import THREE_ELEMENTS

from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import write_recordings


def tiny_dataset(folder: Path, seed: int = 1) -> Path:
    """Six people, one repetition, 20 frequencies, three elements."""
    recordings = simulate_recordings(THREE_ELEMENTS, 6, 1, np.geomspace(5, 5000, 20), seed).recordings
    write_recordings(recordings, folder, significant_digits=6)
    return folder


def fit_arguments(dataset: Path, out: Path, *more: str) -> list[str]:
    """Of the fit that is the same in all tests."""
    return ["fit", str(dataset), "-o", str(out), "--quick", "--covariance", "diagonal", "--network", "m1|r1|n1", *more]
