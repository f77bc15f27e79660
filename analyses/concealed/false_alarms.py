"""Rate of false alarms: how often something is claimed to be missing in populations of the network itself.

Run from the repository's root::

    python analyses/concealed/false_alarms.py --populations 200 --jobs 2 -o analyses/concealed/results

Each population has the complications of real recordings, of sizes drawn at random: repositioning, noise that grows
below 12 Hz and differs between persons, a gain error, correlated elements, a centre of its own, and covariates that
nothing follows. Each is a line of ``false_alarms.jsonl``; those on file are skipped. The rate with its interval and the
claims go to ``false_alarms.csv`` and, between its markers, into the README beside this script.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from effects import concealed
from people import Conditions
from runs import Record, diagnose, read_lines, replace_between, run_cases
from scoring import clopper_pearson

HERE = Path(__file__).parent
FILE = "false_alarms.jsonl"


def conditions(seed: int) -> Conditions:
    """Draw the sizes of the complications."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    least = rng.uniform(0.02, 0.08)
    return Conditions(
        noise=float(np.exp(rng.uniform(np.log(0.005), np.log(0.02)))),
        noise_rise=float(rng.uniform(1.0, 5.0)),
        noise_scale_sd=float(rng.uniform(0.0, 0.25)),
        gain_error=float(rng.uniform(-0.05, 0.05)),
        repositioning=(float(least), float(least + rng.uniform(0.0, 0.04))),
        communality=float(rng.uniform(0.0, 0.95)),
        centre_sd=0.15,
    )


def one_population(case: Mapping[str, Any]) -> Record:
    """Make a population, diagnose it; returns its conditions and the verdict."""
    sizes = conditions(case["seed"])
    recordings, _ = concealed(
        "none", None, 0.0, case["seed"], n_subjects=case["subjects"], n_points=case["points"], conditions=sizes
    )
    return {"conditions": asdict(sizes), "verdict": diagnose(recordings, case["seed"], case["through_command"])}


def claims(records: Sequence[Record]) -> list[Record]:
    """One row for each population in which something was claimed."""
    return [
        {
            "seed": record["case"]["seed"],
            "claimed": " ".join(f"{p['id']}@{p.get('place')}" for p in record["verdict"].get("physics") or []) or "?",
            "pooling": " ".join(str(p.get("pooling")) for p in record["verdict"].get("physics") or []),
            "p_value": " ".join(
                f"{p['evidence']['p_value']:.2g}"
                for p in record["verdict"].get("physics") or []
                if (p.get("evidence") or {}).get("p_value") is not None
            ),
            **{k: v for k, v in record["conditions"].items() if k != "rise_below_hz"},
        }
        for record in records
        if "error" not in record and record["verdict"]["mismatch"]
    ]


def summary(records: Sequence[Record]) -> str:
    """Rate with its 95 % interval, and what was claimed."""
    ended = [record for record in records if "error" not in record]
    false = claims(ended)
    low, high = clopper_pearson(len(false), len(ended))
    lines = [f"Something was claimed in {len(false)} of {len(ended)} populations ({100 * low:.1f}-{100 * high:.1f} %)."]
    counts = Counter(claim for row in false for claim in row["claimed"].split())
    lines += [f"- `{claim}` {n} times" for claim, n in counts.most_common()]
    if len(ended) < len(records):
        lines.append(f"\n{len(records) - len(ended)} ended with an error and are not counted.")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--populations", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=1001)
    parser.add_argument("--jobs", type=int, default=2, help="processes; 0 works in this one")
    parser.add_argument("--subjects", type=int, default=40)
    parser.add_argument("--points", type=int, default=201)
    parser.add_argument("--through-command", action="store_true", help="write files and run the command with --quick")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results")
    options = parser.parse_args()

    sizes = {key: getattr(options, key) for key in ("subjects", "points", "through_command")}
    asked = [{"seed": options.first_seed + i, **sizes} for i in range(options.populations)]
    path = options.out / FILE
    run_cases(asked, one_population, path, options.jobs)
    records = [record for record in read_lines(path) if record["case"] in asked]
    rows = claims(records)
    with (options.out / "false_alarms.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["seed", "claimed"])
        writer.writeheader()
        writer.writerows(rows)
    text = summary(records)
    print(text)
    if (options.subjects, options.points) == (40, 201):
        replace_between(HERE / "README.md", "false-alarms", text)


if __name__ == "__main__":
    main()
