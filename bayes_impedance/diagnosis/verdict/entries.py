"""Entries of the verdict: one for every effect that was found, with what it cannot be told from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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
from bayes_impedance.diagnosis.fit.spike_slab import Members, members
from bayes_impedance.diagnosis.hum.line import Hum
from bayes_impedance.diagnosis.next_experiment.expected_separation import best_sentence, separation
from bayes_impedance.diagnosis.selection.stepwise import Found, Step, rivals
from bayes_impedance.diagnosis.selection.unnamed import Realised
from bayes_impedance.units import number_with_unit as number

_PROPOSALS = 4


def parameters_of(rows: Sequence[Reported]) -> dict[str, dict[str, Any]]:
    """Parameters for the verdict."""
    return {
        row.name: {
            "unit": row.unit,
            "median": row.median,
            "q05": row.q05,
            "q95": row.q95,
            "dispersion": row.dispersion,
        }
        for row in rows
    }


def physics_entry(
    found: Found,
    addition: int,
    posterior: CoefficientPosterior,
    gain: tuple[float, float | None] | None,
    one_recording: bool,
) -> dict[str, Any]:
    """One effect that was found.

    Parameters
    ----------
    found : Found
    addition : int
        Its number in the final model.
    posterior : CoefficientPosterior
    gain : (float, float) or None
        On held-out people, with its standard error.
    one_recording : bool
        There are too few people to tell rig from body.
    """
    model = found.final.model
    item = model.additions[addition]
    effect = item.effect
    who = members(found.final, addition) if effect.pooling == "some" else None
    if who is not None:  # the coefficient of those who have it, not of everybody
        posterior = _of_members(posterior, model.columns(addition)[0] - model.n_elements, who)
    rows = reported(model, addition, posterior, np.asarray(found.final.u[:, : model.n_elements].mean(axis=0)))
    column = model.columns(addition)[0] - model.n_elements
    dispersion = posterior.relative_dispersion[:, column]
    if item.pooling == "shared" and not one_recording:
        dispersion = dispersion_of_shared(found.final, addition, 1)
    interval = [float(q) for q in np.quantile(dispersion, (0.05, 0.95))] if not one_recording else None
    side: str | None = effect.side
    if one_recording:
        side = None
    elif item.pooling != "shared" and verdict_on_side(dispersion) == "body":
        side = "body"
    step = found.step_of(item)
    z = _score_of(step, item.key) if step else float("nan")
    parameters = parameters_of(rows)
    people: Any = "all"
    if who is not None:
        parameters["fraction"] = {
            "unit": "",
            "median": who.fraction,
            "q05": who.q05,
            "q95": who.q95,
            "dispersion": None,
        }
        people = np.flatnonzero(who.probability > 0.5).tolist()
    return {
        "id": effect.id,
        "name": effect.name,
        "place": item.place,
        "side": side,
        "side_decided": side is not None and verdict_on_side(dispersion) == side,
        "pooling": effect.pooling if effect.pooling == "some" else "shared" if item.pooling == "shared" else "varying",
        "subjects": people,
        "parameters": parameters,
        "evidence": {
            "score": float(z**2) if np.isfinite(z) else None,
            "p_value": float(np.exp(step.screening.log_p(z))) if step and np.isfinite(z) else None,
            "elpd_gain": None if gain is None else gain[0],
            "elpd_gain_se": None if gain is None else gain[1],
        },
        "aliases": [],
        "story": effect.story,
        "formula": effect.formula,
        "look_for": effect.look_for,
        "source": effect.source,
        "dispersion_interval": interval,
    }


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


def aliases(step: Step, quick: bool) -> list[dict[str, Any]]:
    """Rivals of what a step has chosen, the closest first, and what would separate them.

    One of the other side may be ahead (``elpd_behind`` below zero): sides go by whether people differ.

    Parameters
    ----------
    step : Step
    quick : bool
        Quote the catalogue's measurement; otherwise it is computed which one separates, for the closest.
    """
    assert step.chosen is not None
    rows = []
    for k, (trial, behind, separated) in enumerate(rivals(step)):
        remedy = trial.effect.separates
        if not separated and k < _PROPOSALS and not quick:
            remedy = f"{best_sentence(separation(step.chosen.fit, trial.fit))}; usually: {remedy}"
        rows.append(
            {
                "id": trial.effect.id,
                "name": trial.effect.name,
                "place": trial.candidate.place,
                "elpd_behind": behind,
                "separated": separated,
                "would_separate": remedy,
            }
        )
    return rows


def unknown_entry(unknown: Realised, named: int) -> dict[str, Any]:
    """Entry for physics without a name: what stands in for it, beyond the additions that have names."""
    terms = unknown.trial.fit.model.additions[named:]
    addition = terms[0]
    formula = f"a small network {addition.effect.branch} {addition.effect.connection} the place"
    if len(terms) > 1:
        formula = "a sum of " + ", ".join(f"{t.effect.branch or t.effect.name} at {t.place}" for t in terms)
    return {
        "id": "unknown",
        "name": "physics outside of the catalogue",
        "place": addition.place,
        "side": None,
        "pooling": "shared" if addition.pooling == "shared" else "varying",
        "parameters": {},
        "evidence": {
            "score": None,
            "p_value": None,
            "elpd_gain": unknown.gain,
            "elpd_gain_se": unknown.gain_se,
        },
        "aliases": [],
        "network": addition.effect.branch if len(terms) == 1 else "",
        "connection": addition.effect.connection,
        "formula": formula,
        "story": "Something is missing that is not in the catalogue. A network that fits stands in for it.",
    }


def hum_entry(hum: Hum, unit: str) -> dict[str, Any]:
    """Entry for hum of the mains; its amplitude is that of the complex hum, of which each part has the rms found."""
    amplitude = {
        key: math.sqrt(2) * value for key, value in (("median", hum.amplitude), ("q05", hum.q05), ("q95", hum.q95))
    }
    structure = STRUCTURES["rig.mains"]
    return {
        "id": structure.id,
        "name": f"{structure.name} at {number(hum.line_hz, 'Hz')}",
        "place": "port",
        "side": "rig",
        "pooling": "shared",
        "parameters": {"amplitude": {"unit": unit, **amplitude, "dispersion": 0.0}},
        "evidence": {"score": None, "p_value": hum.p_value, "elpd_gain": None, "elpd_gain_se": None},
        "aliases": [],
        "story": structure.story,
        "formula": structure.formula,
        "look_for": structure.look_for,
        "source": structure.source,
        "frequencies_hz": list(hum.frequencies_hz),
    }


def joint(found: Found) -> dict[str, Any]:
    """Correlations of all parameters in the joint posterior of several effects."""
    assert found.posterior is not None
    model = found.final.model
    names = [
        f"{model.additions[p.addition].effect.id} {p.name.split('.')[-2] if '.' in p.name else p.name}"
        for p in model.parameters
    ]
    correlation = np.corrcoef(found.posterior.central.T)
    return {"parameters": names, "correlation": np.round(np.atleast_2d(correlation), 3).tolist()}
