"""The verdict as one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_impedance.units import number_with_unit as number


def sentence(verdict: Mapping[str, Any], people: int) -> str:
    """The verdict as one sentence that a person would say to a colleague."""
    physics = verdict["physics"]
    if not verdict["mismatch"]:
        return (
            f"Nothing is missing: the network describes the recordings of {_people(people)} to within their noise, "
            "and an effect larger than the limits listed would have been found."
        )
    parts = [_clause(entry) for entry in physics]
    where_ = verdict["where"]
    bands = where_["bands_hz"]
    band = f", mostly {_span(bands)}" if bands else ""
    gain = verdict["improvement"].get("elpd_gain") if verdict.get("improvement") else None
    text = f"The network leaves out {_listed(parts)}{band}"
    if gain is not None and gain > 0:
        text += f"; with it, predictions of what was held out improve by {gain:.0f} natural logarithms"
    undecided = [a for entry in physics for a in entry.get("aliases", []) if not a["separated"]]
    if undecided:
        names = list(dict.fromkeys(f"{a['name']} at {a['place']}" for a in undecided))
        text += f". These recordings cannot tell it from {_listed(names[:3], 'or')}"
    return text + "."


def _clause(entry: Mapping[str, Any]) -> str:
    if entry["id"] == "unknown":
        stand_in = entry.get("formula", "a small network")
        return f"something unknown at {_place(entry['place'])}, for which {stand_in} stands in"
    first = next(iter(entry["parameters"].items()), None)
    size = ""
    if first is not None:
        name, row = first
        size = f" ({name.replace('_', ' ')} {number(row['median'], row['unit'])}, 90 % interval "
        size += f"{number(row['q05'], row['unit'])} to {number(row['q95'], row['unit'])})"
    side = {"rig": ", a matter of the rig", "body": ", a matter of the body"}.get(entry["side"] or "", "")
    others = {a["id"].split(".")[0] for a in entry.get("aliases", []) if not a["separated"]}
    if not entry.get("side_decided", True) or others - {entry["side"]}:
        side = ""  # people may differ or not, or what it cannot be told from belongs to the other side
    if entry["id"] == "body.covariate":
        return f"that {entry['name']}{size}"
    at = "" if entry["place"] == "port" and entry["side"] == "rig" else f" at {_place(entry['place'])}"
    return f"{entry['name']}{at}{size}{side}"


def _place(name: str | None) -> str:
    return "the port" if name in (None, "port") else f"'{name}'"


def _span(bands: Sequence[Sequence[float]]) -> str:
    spans = [f"{number(low, 'Hz')} to {number(high, 'Hz')}" for low, high in bands[:2]]
    return "from " + " and from ".join(spans)


def _listed(parts: Sequence[str], word: str = "and") -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + f" {word} " + parts[-1]


def _people(n: int) -> str:
    return "one person" if n == 1 else f"{n} people"
