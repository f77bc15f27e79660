"""Coverage of the intervals: how often the truth lies in them, over many virtual populations.

Run from the repository's root: python analyses/coverage/calibration.py [populations]. Writes calibration.csv beside it.
"""

import csv
import sys
from pathlib import Path

import numpy as np

from bayes_impedance import FINGERTIP, FitSettings, fit_population, parse, simulate_recordings
from bayes_impedance.population.fit import QUICK_SETTINGS
from bayes_impedance.population.simulate import Simulation

ELEMENTS = parse(FINGERTIP.network).elements
KINDS = ("central", "dispersion_between_persons", "dispersion_between_repetitions")


def one_population(seed: int, n_subjects: int, n_points: int, settings: FitSettings) -> list[dict[str, object]]:
    """Fit one population; for each parameter the quantile of the truth in its posterior (0 to 1)."""
    grid = np.geomspace(5, 5000, n_points)
    simulation: Simulation = simulate_recordings(FINGERTIP, n_subjects, 3, grid, seed)
    fit = fit_population(simulation.recordings, settings=settings, seed=seed)
    if fit.diagnostics.problems:
        raise RuntimeError("; ".join(fit.diagnostics.problems))
    draws = (np.exp(fit.parameters.mu), fit.parameters.between_persons, fit.parameters.between_repetitions)
    return [
        {
            "seed": seed,
            "element": name,
            "parameter": kind,
            "truth": simulation.truth["elements"][name][kind],
            "median": float(np.median(values[:, i])),
            "rank": float(np.mean(values[:, i] < simulation.truth["elements"][name][kind])),
        }
        for kind, values in zip(KINDS, draws, strict=True)
        for i, name in enumerate(ELEMENTS)
    ]


def coverage(rows: list[dict[str, object]], kinds: tuple[str, ...] = KINDS, level: float = 0.9) -> float:
    """Share of central intervals of a level that contain the truth."""
    ranks = np.array([row["rank"] for row in rows if row["parameter"] in kinds], dtype=float)
    return float(np.mean(np.abs(ranks - 0.5) < level / 2))


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    rows = [row for seed in range(1, n + 1) for row in one_population(seed, 40, 101, QUICK_SETTINGS)]
    with (Path(__file__).parent / "calibration.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    for kind in KINDS:
        levels = "  ".join(f"{100 * level:.0f} %: {coverage(rows, (kind,), level):.3f}" for level in (0.5, 0.9))
        print(f"{kind:32} {levels}")


if __name__ == "__main__":
    main()
