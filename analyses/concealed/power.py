"""Power of the screen against strength, number of people and noise.

Run from the repository's root::

    python analyses/concealed/power.py --repeats 8 --jobs 2 -o analyses/concealed/results/power

The fast part of the diagnosis only: the network is fitted and all candidates are screened once, with the correction
for many. *Detected* is a corrected p below the diagnosis' own level; *named* says that the candidate with the largest
score has a right id. The full diagnosis refits the best candidates and requires more, so it claims slightly less. Each
case is a line of ``power.jsonl``; cases on file are skipped. Curves with 95 % intervals (Clopper-Pearson) go to
``power.png``, the table to ``power.md`` and between its markers into CHALLENGE.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from challenge import recordings_of
from runs import Record, read_lines, replace_between, run_cases
from scoring import clopper_pearson
from visible_in_world import truth_of
from world.experiment import Conditions, Plan, conduct
from world.kinds import KINDS

HERE = Path(__file__).resolve().parent
FILE = "power.jsonl"
POWER_KINDS = ("rig.delay", "body.mass", "body.springpot.tissue", "body.line")
BASE = {"strength": 0.15, "subjects": 40, "noise": 0.01}
VARIED: Mapping[str, Sequence[float]] = {
    "strength": (0.02, 0.05, 0.1, 0.2, 0.35, 0.5),
    "subjects": (5, 10, 20, 40, 80, 200),
    "noise": (0.003, 0.01, 0.03),
}


def one_case(case: Mapping[str, Any]) -> Record:
    """Conduct, fit, screen."""
    from threadpoolctl import threadpool_limits

    from bayes_impedance.diagnosis import catalogue  # noqa: F401  (fills the register)
    from bayes_impedance.diagnosis.catalogue.effect import registered
    from bayes_impedance.diagnosis.fit.baseline import fit_network
    from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
    from bayes_impedance.diagnosis.selection.score_scan import screen
    from bayes_impedance.diagnosis.selection.shortlist import ALPHA
    from bayes_impedance.diagnosis.selection.step import Step

    plan = Plan(
        kinds=(case["kind"],),
        strengths=(case["strength"],),
        seed=case["seed"],
        n_subjects=int(case["subjects"]),
        n_points=case["points"],
        conditions=Conditions(noise=case["noise"]),
    )
    experiment = conduct(plan)
    recordings = recordings_of(experiment, "power")
    with threadpool_limits(1), ThreadPoolExecutor(1) as executor:
        fitted = fit_network(recordings, None, case["seed"], executor, lambda *_: None)
        residuals = tuple(person_residuals(fitted.fit, recordings.names))
        screening = screen(fitted.fit, residuals, registered(), case["seed"], executor)
    step = Step(fitted.fit, residuals, screening, (), None)
    z = np.where(screening.physical, np.abs(np.nan_to_num(screening.z)), 0.0)
    said = screening.candidates[int(np.argmax(z))].effect.id
    detected = bool(step.log_p < np.log(ALPHA))
    right = said in KINDS[case["kind"]].answers
    return {"detected": detected, "said": said, "named": detected and right, "visible": truth_of(experiment)["visible"]}


def cases(repeats: int, points: int, kinds: Sequence[str]) -> list[Record]:
    """Cases along each quantity, the others at :data:`BASE`; ordered by repeat, so that curves grow together."""
    asked: list[Record] = []
    for repeat in range(repeats):
        for name, grid in VARIED.items():
            for value in grid:
                for kind in kinds:
                    case = {"kind": kind, **BASE, name: value, "points": points, "seed": 5000 + repeat}
                    if case not in asked:
                        asked.append(case)
    return asked


def curve(records: Sequence[Record], kind: str, name: str, key: str) -> list[tuple[float, int, int]]:
    """Value, hits and cases along one quantity."""
    others = {k: v for k, v in BASE.items() if k != name}
    rows = [r for r in records if r["case"]["kind"] == kind and all(r["case"][k] == v for k, v in others.items())]
    found = []
    for value in VARIED[name]:
        here = [bool(r[key]) for r in rows if r["case"][name] == value]
        if here:
            found.append((value, sum(here), len(here)))
    return found


def table(records: Sequence[Record], kinds: Sequence[str]) -> str:
    """Detected and named along each quantity, with intervals of the detection."""
    lines = []
    for name, grid in VARIED.items():
        rest = ", ".join(f"{k} {v:g}" for k, v in BASE.items() if k != name)
        lines += [f"Against {name} ({rest}), detected / named of cases, interval of detected, median visible:", ""]
        lines += ["| effect | " + " | ".join(f"{v:g}" for v in grid) + " |", "|" + "---|" * (len(grid) + 1)]
        for kind in kinds:
            named = {value: hits for value, hits, _ in curve(records, kind, name, "named")}
            cells = {}
            for value, hits, n in curve(records, kind, name, "detected"):
                low, high = clopper_pearson(hits, n)
                here = [r["visible"] for r in records if _at(r, kind, name, value)]
                cells[value] = (
                    f"{hits} / {named[value]} of {n} ({100 * low:.0f}-{100 * high:.0f} %), {np.median(here):.1f}"
                )
            lines.append(f"| `{kind}` | " + " | ".join(cells.get(v, "-") for v in grid) + " |")
        lines.append("")
    return "\n".join(lines)


def _at(record: Record, kind: str, name: str, value: float) -> bool:
    wanted = {**BASE, name: value, "kind": kind}
    return all(record["case"][k] == v for k, v in wanted.items())


def draw(records: Sequence[Record], kinds: Sequence[str], path: Path) -> None:
    """Three panels of curves with intervals."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    labels = {"strength": "strength (change / spread between people)", "subjects": "people", "noise": "relative noise"}
    figure, panels = plt.subplots(1, len(VARIED), figsize=(12, 3.8), sharey=True, layout="constrained")
    for axes, name in zip(panels, VARIED, strict=True):
        for k, kind in enumerate(kinds):
            points = curve(records, kind, name, "detected")
            if not points:
                continue
            x = np.array([p[0] for p in points]) * 1.03 ** (k - 1.5)
            share = np.array([hits / n for _, hits, n in points])
            ends = np.array([clopper_pearson(hits, n) for _, hits, n in points])
            error = np.abs(ends.T - share)
            axes.errorbar(x, share, yerror(error), marker="o", markersize=4, capsize=2, linewidth=1.2, label=kind)
        axes.set_xscale("log")
        values = sorted({point[0] for kind in kinds for point in curve(records, kind, name, "detected")})
        axes.set_xticks(values, [f"{value:g}" for value in values])
        axes.minorticks_off()
        axes.set_xlabel(labels[name])
        axes.set_ylim(-0.03, 1.03)
    panels[0].set_ylabel("share detected")
    panels[0].legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def yerror(error: np.ndarray) -> np.ndarray:
    """Lengths of error bars, (2, K); rounding must not make them negative."""
    return np.maximum(error, 0.0)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=8)
    parser.add_argument("--points", type=int, default=61)
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(POWER_KINDS), metavar="KIND")
    parser.add_argument("--jobs", type=int, default=2, help="processes; 0 works in this one")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results" / "power")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / FILE
    asked = cases(options.repeats, options.points, options.only)
    run_cases(asked, one_case, path, options.jobs)
    records = [r for r in read_lines(path) if "error" not in r and r["case"]["points"] == options.points]
    text = table(records, options.only)
    (options.out / "power.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    draw(records, options.only, options.out / "power.png")
    if tuple(options.only) == POWER_KINDS and options.repeats >= 8:
        replace_between(HERE / "CHALLENGE.md", "power", text)


if __name__ == "__main__":
    main()
