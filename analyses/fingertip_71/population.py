"""The shipped population: what virtual users need of a finished fit of the 71 virtual fingertips, in a small file.

``make demo``, then ``python analyses/fingertip_71/population.py out/demo`` writes ``data/fingertip_71/population``.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_impedance.datasets.shipped import POPULATION
from bayes_impedance.results.result import SECONDS_FILE, Result, load_result, save_result

FOLDER = Path(__file__).resolve().parents[2] / "data" / "fingertip_71" / POPULATION
KEPT = ("mu", "dispersion_between_persons", "dispersion_between_repetitions", "correlation")
AXES = ("element", "element_2", "frequency_hz")
DRAWS = 1000
"""Draws of all ensembles together. By choice: their Monte-Carlo error is 3 % of a posterior standard deviation."""


def thinned(result: Result, draws: int = DRAWS) -> Result:
    """The population's parameters of evenly spaced draws, in single precision.

    The axis of frequencies keeps its labels through one variable over it.
    """
    posterior = result.groups["posterior"]
    chains, length = posterior["mu"].shape[:2]
    rows = np.linspace(0, length - 1, draws // chains).astype(int)
    groups = {
        "posterior": {name: posterior[name][:, rows].astype(np.float32) for name in KEPT},
        "constant_data": {
            "network_curve": result.groups["constant_data"]["network_curve"].astype(np.float32),
            "identified": result.groups["constant_data"]["identified"],
        },
    }
    coords = {name: result.coords[name] for name in (*AXES, "part")}
    return replace(result, groups=groups, coords=coords)


def main(folder: Path) -> None:
    save_result(thinned(load_result(folder)), FOLDER)
    (FOLDER / SECONDS_FILE).unlink()  # of the machine that made the file


if __name__ == "__main__":
    main(Path(sys.argv[1]))
