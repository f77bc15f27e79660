"""All benchmarks in one run on one machine: ``make bench``, or ``python benchmarks/run.py --only kernel one_curve``.

Every part runs in a process of its own. Results go to ``results.json`` (parts that are not run keep their last ones),
the table into the README beside this script, the picture to ``benchmarks.png``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from report import draw, replace_between, table
from this_machine import machine

HERE = Path(__file__).resolve().parent
PARTS = ("kernel", "constructs", "one_curve", "population", "diagnosis", "end_to_end")
_BUSY, _PATIENCE_S = 0.5, 180
"""Load average from which another process competes for the cores, and the wait for it to fall below, in seconds: in
three minutes the load of the part before has decayed by exp(-3)."""


def one_part(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Measure one part in this process."""
    if name == "kernel":
        import kernel

        return kernel.measure()
    if name == "constructs":
        import constructs

        return constructs.measure()
    if name == "one_curve":
        import one_curve

        return one_curve.measure(options.slow_people)
    if name == "population":
        import population

        return population.measure(options.seed)
    if name == "diagnosis":
        import diagnosis

        return diagnosis.measure()
    import end_to_end

    return end_to_end.measure(options.rounds)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--seed", type=int, default=3, help="of the population")
    parser.add_argument("--rounds", type=int, default=3, help="warm runs of each command")
    parser.add_argument("--slow-people", type=int, default=71, help="how many people the slow programs are to fit")
    parser.add_argument("--part", choices=PARTS, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--out", type=Path, default=HERE)
    options = parser.parse_args(arguments)
    if options.part:
        print("RESULT " + json.dumps(one_part(options.part, options)))
        return
    path = options.out / "results.json"
    results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    here = machine()
    if set(options.only) == set(PARTS) or "machine" not in results:
        results["machine"] = here  # otherwise it stays that of the numbers that stay
    for part in options.only:
        load = _when_calm()
        print(
            f"{part}: the machine's load is {load:.1f}" + (" (busy: ratios will scatter)" * (load > _BUSY)), flush=True
        )
        results[part] = _apart(part, options) | {"load before": load, "date": here["date"]}
        options.out.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    text = table(results)
    print(text)
    draw(results, options.out / "benchmarks.png")
    if options.out == HERE:
        replace_between(HERE / "README.md", "results", text)


def _when_calm() -> float:
    """Wait until the machine's load is low, or until the patience ends; returns the load average."""
    for _ in range(_PATIENCE_S // 10):
        if os.getloadavg()[0] <= _BUSY:
            break
        time.sleep(10)
    return os.getloadavg()[0]


def _apart(part: str, options: argparse.Namespace) -> dict[str, Any]:
    """One part in a process of its own, with one thread for linear algebra as the commands have."""
    given = ["--seed", options.seed, "--rounds", options.rounds, "--slow-people", options.slow_people]
    command = [sys.executable, str(HERE / "run.py"), "--part", part, *map(str, given)]
    environment: Mapping[str, str] = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT ")]
    if done.returncode != 0 or not lines:
        raise SystemExit(f"{part} failed:\n{done.stderr[-3000:]}")
    return dict(json.loads(lines[-1].removeprefix("RESULT ")))


if __name__ == "__main__":
    main()
