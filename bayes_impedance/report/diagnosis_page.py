"""The page of a diagnosis: the missing physics, or the detection limits if nothing is missing.

The content comes from the :class:`~bayes_impedance.diagnosis.types.Diagnosis`; this room chooses units, digits and
words. :mod:`bayes_impedance.report.findings` formulates the verdict; this module makes the drawings, the tables and
the file.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.schematic import schematic
from bayes_impedance.network.spellings import circuit_of
from bayes_impedance.plots import write_diagnosis_pictures
from bayes_impedance.plots.missing_physics import people
from bayes_impedance.report import alternatives, live_data
from bayes_impedance.report.findings import (
    ABSENT,
    KINDS,
    POOLING,
    affected,
    effects,
    facts,
    interval_text,
    joint,
    kind_of_verdict,
    number_text,
    p_text,
    score_text,
)
from bayes_impedance.report.page_template import embedded_picture, template_environment
from bayes_impedance.runtime.atomic_files import write_text
from bayes_impedance.units import ELECTRICAL_UNIT, Scale, hertz, joined, scale_for, signed, significant

if TYPE_CHECKING:
    from markupsafe import Markup

    from bayes_impedance.diagnosis.types import Diagnosis, Ranked
    from bayes_impedance.diagnosis.verdict_types import Verdict

__all__ = ["write_diagnosis_report"]

DIAGNOSIS_FILE = "diagnosis.html"
"""Beside ``report.html`` of a fit, which a diagnosis leaves as it is."""
_TEMPLATE = "diagnosis.html.j2"
_RANKED = 15
"""Most candidates in the ranking; further ones are left out. By choice: completeness against the table's length."""
_ALIASES = 8
"""Most aliases shown unfolded; further ones are folded. By choice, as for the ranking."""
_NAMES = 12
"""Most names shown unfolded; further ones are folded. By choice, as for the ranking."""
_SAME = 0.95
"""Cosine between two signatures above which the table marks the candidates as alike. By choice: a lower value marks
candidates that the recordings can distinguish."""

