"""Coverage of the design answer's interval: how often it contains the limit of the population that was simulated.

    python analyses/honesty/design_limit.py [populations]

Every population has a centre, spreads and a correlation of its own. 18 of its people are recorded and fitted, and the
stiffness up to which a device is stable with 99 % of the population is asked for as :func:`design_answer` asks for it.
The truth is the quantile of the limits of 2048 evenly spread users of the true population, decided one by one. Writes
``design_limit.csv`` beside itself, a line as soon as a population is done, and goes on where it was stopped.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from bayes_impedance import FitSettings, fit_population, make_result, parse, predict, simulate_recordings
from bayes_impedance.design import PHANTOM, Users, largest_stiffness, limit_of, population_of
from bayes_impedance.design.loop.stability import loop_of
from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population.simulate import VirtualPopulation

NETWORK = "m1|r1|n1"
ELEMENTS = parse(NETWORK).elements
PEOPLE, REPETITIONS, GRID = 18, 2, np.geomspace(5, 500, 16)
SHARE, DAMPING, HIGHEST = 0.99, 0.0, 1e7
TRUE_USERS = 2048
SETTINGS = FitSettings(draws=256, sampler=SamplerSettings(ensembles=2, chunk=100, longest=1500, effective=600.0))
FILE = Path(__file__).with_suffix(".csv")


def drawn(rng: np.random.Generator) -> VirtualPopulation:
    """A population: fingers of some size, unlike each other by 15 to 45 %."""
    sizes = np.array([2e-3, 3.0, 1e-3]) * np.exp(0.3 * rng.normal(size=3))
    return VirtualPopulation(
        network=NETWORK,
        central=dict(zip(ELEMENTS, sizes.tolist(), strict=True)),
        between_persons=dict(zip(ELEMENTS, rng.uniform(0.15, 0.45, 3).tolist(), strict=True)),
        between_repetitions=dict.fromkeys(ELEMENTS, 0.05),
        correlation={("m1", "r1"): float(rng.uniform(-0.6, 0.6))},
    )


def true_limit(population: VirtualPopulation, seed: int) -> float:
    """The population's limit from many of its users."""
    tau = population.vector(population.between_persons)
    factor = tau[:, None] * np.linalg.cholesky(population.correlation_matrix())
    normals = ndtri(qmc.Sobol(len(ELEMENTS), rng=np.random.default_rng(seed)).random(TRUE_USERS))
    log_elements = np.log(population.vector(population.central)) + normals @ factor.T
    users = Users(parse(NETWORK), "N s/m", tuple(map(str, range(TRUE_USERS))), log_elements)
    each, _ = largest_stiffness(loop_of(PHANTOM, users), DAMPING, HIGHEST, halvings=8)
    return float(np.quantile(each, 1 - SHARE))


def one(seed: int) -> dict[str, object]:
    """One population: its limit, and what the design answer says of it."""
    truth = drawn(np.random.default_rng(seed))
    recordings = simulate_recordings(truth, PEOPLE, REPETITIONS, GRID, seed).recordings
    fit = fit_population(recordings, NETWORK, settings=SETTINGS, seed=seed)
    population = population_of(make_result(fit, predict(fit), {}))
    limit = limit_of(population, population.draw(40, seed), PHANTOM, DAMPING, share=SHARE, highest=HIGHEST, seed=seed)
    return {
        "seed": seed,
        "truth": true_limit(truth, seed),
        "limit": limit.stiffness,
        "q05": limit.low,
        "q95": limit.high,
    }


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    rows: list[dict[str, object]] = []
    if FILE.exists():
        with FILE.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    for seed in range(len(rows) + 1, n + 1):
        rows.append(one(seed))
        with FILE.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    columns = np.array([[float(str(row[k])) for k in ("truth", "limit", "q05", "q95")] for row in rows])
    truth, limit, low, high = columns.T
    covered = (low <= truth) & (truth <= high)
    error = np.sqrt(covered.mean() * (1 - covered.mean()) / len(rows))
    print(f"{len(rows)} populations: the 90 % interval contains the true limit in {100 * covered.mean():.0f} %")
    print(f"(Monte-Carlo error {100 * error:.1f} %; below it {np.sum(truth < low)}, above it {np.sum(truth > high)})")
    print(f"the limit is {100 * np.median(np.abs(np.log(limit / truth))):.0f} % off (median)")


if __name__ == "__main__":
    main()
