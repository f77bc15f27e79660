"""Results of the screening for every candidate: the ranking, and the detection limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient
from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.shortlist import ALPHA, best_shapes
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.stepwise import rivals
from bayes_impedance.diagnosis.types import Ranked
from bayes_impedance.diagnosis.verdict_types import Detectable
from bayes_impedance.units import number_with_unit as number
from bayes_impedance.units import unit_of

_POWER = 1.2816
"""90 % quantile of the standard normal: a true effect at the limit is found nine times out of ten."""

_RANKED = 40
"""Largest number of candidates in the ranking. By choice: it bounds the length of the verdict."""


def detection_limits(model: Model, screening: Screening) -> tuple[tuple[Detectable, ...], tuple[str, ...]]:
    """Detection limit of each effect at each place, and the effects that such recordings cannot show."""
    level = critical_z(screening) + _POWER
    information = _information(screening)
    groups: dict[tuple[str, str], list[tuple[float, Candidate]]] = {}
    hidden: list[str] = []
    for k, candidate in enumerate(screening.candidates):
        groups.setdefault((candidate.effect.id, candidate.place), [])
        if np.isfinite(information[k]) and information[k] > 0:
            groups[candidate.effect.id, candidate.place].append((level / np.sqrt(information[k]), candidate))
    limits = []
    for (name, place), rows in groups.items():
        if not rows:
            hidden.append(f"{name} at {place}")
            continue
        rows.sort(key=lambda row: row[0])
        above, candidate = rows[len(rows) // 2]
        effect = candidate.effect
        first = effect.coefficients[0] if effect.operation else None
        scale = first.scale(model.scales) if first else 1.0
        if above > 30 * scale:  # so large that it would dominate the measured curve
            hidden.append(f"{name} at {place}")
            continue
        unit = unit_of(first.unit, model.scales.unit) if first else ""
        value = above / (2 * np.pi) if unit == "Hz" else above
        limits.append(
            Detectable(
                id=name,
                name=effect.name,
                place=place,
                parameter=first.name if first else "size",
                above=float(value),
                unit=unit,
                shape={k: float(v) for k, v in candidate.shape.items()},
            )
        )
    return tuple(limits), tuple(hidden)


def _information(screening: Screening) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((screening.z / screening.size) ** 2)


def critical_z(screening: Screening) -> float:
    """Score at which a candidate becomes significant after correction for all candidates."""
    grid = np.linspace(2.0, 8.0, 601)
    return float(grid[np.argmax(screening.log_p(grid) < np.log(ALPHA))])


def ranking(step: Step, remaining: Sequence[PersonResiduals] = ()) -> tuple[Ranked, ...]:
    """All effects at all places, each with its best shape, the strongest evidence first.

    Parameters
    ----------
    step : Step
    remaining : sequence of PersonResiduals
        Of the final model, if structure remains in them.
    """
    s = step.screening
    order = best_shapes(s, physical_only=False)[:_RANKED]
    if not order:
        return ()
    notes = {}
    if step.chosen is not None:
        notes[step.chosen.fit.model.additions[-1].key] = "found"
        for trial, behind, separated in rivals(step, remaining):
            key = (trial.effect.id, trial.effect.form, trial.candidate.place)
            notes[key] = f"{'' if separated else 'alias, '}behind by {behind:.1f}"
    rows = []
    for k in order:
        c = s.candidates[k]
        first = c.effect.coefficients[0] if c.effect.operation else None
        shape = ", ".join(f"{n.replace('_', ' ')} {_shape_text(c.effect, n, v)}" for n, v in c.shape.items())
        key = (c.effect.id, c.effect.form, c.place)
        note = notes.get(key, "" if s.physical[k] else "unphysical sign")
        rows.append(
            Ranked(
                id=c.effect.id,
                place=c.place,
                pooling=c.effect.pooling,
                shape=shape,
                score=float(s.z[k] ** 2),
                p_value=float(np.exp(s.log_p(s.z[k]))),
                size=_size_text(step.before.model, first, float(s.size[k])),
                physical=bool(s.physical[k]),
                likeness=float(abs(np.nan_to_num(s.cosine[k, order[0]]))),
                note=note,
            )
        )
    return tuple(rows)


def _shape_text(effect: Effect, name: str, value: float) -> str:
    unit = next((c.unit for c in effect.coefficients if c.name == name), "")
    return number(value / (2 * np.pi), "Hz") if unit == "Hz" else number(value, unit)


def _size_text(model: Model, coefficient: Coefficient | None, size: float) -> str:
    if coefficient is None:
        return f"{size:.3g}"
    if coefficient.unit == "Hz":
        return number(size / (2 * np.pi), "Hz")
    return number(size, unit_of(coefficient.unit, model.scales.unit))
