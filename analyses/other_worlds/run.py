"""Worlds that are not ours, from one command: draw, seal, diagnose blindly, score strictly.

Run from the repository's root::

    python analyses/other_worlds/run.py --cases 40 --seed 1 --jobs 1

Each verdict is appended to ``results/seed_1/verdicts.jsonl`` when it is there; an interrupted run goes on. A seed is
used once: a second use is refused without ``--again``, which marks its results. ``--score`` scores what is on file of
all seeds, diagnoses nothing, and writes ``results/table.csv`` and ``results/table.md``.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import sealed_cases
from blind import run
from drawing import draw
from drawn_worlds import described
from same_curve import same_curve
from strict_scoring import Row, markdown, score, write

HERE = Path(__file__).resolve().parent


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--again", action="store_true", help="use a seed a second time; its results are marked")
    parser.add_argument("--small", action="store_true", help="8 people and 41 frequencies, for a trial")
    parser.add_argument("--score", action="store_true", help="diagnose nothing: score what is on file")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results")
    options = parser.parse_args(arguments)
    out = options.out.resolve()
    if not options.score:
        folder = out / f"seed_{options.seed}"
        try:
            if sealed_cases.may_run(folder, options.cases, options.again):
                seal = sealed_cases.prepare(options.seed, options.cases, folder, options.small)
                print(f"sealed {options.cases} cases: SHA-256 {seal}", flush=True)
        except sealed_cases.SeedUsedError as error:
            print(error)
            return 2
        on_file = sealed_cases.verdicts_of(folder)
        waiting = [a for a in sealed_cases.answers_of(folder) if a["data_sha256"] not in on_file]
        for a in waiting:
            if sealed_cases.digest_of(folder / "datasets" / a["case"]) != a["data_sha256"]:
                print(f"the dataset of {a['case']} is not what was sealed")
                return 1
        run([folder / "datasets" / a["case"] for a in waiting], folder, options.jobs)
    rows = [row for folder in sorted(out.glob("seed_*")) for row in rows_of(folder)]
    write(rows, out)
    print(markdown(rows))
    return 0


def rows_of(folder: Path) -> list[Row]:
    """Rows of a seed's cases that have a verdict; the seal is checked, and that each verdict is of the sealed data.

    Where worlds are drawn in another way now, names alone decide.
    """
    sealed = json.loads((folder / sealed_cases.SEALED).read_text(encoding="utf-8"))
    seed, small = sealed["seed"], sealed.get("small", False)
    on_file = sealed_cases.verdicts_of(folder)
    rows = []
    for i, answer in enumerate(sealed_cases.answers_of(folder)):
        record = on_file.get(answer["data_sha256"])
        if record is None:
            continue
        verdict = record["verdict"]
        if verdict is not None and verdict["data_sha256"] != answer["data_sha256"]:
            raise ValueError(f"the verdict filed under {answer['case']} is of other data")
        world = draw(seed, i, small)
        today = json.loads(json.dumps(described(world)))
        alike = all(_equal(today[key], answer[key]) for key in today)
        rows.append(score(answer, record, (lambda v, world=world: same_curve(world, v)) if alike else None))
    return rows


def _equal(one: Any, other: Any) -> bool:
    """Equal to within rounding: the last digits of what is drawn differ between machines."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-9)
    return bool(one == other)


if __name__ == "__main__":
    raise SystemExit(main())
