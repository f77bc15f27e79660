"""All tests of the population: covariates, drift, subgroups, correlations, as entries of the verdict.

The tests are those of :mod:`bayes_impedance.diagnosis.heterogeneity.regression` and its neighbours; here each person's
quadratic likelihood is computed from a fit, and significant structures are collected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.normal_equations import sums
from bayes_impedance.diagnosis.fit.refit import Refit
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
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.recordings.files import Recordings

ALPHA = 0.003
"""Corrected level of each family of tests. There are four families; by the union bound they raise 1.2 % false alarms
together, about as many as the search for missing physics (1 %)."""


def person_likelihoods(fit: Refit) -> PersonLikelihoods:
    """Each person's likelihood of the log elements, deviations between repetitions integrated out."""
    h, linear = _recordings(fit)
    e = fit.model.n_elements
    precision = np.maximum(fit.population.rho[:e], LEAST_RHO) ** -2.0
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


@dataclass(frozen=True)
class ElementTrends:
    """Elements that follow one covariate or the repetitions.

    Attributes
    ----------
    covariate : str or None
        None for the repetitions.
    trends : tuple of Trend
        The most significant first; at least one.
    gain, gain_se : float
        On held-out people, with its standard error.
    """

    covariate: str | None
    trends: tuple[Trend, ...]
    gain: float
    gain_se: float


Structure = ElementTrends | Subgroup | CorrelationTest
"""A significant structure of the population."""


def find_structures(
    fit: Refit, recordings: Recordings, diagonal: bool, seed: int
) -> tuple[tuple[Structure, ...], list[str]]:
    """Significant structures of the population, and remarks.

    Parameters
    ----------
    fit : Refit
    recordings : Recordings
    diagonal : bool
        Whether the claimed population has independent elements.
    seed : int
    """
    found: list[Structure] = []
    remarks: list[str] = []
    people = person_likelihoods(fit)
    values = covariates_of(recordings)
    if values:
        tested = find_covariates(people, values)
        remarks += [f"Covariates: {text}" for text in (tested.reason, *tested.remarks) if text]
        for name in dict.fromkeys(t.covariate for t in tested.trends if t.p_corrected < ALPHA):
            rows = tuple(t for t in tested.trends if t.covariate == name and t.p_corrected < ALPHA)
            regressor = regressors_of({name: values[name]}, [])[name][0]
            gain = gain_of_covariate(people, regressor, [t.element for t in rows], seed)
            found.append(ElementTrends(name, rows, *gain))
    if any(len(s.repetitions) > 1 for s in recordings.subjects):
        repetitions = repetition_likelihoods(fit)
        rows = tuple(t for t in find_drift(repetitions).trends if t.p_corrected < ALPHA)
        if rows:
            found.append(ElementTrends(None, rows, *gain_of_drift(repetitions, [t.element for t in rows], seed)))
    e = fit.model.n_elements
    group = find_subgroup(people, fit.population.mu[:e], fit.population.covariance[:e, :e], seed)
    if group.p_corrected < ALPHA:
        found.append(group)
    if diagonal:
        together = correlation_test(people, seed)
        if together.p_corrected < ALPHA:
            found.append(together)
    return tuple(found), remarks


def covariates_of(recordings: Recordings) -> dict[str, np.ndarray]:
    """Covariates of all people by name, each (N,); NaN where unknown."""
    names = sorted({name for s in recordings.subjects for name in s.covariates})
    return {n: np.array([float(s.covariates.get(n, np.nan)) for s in recordings.subjects]) for n in names}
