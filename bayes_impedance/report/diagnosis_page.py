"""The page of a diagnosis: the missing physics, or the detection limits if nothing is missing.

The content comes from the :class:`~bayes_impedance.diagnosis.types.Diagnosis`; this room chooses units, digits and
words. :mod:`bayes_impedance.report.findings` formulates the verdict; this module makes the drawings, the tables and
the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.plots import write_diagnosis_pictures
from bayes_impedance.plots.missing_physics import people
from bayes_impedance.report import REPORT_FILE, _embedded, _environment
from bayes_impedance.report.findings import (
    ABSENT,
    KINDS,
    POOLING,
    SIDES,
    affected,
    effects,
    facts,
    interval_text,
    joint,
    kind_of_verdict,
    number_or_nan,
    number_text,
    p_text,
    physics,
    score_text,
)
from bayes_impedance.report.schematic import schematic
from bayes_impedance.runtime.atomic_files import write_text
from bayes_impedance.units import hertz, scale_for, signed, significant

if TYPE_CHECKING:
    from markupsafe import Markup

    from bayes_impedance.diagnosis.types import Diagnosis, Ranked

__all__ = ["write_diagnosis_report"]

_TEMPLATE = "diagnosis.html.j2"
_RANKED = 15
_ALIASES = 8
_NAMES = 12
"""How many rows stand open on the page; further aliases and names are folded, further candidates left out."""
_SAME = 0.95
"""Cosine between signatures above which two candidates look alike in the table."""

_QUANTITIES = {
    "central": "centre",
    "dispersion_between_persons": "spread between persons (sd of ln)",
    "dispersion_between_repetitions": "spread between repetitions (sd of ln)",
}


@dataclass(frozen=True, kw_only=True)
class RankedRow:
    """A line of the ranking; `bar` is the score in percent of the best."""

    candidate: Ranked
    how: str
    score: str
    bar: str
    p_value: str
    likeness: str
    alike: bool


def write_diagnosis_report(diagnosis: Diagnosis, folder: Path, pictures: Mapping[str, Path] | None = None) -> Path:
    """Write the page of a diagnosis: one file without scripts that needs neither network nor other files.

    Parameters
    ----------
    diagnosis : Diagnosis
    folder : Path
        Made if it does not exist.
    pictures : mapping of str to Path, optional
        PNG files as :func:`~bayes_impedance.plots.write_diagnosis_pictures` names them; drawn into
        ``folder/pictures`` if not given.

    Returns
    -------
    Path
        Of the page. It appears under its name only when it is complete.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if pictures is None:
        pictures = write_diagnosis_pictures(diagnosis, folder / "pictures")
    text = _environment().get_template(_TEMPLATE).render(**_context(diagnosis, pictures))
    return write_text(folder / REPORT_FILE, text)


def _context(diagnosis: Diagnosis, pictures: Mapping[str, Path]) -> dict[str, object]:
    verdict, n = diagnosis.verdict, len(diagnosis.subjects)
    kind = kind_of_verdict(verdict)
    before, after = networks(diagnosis)
    names = affected(verdict)
    return {
        "title": diagnosis.title,
        "who": people(diagnosis),
        "one_who": people(diagnosis, 1),
        "single": n == 1,
        "electrical": diagnosis.unit == "ohm",
        "kind": kind,
        "kicker": KINDS[kind],
        "sentence": verdict.get("summary") or "The diagnosis came without a sentence.",
        "mismatch": bool(verdict.get("mismatch")),
        "reliable": bool(verdict.get("reliable", True)),
        "remarks": list(verdict.get("remarks") or []),
        "facts": facts(diagnosis),
        "affected": names if len(names) > _NAMES else [],
        "effects": effects(diagnosis),
        "open_aliases": _ALIASES,
        "unexplained": unexplained(diagnosis),
        "joint": joint(verdict),
        "before": before,
        "after": after,
        "drawing": drawing(before, _marks(before, verdict), diagnosis),
        "drawing_after": drawing(after, dict.fromkeys(added(before, after), "new"), diagnosis) if after else None,
        "ranking": ranking(diagnosis),
        "left_off": max(len(diagnosis.ranking) - _RANKED, 0),
        "improvements": improvements(diagnosis),
        "held_out": (verdict.get("improvement") or {}).get("held_out") or "",
        "differences": differences(diagnosis),
        "limits": limits(verdict),
        "not_identifiable": [str(x) for x in verdict.get("not_identifiable") or []],
        "elements_not_identified": [str(x) for x in verdict.get("elements_not_identified") or []],
        "provenance": provenance(diagnosis),
        "pictures": {name: _embedded(file) for name, file in pictures.items()},
    }


