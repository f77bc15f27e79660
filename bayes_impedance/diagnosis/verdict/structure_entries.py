"""Entries of the verdict that change no formula: structures of the population, and hum of the mains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.population_structure import OF_AMPLITUDE, STRUCTURES
from bayes_impedance.diagnosis.heterogeneity.correlations import CorrelationTest
from bayes_impedance.diagnosis.heterogeneity.subgroups import Subgroup
from bayes_impedance.diagnosis.heterogeneity.tests import ElementTrends, OtherVariable, Structure
from bayes_impedance.diagnosis.heterogeneity.trends import Trend
from bayes_impedance.diagnosis.hum.line import Hum
from bayes_impedance.diagnosis.verdict.entries import names_of
from bayes_impedance.diagnosis.verdict_types import Alias, EvidenceOfEffect, Kind, Parameter, Physics
from bayes_impedance.recordings.circumstances import is_amplitude
from bayes_impedance.units import number_with_unit as number

_SIGNIFICANT_PAIR = 0.05
"""Corrected level at which a pair of correlated elements is listed, where the test of all pairs is significant. By
choice."""

_ORDER = ("body.amplitude", "body.drift", "body.covariate")
"""Of two variables that went together, the measurement of the first of these lets them vary apart."""


def hum_entry(hum: Hum, unit: str) -> Physics:
    """Entry for mains hum; its amplitude is that of the complex hum, whose two parts each have the rms found."""
    middle, low, high = (math.sqrt(2) * value for value in (hum.amplitude, hum.q05, hum.q95))
    entry = _of_population(
        "hum",
        "rig.mains",
        "port",
        {"amplitude": Parameter(unit, middle, low, high, 0.0)},
        EvidenceOfEffect(None, hum.p_value, None, None),
    )
    return replace(entry, name=f"{entry.name} at {number(hum.line_hz, 'Hz')}", frequencies_hz=tuple(hum.frequencies_hz))


def structure_entry(structure: Structure, elements: Sequence[str], names: Sequence[str]) -> Physics:
    """Entry for a structure of the population, in the distribution of the elements.

    Parameters
    ----------
    structure : Structure
    elements : sequence of str
        Of the network.
    names : sequence of str
        Of the people.
    """
    if isinstance(structure, ElementTrends):
        return _trend_entry(structure)
    if isinstance(structure, Subgroup):
        return _subgroup_entry(structure, elements, names)
    return _correlation_entry(structure)


def _trend_entry(found: ElementTrends) -> Physics:
    """Entry for elements that follow a covariate or the repetitions, the most significant first."""
    first, covariate = found.trends[0], found.covariate
    kind = _kind(covariate, found.within)
    parameter = "trend" if covariate is None else "slope"
    unit = "per repetition" if covariate is None else "" if first.transform == "log" else f"per unit of {covariate}"
    parameters = {
        parameter if k == 0 else f"{parameter} of {row.element}": _shared(unit, row.estimate, row.q05, row.q95)
        for k, row in enumerate(found.trends)
    }
    evidence = _evidence(first.statistic**2, first.p_corrected, found.gain, found.gain_se)
    entry = _of_population("trend", kind, found.place, parameters, evidence)
    name = entry.name if covariate is None else f"{first.element} follows {covariate}"
    if kind == "body.amplitude":
        name = f"{first.element} {'grows' if first.estimate > 0 else 'falls'} with the amplitude, noted as {covariate}"
        entry = replace(entry, story=f"{entry.story} {_of_amplitude(first)}")
    elif covariate is not None and found.within:
        name += " from repetition to repetition"
    return replace(
        entry,
        name=name,
        covariate=covariate,
        elements=tuple(row.element for row in found.trends),
        aliases=tuple(_alias(other, kind) for other in found.others),
    )


def _kind(covariate: str | None, within: bool) -> str:
    """Which entry of the catalogue it is that elements follow something."""
    if covariate is None:
        return "body.drift"
    return "body.amplitude" if within and is_amplitude(covariate) else "body.covariate"


def _of_amplitude(trend: Trend) -> str:
    """What a slope over the amplitude means, in the words of the field."""
    means = OF_AMPLITUDE.get((trend.element[0], trend.estimate > 0), "")
    if trend.transform == "log":
        means += f" {trend.element} is multiplied by {2**trend.estimate:.3g} where {trend.covariate} is doubled."
    return means.strip()


def _alias(other: OtherVariable, kind: str) -> Alias:
    """Something else that the elements may follow; the measurement lets the two vary apart from each other."""
    own = _kind(other.covariate, True)
    return Alias(
        id=own,
        name=STRUCTURES[own].name if other.covariate is None else f"an element that follows {other.covariate}",
        place=other.element,
        elpd_behind=other.behind,
        separated=False,
        would_separate=next(STRUCTURES[k].separates for k in _ORDER if k in (own, kind)),
    )


def _subgroup_entry(group: Subgroup, elements: Sequence[str], names: Sequence[str]) -> Physics:
    strongest = int(np.argmax(np.abs(group.shift)))
    parameters = {
        "fraction": _shared("", group.share, group.share_q05, group.share_q95),
        "shift": _shared("", group.shift[strongest], group.shift_q05[strongest], group.shift_q95[strongest]),
    }
    place = group.element or elements[strongest]
    evidence = _evidence(group.statistic, group.p_corrected, 0.5 * group.statistic - 2.0)
    entry = _of_population("subgroup", "body.subgroup", place, parameters, evidence)
    return replace(entry, subjects=names_of(group.membership, names), elements=(place,))


def _correlation_entry(test: CorrelationTest) -> Physics:
    parameters = {
        f"correlation of {pair.first} and {pair.second}": _shared("", pair.estimate, pair.q05, pair.q95)
        for pair in test.pairs
        if pair.p_corrected < _SIGNIFICANT_PAIR
    }
    gain = 0.5 * (test.statistic - test.degrees_of_freedom)
    evidence = _evidence(test.statistic, test.p_corrected, gain)
    return _of_population("correlation", "body.correlation", test.pairs[0].first, parameters, evidence)


def _shared(unit: str, median: float, q05: float, q95: float) -> Parameter:
    return Parameter(unit, float(median), float(q05), float(q95), 0.0)


def _evidence(score: float, p_value: float, gain: float, se: float | None = None) -> EvidenceOfEffect:
    """Evidence; a gain without a standard error is a likelihood ratio net of its parameters (Akaike), not held out."""
    se = float(np.sqrt(2 * max(gain, 0.5))) if se is None else se
    return EvidenceOfEffect(float(score), float(p_value), float(gain), se)


def _of_population(
    kind: Kind, structure: str, place: str, parameters: dict[str, Parameter], evidence: EvidenceOfEffect
) -> Physics:
    """Entry for a structure that changes no formula, with the catalogue's texts."""
    said = STRUCTURES[structure]
    return Physics(
        kind=kind,
        id=said.id,
        name=said.name,
        place=place,
        side=said.side,
        pooling=said.pooling,
        parameters=parameters,
        evidence=evidence,
        story=said.story,
        formula=said.formula,
        look_for=said.look_for,
        source=said.source,
    )
