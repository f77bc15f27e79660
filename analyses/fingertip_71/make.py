"""Make the virtual population of data/fingertip_71: 71 subjects, 3 repetitions, 401 points, and the truth beside it.

Run from the repository's root: python analyses/fingertip_71/make.py
"""

import json
from pathlib import Path

import numpy as np

from bayes_impedance import FINGERTIP, parse, simulate_recordings, write_recordings

FOLDER = Path(__file__).parents[2] / "data" / "fingertip_71"
SEED = 71


def main() -> None:
    simulation = simulate_recordings(
        FINGERTIP, 71, 3, np.geomspace(5, 5000, 401), SEED, "71 virtual fingertips (simulated, not measured)"
    )
    write_recordings(simulation.recordings, FOLDER, significant_digits=6, compress=True)
    (FOLDER / "truth.json").write_text(json.dumps(simulation.truth, indent=2) + "\n", encoding="utf-8")
    header = ",".join(["subject", *parse(FINGERTIP.network).elements])
    rows = [
        ",".join([name, *(f"{value:.6g}" for value in np.exp(log_elements))])
        for name, log_elements in zip(simulation.recordings.names, simulation.log_elements, strict=True)
    ]
    (FOLDER / "truth_subjects.csv").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
