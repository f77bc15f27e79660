"""How often each effect of the catalogue is found, named and measured when it is concealed, over many seeds.

Run from the repository's root::

    python analyses/concealed/catalogue_table.py --seeds 10 --strength 0.3 --jobs 2 -o analyses/concealed/results

Each case is a line of ``catalogue.jsonl`` with truth and verdict. Cases on file are skipped, so
a run may be interrupted. ``--only rig.delay body.line`` runs some effects, ``--score`` only scores the cases on file.
The table goes to ``table.csv`` and, between its markers, into the README beside this script.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from effects import concealed
from forms import EFFECTS, NOTHING
from runs import Record, diagnose, read_lines, replace_between, run_cases
from scoring import VISIBLE, YES_NO, clopper_pearson, score, tally

HERE = Path(__file__).parent
FILE = "catalogue.jsonl"

STRENGTH_FACTOR = {"body.covariate": 2.5, "body.drift": 2.5}
"""Factors of --strength. Explaining 30 % of a standard deviation is a correlation of 0.3, hardly significant with 40
people. A drift of 30 % of a standard deviation hides among 120 fingers that are put down with a scatter of 5 to 8 %."""

HEADERS = {
    "detected": "detected",
    "first": "named first",
    "first_or_undecided": "named first or undecided",
    "side": "side",
    "band": "band",
    "visible_band": "visible band",
    "place": "place",
}


def one_case(case: Mapping[str, Any]) -> Record:
    """Conceal, diagnose; returns truth and verdict."""
    recordings, truth = concealed(
        case["id"],
        case["place"],
        case["strength"],
        case["seed"],
        n_subjects=case["subjects"],
        n_points=case["points"],
    )
    return {"truth": truth, "verdict": diagnose(recordings, case["seed"], case["through_command"])}


def cases(options: argparse.Namespace) -> list[Record]:
    """Seed by seed, so that an interrupted run has all effects; places take turns with the seed."""
    return [
        {
            "id": name,
            "place": EFFECTS[name].places[seed % len(EFFECTS[name].places)],
            "seed": seed,
            "strength": 0.0 if name in NOTHING else round(options.strength * STRENGTH_FACTOR.get(name, 1.0), 6),
            "subjects": options.subjects,
            "points": options.points,
            "through_command": options.through_command,
        }
        for seed in range(options.first_seed, options.first_seed + options.seeds)
        for name in options.only or EFFECTS
    ]


def scored(records: Sequence[Record]) -> list[Record]:
    """One flat row for each case that ended."""
    return [
        {"id": record["case"]["id"], "concealed_at": record["case"]["place"], "seconds": record["seconds"]}
        | score(record["verdict"], record["truth"])
        for record in records
        if "error" not in record
    ]


def write_csv(rows: Sequence[Record], path: Path) -> None:
    """One row for each effect, for all, and for all detectable ones: counts with the limits of their 95 % intervals."""
    lines = []
    for name, group in _groups(rows).items():
        counts = tally(group)
        line = {"id": name, "places": " ".join(sorted({r["concealed_at"] for r in group}))} | counts
        for key in YES_NO:
            line[f"{key}_low"], line[f"{key}_high"] = (
                f"{x:.4f}" for x in clopper_pearson(counts[key], counts["cases"])
            )
        line["covered_low"], line["covered_high"] = (
            f"{x:.4f}" for x in clopper_pearson(counts["covered"], counts["intervals"])
        )
        lines.append(line)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(lines[0]) if lines else ["id"])
        writer.writeheader()
        writer.writerows(lines)


def markdown(rows: Sequence[Record], failed: int) -> str:
    """The table as Markdown: counts with 95 % intervals, wrong names, and false claims."""
    head = ["effect", "at", "visible", *HEADERS.values(), "intervals that cover", "elpd gain", "s"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, group in _groups(rows).items():
        counts, single = tally(group), name in EFFECTS
        label, places = (f"`{name}`", ", ".join(sorted({r["concealed_at"] for r in group}))) if single else (name, "")
        cells = [rate(counts[key], counts["cases"], key in YES_NO[:3] or not single) for key in YES_NO]
        covered = rate(counts["covered"], counts["intervals"], not single)
        gain = "-" if math.isnan(counts["elpd_gain"]) else f"{counts['elpd_gain']:.0f}"
        cells = [label, places, f"{counts['visible']:.1f}", *cells, covered, gain, f"{counts['seconds']:.0f}"]
        lines.append("| " + " | ".join(cells) + " |")
    concealing = [r for r in rows if r["id"] not in NOTHING]
    lines += ["", *_people(concealing), *_instead(concealing), *_nothing(rows)]
    if failed:
        lines += ["", f"{failed} cases ended with an error and are not counted."]
    return "\n".join(lines)


def _groups(rows: Sequence[Record]) -> dict[str, list[Record]]:
    """Rows of each effect that has any, then of all effects, then of all detectable ones."""
    concealing = [r for r in rows if r["id"] not in NOTHING]
    groups = {name: [r for r in concealing if r["id"] == name] for name in EFFECTS}
    groups["all"] = concealing
    groups[f"all visible ({VISIBLE:g} or more)"] = [r for r in concealing if r["visible"] >= VISIBLE]
    return {name: group for name, group in groups.items() if group}


def rate(hits: int, n: int, interval: bool) -> str:
    """``9/10 (55-100 %)``, or a dash when there is nothing to count."""
    if n == 0:
        return "-"
    low, high = clopper_pearson(hits, n)
    return f"{hits}/{n}" + (f" ({100 * low:.0f}-{100 * high:.0f} %)" if interval else "")


def _people(rows: Sequence[Record]) -> list[str]:
    """Which members of subgroups were named, and whether covariates were named correctly."""
    lines = []
    people = [r["people"] for r in rows if r["people"] is not None]
    if people:
        concerned, hits, false = (sum(p[key] for p in people) for key in ("concerned", "hits", "false"))
        lines.append(f"- Subgroups: {hits} of {concerned} people concerned were named, and {false} others.")
    named = [r["covariate"] for r in rows if r["covariate"] is not None]
    if named:
        lines.append(f"- Covariates: the right one was named in {rate(sum(named), len(named), True)}.")
    return lines


def _instead(rows: Sequence[Record]) -> list[str]:
    """Wrong names: the right effect came neither first nor undecided."""
    wrong = Counter((r["id"], r["said"] or "nothing") for r in rows if not r["first_or_undecided"])
    if not wrong:
        return []
    said = "; ".join(f"`{true}` called `{name}` {n} times" for (true, name), n in sorted(wrong.items()))
    return [f"- Called something else: {said}."]


def _nothing(rows: Sequence[Record]) -> list[str]:
    """Claims where nothing was concealed."""
    lines = []
    for name in NOTHING:
        group = [r for r in rows if r["id"] == name]
        if group:
            false = Counter(r["said"] for r in group if r["detected"])
            claimed = f": {', '.join(f'`{k}` {n} times' for k, n in sorted(false.items(), key=str))}" if false else ""
            lines.append(f"- `{name}`: something was claimed in {rate(false.total(), len(group), True)}{claimed}.")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="how many seeds for each effect")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--strength", type=float, default=0.3, help="change of the mean over the spread of people")
    parser.add_argument("--only", nargs="+", choices=list(EFFECTS), metavar="ID", help="some effects only")
    parser.add_argument("--jobs", type=int, default=2, help="processes; 0 works in this one")
    parser.add_argument("--subjects", type=int, default=40)
    parser.add_argument("--points", type=int, default=201)
    parser.add_argument("--through-command", action="store_true", help="write files and run the command with --quick")
    parser.add_argument("--score", action="store_true", help="diagnose nothing: score what is on file")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results")
    options = parser.parse_args()

    path = options.out / FILE
    asked = cases(options)
    if not options.score:
        run_cases(asked, one_case, path, options.jobs)
    # All seeds on file count. A file may also hold other strengths and sizes; a table is of one of each.
    same = ("id", "strength", "subjects", "points", "through_command")
    kinds = {tuple(case[key] for key in same) for case in asked}
    kept = [record for record in read_lines(path) if tuple(record["case"][key] for key in same) in kinds]
    rows = scored(kept)
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(rows, options.out / "table.csv")
    table = markdown(rows, len(kept) - len(rows))
    print(table)
    if options.only is None and (options.subjects, options.points) == (40, 201):
        replace_between(HERE / "README.md", "catalogue", f"Strength {options.strength:g}.\n\n{table}")


if __name__ == "__main__":
    main()
