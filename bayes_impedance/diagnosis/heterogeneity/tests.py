"""All tests of the population: covariates, drift, subgroups, correlations, as entries of the verdict.

The tests themselves are in the other modules of this room. Here their input, everybody's quadratic likelihood, is made
from a fit, and significant results are written as entries.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_impedance.diagnosis.catalogue.population_structure import STRUCTURES
from bayes_impedance.diagnosis.fit.fitter import Refit
from bayes_impedance.diagnosis.fit.normal_equations import sums
from bayes_impedance.diagnosis.heterogeneity.correlations import CorrelationTest, correlation_test
from bayes_impedance.diagnosis.heterogeneity.gain import gain_of_covariate, gain_of_drift
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.regression import (
    RepetitionLikelihoods,
    Trend,
    find_covariates,
    find_drift,
    regressors_of,
)
from bayes_impedance.diagnosis.heterogeneity.subgroups import Subgroup, find_subgroup
from bayes_impedance.recordings.files import Recordings

ALPHA = 0.003
"""Corrected level of each family of tests. There are four families; by the union bound they raise 1.2 % false alarms
together, about as many as the search for missing physics (1 %)."""

_SMALLEST_RHO = 1e-3
"""Dispersion between repetitions, of log elements, below which it is set to this: a precision must be finite."""

_MEMBER = 0.5
"""Probability of membership above which a person is named as one of a subgroup."""

_REPORTED_PAIR = 0.05
"""Corrected p-value below which a pair of elements is named once the correlations as a whole are significant."""


def person_likelihoods(fit: Refit) -> PersonLikelihoods:
    """Everybody's likelihood of the log elements, deviations between repetitions integrated out."""
    h, linear = _recordings(fit)
    e = fit.model.n_elements
    precision = np.maximum(fit.population.rho[:e], _SMALLEST_RHO) ** -2.0
    pulled = np.linalg.solve(h + np.diag(precision), np.concatenate([h, linear[..., None]], axis=2))
    information = h - np.einsum("mpq,mqr->mpr", h, pulled[..., :-1])
    reduced = linear - np.einsum("mpq,mq->mp", h, pulled[..., -1])
    n = len(fit.data)
    total = sums(information, fit.owner, n)
    names = fit.model.network.elements
    return PersonLikelihoods(names, sums(reduced, fit.owner, n), 0.5 * (total + np.swapaxes(total, 1, 2)))


def repetition_likelihoods(fit: Refit) -> RepetitionLikelihoods:
    """Likelihoods of the deviations of every repetition from the person's elements."""
    h, linear = _recordings(fit)
    e = fit.model.n_elements
    centred = linear - np.einsum("mpq,mq->mp", h, fit.persons[fit.owner][:, :e])
    rows = [np.flatnonzero(fit.owner == i) for i in range(len(fit.data))]
    return RepetitionLikelihoods(
        fit.model.network.elements,
        tuple(centred[r] for r in rows),
        tuple(h[r] for r in rows),
        tuple(np.arange(r.size) for r in rows),
    )


def _recordings(fit: Refit) -> tuple[np.ndarray, np.ndarray]:
    """Information (M, E, E) and linear term (M, E) of every recording's elements, additions held."""
    e = slice(0, fit.model.n_elements)
    w = fit.weight[fit.owner]
    h = w[:, None, None] * fit.equations.information[:, e, e]
    return h, np.einsum("mpq,mq->mp", h, fit.u[:, e]) - w[:, None] * fit.equations.gradient[:, e]


def structure_entries(
    fit: Refit, recordings: Recordings, diagonal: bool, seed: int
) -> tuple[list[dict[str, Any]], list[str]]:
    """Entries of the verdict for covariates and drift, and remarks."""
    entries: list[dict[str, Any]] = []
    remarks: list[str] = []
    people = person_likelihoods(fit)
    values = covariates_of(recordings)
    if values:
        found = find_covariates(people, values)
        remarks += [f"Covariates: {text}" for text in (found.reason, *found.remarks) if text]
        for name in dict.fromkeys(t.covariate for t in found.trends if t.p_corrected < ALPHA):
            rows = [t for t in found.trends if t.covariate == name and t.p_corrected < ALPHA]
            regressor = regressors_of({name: values[name]}, [])[name][0]
            gain = gain_of_covariate(people, regressor, [t.element for t in rows], seed)
            entries.append(_entry("body.covariate", rows, "slope", name, gain))
    if any(len(s.repetitions) > 1 for s in recordings.subjects):
        repetitions = repetition_likelihoods(fit)
        rows = [t for t in find_drift(repetitions).trends if t.p_corrected < ALPHA]
        if rows:
            gain = gain_of_drift(repetitions, [t.element for t in rows], seed)
            entries.append(_entry("body.drift", rows, "trend", None, gain))
    e = fit.model.n_elements
    group = find_subgroup(people, fit.population.mu[:e], fit.population.covariance[:e, :e], seed)
    if group.p_corrected < ALPHA:
        entries.append(_subgroup_entry(group, people.elements))
    if diagonal:
        together = correlation_test(people, seed)
        if together.p_corrected < ALPHA:
            entries.append(_correlation_entry(together))
    return entries, remarks


