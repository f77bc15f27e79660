"""A verdict as plain text for the template: its kind, where the mismatch is, and a card for each effect."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bayes_impedance.diagnosis.verdict.sentence import body_of, gain_in_words, only_structure
from bayes_impedance.plots.missing_physics import people
from bayes_impedance.units import hertz, scale_for, signed, significant, with_interval

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.types import Diagnosis
    from bayes_impedance.diagnosis.verdict_types import Alias, EvidenceOfEffect, Parameter, Physics, Verdict

ABSENT = "–"
POOLING = {
    "shared": "the same for all",
    "varying": "a different size for each",
    "some": "in some only",
}
KINDS = {
    "nothing": "Nothing is missing",
    "structure": "No effect was found",
    "found": "Physics is missing",
    "unknown": "Physics is missing that no known effect explains",
    "refused": "Not reliable",
}
_SMALLEST_P = 1e-300
"""Smaller p-values are given as an upper bound: close to the smallest double-precision number, 2e-308."""


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect as text: value, 90 % interval, unit and relative spread between people."""

    name: str
    value: str
    interval: str
    unit: str
    spread: str


@dataclass(frozen=True, kw_only=True)
class AliasRow:
    """An alternative explanation, how much worse it fits, and a measurement that would distinguish it."""

    id: str
    name: str
    place: str
    behind: str
    separated: bool
    remedy: str


@dataclass(frozen=True, kw_only=True)
class EffectCard:
    """A card of the page: one effect that the network lacks."""

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
    aliases: list[AliasRow]


# -------------------------------------------------------------------- the verdict


def kind_of_verdict(verdict: Verdict) -> str:
    """Kind of a verdict: ``nothing``, ``structure``, ``found``, ``unknown`` or ``refused`` (not reliable)."""
    if not verdict.reliable:
        return "refused"
    if not verdict.mismatch:
        return "structure" if only_structure(verdict) else "nothing"
    return "found" if any(entry.kind != "unknown" for entry in verdict.physics) else "unknown"


def facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Where the mismatch is, in a few words each; empty if there is none."""
    verdict = diagnosis.verdict
    if not verdict.mismatch:
        return []
    where, gain = verdict.where, verdict.improvement
    names, found = affected(verdict), []
    if where.bands_hz:
        found.append(("Frequencies", ", ".join(f"{hertz(a)} to {hertz(b)}" for a, b in where.bands_hz)))
    side = _side(where.side, diagnosis) if where.side else None
    for title, text in (
        ("Part of z", where.part),
        ("Place", where.place),
        ("Belongs to", side),
        ("Follows", where.covariate),
    ):
        if text:
            found.append((title, text))
    if names:
        more = f" and {len(names) - 3} more" if len(names) > 4 else ""
        found.append(("Shown by", ", ".join(names[:3] if more else names) + more))
    elif where.subjects == "all":
        found.append(("Shown by", f"all {people(diagnosis)}" if len(diagnosis.subjects) > 1 else "the one measured"))
    if gain is not None and gain.elpd_gain is not None:
        found.append(("Held-out gain", _gain_text(gain.elpd_gain, gain.elpd_gain_se)))
    return found


def affected(verdict: Verdict) -> list[str]:
    """Names of the subjects who show the mismatch; empty if all do."""
    names = verdict.where.subjects
    return [] if names == "all" else list(names)


# -------------------------------------------------------------------- what was left out


def effects(diagnosis: Diagnosis) -> list[EffectCard]:
    """A card for each effect that was found."""
    return [_effect(entry, i, diagnosis) for i, entry in enumerate(diagnosis.verdict.physics, 1)]


def _effect(entry: Physics, number: int, diagnosis: Diagnosis) -> EffectCard:
    side = "not decided" if entry.side is None else _side(entry.side, diagnosis)
    return EffectCard(
        number=number,
        id=entry.id,
        name=entry.name,
        story=entry.story,
        formula=entry.formula,
        place=entry.place,
        side=side + ("" if entry.side_decided or entry.side is None else ", not certain"),
        why=why_side(entry, diagnosis),
        pooling=POOLING[entry.pooling],
        parameters=[_quantity(name, parameter) for name, parameter in entry.parameters.items()],
        evidence=_evidence(entry.evidence),
        aliases=[_alias(alias) for alias in entry.aliases],
    )


def why_side(entry: Physics, diagnosis: Diagnosis) -> str:
    """Reason why an effect is attributed to the rig or to the body, from its spread between people."""
    who, one, body = people(diagnosis), people(diagnosis, 1), body_of(diagnosis.unit)
    if len(diagnosis.subjects) == 1:
        return (
            f"One {one} was measured, so the recordings cannot show whether the effect varies between {who}: the "
            "side follows from the kind of effect."
        )
    spread = _spread(entry)
    if spread is None:
        return f"Its dispersion between {who} was not estimated."
    says = {
        "rig": f"An effect of the rig is the same for all {who}; a dispersion near zero supports the rig",
        "body": f"An effect of the rig is the same for all {who}; a dispersion above zero supports the {body}",
    }.get(
        entry.side or "",
        f"An effect of the rig is the same for all {who}, one of the {body} is not; the dispersion does not decide",
    )
    return f"{says}. Relative dispersion of the {spread[0]} between {who}: {spread[1]}."


def _spread(entry: Physics) -> tuple[str, str] | None:
    """The parameter whose spread decides between rig and body, and that spread with its interval."""
    if not entry.parameters:
        return None
    name, first = next(iter(entry.parameters.items()))
    interval, text = entry.dispersion_interval, ""
    if interval is not None:
        text = f"90 % interval {_percent(interval[0])} to {_percent(interval[1])}"
    if entry.pooling == "shared":  # its dispersion is zero because it was not estimated
        return None if interval is None else (name.replace("_", " "), text)
    if first.dispersion is None:
        return None
    return name.replace("_", " "), ", ".join(part for part in (_percent(first.dispersion), text) if part)


def _quantity(name: str, parameter: Parameter) -> Quantity:
    middle, low, high = parameter.median, parameter.q05, parameter.q95
    # The prefix follows the interval if that is far wider than the middle value.
    scale = scale_for(max(abs(x) for x in (middle, (high - low) / 4, 0.0) if math.isfinite(x)), parameter.unit)
    value, interval = interval_text(*(scale.factor * x for x in (middle, low, high)))
    spread = "the same for all" if parameter.dispersion == 0 else _percent(parameter.dispersion)
    return Quantity(name.replace("_", " "), value, interval, "" if value == ABSENT else scale.unit, spread)


def _evidence(entry: EvidenceOfEffect) -> list[tuple[str, str, str]]:
    """Name, value, meaning."""
    return [
        ("score", score_text(entry.score), "chi-square statistic of the screening"),
        ("p", p_text(entry.p_value), "corrected for all candidates that were tried"),
        (
            "held-out gain",
            _plus_minus(entry.elpd_gain, entry.elpd_gain_se),
            f"nats of log predictive density, ± standard error: {_predicts(entry)}",
        ),
    ]


def _predicts(entry: EvidenceOfEffect) -> str:
    if entry.elpd_gain is None or not math.isfinite(entry.elpd_gain):
        return "not computed"
    return f"recordings that were held out are predicted {gain_in_words(entry.elpd_gain, entry.elpd_gain_se)}"


def _gain_text(gain: float, error: float | None) -> str:
    """A gain with its standard error, beside what it means."""
    return f"{_plus_minus(gain, error)} nats: predicted {gain_in_words(gain, error)}"


def _side(side: str, diagnosis: Diagnosis) -> str:
    return f"the {body_of(diagnosis.unit)}" if side == "body" else f"the {side}"


def _alias(entry: Alias) -> AliasRow:
    return AliasRow(
        id=entry.id,
        name=entry.name,
        place=entry.place,
        behind=number_text(entry.elpd_behind),
        separated=entry.separated,
        remedy=entry.would_separate,
    )


def joint(verdict: Verdict) -> list[tuple[str, str, str]]:
    """Pairs of parameters of all effects with their posterior correlation, the strongest first."""
    if verdict.joint is None:
        return []
    names, matrix = verdict.joint.parameters, verdict.joint.correlation
    rows = {(names[j], names[i]): matrix[i][j] for i in range(len(names)) for j in range(i)}
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
    """A chi-square statistic as text: large values without decimals."""
    score = number_or_nan(value)
    return number_text(score) if not 100 <= score < 1e6 else f"{score:.0f}"


def number_or_nan(value: float | None) -> float:
    """A number, NaN for None."""
    return math.nan if value is None else float(value)


def interval_text(middle: float, low: float, high: float) -> tuple[str, str]:
    """A value and its interval, with as many digits as the interval justifies; a dash for unknown values."""
    if not all(map(math.isfinite, (middle, low, high))):
        return number_text(middle), ABSENT
    value, interval = with_interval(middle, low, high)
    return _minus(value.lstrip("-") if float(value) == 0 else value), _minus(interval)


def _minus(text: str) -> str:
    return text.replace("-", "−")


def number_text(value: float | None, digits: int = 3) -> str:
    """A number with a given number of significant digits; a dash if it is not known."""
    return _minus(significant(number_or_nan(value), digits))


def _plus_minus(value: float | None, error: float | None) -> str:
    text = number_text(value)
    return text if error is None or not math.isfinite(error) else f"{text} ± {number_text(error, 2)}"


def _percent(value: float | None) -> str:
    share = 100 * number_or_nan(value)
    return f"{significant(share, 2)} %" if math.isfinite(share) else ABSENT