_QUANTITIES = {
    "central": "centre",
    "dispersion_between_persons": "dispersion between {who} (sd of ln)",
    "dispersion_between_repetitions": "dispersion between repetitions (sd of ln)",
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


def write_diagnosis_report(
    diagnosis: Diagnosis, folder: str | os.PathLike[str], pictures: Mapping[str, Path] | None = None
) -> Path:
    """Write the page of a diagnosis: one file that needs neither network nor other files.

    Without scripts it shows pictures in place of charts.

    Parameters
    ----------
    diagnosis : Diagnosis
    folder : path
        Made if it does not exist.
    pictures : mapping of str to Path, optional
        PNG files as :func:`~bayes_impedance.plots.write_diagnosis_pictures` names them; drawn into
        ``folder/pictures`` if not given.

    Returns
    -------
    Path
        Of the page. It appears under its name only when it is complete.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if pictures is None:
        pictures = write_diagnosis_pictures(diagnosis, folder / "pictures")
    text = template_environment().get_template(_TEMPLATE).render(**_context(diagnosis, pictures))
    return write_text(folder / DIAGNOSIS_FILE, text)


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
        "electrical": diagnosis.unit == ELECTRICAL_UNIT,
        "circuit_of": partial(circuit_of, unit=diagnosis.unit),
        "kind": kind,
        "kicker": KINDS[kind],
        "sentence": verdict.summary,
        "mismatch": verdict.mismatch,
        "reliable": verdict.reliable,
        "remarks": verdict.remarks,
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
        "held_out": verdict.improvement.held_out if verdict.improvement is not None else "",
        "differences": differences(diagnosis),
        "limits": limits(verdict),
        "not_identifiable": verdict.not_identifiable,
        "elements_not_identified": verdict.elements_not_identified,
        "provenance": provenance(diagnosis),
        "pictures": {name: embedded_picture(file) for name, file in pictures.items()},
        "alternatives": alternatives.of_diagnosis(diagnosis),
        **live_data.of_diagnosis(diagnosis),
    }


@dataclass(frozen=True)
class MissingOnePort:
    """The network fitted in place of physics that is not in the catalogue: place, notation, drawing."""

    place: str
    network: str
    drawing: Markup | None


def unexplained(diagnosis: Diagnosis) -> MissingOnePort | None:
    """The network that stands for what no effect of the catalogue describes; None if there is none."""
    entry = diagnosis.verdict.unexplained
    if entry is None or not entry.formula:
        return None
    return MissingOnePort(entry.place, entry.network, drawing(entry.network, {}, diagnosis))


# -------------------------------------------------------------------- the network


def networks(diagnosis: Diagnosis) -> tuple[str, str]:
    """Notation of the network before the diagnosis, and after it (an empty text if they are equal)."""
    before, after = diagnosis.verdict.network
    return before, "" if after == before else after


def _marks(notation: str, verdict: Verdict) -> dict[tuple[int, ...], str]:
    """Paths of the places of the effects found, with the numbers of their cards."""
    network, marks = _parsed(notation), dict[tuple[int, ...], list[str]]()
    for number, entry in enumerate(verdict.physics, 1):
        try:
            if network is not None:
                marks.setdefault(network.place(entry.place).path, []).append(str(number))
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
    return (
        None
        if network is None
        else Markup(schematic(network, electrical=diagnosis.unit == ELECTRICAL_UNIT, mark=marks))
    )


def _parsed(notation: str | None) -> Network | None:
    try:
        return parse(notation) if notation else None
    except InputError:
        return None


# -------------------------------------------------------------------- tables


def ranking(diagnosis: Diagnosis) -> list[RankedRow]:
    """The best candidates of the first screening."""
    rows = diagnosis.ranking[:_RANKED]
    best = max((row.score for row in rows if math.isfinite(row.score)), default=0.0)
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
    """Quantities that changed: name, and values before and after with their unit."""
    entry = diagnosis.verdict.improvement
    if entry is None:
        return []
    scale = scale_for(max(filter(math.isfinite, entry.delta_magnitude), default=math.nan), diagnosis.unit)
    one = "the network" if len(diagnosis.subjects) == 1 else "one network for all"
    rows = (
        (f"Magnitude error of {one} (eq. 5)", entry.delta_magnitude, scale.factor, f" {scale.unit}"),
        (f"Phase error of {one} (eq. 5)", entry.delta_phase_deg, 1.0, "°"),
        (
            f"Error of each {people(diagnosis, 1)}'s individual fit (relative, median)",
            entry.subject_rms_relative,
            100.0,
            " %",
        ),
        ("Recordings inside the predicted 90 % band, average over frequency", entry.coverage90, 100.0, " %"),
    )
    shown = []
    for name, pair, factor, unit in rows:
        if any(map(math.isfinite, pair)):
            before, after = (number_text(x * factor) for x in pair)
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
        what = _QUANTITIES.get(d.what, d.what).format(who=people(diagnosis))
        rows.append((d.element, what, *shown, ratio, interval, p_text(d.p_value)))
    return rows


def limits(verdict: Verdict) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Detection limits: id and name of each effect, and at each place the smallest size that would be detected."""
    grouped: dict[str, list[tuple[str, str]]] = {}
    names = {}
    for limit in verdict.detectable:
        scale = scale_for(limit.above, limit.unit) if limit.unit else Scale(1.0, "")
        size = joined(significant(limit.above * scale.factor, 2), scale.unit)
        grouped.setdefault(limit.id, []).append((limit.place, size))
        names[limit.id] = limit.name
    return [(id, names[id], places) for id, places in grouped.items()]


def provenance(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Provenance of the verdict: rows of name and value."""
    verdict, f = diagnosis.verdict, diagnosis.before.frequency_hz
    n, repetitions = len(diagnosis.subjects), diagnosis.repetitions
    times = "once" if repetitions == 1 else f"up to {repetitions} times each" if n > 1 else f"{repetitions} times"
    seconds = ", ".join(f"{name} {value:.1f} s" for name, value in diagnosis.seconds.items())
    return [
        ("Recordings", diagnosis.title),
        ("Measured", f"{n} {people(diagnosis, n)}, {times}, {f.size} frequencies from {hertz(f[0])} to {hertz(f[-1])}"),
        ("Network", networks(diagnosis)[0]),
        ("Seed", str(verdict.seed)),
        ("SHA-256 of the data", verdict.data_sha256 or "none: the recordings did not come from a file"),
        ("Version", verdict.version),
        ("Seconds", seconds or "not recorded"),
    ]
