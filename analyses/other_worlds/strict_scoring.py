"""Strict rightness of a verdict: the right set of names and nothing else.

- Something of the catalogue is missing: as many entries as effects, and each effect has an entry of its own that names
  it, or leaves it undecided: at most :data:`MOST_UNDECIDED` names, entry and aliases that are not separated.
- Physics outside of the catalogue: one entry, ``unknown`` or one that is the same curve in the band. Several names for
  one thing are wrong, however well they fit together. An element that changes during the sweep counts as outside where
  everybody was swept once: time and frequency then go together, such recordings cannot show it, and it is not offered.
  Beside an effect of the catalogue it is right alone, or beside that effect's name.
- Nothing is missing: nothing is claimed.

An entry about the noise is right where the noise has such tails, and is not counted. A case is *visible* if every
effect stands out by six standard errors (``visible.py``); rates are over visible cases.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from itertools import permutations
from pathlib import Path
from statistics import median
from typing import Any

from scipy.stats import beta
from visible import VISIBLE

MOST_UNDECIDED = 3
"""Names in a set that is left open: more say nothing."""

LATER_NAMES = {
    "outside.free_line": ("line",),
    "outside.squeeze_film": ("film", "squeeze"),
    "outside.stiffening": ("amplitude", "stiffening"),
    "outside.semi_inductance": ("inductance",),
    "outside.diffusion": ("diffusion",),
    "outside.fractional_zener": ("broad_relaxation",),
}
"""Words of an id that name physics which was outside of the catalogue when the kinds were chosen: right at the right
place, if the catalogue comes to have such an entry."""

Row = dict[str, Any]


def names_of(entry: Mapping[str, Any]) -> set[str]:
    """The entry's name, and those that it says cannot be told from it."""
    return {entry["id"], *(a["id"] for a in entry.get("aliases") or [] if a.get("separated") is False)}


def group_of(answer: Mapping[str, Any]) -> str:
    """``none``, ``one``, ``two`` or ``outside``."""
    effects = answer["effects"]
    if any(_is_outside(answer, e) for e in effects):
        return "outside"
    return ("none", "one", "two")[len(effects)]


def _is_outside(answer: Mapping[str, Any], effect: Mapping[str, Any]) -> bool:
    swept_once = answer["repetitions"] == 1
    return bool(effect["id"].startswith("outside") or (swept_once and effect["kind"] == "body.drift"))


