"""A verdict as plain text for the template: its kind, where the mismatch is, and a card for each effect.

Only the keys of the verdict's schema are expected, and each of them may be missing or None, because a page that cannot
be written helps nobody to find out why a diagnosis failed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayes_impedance.plots.missing_physics import people
from bayes_impedance.units import hertz, scale_for, signed, significant, with_interval

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.types import Diagnosis

ABSENT = "–"
SIDES = {"rig": "the rig", "body": "the body", "both": "rig and body"}
POOLING = {
    "shared": "the same for everybody",
    "varying": "a size of its own for each",
    "some": "in some only",
}
KINDS = {
    "nothing": "Nothing is missing",
    "found": "Something was left out",
    "unknown": "Something is missing that has no name",
    "refused": "Not to be relied on",
}
_SMALLEST_P = 1e-300


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect as text: value, 90 % interval, unit and relative spread between people."""

    name: str
    value: str
    interval: str
    unit: str
    spread: str


@dataclass(frozen=True, kw_only=True)
class Alias:
    """Another explanation, how far it is behind, and what would tell it apart."""

    id: str
    name: str
    place: str
    behind: str
    separated: bool | None
    remedy: str


@dataclass(frozen=True, kw_only=True)
class EffectCard:
    """A card: one effect that was left out."""

    number: int
    id: str
    name: str
    story: str
    formula: str
    place: str
    side: str
    why: str
    pooling: str
    parameters: list[Quantity]
    evidence: list[tuple[str, str, str]]
    aliases: list[Alias]


# -------------------------------------------------------------------- the verdict


def kind_of_verdict(verdict: Mapping[str, Any]) -> str:
    """Which of ``nothing``, ``found``, ``unknown`` and ``refused`` (it cannot be relied on) a verdict is."""
    # A verdict that does not say whether anything is missing must not read as "nothing is".
    if not verdict.get("reliable", True) or verdict.get("mismatch") is None:
        return "refused"
    if not verdict["mismatch"]:
        return "nothing"
    return "found" if any(entry.get("id") != "unknown" for entry in physics(verdict)) else "unknown"


def facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Where the mismatch is, in a few words each; nothing if there is none."""
    verdict = diagnosis.verdict
    if not verdict.get("mismatch"):
        return []
    where, gain = verdict.get("where") or {}, verdict.get("improvement") or {}
    names, found = affected(verdict), []
    if where.get("bands_hz"):
        found.append(("Frequencies", ", ".join(f"{hertz(a)} to {hertz(b)}" for a, b in where["bands_hz"])))
    for key, title in (("part", "Seen in"), ("place", "Place"), ("side", "Belongs to"), ("covariate", "Follows")):
        if where.get(key):
            found.append((title, SIDES.get(where[key], where[key]) if key == "side" else str(where[key])))
    if names:
        more = f" and {len(names) - 3} more" if len(names) > 4 else ""
        found.append(("Seen in whom", ", ".join(names[:3] if more else names) + more))
    elif where.get("subjects") == "all":
        found.append(
            ("Seen in whom", f"all {people(diagnosis)}" if len(diagnosis.subjects) > 1 else "the one measured")
        )
    if gain.get("elpd_gain") is not None:
        found.append(("Held-out gain", _plus_minus(gain.get("elpd_gain"), gain.get("elpd_gain_se"))))
    return found


def affected(verdict: Mapping[str, Any]) -> list[str]:
    """Names of those who show the mismatch; empty if it is everybody."""
    names = (verdict.get("where") or {}).get("subjects")
    return [str(name) for name in names] if isinstance(names, list | tuple) else []


# -------------------------------------------------------------------- what was left out


def effects(diagnosis: Diagnosis) -> list[EffectCard]:
    """A card for each effect that was found."""
    return [_effect(entry, i, diagnosis) for i, entry in enumerate(physics(diagnosis.verdict), 1)]


def physics(verdict: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Entries of the effects that were found."""
    return list(verdict.get("physics") or [])


def _effect(entry: Mapping[str, Any], number: int, diagnosis: Diagnosis) -> EffectCard:
    unknown = entry.get("id") == "unknown"
    name = entry.get("name") or ("a one-port that no entry of the catalogue describes" if unknown else entry.get("id"))
    return EffectCard(
        number=number,
        id=str(entry.get("id") or ""),
        name=str(name or "an effect without a name"),
        story=str(entry.get("story") or ""),
        formula=str(entry.get("formula") or entry.get("network") or ""),
        place=str(entry.get("place") or ""),
        side=SIDES.get(entry.get("side") or "", entry.get("side") or "not decided")
        + ("" if entry.get("side_decided", True) or not entry.get("side") else ", not certainly"),
        why=why_side(entry, diagnosis),
        pooling=POOLING.get(entry.get("pooling") or "", entry.get("pooling") or ""),
        parameters=[_parameter(key, value) for key, value in (entry.get("parameters") or {}).items()],
        evidence=_evidence(entry.get("evidence") or {}),
        aliases=[_alias(alias) for alias in entry.get("aliases") or []],
    )


