"""Many small virtual populations with power laws, delays and other parameters of the rig, and how intervals hold.

    python analyses/extended_posterior/calibration.py KIND --populations 50 --first 0

Each population has a truth of its own: central values, dispersions and what is the same for all are drawn from the
seed.
A line for each goes to results/KIND.csv: for every parameter whether the 90 % interval contains the truth, and the rank
of the truth among the posterior's draws. ``--table`` prints the table of what is there.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.fit import QUICK_SETTINGS, fit_population
from bayes_impedance.recordings.files import Recordings, Subject

HERE = Path(__file__).parent / "results"
KINDS: dict[str, tuple[str, dict[str, float]]] = {
    "springpot": (
        "(n3|r3|p1^a1*@70)-(m2|r1|n1)",
        {"n3": 1e-4, "r3": 20.0, "p1": 30.0, "a1": 0.45, "m2": 1e-3, "r1": 2.0, "n1": 1e-3},
    ),
    "springpot_varying": ("m1|r1|p1^a1@70", {"m1": 5e-3, "r1": 1.0, "p1": 3.0, "a1": 0.35}),
    "relaxation": (
        "(n3|r3)-(m2|r1|n1|(r4-n4))",
        {"n3": 1e-4, "r3": 30.0, "m2": 1e-3, "r1": 2.0, "n1": 1e-3, "r4": 4.0, "n4": 1e-3},
    ),
    "delay": (
        "delay[d1*]((n3|r3)-(m2|r1|n1))",
        {"d1": 1e-4, "n3": 1e-4, "r3": 30.0, "m2": 1e-3, "r1": 2.0, "n1": 1e-3},
    ),
    "residual_mass": (
        "offset[m9*]((n3|r3)-(m2|r1|n1))",
        {"m9": 2e-4, "n3": 1e-4, "r3": 30.0, "m2": 1e-3, "r1": 2.0, "n1": 1e-3},
    ),
}
PEOPLE, REPETITIONS, POINTS, BAND_HZ, NOISE, BETWEEN_REPETITIONS = 16, 2, 50, (5.0, 1000.0), 0.01, 0.01
"""Of each population: small ones, where intervals are wide and any mistake in them shows."""


def population(kind: str, seed: int) -> tuple[Recordings, dict[str, float], dict[str, float]]:
    """Recordings of one population, its central values on the scale of u, and its dispersions."""
    notation, centre = KINDS[kind]
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    kernel = Kernel(parse(notation))
    mu, tau = np.empty(len(centre)), np.zeros(len(centre))
    for k, p in enumerate(kernel.parameters):
        value = centre[p.name]
        mu[k] = value * rng.normal() if p.link == "signed" else float(p.u(value)) + 0.2 * rng.normal()
        tau[k] = 0.0 if p.shared else rng.uniform(0.1, 0.35)
    frequency = np.geomspace(*BAND_HZ, POINTS)
    subjects = []
    for i in range(PEOPLE):
        theta = mu + tau * rng.normal(size=mu.size)
        own = theta + BETWEEN_REPETITIONS * (tau > 0) * rng.normal(size=(REPETITIONS, mu.size))
        z = kernel.impedance(own, frequency)
        z = z * (1 + NOISE * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))
        names = tuple(str(j + 1) for j in range(REPETITIONS))
        subjects.append(Subject(name=f"v{i:02d}", repetitions=names, frequency_hz=frequency, z=z, noise_sd=None))
    recordings = Recordings(
        subjects=tuple(subjects), title=kind, unit="N s/m", network=notation, source=None, licence=None
    )
    names = kernel.elements
    return recordings, dict(zip(names, mu, strict=True)), dict(zip(names, tau, strict=True))


def one(kind: str, seed: int, workers: int) -> list[dict[str, object]]:
    """Fit one population: a row for each parameter and quantity."""
    recordings, centre, spread = population(kind, seed)
    fit = fit_population(recordings, settings=QUICK_SETTINGS, seed=seed + 1, workers=workers)
    rows = []
    for k, name in enumerate(fit.kernel.elements):
        shared = fit.kernel.parameters[k].shared
        for quantity, draws, truth in (
            ("shared" if shared else "centre", fit.parameters.mu[:, k], centre[name]),
            ("dispersion", fit.parameters.between_persons[:, k], spread[name]),
        ):
            if quantity == "dispersion" and shared:
                continue
            low, high = np.quantile(draws, (0.05, 0.95))
            rows.append(
                {
                    "seed": seed,
                    "parameter": name,
                    "quantity": quantity,
                    "identified": int(fit.identified[k]),
                    "problems": len(fit.diagnostics.problems),
                    "covers": int(low <= truth <= high),
                    "rank": f"{np.mean(draws < truth):.4f}",
                    "z": f"{(truth - draws.mean()) / draws.std():.3f}",
                }
            )
    return rows


def table() -> None:
    """Coverage of each kind and quantity, over populations whose fit reports no problem.

    Intervals of one population are not independent: the standard error is that of the populations' own coverages. The
    ranks are tested in five equal classes, with as many independent ones as explain that standard error.
    """
    print("| kind | populations | with problems | quantity | intervals | coverage of 90 % | rms z | mean rank | p |")
    print("|---|---|---|---|---|---|---|---|---|")
    for file in sorted(HERE.glob("*.csv")):
        rows = list(csv.DictReader(file.open()))
        good = [r for r in rows if r["problems"] == "0" and r["identified"] == "1"]
        n, bad = len({r["seed"] for r in rows}), len({r["seed"] for r in rows if r["problems"] != "0"})
        for quantity in sorted({quantity_of(r) for r in good}):
            some = [r for r in good if quantity_of(r) == quantity]
            print(f"| {file.stem} | {n} | {bad} | {quantity} | {line(some)}")


def quantity_of(row: dict[str, str]) -> str:
    """What a row is about; an exponent's central value is a quantity of its own."""
    return "exponent" if row["parameter"].startswith("a") and row["quantity"] == "centre" else row["quantity"]