def entries_of(answer: Mapping[str, Any], verdict: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Physics of a verdict, without what it rightly says of the noise."""
    tails = answer["noise"]["tails"] is not None
    return [e for e in verdict["physics"] if not (tails and e["id"].startswith("noise"))]


def right(answer: Mapping[str, Any], entries: Sequence[Mapping[str, Any]], same_curve: bool) -> bool:
    """Whether a verdict is strictly right; `same_curve` says that its entries are the truth's curve in the band."""
    group = group_of(answer)
    if group == "none":
        return not entries
    if group == "outside":
        if len(entries) != 1:
            return _beside_unknown(answer, entries)
        return same_curve or entries[0]["id"] == "unknown" or _named_later(answer["effects"][0], entries[0])
    return matched(answer, entries) is not None


def _beside_unknown(answer: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the effects of the catalogue have their names, and what is outside of it is one unknown."""
    inside = [effect for effect in answer["effects"] if not _is_outside(answer, effect)]
    named = [entry for entry in entries if entry["id"] != "unknown"]
    one_unknown = len(entries) == len(named) + 1 == len(answer["effects"])
    return bool(one_unknown and inside and matched({**answer, "effects": inside}, named) is not None)


def _named_later(effect: Mapping[str, Any], entry: Mapping[str, Any]) -> bool:
    words = LATER_NAMES.get(effect["id"], ())
    return entry.get("place") == effect["place"] and any(word in entry["id"] for word in words)


def matched(answer: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]] | None:
    """An entry of its own for each effect, in the order of the effects, if nothing is left over."""
    ids = [e["id"] for e in answer["effects"]]
    if len(ids) != len(entries):
        return None
    for order in permutations(entries):
        sets = [names_of(entry) for entry in order]
        if all(i in names and len(names) <= MOST_UNDECIDED for i, names in zip(ids, sets, strict=True)):
            return list(order)
    return None


def covered(effect: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, bool]:
    """For each true parameter of an effect that was named at its place: whether the 90 % interval holds it."""
    if entry["id"] != effect["id"] or entry.get("place") != effect["place"]:
        return {}
    if effect["id"] == "body.springpot" and ("element" in effect["kind"]) != ("becomes" in str(entry.get("formula"))):
        return {}  # an exponent of another formula
    if effect["id"] == "rig.mains":
        return {}  # drawn is the line before the lock-in, said is what is left of it at the strongest point
    found = {}
    for name, true in effect["values"].items():
        said = (entry.get("parameters") or {}).get(name)
        per_unit = name == "slope" and said is not None and said.get("unit")  # of the covariate, not of its logarithm
        if said is not None and said.get("q05") is not None and said.get("q95") is not None and not per_unit:
            found[name] = bool(said["q05"] <= true <= said["q95"])
    return found


def score(
    answer: Mapping[str, Any], record: Mapping[str, Any], same: Callable[[Mapping[str, Any]], bool] | None = None
) -> Row:
    """One row of the table.

    Parameters
    ----------
    answer : mapping
        Of ``sealed.json``.
    record : mapping
        Of ``verdicts.jsonl``.
    same : callable, optional
        Verdict to whether its entries are the truth's curve in the band; asked only where names do not decide.
    """
    effects = answer["effects"]
    group = group_of(answer)
    row: Row = {
        "case": answer["case"],
        "group": group,
        "network": answer["network"],
        "people": answer["people"],
        "repetitions": answer["repetitions"],
        "points": answer["points"],
        "effect": " + ".join(f"{e['kind']} at {e['place']}" for e in effects) or "nothing",
        "strength": max((e["strength"] for e in effects), default=0.0),
        "visible": min(answer["visible"], default=0.0),
        "is_visible": group == "none" or min(answer["visible"]) >= VISIBLE,
        "seconds": record["seconds"],
        "processor_seconds": record.get("processor_seconds"),
        "exit": record["exit"],
        "crashed": record["verdict"] is None or bool(record["crash"]),
        "reliable": None,
        "said": "-",
        "right": False,
        "same_curve": None,
        "side": None,
        "intervals": 0,
        "covered": 0,
    }
    verdict = record["verdict"]
    if verdict is None:
        return row
    entries = entries_of(answer, verdict)
    row["reliable"] = verdict.get("reliable", True)
    row["said"] = "; ".join(described(e) for e in entries) or "nothing"
    row["right"] = right(answer, entries, False)
    if not row["right"] and entries and effects and same is not None:
        row["same_curve"] = same(verdict)
        row["right"] = right(answer, entries, bool(row["same_curve"]))
    if effects and entries:
        sides = {e["side"] for e in effects}
        first = entries[0]
        undecided = first.get("side") is None or first.get("side_decided") is False
        row["side"] = undecided or first["side"] in sides
    pairs = matched(answer, entries) if group in ("one", "two") else None
    if pairs is not None:
        hits = [hit for e, p in zip(effects, pairs, strict=True) for hit in covered(e, p).values()]
        row["intervals"], row["covered"] = len(hits), sum(hits)
    return row


def described(entry: Mapping[str, Any]) -> str:
    """``id at place`` with the names that are left undecided."""
    others = sorted(names_of(entry) - {entry["id"]})
    return f"{entry['id']} at {entry.get('place')}" + (f" (or {', '.join(others)})" if others else "")


def rate(hits: int, n: int) -> str:
    """``9/10 (55-100 %)`` with the 95 % interval of Clopper and Pearson, or a dash."""
    if n == 0:
        return "-"
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(0.975, hits + 1, n - hits))
    return f"{hits}/{n} ({100 * low:.0f}-{100 * high:.0f} %)"


def rates(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """What is counted, and how often it came."""

    def of(chosen: Sequence[Row], key: Callable[[Row], bool]) -> str:
        return rate(sum(bool(key(r)) for r in chosen), len(chosen))

    seen = [r for r in rows if r["group"] != "none" and r["is_visible"]]
    faint = [r for r in rows if not r["is_visible"]]
    judged = [r for r in seen if r["side"] is not None]
    timed = {k: [r[k] for r in rows if r.get(k) is not None] for k in ("seconds", "processor_seconds")}
    lines = [("strictly right, of visible", of(seen, lambda r: r["right"]))]
    for group in ("one", "two", "outside"):
        lines.append((f"... {group}", of([r for r in seen if r["group"] == group], lambda r: r["right"])))
    lines += [
        ("nothing claimed where there is nothing", of([r for r in rows if r["group"] == "none"], lambda r: r["right"])),
        ("not visible: nothing claimed, or rightly", of(faint, lambda r: r["right"] or r["said"] == "nothing")),
        ("90 % intervals that cover", rate(sum(r["covered"] for r in seen), sum(r["intervals"] for r in seen))),
        ("side right or undecided", of(judged, lambda r: r["side"])),
        ("crashes and no verdict", of(rows, lambda r: r["crashed"])),
        ("must not be relied on", of([r for r in rows if r["reliable"] is not None], lambda r: not r["reliable"])),
    ]
    lines += [
        (f"{name.replace('_', ' ')}, median and worst", f"{median(found):.0f}, {max(found):.0f}")
        for name, found in timed.items()
        if found
    ]
    return lines


def markdown(rows: Sequence[Row]) -> str:
    """Rates, then every verdict that is not strictly right."""
    lines = ["| what | count, with 95 % interval |", "|---|---|"]
    lines += [f"| {what} | {value} |" for what, value in rates(rows)]
    wrong = [r for r in rows if not r["right"] and (r["is_visible"] or r["said"] != "nothing")]
    lines += ["", "| not right | network | N x J x F | missing | visible | said |", "|---|---|---|---|---|---|"]
    for r in wrong:
        size = f"{r['people']} x {r['repetitions']} x {r['points']}"
        network = r["network"].replace("|", "\\|")
        effect, said = (r[k].replace("|", "\\|") for k in ("effect", "said"))
        said = "crash" if r["crashed"] else said
        lines.append(f"| {r['case']} | `{network}` | {size} | {effect} | {r['visible']:.0f} | {said} |")
    return "\n".join(lines)


def write(rows: Sequence[Row], out: Path) -> None:
    """The table as CSV and as Markdown."""
    if not rows:
        return
    with (out / "table.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    (out / "table.md").write_text(markdown(rows) + "\n", encoding="utf-8")
