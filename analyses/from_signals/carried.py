"""Whether intervals hold where the calibration is noticeably off: its uncertainty carried on by the fit, or not.

Run from the repository's root: python analyses/from_signals/carried.py [-o OUT] [--seeds 12] [--first 1]

People are alike here (5 % in each element), so that the mean of 16 of them is known to 1.3 %; the runs with known
loads are noisy, so that the calibration is off by some per cent, in each seed in another way. The population is fitted
with the common error of the calibration as the import writes it, and without it. Writes results/carried.csv beside this
file, and prints how often the 90 % intervals of the centres hold the true centre, and the mean of the very people.
"""

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_impedance import fit_population, parse, read_recordings
from bayes_impedance.commands.cli import main as command
from bayes_impedance.intake.simulated_rig import SimulatedRig
from bayes_impedance.population.fit import QUICK_SETTINGS
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings

RESULTS = Path(__file__).resolve().parent / "results"
PEOPLE = VirtualPopulation(
    network="m1|r1|n1",
    central={"m1": 2e-3, "r1": 2.0, "n1": 5e-4},
    between_persons={"m1": 0.05, "r1": 0.05, "n1": 0.05},
    between_repetitions={"m1": 0.02, "r1": 0.02, "n1": 0.02},
    noise=0.0,
)
ELEMENTS = parse(PEOPLE.network).elements
SUBJECTS, REPETITIONS, FREQUENCY_HZ = 16, 2, np.geomspace(10, 1000, 30)
NOISE, CALIBRATION_NOISE = 0.01, 0.25
"""Of a part of the measured value, over its size: of people's recordings and of runs with known loads."""
LOADS = {"open": 0.0, "mass=10 g": 0.01, "mass=50 g": 0.05}
CARRIED, EXACT = "carried on", "taken as exact"


def dataset(folder: Path, seed: int) -> tuple[Path, np.ndarray]:
    """Recordings behind a rig, imported with noisy runs; and the people's mean log elements."""
    rng, rig = np.random.default_rng(seed), SimulatedRig()
    simulation = simulate_recordings(PEOPLE, SUBJECTS, REPETITIONS, FREQUENCY_HZ, seed)
    people = folder / "people"
    people.mkdir(parents=True, exist_ok=True)
    for one in simulation.recordings.subjects:
        for name, z in zip(one.repetitions, one.z, strict=True):
            write(people / f"{one.name}_{name}.csv", rig.measured(FREQUENCY_HZ, z), NOISE, rng)
    words = []
    for name, mass in LOADS.items():
        file = folder / f"{name.replace('=', '_').replace(' ', '_')}.csv"
        write(file, rig.measured(FREQUENCY_HZ, 2j * np.pi * FREQUENCY_HZ * mass), CALIBRATION_NOISE, rng)
        words.append(f"{name}:{file}")
    out = folder / "dataset"
    pattern = r"(?P<subject>[^_]+)_(?P<repetition>\d+)"
    arguments = [str(people), "--subject-from-name", pattern, "--rig", "smooth", "--network", PEOPLE.network]
    if command(["import", *arguments, "--known-load", *words, "-o", str(out), "--overwrite"]) != 0:
        raise RuntimeError(f"seed {seed}: the import failed")
    return out, simulation.log_elements.mean(axis=0)


def write(file: Path, z: np.ndarray, noise: float, rng: np.random.Generator) -> None:
    """A spectrum with noise in proportion to its size, and its standard deviation."""
    sd = noise * np.abs(z)
    noisy = z + sd * (rng.normal(size=z.size) + 1j * rng.normal(size=z.size))
    rows = np.column_stack([FREQUENCY_HZ, noisy.real, noisy.imag, sd])
    np.savetxt(file, rows, delimiter=",", header="frequency_hz,z_re,z_im,noise_sd", comments="")


def centres(folder: Path, seed: int) -> list[dict[str, object]]:
    """Posterior of the centre of each log element in both ways."""
    out, people = dataset(folder, seed)
    recordings, rows = read_recordings(out), []
    for way, own in ((CARRIED, recordings), (EXACT, replace(recordings, calibration=None))):
        fit = fit_population(own, settings=QUICK_SETTINGS, seed=seed, workers=1)
        if fit.diagnostics.problems:
            print(f"seed {seed}, {way}: {'; '.join(fit.diagnostics.problems)}")
        print(f"seed {seed}, {way}: {sum(fit.seconds.values()):.0f} s, missed {fit.diagnostics.missed:.2g}", flush=True)
        for i, name in enumerate(ELEMENTS):
            mu = fit.parameters.mu[:, fit.kernel.elements.index(name)]
            low, high = np.quantile(mu, [0.05, 0.95])
            rows.append(
                {
                    "seed": seed,
                    "calibration": way,
                    "element": name,
                    "mean": f"{mu.mean():.6g}",
                    "sd": f"{mu.std():.6g}",
                    "low": f"{low:.6g}",
                    "high": f"{high:.6g}",
                    "true_centre": f"{np.log(PEOPLE.central[name]):.6g}",
                    "mean_of_people": f"{people[i]:.6g}",
                    "problems": len(fit.diagnostics.problems),
                }
            )
    return rows


def coverage(rows: list[dict[str, object]], way: str, of: str) -> tuple[int, int]:
    """How many 90 % intervals hold the truth, and of how many."""
    own = [row for row in rows if row["calibration"] == way]
    return sum(float(str(r["low"])) <= float(str(r[of])) <= float(str(r["high"])) for r in own), len(own)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/carried"))
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=1)
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    rows: list[dict[str, object]] = []
    for seed in range(options.first, options.first + options.seeds):
        rows += centres(options.out / str(seed), seed)
        with (RESULTS / "carried.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    for way in (CARRIED, EXACT):
        for of in ("true_centre", "mean_of_people"):
            hits, total = coverage(rows, way, of)
            print(f"{way}: {hits} of {total} intervals hold the {of.replace('_', ' ')}")


if __name__ == "__main__":
    main()