def covariates_of(recordings: Recordings) -> dict[str, np.ndarray]:
    """Everybody's covariates by name, each (N,); NaN where one is not known."""
    names = sorted({name for s in recordings.subjects for name in s.covariates})
    return {n: np.array([float(s.covariates.get(n, np.nan)) for s in recordings.subjects]) for n in names}


def _subgroup_entry(group: Subgroup, elements: tuple[str, ...]) -> dict[str, Any]:
    strongest = int(np.argmax(np.abs(group.shift)))
    parameters = {
        "fraction": _row("", group.share, group.share_q05, group.share_q95),
        "shift": _row("", group.shift[strongest], group.shift_q05[strongest], group.shift_q95[strongest]),
    }
    entry = _structure("body.subgroup", group.element or elements[strongest], parameters)
    entry["subjects"] = np.flatnonzero(group.membership > _MEMBER).tolist()
    entry["elements"] = [entry["place"]]
    entry["evidence"] = _evidence(group.statistic, group.p_corrected, 0.5 * group.statistic - 2.0)
    return entry


def _correlation_entry(test: CorrelationTest) -> dict[str, Any]:
    parameters = {
        f"correlation of {pair.first} and {pair.second}": _row("", pair.estimate, pair.q05, pair.q95)
        for pair in test.pairs
        if pair.p_corrected < _REPORTED_PAIR
    }
    first = test.pairs[0].first
    entry = _structure("body.correlation", first, parameters)
    entry["evidence"] = _evidence(test.statistic, test.p_corrected, 0.5 * (test.statistic - test.degrees_of_freedom))
    return entry


def _row(unit: str, median: float, q05: float, q95: float) -> dict[str, Any]:
    return {"unit": unit, "median": float(median), "q05": float(q05), "q95": float(q95), "dispersion": 0.0}


def _evidence(score: float, p_value: float, gain: float, se: float | None = None) -> dict[str, Any]:
    """Evidence; a gain without a standard error is a likelihood ratio net of its parameters (Akaike), not held out."""
    se = float(np.sqrt(2 * max(gain, 0.5))) if se is None else se
    return {"score": float(score), "p_value": float(p_value), "elpd_gain": float(gain), "elpd_gain_se": se}


def _structure(kind: str, place: str, parameters: dict[str, Any]) -> dict[str, Any]:
    structure = STRUCTURES[kind]
    return {
        "id": kind,
        "name": structure.name,
        "place": place,
        "side": structure.side,
        "pooling": structure.pooling,
        "parameters": parameters,
        "aliases": [],
        "story": structure.story,
        "formula": structure.formula,
        "look_for": structure.look_for,
        "source": structure.source,
    }


def _entry(
    kind: str, rows: list[Trend], parameter: str, covariate: str | None, gain: tuple[float, float]
) -> dict[str, Any]:
    """Entry for elements that follow a covariate or the repetitions, smallest p-value first."""
    unit = (
        "per repetition" if kind == "body.drift" else "" if rows[0].transform == "log" else f"per unit of {covariate}"
    )
    parameters = {
        parameter if k == 0 else f"{parameter} of {row.element}": _row(unit, row.estimate, row.q05, row.q95)
        for k, row in enumerate(rows)
    }
    entry = _structure(kind, rows[0].element, parameters)
    if covariate is not None:
        entry["name"] = f"{rows[0].element} follows {covariate}"
    entry["covariate"] = covariate
    entry["elements"] = [row.element for row in rows]
    entry["evidence"] = _evidence(rows[0].statistic ** 2, rows[0].p_corrected, *gain)
    return entry