def line(rows: list[dict[str, str]]) -> str:
    """Number of intervals, coverage with its standard error, root mean square of z, mean rank, p of uniform ranks."""
    each = defaultdict(list)
    for r in rows:
        each[r["seed"]].append(float(r["covers"]))
    own = np.array([np.mean(v) for v in each.values()])
    covers, ranks, z = (np.array([float(r[k]) for r in rows]) for k in ("covers", "rank", "z"))
    coverage = covers.mean()
    error = max(own.std(ddof=1) / np.sqrt(own.size), np.sqrt(0.9 * 0.1 / len(rows))) if own.size > 1 else np.nan
    classes = np.bincount(np.minimum((5 * ranks).astype(int), 4), minlength=5)
    independent = min(1.0, 0.9 * 0.1 / (len(rows) * error**2))
    p = chi2.sf(independent * np.sum((classes - len(rows) / 5) ** 2 / (len(rows) / 5)), 4)
    return (
        f"{len(rows)} | {100 * coverage:.0f} ± {100 * error:.0f} % | {np.sqrt(np.mean(z**2)):.2f} | "
        f"{ranks.mean():.2f} | {p:.2g} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--populations", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    if options.table:
        table()
        return
    HERE.mkdir(exist_ok=True)
    for seed in range(options.first, options.first + options.populations):
        for kind in options.kind or KINDS:
            rows = one(kind, seed, options.workers)
            file = HERE / f"{kind}.csv"
            new = not file.exists()
            with file.open("a", newline="") as out:
                writer = csv.DictWriter(out, rows[0])
                if new:
                    writer.writeheader()
                writer.writerows(rows)
            print(kind, seed, "covered", sum(int(str(r["covers"])) for r in rows), "of", len(rows), flush=True)


if __name__ == "__main__":
    main()
