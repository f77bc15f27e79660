"""How often the Kramers-Kronig check says something of causal curves, and of faulty ones.

    python analyses/kramers_kronig/rates.py --causal 6000
    python analyses/kramers_kronig/rates.py --faulty 200 --noise 0.01

writes `results/causal.csv` (findings by kind of curve, channel and noise) or `results/faulty_0.01.csv` (by fault), a
minute each.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from pathlib import Path

import numpy as np
from worlds import BEHIND, KINDS, NOISES, draw_band, draw_curve, draw_noise_level, faulty, with_noise

from bayes_impedance.quality.kramers_kronig import disagreement


def causal(count: int, seed: int) -> list[tuple[str, str, int, int]]:
    of, found = Counter(), Counter()
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        f = draw_band(rng)
        # Half of the curves are networks, and half of the noise is what most recordings have.
        kind = str(rng.choice(KINDS, p=[0.7, 0.15, 0.15]))
        behind = str(rng.choice(BEHIND, p=[0.5, 0.1, 0.1, 0.15, 0.15]))
        noise = str(rng.choice(NOISES, p=[0.5, 0.1, 0.1, 0.1, 0.1, 0.1]))
        z = draw_curve(rng, f, kind, behind)(0 * f)
        said = disagreement(f, with_noise(rng, f, z, draw_noise_level(rng), noise)) is not None
        for key in (("all", "all"), ("curve", kind), ("behind", behind), ("noise", noise)):
            of[key] += 1
            found[key] += said
        if said:
            print("finding:", i, kind, behind, noise, f.size)
    return [(*key, found[key], of[key]) for key in of]


def planted(count: int, seed: int, level: float) -> list[tuple[str, int, int]]:
    found: Counter[str] = Counter()
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        f = draw_band(rng)
        curve = draw_curve(rng, f, "network", "nothing")
        e = rng.normal(size=f.size) + 1j * rng.normal(size=f.size)
        for name, z in {"none": curve(0 * f), **faulty(f, curve)}.items():
            found[name] += disagreement(f, z + level * np.abs(z) * e) is not None
    return [(name, said, count) for name, said in found.items()]


def write(file: Path, header: list[str], rows: list) -> None:
    file.parent.mkdir(exist_ok=True)
    with file.open("w", newline="") as out:
        csv.writer(out, lineterminator="\n").writerows([header, *rows])
    for row in rows:
        print(*row)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--causal", type=int, default=0)
    parser.add_argument("--faulty", type=int, default=0)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=50000)
    given = parser.parse_args()
    results = Path(__file__).parent / "results"
    with np.errstate(all="ignore"):
        if given.causal:
            write(results / "causal.csv", ["of", "which", "findings", "curves"], causal(given.causal, given.seed))
        if given.faulty:
            rows = planted(given.faulty, given.seed, given.noise)
            write(results / f"faulty_{given.noise:g}.csv", ["fault", "findings", "curves"], rows)


if __name__ == "__main__":
    main()
