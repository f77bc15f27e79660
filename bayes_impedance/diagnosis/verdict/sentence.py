"""The verdict as one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_impedance.diagnosis.verdict_types import Physics, Verdict
from bayes_impedance.units import number_with_unit as number


def sentence(verdict: Verdict, people: int) -> str:
    """The verdict summarised in one sentence.

    Parameters
    ----------
    verdict : Verdict
        Its `sentence` is not used.
    people : int
        Number of people measured.
    """
    if not verdict.reliable and verdict.shortcomings:
        return f"Nothing can be concluded: {_clause_of(verdict.shortcomings[0])}"
    if not verdict.mismatch and not verdict.reliable:
        return "Whether anything is missing cannot be said: the fit of the network did not come to rest."
    if not verdict.mismatch and verdict.shortcomings:
        return (
            "Nothing was found that all people have and the network lacks, but it does not describe everybody: "
            f"{_clause_of(verdict.shortcomings[0])}"
        )
    if not verdict.mismatch:
        return (
            f"Nothing is missing: the network describes the recordings of {_people(people)} to within their noise, "
            "and an effect larger than the limits listed would have been found."
        )
    bands = verdict.where.bands_hz
    band = f", mostly {_span(bands)}" if bands else ""
    text = f"The network leaves out {_listed([_clause(entry) for entry in verdict.physics])}{band}"
    gain = None if verdict.improvement is None else verdict.improvement.elpd_gain
    if gain is not None and gain > 0:
        text += f"; with it, predictions of what was held out improve by {gain:.0f} natural logarithms"
    undecided = [alias for entry in verdict.physics for alias in entry.aliases if not alias.separated]
    if undecided:
        names = list(dict.fromkeys(f"{alias.name} at {alias.place}" for alias in undecided))
        text += f". These recordings cannot tell it from {_listed(names[:3], 'or')}"
    if verdict.shortcomings:
        text += f". Even so, {_clause_of(verdict.shortcomings[0])[:-1]}"
    return text + "."


def _clause_of(sentence: str) -> str:
    """A sentence as the final clause of another."""
    return sentence[0].lower() + sentence[1:].rstrip(".") + "."


def _clause(entry: Physics) -> str:
    if entry.kind == "unknown":
        return f"something unknown at {_place(entry.place)}, for which {entry.formula} stands in"
    size = ""
    for name, row in list(entry.parameters.items())[:1]:
        size = f" ({name.replace('_', ' ')} {number(row.median, row.unit)}, 90 % interval "
        size += f"{number(row.q05, row.unit)} to {number(row.q95, row.unit)})"
    side = {"rig": ", a matter of the rig", "body": ", a matter of the body"}.get(entry.side or "", "")
    others = {alias.id.split(".")[0] for alias in entry.aliases if not alias.separated}
    if not entry.side_decided or others - {entry.side}:
        side = ""  # dispersion is undecided, or an inseparable rival belongs to the other side
    if entry.id == "body.covariate" or entry.kind == "correlation":
        return f"that {entry.name}{size}"
    at = "" if entry.place == "port" and entry.side == "rig" else f" at {_place(entry.place)}"
    return f"{entry.name}{at}{size}{side}"


def _place(name: str) -> str:
    return "the port" if name == "port" else f"'{name}'"


def _span(bands: Sequence[Sequence[float]]) -> str:
    spans = [f"{number(low, 'Hz')} to {number(high, 'Hz')}" for low, high in bands[:2]]
    return "from " + " and from ".join(spans)


def _listed(parts: Sequence[str], word: str = "and") -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + f" {word} " + parts[-1]


def _people(n: int) -> str:
    return "one person" if n == 1 else f"{n} people"
