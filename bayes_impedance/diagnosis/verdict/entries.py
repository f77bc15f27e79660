"""Entries of the verdict: one for every effect that was found, with the rivals that cannot be separated from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from bayes_impedance.diagnosis.catalogue.population_structure import STRUCTURES
from bayes_impedance.diagnosis.fit.coefficient_posterior import (
    CoefficientPosterior,
    Reported,
    reported,
    verdict_on_side,
)
from bayes_impedance.diagnosis.fit.extend import dispersion_of_shared
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.spike_slab import Members, members
from bayes_impedance.diagnosis.heterogeneity.correlations import CorrelationTest
from bayes_impedance.diagnosis.heterogeneity.subgroups import Subgroup
from bayes_impedance.diagnosis.heterogeneity.tests import ElementTrends, Structure
from bayes_impedance.diagnosis.hum.line import Hum
from bayes_impedance.diagnosis.next_experiment.expected_separation import best_sentence, separation
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.stepwise import Found, rivals
from bayes_impedance.diagnosis.selection.unnamed import Realised
from bayes_impedance.diagnosis.verdict_types import (
    Alias,
    EvidenceOfEffect,
    Joint,
    Kind,
    Parameter,
    Physics,
    Subjects,
)
from bayes_impedance.recordings.circumstances import is_amplitude
from bayes_impedance.units import number_with_unit as number

_PROPOSALS = 4
"""Closest rivals for which the separating measurement is computed: each takes as long as a refit of all
people. By choice."""

_SIGNIFICANT_PAIR = 0.05
"""Corrected level at which a pair of correlated elements is listed, where the test of all pairs is significant. By
choice."""


def effect_entry(
    found: Found,
    addition: int,
    posterior: CoefficientPosterior,
    gain: tuple[float, float | None] | None,
    names: Sequence[str],
    few_people: bool,
    quick: bool,
    remaining: Sequence[PersonResiduals] = (),
) -> Physics:
    """Entry for an effect of the catalogue.

    Parameters
    ----------
    found : Found
    addition : int
        Its number in the final model.
    posterior : CoefficientPosterior
    gain : (float, float) or None
        On held-out people, with its standard error.
    names : sequence of str
        Of the people.
    few_people : bool
        Whether there are too few people to distinguish rig and body.
    quick : bool
    remaining : sequence of PersonResiduals
        As for :func:`aliases_of`.
    """
    model = found.final.model
    item = model.additions[addition]
    effect = item.effect
    who = members(found.final, addition) if item.only_in_some else None
    if who is not None:  # the coefficient among those who have it
        posterior = _of_members(posterior, model.columns(addition)[0] - model.n_elements, who)
    elements = posterior.elements
    if elements is None:
        elements = found.final.u[:, : model.n_elements].mean(axis=0)
    rows = reported(model, addition, posterior, elements)
    column = model.columns(addition)[0] - model.n_elements
    dispersion = posterior.relative_dispersion[:, column]
    interval = None
    if item.pooling == "shared" and not few_people:
        dispersion = dispersion_of_shared(found.final, addition, 1)
        low, high = (float(q) for q in np.quantile(dispersion, (0.05, 0.95)))
        interval = (low, high)
    elif who is None and not few_people:  # among those who have it, the spread is an estimate without an interval
        interval = rows[0].dispersion_interval
    side: str | None = effect.side
    if few_people:
        side = None
    elif who is None and item.pooling != "shared" and verdict_on_side(dispersion) == "body":
        side = "body"
    step = found.step_of(item)
    z = _score_of(step, item.key) if step else float("nan")
    parameters = parameters_of(rows)
    people: Subjects = "all"
    if who is not None:
        parameters["fraction"] = Parameter("", who.fraction, who.q05, who.q95, None)
        people = _named(who.probability, names)
    return Physics(
        kind="effect",
        id=effect.id,
        name=effect.name,
        place=item.place,
        side=side,
        side_decided=side is not None and verdict_on_side(dispersion) == side,
        pooling="some" if who is not None else "shared" if item.pooling == "shared" else "varying",
        subjects=people,
        parameters=parameters,
        evidence=EvidenceOfEffect(
            score=float(z**2) if np.isfinite(z) else None,
            p_value=float(np.exp(step.screening.log_p(z))) if step and np.isfinite(z) else None,
            elpd_gain=None if gain is None else gain[0],
            elpd_gain_se=None if gain is None else gain[1],
        ),
        aliases=() if step is None else aliases_of(step, quick, remaining),
        story=effect.story,
        formula=effect.formula,
        look_for=effect.look_for,
        source=effect.source,
        dispersion_interval=interval,
    )


def parameters_of(rows: Sequence[Reported]) -> dict[str, Parameter]:
    """Parameters for the verdict."""
    return {row.name: Parameter(row.unit, row.median, row.q05, row.q95, row.dispersion) for row in rows}


def _named(probability: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """Names of those who more probably belong to a group than not."""
    return tuple(names[i] for i in np.flatnonzero(probability > 0.5).tolist())


def _of_members(posterior: CoefficientPosterior, column: int, who: Members) -> CoefficientPosterior:
    """The posterior with one coefficient's distribution replaced by that among those who have it."""
    central, relative = posterior.central.copy(), posterior.relative_dispersion.copy()
    order = np.argsort(np.argsort(central[:, column]))
    quantiles = (order + 0.5) / len(order)
    central[:, column] = who.mean + who.mean_sd * ndtri(quantiles)  # keeps the correlation with the shapes
    relative[:, column] = who.dispersion
    return replace(posterior, central=central, relative_dispersion=relative)


