"""Entries of the verdict: one for every effect that was found, with the rivals that cannot be separated from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.fit.coefficient_posterior import (
    CoefficientPosterior,
    Reported,
    reported,
    verdict_on_side,
)
from bayes_impedance.diagnosis.fit.extend import dispersion_of_shared
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.spike_slab import members
from bayes_impedance.diagnosis.next_experiment.expected_separation import best_sentence, separation
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.stepwise import Found, rivals
from bayes_impedance.diagnosis.selection.unnamed import Realised
from bayes_impedance.diagnosis.verdict_types import (
    Alias,
    EvidenceOfEffect,
    Joint,
    Parameter,
    Physics,
    Subjects,
)

_PROPOSALS = 4
"""Closest rivals for which the separating measurement is computed: each takes as long as a refit of all
people. By choice."""


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
    who = None
    if item.only_in_some:
        who = posterior.who.get(addition) or members(found.final, addition)
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
    elif not few_people:
        interval = rows[0].dispersion_interval
    side: str | None = effect.side
    if few_people:
        side = None
    elif who is None and item.pooling != "shared" and verdict_on_side(dispersion) == "body":
        side = "body"
    step = found.step_of(item)
    z, p_value = _significance_of(step, item.key) if step else (float("nan"), None)
    parameters = parameters_of(rows)
    people: Subjects = "all"
    if who is not None:
        parameters["fraction"] = Parameter("", who.fraction, who.q05, who.q95, None)
        people = names_of(who.probability, names)
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
            p_value=p_value,
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


def names_of(probability: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """Names of those who more probably belong to a group than not."""
    return tuple(names[i] for i in np.flatnonzero(probability > 0.5).tolist())


def _significance_of(step: Step, key: tuple[str, str, str]) -> tuple[float, float]:
    """Largest score of an effect at its place, and its p-value corrected for everything that was scanned."""
    scans = [scan for scan in (step.screening, step.richer) if scan is not None]
    z = 0.0
    for scan in scans:
        same = [k for k, c in enumerate(scan.candidates) if (c.effect.id, c.effect.form, c.place) == key]
        z = max(z, float(np.abs(np.nan_to_num(scan.z[same])).max(initial=0.0)))
    return z, min(1.0, sum(float(np.exp(scan.log_p(z))) for scan in scans))


def aliases_of(step: Step, quick: bool, remaining: Sequence[PersonResiduals] = ()) -> tuple[Alias, ...]:
    """Rivals of a step's choice, the closest first, and the measurements that would separate them.

    A rival of the other side may be ahead (``elpd_behind`` below zero), because rig or body is decided by dispersion.
    Forms of one effect at one place, such as a second path with and without inertia, are one explanation: the closest
    is listed, and it is excluded if all are; those of the choice's own effect and place are none.

    Parameters
    ----------
    step : Step
    quick : bool
        Quote the catalogue's measurement; otherwise the best separating one is computed for the closest rivals.
    remaining : sequence of PersonResiduals
        Of the final model, if structure remains in them.
    """
    assert step.chosen is not None
    said = [(step.chosen.effect.id, step.chosen.candidate.place)]
    rows: list[Alias] = []
    found = rivals(step, remaining)
    for k, (trial, behind, _) in enumerate(found):
        name = trial.effect.id, trial.candidate.place
        if name in said:
            continue
        said.append(name)
        separated = all(s for t, _, s in found if (t.effect.id, t.candidate.place) == name)
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
    name = "physics outside the catalogue"
    story = "No effect of the catalogue explains what is missing. A small passive network represents it."
    if len(terms) == 1 and not branches[0]:
        formula = f"a law of the form {addition.effect.formula}"
        if addition.effect.id == "unknown":
            name, story = addition.effect.name, addition.effect.story
            formula = "a value that changes along the sweep"
    if len(terms) > 1:
        each = zip(terms, branches, strict=True)
        formula = "a sum of " + ", ".join(f"{branch or t.effect.name} at {t.place}" for t, branch in each)
    return Physics(
        kind="unknown",
        id="unknown",
        name=name,
        place=addition.place,
        side=None,
        pooling="shared" if addition.pooling == "shared" else "varying",
        parameters={},
        evidence=EvidenceOfEffect(None, None, unknown.gain, unknown.gain_se),
        network=branches[0] if len(terms) == 1 else "",
        connection=addition.effect.connection,
        formula=formula,
        story=story,
    )


def unpredicted_entry() -> Physics:
    """Entry for structure in the residuals that neither an effect nor a small network predicts."""
    return Physics(
        kind="unknown",
        id="unknown",
        name="physics outside the catalogue",
        place="port",
        side=None,
        pooling="varying",
        parameters={},
        evidence=EvidenceOfEffect(None, None, None, None),
        connection="beside",
        formula="",
        story=(
            "The residuals are not noise, but no effect of the catalogue and no small network that was tried predicts "
            "recordings that were held out better than the network alone does."
        ),
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


def joint_of(model: Model, posterior: CoefficientPosterior | None) -> Joint:
    """Correlations of all parameters in the joint posterior of several named effects, all additions of `model`."""
    assert posterior is not None  # there are several effects
    ids = [addition.effect.id for addition in model.additions]
    said = [f"{i} at {a.place}" if ids.count(i) > 1 else i for i, a in zip(ids, model.additions, strict=True)]
    names = tuple(f"{said[p.addition]} {p.name.split('.')[-2] if '.' in p.name else p.name}" for p in model.parameters)
    correlation = np.round(np.atleast_2d(np.corrcoef(posterior.central.T)), 3)
    return Joint(names, tuple(tuple(row) for row in correlation.tolist()))
