"""Simulation-based calibration of networks with power laws, delays and other parameters of the rig.

    python analyses/extended_posterior/calibration.py KIND --populations 50 --first 0

Each population's truth (central values, both dispersions, correlations, and what is the same for all) is drawn from the
very prior that its fit has, so that ranks of truths among posterior draws are uniform if the posterior is right (Talts
et al. 2018). A line for each parameter goes to results/KIND.csv: whether the 90 % interval contains the truth, and its
rank. ``--table`` prints the table of what is there.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.population.fit import QUICK_SETTINGS, fit_population
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior
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
PEOPLE, REPETITIONS, POINTS, BAND_HZ, NOISE = 16, 2, 50, (5.0, 1000.0), 0.01
"""Of each population: small ones, where intervals are wide and any mistake in them shows."""
CENTRE_SD, DISPERSION, CONCENTRATION = 0.2, 0.2, 2.0
"""The prior of fits and truths: central values around those in `KINDS` (natural logarithm, or logit), half-normal
dispersions between people and between repetitions, LKJ correlations. A signed parameter is normal about zero with the
listed value as its standard deviation."""
_STREAM = 7
"""First entropy of the truths' seeds: they are not those of the fits."""


def prior_of(kernel: Kernel, centre: dict[str, float]) -> GivenPrior:
    """The prior that the fit is told."""
    return GivenPrior(
        concentration=CONCENTRATION,
        dispersion=DISPERSION,
        elements={
            p.name: ElementPrior(centre=0.0, scale=centre[p.name])
            if p.link == SIGNED
            else ElementPrior(centre=centre[p.name], scale=CENTRE_SD)
            for p in kernel.parameters
        },
    )


def correlation_of(size: int, rng: np.random.Generator) -> np.ndarray:
    """A correlation matrix from LKJ, by its vine of partial correlations (Lewandowski, Kurowicka and Joe 2009)."""
    partial, result, beta = np.zeros((size, size)), np.eye(size), CONCENTRATION + (size - 1) / 2
    for k in range(size - 1):
        beta -= 0.5
        for i in range(k + 1, size):
            partial[k, i] = r = 2 * rng.beta(beta, beta) - 1
            for m in range(k - 1, -1, -1):
                r = r * np.sqrt((1 - partial[m, i] ** 2) * (1 - partial[m, k] ** 2)) + partial[m, i] * partial[m, k]
            result[k, i] = result[i, k] = r
    return result


def population(kind: str, seed: int) -> tuple[Recordings, GivenPrior, dict[str, dict[str, float]]]:
    """Recordings of one population, the prior, and the truth of each quantity by parameter, on the scale of u."""
    notation, centre = KINDS[kind]
    rng = np.random.default_rng([_STREAM, seed, list(KINDS).index(kind)])
    kernel = Kernel(parse(notation))
    signed = np.array([p.link == SIGNED for p in kernel.parameters])
    values = [centre[name] for name in kernel.elements]
    middle = np.array([0.0 if p.link == SIGNED else float(p.u(centre[p.name])) for p in kernel.parameters])
    varying = np.flatnonzero([not p.shared for p in kernel.parameters])
    mu = middle + np.where(signed, values, CENTRE_SD) * rng.normal(size=middle.size)
    tau = DISPERSION * np.abs(rng.normal(size=varying.size))
    rho = DISPERSION * np.abs(rng.normal(size=varying.size))
    factor = tau[:, None] * np.linalg.cholesky(correlation_of(varying.size, rng))
    frequency = np.geomspace(*BAND_HZ, POINTS)
    subjects = []
    for i in range(PEOPLE):
        own = np.tile(mu, (REPETITIONS, 1))
        own[:, varying] += factor @ rng.normal(size=varying.size)
        own[:, varying] += rho * rng.normal(size=(REPETITIONS, varying.size))
        z = kernel.impedance(own, frequency)
        z = z * (1 + NOISE * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))
        names = tuple(str(j + 1) for j in range(REPETITIONS))
        subjects.append(Subject(name=f"v{i:02d}", repetitions=names, frequency_hz=frequency, z=z, noise_sd=None))
    recordings = Recordings(
        subjects=tuple(subjects), title=kind, unit="N s/m", network=notation, source=None, licence=None
    )
    own_names = [kernel.elements[k] for k in varying]
    truth = {
        "centre": {name: mu[kernel.elements.index(name)] for name in own_names},
        "dispersion": dict(zip(own_names, tau, strict=True)),
        "repetitions": dict(zip(own_names, rho, strict=True)),
        "shared": {p.name: mu[k] for k, p in enumerate(kernel.parameters) if p.shared},
    }
    return recordings, prior_of(kernel, centre), truth


def one(kind: str, seed: int, workers: int) -> list[dict[str, object]]:
    """Fit one population: a row for each parameter and quantity."""
    recordings, prior, truth = population(kind, seed)
    fit = fit_population(recordings, settings=replace(QUICK_SETTINGS, prior=prior), seed=seed + 1, workers=workers)
    found = {
        "centre": fit.parameters.mu,
        "dispersion": fit.parameters.between_persons,
        "repetitions": fit.parameters.between_repetitions,
        "shared": fit.parameters.mu,
    }
    rows = []
    for k, name in enumerate(fit.kernel.elements):
        for quantity, draws in found.items():
            if name not in truth[quantity]:
                continue
            own, value = draws[:, k], truth[quantity][name]
            low, high = np.quantile(own, (0.05, 0.95))
            rows.append(
                {
                    "seed": seed,
                    "parameter": name,
                    "quantity": quantity,
                    "identified": int(fit.identified[k]),
                    "problems": len(fit.diagnostics.problems),
                    "covers": int(low <= value <= high),
                    "rank": f"{np.mean(own < value):.4f}",
                    "z": f"{(value - own.mean()) / own.std():.3f}",
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
    """What a row is about; an exponent's own central value is a quantity by itself."""
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
