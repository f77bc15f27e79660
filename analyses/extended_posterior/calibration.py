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


def one(kind: str, seed: int) -> list[dict[str, object]]:
    """Fit one population: a row for each parameter and quantity."""
    recordings, centre, spread = population(kind, seed)
    fit = fit_population(recordings, settings=QUICK_SETTINGS, seed=seed + 1)
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
    """Coverage of each kind and quantity, over populations whose fit reports no problem."""
    print(f"{'kind':20s} {'populations':>11s} {'with problems':>13s}  coverage of 90 % intervals (and rms of z)")
    for file in sorted(HERE.glob("*.csv")):
        rows = list(csv.DictReader(file.open()))
        good = [r for r in rows if r["problems"] == "0" and r["identified"] == "1"]
        found = defaultdict(list)
        for r in good:
            found[r["quantity"]].append((int(r["covers"]), float(r["z"])))
        n, bad = len({r["seed"] for r in rows}), len({r["seed"] for r in rows if r["problems"] != "0"})
        said = "  ".join(
            f"{q} {100 * np.mean([c for c, _ in v]):.0f} % of {len(v)} ({np.sqrt(np.mean([z * z for _, z in v])):.2f})"
            for q, v in sorted(found.items())
        )
        print(f"{file.stem:20s} {n:11d} {bad:13d}  {said}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--populations", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    if options.table:
        table()
        return
    HERE.mkdir(exist_ok=True)
    for seed in range(options.first, options.first + options.populations):
        for kind in options.kind or KINDS:
            rows = one(kind, seed)
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
