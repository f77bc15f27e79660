"""From volts to the population's centre and a verdict, with the rig subtracted or taken out as a two-port.

Run from the repository's root: python analyses/from_signals/from_volts.py [-o OUT] [--seeds 22] [--diagnose]

For each seed signals of a virtual population on a rig with errors are simulated, imported once with the unloaded run
subtracted and once with the two-port of the rig, and the population is fitted. Writes results/centres.csv beside this
file, and prints how many posterior standard deviations the centres are off: from the true centre, and from the mean of
the very people that were simulated, which leaves their choice out. With ``--diagnose`` it also writes what ``diagnose``
finds in the first population, results/verdicts.json.
"""

import argparse
import csv
import json
import shutil
from pathlib import Path

import numpy as np

from bayes_impedance import FINGERTIP, FitSettings, diagnose, fit_population, parse, read_recordings
from bayes_impedance.commands.cli import main as command
from bayes_impedance.commands.simulate_signals import simulate_signals, without_noise
from bayes_impedance.population.fit import QUICK_SETTINGS

RESULTS = Path(__file__).resolve().parent / "results"
ELEMENTS = parse(FINGERTIP.network).elements
SUBJECTS, REPETITIONS, FREQUENCY_HZ = 12, 2, np.geomspace(5, 5000, 60)
SETTINGS = FitSettings(covariance="diagonal", draws=QUICK_SETTINGS.draws, sampler=QUICK_SETTINGS.sampler)
SUBTRACTED, TWO_PORT = "subtracted", "two-port"


def datasets(folder: Path, seed: int) -> dict[str, Path]:
    """Signals of one population, imported with both calibrations."""
    shutil.rmtree(folder, ignore_errors=True)
    words = simulate_signals(folder / "raw", FINGERTIP, SUBJECTS, REPETITIONS, FREQUENCY_HZ, seed)
    loads = slice(words.index("--known-load") + 1, words.index("--force"))
    channels = words[loads.stop :]
    unloaded = words[loads][0].removeprefix("open:")
    for way, calibration in (
        (SUBTRACTED, ["--unloaded", unloaded]),
        (TWO_PORT, ["--known-load", *words[loads]]),
    ):
        arguments = [words[0], *calibration, *channels, "--network", FINGERTIP.network, "-o", str(folder / way)]
        if command(["import", *arguments]) != 0:
            raise RuntimeError(f"seed {seed}: the import failed")
    shutil.rmtree(folder / "raw")
    return {way: folder / way for way in (SUBTRACTED, TWO_PORT)}


def centres(dataset: Path, way: str, seed: int) -> list[dict[str, object]]:
    """Posterior of the centre of each log element, with the truth and the mean of the simulated people."""
    fit = fit_population(read_recordings(dataset).in_memory(), settings=SETTINGS, seed=seed, workers=1)
    if fit.diagnostics.problems:
        print(f"seed {seed}, {way}: {'; '.join(fit.diagnostics.problems)}")
    people = without_noise(FINGERTIP, SUBJECTS, REPETITIONS, FREQUENCY_HZ, seed).log_elements.mean(axis=0)
    columns = [fit.kernel.elements.index(name) for name in ELEMENTS]  # beside those of what the calibration leaves
    mu = fit.parameters.mu[:, columns]
    return [
        {
            "seed": seed,
            "calibration": way,
            "element": name,
            "mean": f"{mu[:, i].mean():.6g}",
            "sd": f"{mu[:, i].std():.6g}",
            "true_centre": f"{np.log(FINGERTIP.central[name]):.6g}",
            "mean_of_people": f"{people[i]:.6g}",
        }
        for i, name in enumerate(ELEMENTS)
    ]


def summary(rows: list[dict[str, str]]) -> dict[str, dict[str, list[float]]]:
    """Mean over seeds of the deviations in posterior standard deviations: from the centre, and from the people."""
    found: dict[str, dict[str, list[float]]] = {}
    for way in (SUBTRACTED, TWO_PORT):
        for name in ELEMENTS:
            own = [row for row in rows if (row["calibration"], row["element"]) == (way, name)]
            mean, sd, truth, people = (
                np.array([float(row[key]) for row in own]) for key in ("mean", "sd", "true_centre", "mean_of_people")
            )
            found.setdefault(way, {})[name] = [float(np.mean((mean - to) / sd)) for to in (truth, people)]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/from_signals"))
    parser.add_argument("--seeds", type=int, default=22)
    parser.add_argument("--diagnose", action="store_true")
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    rows = []
    for seed in range(1, options.seeds + 1):
        for way, dataset in datasets(options.out / str(seed), seed).items():
            rows += centres(dataset, way, seed)
    with (RESULTS / "centres.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    for way, elements in summary(rows).items():
        for name, (from_centre, from_people) in elements.items():
            print(f"{way:12} {name:3} from the centre {from_centre:6.2f} sd, from the people {from_people:6.2f} sd")
    if options.diagnose:
        verdicts = {}
        for way in (SUBTRACTED, TWO_PORT):
            verdict = diagnose(
                read_recordings(options.out / "1" / way).in_memory(), seed=1, quick=True, workers=1
            ).verdict
            verdicts[way] = {
                "summary": verdict.summary,
                "found": {
                    f"{entry.id} at {entry.place}": {
                        n: [p.q05, p.median, p.q95, p.unit] for n, p in entry.parameters.items()
                    }
                    for entry in verdict.physics
                },
            }
        (RESULTS / "verdicts.json").write_text(json.dumps(verdicts, indent=2) + "\n", encoding="utf-8")
        print(json.dumps(verdicts, indent=2))


if __name__ == "__main__":
    main()
