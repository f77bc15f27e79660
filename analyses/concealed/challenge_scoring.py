"""Verdicts of a challenge against the answers: one row for each case, then rates, tables and a confusion matrix.

What counts as right:

- **catalogue**: as in ``scoring.py``; *named* is the right id first or among the aliases stated as not separated, and
  *named or the same* also admits claims that leave nothing visible of the true change (``equivalence.py``).
- **pair**: named if one of the two comes first (or undecided); *both* if both are listed or undecided.
- **outside**: the verdict says ``unknown``, or its claim is equivalent to the truth in the band; and it predicts
  held-out data better.
- **trap, nothing**: nothing is claimed. Naming a residual stiffness where there is one is no false claim.

A case is *detectable* if an effect could stand out by :data:`~scoring.VISIBLE` standard errors or more.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from equivalence import left_over
from equivalence import same as same_in_band
from runs import Record
from scoring import VISIBLE, clopper_pearson, score
from world.experiment import Experiment

Row = dict[str, Any]
IMPROVED = ("delta_magnitude", "delta_phase_deg", "subject_rms_relative")
_RIGHT_ON_TRAP = {"trap.port_stiffness": "rig.stiffness"}


def score_case(verdict: Mapping[str, Any], truth: Mapping[str, Any], experiment: Experiment | None = None) -> Row:
    """One verdict against its answer.

    Parameters
    ----------
    verdict : mapping
        Content of ``verdict.json``.
    truth : mapping
        Of ``visible_in_world.truth_of``.
    experiment : Experiment, optional
        The true experiment, conducted again, to compute equivalence; without it names alone count.
    """
    physics = list(verdict.get("physics") or [])
    first = physics[0] if physics else {}
    improvement = verdict.get("improvement") or {}
    row: Row = {
        "kind": " + ".join(truth["kinds"]),
        "group": truth["group"],
        "visible": truth["visible"],
        "detectable": truth["visible"] >= VISIBLE,
        "subjects_n": truth["subjects"],
        "strength": max(truth["strengths"], default=0.0),
        "detected": bool(verdict["mismatch"]),
        "said": first.get("id"),
        "claims": [f"{p['id']} at {p.get('place')}" for p in physics],
        "improved": _improved(improvement),
        "elpd_gain": improvement.get("elpd_gain"),
        "elpd_gain_se": improvement.get("elpd_gain_se"),
    }
    if not truth["mismatch"]:
        allowed = _RIGHT_ON_TRAP.get(truth["kinds"][0])
        return row | {"false_claim": row["detected"] and first.get("id") != allowed, "right": not row["detected"]}
    scores = [best_of(verdict, effect) for effect in truth["effects"]]
    listed = [_listed(physics, effect["answers"]) for effect in truth["effects"]]
    lead = max(scores, key=lambda s: (s["first"], s["first_or_undecided"]))
    row |= {key: lead[key] for key in ("first", "first_or_undecided", "side", "place", "people", "covariate")}
    row |= {"band": lead["band"], "visible_band": lead["visible_band"]}
    # With two effects, the claimed size of either counts, whichever comes first.
    row["parameters"] = [covers for s in scores for covers in s["parameters"].values()] if len(scores) == 1 else []
    row["both"] = all(listed) if len(listed) > 1 else None
    known = [(p["id"], p["place"]) for p in physics if p["id"] != "unknown" and p.get("place")]
    row["explained"], row["left"], row["same"] = None, None, False
    if experiment is not None and known:
        row["explained"], row["left"] = left_over(experiment, known)
        row["same"] = same_in_band(experiment, known)
    row["side_open"] = first.get("side") is None or not first.get("side_decided", True)
    if truth["group"] == "outside":
        says_unknown = any(p["id"] == "unknown" for p in physics)
        gain = row["elpd_gain"] if row["elpd_gain"] is not None else -np.inf
        row["right"] = row["detected"] and (says_unknown or row["same"]) and gain > 0
        # An unknown has no side.
        row["side"] = None if first.get("side") is None else row["side"]
    else:
        row["right"] = bool(row["first_or_undecided"])
    row["named_or_same"] = bool(row["right"] or row["same"])
    return row


def best_of(verdict: Mapping[str, Any], effect: Mapping[str, Any]) -> Row:
    """Score by the best matching answer, where an effect has several right names."""
    scores = [score(verdict, {**effect, "id": answer}) for answer in effect["answers"]]
    return max(scores, key=lambda s: (s["first"], s["first_or_undecided"]))


def _listed(physics: Sequence[Mapping[str, Any]], answers: Sequence[str]) -> bool:
    accounts = [a for p in physics for a in (p, *(a for a in p.get("aliases") or [] if not a.get("separated", True)))]
    return any(account["id"] in answers for account in accounts)


def _improved(improvement: Mapping[str, Any]) -> dict[str, float]:
    """After over before, of each error."""
    pairs = {name: improvement[name] for name in IMPROVED if improvement.get(name)}
    return {name: float(after / before) for name, (before, after) in pairs.items() if before}


def rate(hits: int, n: int) -> str:
    """``9/10 (55-100 %)``, or a dash when there is nothing to count."""
    if n == 0:
        return "-"
    low, high = clopper_pearson(hits, n)
    return f"{hits}/{n} ({100 * low:.0f}-{100 * high:.0f} %)"


def summary(rows: Sequence[Row]) -> dict[str, tuple[int, int]]:
    """Overall rates: name to (hits, cases)."""

    def count(chosen: Sequence[Row], hit: Callable[[Row], bool]) -> tuple[int, int]:
        return sum(hit(r) for r in chosen), len(chosen)

    catalogue = [r for r in rows if r["group"] in ("catalogue", "pair")]
    seen = [r for r in catalogue if r["detectable"]]
    outside = [r for r in rows if r["group"] == "outside" and r["detectable"]]
    faint = [r for r in rows if r["group"] in ("catalogue", "pair", "outside") and not r["detectable"]]
    claimed = [r for r in seen if r["detected"]]
    intervals = [covers for r in seen for covers in r["parameters"]]
    return {
        "detected, of detectable catalogue cases": count(seen, lambda r: r["detected"]),
        "right name or honest alias set": count(seen, lambda r: r["first_or_undecided"]),
        "right name, alias set, or the same in the band": count(seen, lambda r: r["named_or_same"]),
        "right name first": count(seen, lambda r: r["first"]),
        "right side, of those detected": count(claimed, lambda r: bool(r["side"])),
        "... or what is claimed is the same in the band": count(claimed, lambda r: bool(r["side"]) or r["same"]),
        "... or the verdict says that it does not know": count(claimed, lambda r: bool(r["side"]) or r["side_open"]),
        "right place, of those detected": count(claimed, lambda r: r["place"]),
        "band meets that of the change": count(claimed, lambda r: r["band"]),
        "band meets that of its visible part": count(claimed, lambda r: r["visible_band"]),
        "both of two effects listed": count([r for r in seen if r["both"] is not None], lambda r: r["both"]),
        "90 % intervals that cover": (sum(intervals), len(intervals)),
        "held-out gain above zero, of those detected": count(
            [r for r in claimed if r["elpd_gain"] is not None], lambda r: r["elpd_gain"] > 0
        ),
        "outside the catalogue: unknown or the same, and better on held-out people": count(
            outside, lambda r: r["right"]
        ),
        "outside the catalogue, strictly: nothing but unknown is named, or the same": count(
            outside, lambda r: r["right"] and (r["same"] or r["said"] == "unknown")
        ),
        "detected though not detectable": count(faint, lambda r: r["detected"]),
        "false alarms where nothing is at work": count(
            [r for r in rows if r["group"] == "nothing"], lambda r: r["false_claim"]
        ),
        "claims on traps": count([r for r in rows if r["group"] == "trap"], lambda r: r["false_claim"]),
    }


def markdown(rows: Sequence[Row], failed: int, missing: int) -> str:
    """Markdown of the rates, of the verdict on each case, and of the change of the errors."""
    lines = ["| what | count, with 95 % interval |", "|---|---|"]
    lines += [f"| {name} | {rate(*counts)} |" for name, counts in summary(rows).items()]
    lines += ["", *_improvements(rows), *_people(rows)]
    if failed or missing:
        lines += [f"- {failed} cases ended with an error, {missing} were not run: neither is counted."]
    head = ["at work", "strength", "people", "visible", "said", "right", "same in band", "left", "elpd gain"]
    lines += ["", "| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    order = ("catalogue", "pair", "outside", "trap", "nothing")
    for r in sorted(rows, key=lambda r: (order.index(r["group"]), r["kind"], -r["visible"])):
        gain = "-" if r["elpd_gain"] is None else f"{r['elpd_gain']:.0f}"
        left = "-" if r.get("left") is None else f"{r['left']:.1f}"
        said = ", ".join(r["claims"]) or "nothing"
        same = "-" if r.get("explained") is None else "yes" if r["same"] else "no"
        mark = "yes" if r["right"] else "no" if r["detectable"] or r["detected"] else "not visible"
        cells = [
            r["kind"],
            f"{r['strength']:.2f}",
            r["subjects_n"],
            f"{r['visible']:.1f}",
            said,
            mark,
            same,
            left,
            gain,
        ]
        lines.append("| " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines)


def _improvements(rows: Sequence[Row]) -> list[str]:
    seen = [r for r in rows if r["group"] in ("catalogue", "pair", "outside") and r["detected"] and r["improved"]]
    lines = []
    for name in IMPROVED:
        ratios = [r["improved"][name] for r in seen if name in r["improved"]]
        if ratios:
            worse = sum(ratio > 1.0 for ratio in ratios)
            lines.append(
                f"- `{name}` after over before: median {np.median(ratios):.3f}, worse in {worse} of {len(ratios)}."
            )
    return lines


def _people(rows: Sequence[Row]) -> list[str]:
    people = [r["people"] for r in rows if r.get("people")]
    if not people:
        return []
    concerned, hits, false = (sum(p[key] for p in people) for key in ("concerned", "hits", "false"))
    return [f"- Subgroups: {hits} of {concerned} people concerned were named, and {false} others."]


def confusion(rows: Sequence[Row]) -> tuple[list[str], list[str], np.ndarray]:
    """True effects against effects named first: names of rows and columns, counts."""
    counts = Counter((r["kind"], r["said"] or "nothing") for r in rows)
    order = {kind: i for i, kind in enumerate(dict.fromkeys(r["kind"] for r in sorted(rows, key=_by_group)))}
    said = sorted({name for _, name in counts}, key=lambda n: (n == "nothing", n == "unknown", n))
    table = np.zeros((len(order), len(said)), dtype=int)
    for (kind, name), n in counts.items():
        table[order[kind], said.index(name)] = n
    return list(order), said, table


def _by_group(row: Row) -> tuple[int, str]:
    return ("catalogue", "pair", "outside", "trap", "nothing").index(row["group"]), row["kind"]


def draw_confusion(rows: Sequence[Row], path: Path) -> None:
    """The confusion matrix as a picture."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    kinds, said, table = confusion(rows)
    figure, axes = plt.subplots(figsize=(3.5 + 0.42 * len(said), 2.0 + 0.26 * len(kinds)), layout="constrained")
    axes.imshow(np.where(table > 0, np.log1p(table), np.nan), cmap="Blues", vmin=0, vmax=np.log(12), aspect="auto")
    for i, j in np.argwhere(table > 0):
        axes.text(j, i, str(table[i, j]), ha="center", va="center", fontsize=8)
    axes.set_xticks(range(len(said)), said, rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(kinds)), kinds, fontsize=8)
    axes.set_xlabel("said first")
    axes.set_ylabel("at work")
    axes.set_xticks(np.arange(len(said)) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(kinds)) - 0.5, minor=True)
    axes.grid(which="minor", color="0.85", linewidth=0.6)
    axes.tick_params(which="minor", length=0)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def scored(pairs: Sequence[tuple[Mapping[str, Any], Record]], conduct_again: Callable[[Any], Experiment]) -> list[Row]:
    """Rows of all cases that ended; `conduct_again` gets a case's plan from the answers."""
    return [
        {"case": answer["case"], "seconds": record["seconds"]}
        | score_case(record["verdict"], answer["truth"], conduct_again(answer["plan"]))
        for answer, record in pairs
        if "error" not in record
    ]