def why_side(entry: Mapping[str, Any], diagnosis: Diagnosis) -> str:
    """Why an effect is said to be of the rig or of the body: what its spread between people shows."""
    who, one = people(diagnosis), people(diagnosis, 1)
    if len(diagnosis.subjects) == 1:
        return (
            f"One {one} was measured, so the recordings cannot show whether the effect varies between {who}: the side "
            "follows from what the effect is."
        )
    spreads = [p.get("dispersion") for p in (entry.get("parameters") or {}).values()]
    known = [s for s in spreads if s is not None]
    low, high = entry.get("dispersion_interval") or (None, None)
    if low is None or high is None:
        if not known:
            return f"How much it varies between {who} was not estimated."
        spread = f"{_percent(max(known))}"
    else:
        middle = f"{_percent(max(known))}, " if known else ""
        spread = f"{middle}90 % interval {_percent(low)} to {_percent(high)}"
    says = {
        "rig": "A rig is the same for everybody, and a spread near zero speaks for it",
        "body": "A rig is the same for everybody; a spread above zero speaks for the body",
    }.get(entry.get("side") or "", "A rig is the same for everybody, a body is not; this does not decide between them")
    return f"{says}. Relative spread between {who}: {spread}."


def _parameter(name: str, entry: Mapping[str, Any]) -> Quantity:
    unit = str(entry.get("unit") or "")
    middle, low, high = (number_or_nan(entry.get(key)) for key in ("median", "q05", "q95"))
    spread = _percent(entry.get("dispersion"))
    # An interval that is far wider than its middle decides the prefix.
    scale = scale_for(max(abs(x) for x in (middle, (high - low) / 4, 0.0) if math.isfinite(x)), unit)
    value, interval = interval_text(*(scale.factor * x for x in (middle, low, high)))
    return Quantity(name.replace("_", " "), value, interval, "" if value == ABSENT else scale.unit, spread)


def _evidence(entry: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Name, value, meaning."""
    return [
        ("score", score_text(entry.get("score")), "chi-square statistic of the screening"),
        ("p", p_text(entry.get("p_value")), "corrected for everything that was tried"),
        (
            "held-out gain",
            _plus_minus(entry.get("elpd_gain"), entry.get("elpd_gain_se")),
            "in log predictive density, ± standard error",
        ),
    ]


def _alias(entry: Mapping[str, Any]) -> Alias:
    separated = entry.get("separated")
    return Alias(
        id=str(entry.get("id") or ""),
        name=str(entry.get("name") or ""),
        place=str(entry.get("place") or ABSENT),
        behind=number_text(entry.get("elpd_behind")),
        separated=None if separated is None else bool(separated),
        remedy=str(entry.get("would_separate") or ""),
    )


def joint(verdict: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Pairs of parameters of all effects, their posterior correlation, and the stronger ones first."""
    rows: dict[tuple[str, str], float] = {}
    for source in (verdict, *physics(verdict)):
        entry = source.get("joint")
        if not isinstance(entry, Mapping):
            continue
        names, matrix = entry.get("parameters") or [], entry.get("correlation") or []
        for i in range(len(matrix)):
            rows |= {(str(names[j]), str(names[i])): number_or_nan(matrix[i][j]) for j in range(i)}
    known = [(a, b, value) for (a, b), value in rows.items() if math.isfinite(value)]
    return [(a, b, signed(value)) for a, b, value in sorted(known, key=lambda row: -abs(row[2]))]


# -------------------------------------------------------------------- numbers as text


def p_text(value: float | None) -> str:
    """A p-value; values below the smallest floating-point numbers are given as an upper bound."""
    p = number_or_nan(value)
    if not math.isfinite(p):
        return ABSENT
    return "< 1e-300" if p < _SMALLEST_P else significant(p, 2)


def score_text(value: float | None) -> str:
    """A chi-square statistic: large ones without decimals."""
    score = number_or_nan(value)
    return number_text(score) if not 100 <= score < 1e6 else f"{score:.0f}"


def number_or_nan(value: float | None) -> float:
    """A number, NaN for None."""
    return math.nan if value is None else float(value)


def interval_text(middle: float, low: float, high: float) -> tuple[str, str]:
    """A value and its interval, with as many digits as the interval allows; a dash for what is not known."""
    if not all(map(math.isfinite, (middle, low, high))):
        return number_text(middle), ABSENT
    value, interval = with_interval(middle, low, high)
    return _minus(value.lstrip("-") if float(value) == 0 else value), _minus(interval)


def _minus(text: str) -> str:
    return text.replace("-", "−")


def number_text(value: float | None, digits: int = 3) -> str:
    """A number with some significant digits; a dash if it is not known."""
    return _minus(significant(number_or_nan(value), digits))


def _plus_minus(value: float | None, error: float | None) -> str:
    text = number_text(value)
    return text if error is None or not math.isfinite(error) else f"{text} ± {number_text(error, 2)}"


def _percent(value: float | None) -> str:
    share = 100 * number_or_nan(value)
    return f"{significant(share, 2)} %" if math.isfinite(share) else ABSENT