def unexplained(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """What is left that nothing in the catalogue describes: place, side, share, notation and drawing."""
    entry = diagnosis.verdict.get("unexplained")
    if not entry:
        return None
    share = number_or_nan(entry.get("share"))
    return {
        "place": str(entry.get("place") or ""),
        "side": SIDES.get(entry.get("side") or "", entry.get("side") or ""),
        "share": f"{100 * share:.0f} %" if math.isfinite(share) else "",
        "network": str(entry.get("network") or ""),
        "drawing": drawing(entry.get("network"), {}, diagnosis),
        "is_a_card": _is_a_card(diagnosis.verdict),
    }


def _is_a_card(verdict: Mapping[str, Any]) -> bool:
    """Whether what is unexplained is one of the effects already, as ``unknown``."""
    return any(entry.get("id") == "unknown" for entry in physics(verdict))


# -------------------------------------------------------------------- the network


def networks(diagnosis: Diagnosis) -> tuple[str, str]:
    """Notation before, and after if it differs (else an empty text)."""
    given = list(diagnosis.verdict.get("network") or [])
    before = str(given[0] if given and given[0] else diagnosis.before.network)
    after = str(given[1] if len(given) > 1 and given[1] else "")
    return before, "" if after == before else after


def _marks(notation: str, verdict: Mapping[str, Any]) -> dict[tuple[int, ...], str]:
    """Paths of the places that were found, with the numbers of their cards; ``?`` for what is unexplained."""
    found = [(str(i), entry.get("place")) for i, entry in enumerate(physics(verdict), 1)]
    if not _is_a_card(verdict):
        found.append(("?", (verdict.get("unexplained") or {}).get("place")))
    network, marks = _parsed(notation), dict[tuple[int, ...], list[str]]()
    for text, name in found:
        try:
            if network is not None and name:
                marks.setdefault(network.place(str(name)).path, []).append(text)
        except InputError:
            continue  # effects on the whole population have no place
    return {path: ", ".join(texts) for path, texts in marks.items()}


def added(before: str, after: str) -> list[tuple[int, ...]]:
    """Paths of the largest parts of a network whose elements are all new."""
    old, new = _parsed(before), _parsed(after)
    if old is None or new is None:
        return []
    known, paths = set(old.elements), list[tuple[int, ...]]()
    for path, node in new.walk():
        inside = any(path[: len(outer)] == outer for outer in paths)
        if not inside and not known & set(node.elements):
            paths.append(path)
    return paths


def drawing(notation: str | None, marks: Mapping[tuple[int, ...], str], diagnosis: Diagnosis) -> Markup | None:
    """The network as a drawing, or None if the text is no network."""
    from markupsafe import Markup

    network = _parsed(notation)
    return None if network is None else Markup(schematic(network, electrical=diagnosis.unit == "ohm", mark=marks))


def _parsed(notation: str | None) -> Network | None:
    try:
        return parse(notation) if notation else None
    except InputError:
        return None


# -------------------------------------------------------------------- tables


def ranking(diagnosis: Diagnosis) -> list[RankedRow]:
    """The best candidates of the first screening."""
    rows = diagnosis.ranking[:_RANKED]
    best = max([number_or_nan(row.score) for row in rows if math.isfinite(number_or_nan(row.score))], default=0.0)
    return [
        RankedRow(
            candidate=row,
            how=", ".join(x for x in (POOLING.get(row.pooling, row.pooling), row.shape) if x),
            score=score_text(row.score),
            bar=f"{100 * max(row.score, 0.0) / best:.1f}" if best > 0 and math.isfinite(row.score) else "0",
            p_value=p_text(row.p_value),
            likeness=signed(row.likeness).lstrip("+") if math.isfinite(row.likeness) else ABSENT,
            alike=i > 0 and abs(row.likeness) >= _SAME,
        )
        for i, row in enumerate(rows)
    ]


def improvements(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """What changed: name, before and after with their unit."""
    entry = diagnosis.verdict.get("improvement") or {}
    scale = scale_for(max(_finite(entry.get("delta_magnitude")), default=math.nan), diagnosis.unit)
    one = "the network" if len(diagnosis.subjects) == 1 else "one network for all"
    rows = (
        (f"Magnitude error of {one} (eq. 5)", "delta_magnitude", scale.factor, f" {scale.unit}"),
        (f"Phase error of {one} (eq. 5)", "delta_phase_deg", 1.0, "°"),
        (f"Error of each {people(diagnosis, 1)}'s own network (relative)", "subject_rms_relative", 100.0, " %"),
        ("Recordings inside of the predicted 90 % band", "coverage90", 100.0, " %"),
    )
    shown = []
    for name, key, factor, unit in rows:
        if _finite(entry.get(key)):
            before, after = (number_text(number_or_nan(x) * factor) for x in entry[key])
            shown.append((name, *(text if text == ABSENT else text + unit for text in (before, after))))
    return shown


def differences(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """How the recordings differ from a claimed simulation: element, quantity, both values, ratio, interval, p."""
    rows = []
    for d in diagnosis.differences:
        unit = d.unit if d.what == "central" else ""
        values = [x for x in (d.simulation, d.recordings) if math.isfinite(x)]
        scale = scale_for(max(map(abs, values), default=math.nan), unit)
        shown = (f"{number_text(x * scale.factor)} {scale.unit}".strip() for x in (d.simulation, d.recordings))
        ratio, interval = interval_text(d.ratio, d.q05, d.q95)
        what = _QUANTITIES.get(d.what, d.what)
        rows.append((d.element, what, *shown, ratio, interval, p_text(d.p_value)))
    return rows


def limits(verdict: Mapping[str, Any]) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Detection limits: id, name, and the smallest detectable size at each place."""
    grouped: dict[str, list[tuple[str, str]]] = {}
    names = {}
    for entry in verdict.get("detectable") or []:
        above = number_or_nan(entry.get("above"))
        scale = scale_for(above, str(entry.get("unit") or ""))
        size = f"{significant(above * scale.factor, 2)} {scale.unit}".strip() if math.isfinite(above) else "not visible"
        grouped.setdefault(str(entry.get("id")), []).append((str(entry.get("place") or ""), size))
        names[str(entry.get("id"))] = str(entry.get("name") or "")
    return [(id, names[id], places) for id, places in grouped.items()]


def provenance(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Where the verdict comes from."""
    verdict, f = diagnosis.verdict, diagnosis.before.frequency_hz
    n, repetitions = len(diagnosis.subjects), diagnosis.repetitions
    times = "once" if repetitions == 1 else f"up to {repetitions} times each" if n > 1 else f"{repetitions} times"
    seconds = ", ".join(f"{name} {value:.1f} s" for name, value in diagnosis.seconds.items())
    return [
        ("Recordings", diagnosis.title),
        ("Measured", f"{n} {people(diagnosis, n)}, {times}, {f.size} frequencies from {hertz(f[0])} to {hertz(f[-1])}"),
        ("Network", networks(diagnosis)[0]),
        ("Seed", _text(verdict.get("seed"), "not recorded")),
        ("SHA-256 of the data", _text(verdict.get("data_sha256"), "none: the recordings did not come from a file")),
        ("Version", _text(verdict.get("version"), "not recorded")),
        ("Seconds", seconds or "not recorded"),
    ]


def _text(value: object, otherwise: str) -> str:
    return otherwise if value is None or value == "" else str(value)


def _finite(values: Iterable[float | None] | None) -> list[float]:
    return [x for x in map(number_or_nan, values or ()) if math.isfinite(x)]