def _score_of(step: Step, key: tuple[str, str, str]) -> float:
    same = [k for k, c in enumerate(step.screening.candidates) if (c.effect.id, c.effect.form, c.place) == key]
    z = np.abs(np.nan_to_num(step.screening.z[same]))
    return float(z.max(initial=0.0))


def aliases_of(step: Step, quick: bool, remaining: Sequence[PersonResiduals] = ()) -> tuple[Alias, ...]:
    """Rivals of a step's choice, the closest first, and the measurements that would separate them.

    A rival of the other side may be ahead (``elpd_behind`` below zero), because rig or body is decided by dispersion.

    Parameters
    ----------
    step : Step
    quick : bool
        Quote the catalogue's measurement; otherwise the best separating one is computed for the closest rivals.
    remaining : sequence of PersonResiduals
        Of the final model, if structure remains in them.
    """
    assert step.chosen is not None
    rows = []
    for k, (trial, behind, separated) in enumerate(rivals(step, remaining)):
        remedy = trial.effect.separates
        if not separated and k < _PROPOSALS and not quick:
            remedy = f"{best_sentence(separation(step.chosen.fit, trial.fit))}; in general: {remedy}"
        rows.append(
            Alias(
                id=trial.effect.id,
                name=trial.effect.name,
                place=trial.candidate.place,
                elpd_behind=behind,
                separated=separated,
                would_separate=remedy,
            )
        )
    return tuple(rows)


def unknown_entry(unknown: Realised, named: int) -> Physics:
    """Entry for unnamed physics: the network that stands for it, in addition to the named effects."""
    terms = unknown.trial.fit.model.additions[named:]
    if not terms:
        return _whole_network(unknown)
    addition = terms[0]
    branches = unknown.trial.fit.model.branches[named:]  # with names that are free in the network
    joined = "in parallel with" if addition.effect.connection == "beside" else "in series with"
    formula = f"a small network {branches[0]} {joined} the place"
    if len(terms) > 1:
        each = zip(terms, branches, strict=True)
        formula = "a sum of " + ", ".join(f"{branch or t.effect.name} at {t.place}" for t, branch in each)
    return Physics(
        kind="unknown",
        id="unknown",
        name="physics outside the catalogue",
        place=addition.place,
        side=None,
        pooling="shared" if addition.pooling == "shared" else "varying",
        parameters={},
        evidence=EvidenceOfEffect(None, None, unknown.gain, unknown.gain_se),
        network=branches[0] if len(terms) == 1 else "",
        connection=addition.effect.connection,
        formula=formula,
        story="No effect of the catalogue explains what is missing. A small passive network represents it.",
    )


def _whole_network(unknown: Realised) -> Physics:
    """Entry for a claimed network that lacks elements: the network that describes the recordings."""
    network = str(unknown.trial.fit.model.network)
    return Physics(
        kind="unknown",
        id="unknown",
        name="elements that the network lacks",
        place="port",
        side=None,
        pooling="varying",
        parameters={},
        evidence=EvidenceOfEffect(None, None, unknown.gain, unknown.gain_se),
        network=network,
        connection="instead",
        formula=f"the network {network} instead",
        story=(
            "No effect of the catalogue explains what is missing as well as more elements do: the claimed network was "
            "grown element by element, and elements that do not improve predictions were removed."
        ),
    )


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
    kind, parameter = ("body.drift", "trend") if covariate is None else ("body.covariate", "slope")
    unit = "per repetition" if covariate is None else "" if first.transform == "log" else f"per unit of {covariate}"
    parameters = {
        parameter if k == 0 else f"{parameter} of {row.element}": _shared(unit, row.estimate, row.q05, row.q95)
        for k, row in enumerate(found.trends)
    }
    evidence = _evidence(first.statistic**2, first.p_corrected, found.gain, found.gain_se)
    entry = _of_population("trend", kind, found.place, parameters, evidence)
    name = entry.name if covariate is None else f"{first.element} follows {covariate}"
    if covariate is not None and found.within:
        name += " from repetition to repetition"
        name += ": it depends on the amplitude" if is_amplitude(covariate) else ""
    return replace(entry, name=name, covariate=covariate, elements=tuple(row.element for row in found.trends))


def _subgroup_entry(group: Subgroup, elements: Sequence[str], names: Sequence[str]) -> Physics:
    strongest = int(np.argmax(np.abs(group.shift)))
    parameters = {
        "fraction": _shared("", group.share, group.share_q05, group.share_q95),
        "shift": _shared("", group.shift[strongest], group.shift_q05[strongest], group.shift_q95[strongest]),
    }
    place = group.element or elements[strongest]
    evidence = _evidence(group.statistic, group.p_corrected, 0.5 * group.statistic - 2.0)
    entry = _of_population("subgroup", "body.subgroup", place, parameters, evidence)
    return replace(entry, subjects=_named(group.membership, names), elements=(place,))


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


def joint_of(model: Model, posterior: CoefficientPosterior | None) -> Joint:
    """Correlations of all parameters in the joint posterior of several named effects, all additions of `model`."""
    assert posterior is not None  # there are several effects
    ids = [addition.effect.id for addition in model.additions]
    said = [f"{i} at {a.place}" if ids.count(i) > 1 else i for i, a in zip(ids, model.additions, strict=True)]
    names = tuple(f"{said[p.addition]} {p.name.split('.')[-2] if '.' in p.name else p.name}" for p in model.parameters)
    correlation = np.round(np.atleast_2d(np.corrcoef(posterior.central.T)), 3)
    return Joint(names, tuple(tuple(row) for row in correlation.tolist()))
