"""Whether intervals hold where the calibration is noticeably off: its uncertainty carried on by the fit, or not.

Run from the repository's root: python analyses/from_signals/carried.py [-o OUT] [--seeds 12] [--first 1]
[--calibration smooth | "each frequency" | unloaded]

People are alike here (5 % in each element), so that the mean of 16 of them is known to 1.3 %; the runs with known
loads are noisy, so that the calibration is off by some per cent, in each seed in another way. The population is fitted
with the common error of the calibration as the import writes it, and without it: of the six parameters of a rig, of the
map of each frequency, or of a single unloaded run that is subtracted, from a rig of which nothing else is wrong. Writes
results/carried.csv (carried_each_frequency.csv, carried_unloaded.csv) beside this file, and prints how often the 90 %
intervals of the centres hold the true centre, and the mean of the very people; of the dispersions the true one; and of
the persons' own elements theirs, in the mean of their repetitions.
"""

import argparse
import csv
from dataclasses import dataclass, replace
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
NOISE = 0.01
"""Of a part of the measured value of people's recordings, over its size."""
LOADS = {"open": 0.0, "mass=10 g": 0.01, "mass=50 g": 0.05}
CARRIED, EXACT = "carried on", "taken as exact"


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Runs, their noise over their size, and the rig."""

    loads: tuple[str, ...]
    noise: float
    options: tuple[str, ...]
    rig: SimulatedRig
    results: str


CALIBRATIONS = {
    "smooth": Calibration(
        loads=tuple(LOADS), noise=0.25, options=("--rig", "smooth"), rig=SimulatedRig(), results="carried.csv"
    ),
    "each frequency": Calibration(
        loads=tuple(LOADS),
        noise=0.01,
        options=("--rig", "each frequency"),
        rig=SimulatedRig(),
        results="carried_each_frequency.csv",
    ),
    "unloaded": Calibration(
        loads=("open",),
        noise=0.2,
        options=(),
        rig=SimulatedRig(gain=1.0, delay_s=0.0, mount=0.0),
        results="carried_unloaded.csv",
    ),
}


def dataset(folder: Path, seed: int, calibration: Calibration) -> tuple[Path, np.ndarray]:
    """Recordings behind a rig, imported with noisy runs; and the log elements of each person (N, P)."""
    rng, rig = np.random.default_rng(seed), calibration.rig
    simulation = simulate_recordings(PEOPLE, SUBJECTS, REPETITIONS, FREQUENCY_HZ, seed)
    people = folder / "people"
    people.mkdir(parents=True, exist_ok=True)
    for one in simulation.recordings.subjects:
        for name, z in zip(one.repetitions, one.z, strict=True):
            write(people / f"{one.name}_{name}.csv", rig.measured(FREQUENCY_HZ, z), NOISE, rng)
    words = []
    for name in calibration.loads:
        file = folder / f"{name.replace('=', '_').replace(' ', '_')}.csv"
        write(file, rig.measured(FREQUENCY_HZ, 2j * np.pi * FREQUENCY_HZ * LOADS[name]), calibration.noise, rng)
        words.append(f"{name}:{file}")
    out = folder / "dataset"
    pattern = r"(?P<subject>[^_]+)_(?P<repetition>\d+)"
    arguments = [str(people), "--subject-from-name", pattern, *calibration.options, "--network", PEOPLE.network]
    if command(["import", *arguments, "--known-load", *words, "-o", str(out), "--overwrite"]) != 0:
        raise RuntimeError(f"seed {seed}: the import failed")
    return out, np.array([log_elements(one.z) for one in simulation.recordings.subjects])


def log_elements(z: np.ndarray) -> np.ndarray:
    """Exact log elements of a mass, damper and spring, mean over the repetitions of z (J, F)."""
    omega = 2 * np.pi * FREQUENCY_HZ
    columns = np.stack([omega, -1 / omega], axis=1)
    mass, stiffness = np.linalg.lstsq(columns, z.imag.T, rcond=None)[0]
    by_name = {"m1": mass, "r1": z.real.mean(axis=1), "n1": 1 / stiffness}
    return np.array([np.log(by_name[name]).mean() for name in ELEMENTS])


def write(file: Path, z: np.ndarray, noise: float, rng: np.random.Generator) -> None:
    """A spectrum with noise in proportion to its size, and its standard deviation."""
    sd = noise * np.abs(z)
    noisy = z + sd * (rng.normal(size=z.size) + 1j * rng.normal(size=z.size))
    rows = np.column_stack([FREQUENCY_HZ, noisy.real, noisy.imag, sd])
    np.savetxt(file, rows, delimiter=",", header="frequency_hz,z_re,z_im,noise_sd", comments="")


def centres(folder: Path, seed: int, calibration: Calibration) -> list[dict[str, object]]:
    """Posterior of the centre of each log element in both ways."""
    out, people = dataset(folder, seed, calibration)
    recordings, rows = read_recordings(out), []
    for way, own in ((CARRIED, recordings), (EXACT, replace(recordings, calibration=None, calibration_map=None))):
        fit = fit_population(own, settings=QUICK_SETTINGS, seed=seed, workers=1)
        if fit.diagnostics.problems:
            print(f"seed {seed}, {way}: {'; '.join(fit.diagnostics.problems)}")
        print(f"seed {seed}, {way}: {sum(fit.seconds.values()):.0f} s, missed {fit.diagnostics.missed:.2g}", flush=True)
        for i, name in enumerate(ELEMENTS):
            column = fit.kernel.elements.index(name)
            mu, spread = fit.parameters.mu[:, column], fit.parameters.between_persons[:, column]
            low, high = np.quantile(mu, [0.05, 0.95])
            spread_low, spread_high = np.quantile(spread, [0.05, 0.95])
            own = np.quantile(fit.person_draws[..., column], [0.05, 0.95], axis=(0, 1))
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
                    "mean_of_people": f"{people[:, i].mean():.6g}",
                    "spread_low": f"{spread_low:.6g}",
                    "spread_high": f"{spread_high:.6g}",
                    "persons_held": int(np.sum((own[0] <= people[:, i]) & (people[:, i] <= own[1]))),
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
    parser.add_argument("--calibration", choices=CALIBRATIONS, default="smooth")
    options = parser.parse_args()
    calibration = CALIBRATIONS[options.calibration]
    RESULTS.mkdir(exist_ok=True)
    rows: list[dict[str, object]] = []
    for seed in range(options.first, options.first + options.seeds):
        rows += centres(options.out / options.calibration / str(seed), seed, calibration)
        with (RESULTS / calibration.results).open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    for way in (CARRIED, EXACT):
        for of in ("true_centre", "mean_of_people"):
            hits, total = coverage(rows, way, of)
            print(f"{way}: {hits} of {total} intervals hold the {of.replace('_', ' ')}")
        spreads = [
            float(str(r["spread_low"])) <= PEOPLE.between_persons[str(r["element"])] <= float(str(r["spread_high"]))
            for r in rows
            if r["calibration"] == way
        ]
        held = [int(str(r["persons_held"])) for r in rows if r["calibration"] == way]
        print(f"{way}: {sum(spreads)} of {len(spreads)} intervals hold the true dispersion")
        print(f"{way}: {sum(held)} of {len(held) * SUBJECTS} intervals of the persons' elements hold theirs")


if __name__ == "__main__":
    main()
