r"""Regression of the elements on covariates of the person.

:math:`\theta_i = \mu + B x_i + N(0, T)`, with mu, T and the slopes of all elements free: an element's
slope is then its own and not induced by a correlated element. The statistic is the restricted estimate over its
standard error, against Student's t, with Kenward and Roger's standard error and degrees of freedom: exact if every
recording determines every element, whatever N. No simulation is needed, and p values have no lower limit. Each
covariate is tested beside those already found (the best one is added as long as its p, times everything tried, is below
`alpha`): if contact force happens to grow with age, an effect of the force is not attributed to age. Corrected p values
are Holm's over all elements times all covariates.

How a covariate enters is said in :mod:`.trends`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.reml import FullCovariance, centred_fit, fit_normal_population
from bayes_impedance.diagnosis.heterogeneity.trends import (
    ALPHA,
    COLLINEAR,
    LARGEST_SLOPE_SD,
    MINIMUM_PERSONS,
    Trend,
    Trends,
    corrected,
    others,
    regressors_of,
    trends_of,
)
from bayes_impedance.diagnosis.multiple_testing import bonferroni
from bayes_impedance.errors import InputError
from bayes_impedance.units import counted

_SPARE_PERSONS = 3
"""Persons required in addition to one per covariate: for the mean, and two degrees of freedom for the variance."""


def find_covariates(
    likelihoods: PersonLikelihoods, covariates: Mapping[str, np.ndarray], *, alpha: float = ALPHA
) -> Trends:
    """Test every element against every covariate.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
        Of N persons.
    covariates : mapping of str to ndarray, shape (N,)
        NaN where unknown; the person is then left out of that covariate's tests.
    alpha : float
        Corrected p below which a covariate is added to the model in which the others are tested.

    Returns
    -------
    Trends
    """
    n = len(likelihoods)
    for name, values in covariates.items():
        if np.shape(values) != (n,):
            raise InputError(
                f"covariate '{name}' has shape {np.shape(values)}: give one number for each of {n} subjects"
            )
    if n < MINIMUM_PERSONS:
        return Trends((), 0, reason=f"only {counted(n, 'subject')}; at least {MINIMUM_PERSONS} are needed")
    if not covariates:
        return Trends((), 0, reason="there are no covariates")
    remarks: list[str] = []
    regressors = regressors_of(covariates, remarks)
    centre, null = centred_fit(likelihoods)
    kept = np.flatnonzero(null.determined)
    remarks += [f"{e} is not determined by the recordings" for e in others(likelihoods.elements, kept)]
    if not regressors or not kept.size:
        return Trends((), 0, reason="no covariate varies, or no element is determined", remarks=tuple(remarks))
    search = _Search(likelihoods.around(centre), null.covariance, regressors, kept)
    beside: list[str] = []
    while True:
        rows = {q: search.slopes([b for b in beside if b != q], q) for q in regressors}
        tried = sum(len(r) for r in rows.values())
        best = {q: min((t.p_value for t in r), default=1.0) for q, r in rows.items() if q not in beside}
        if not best or bonferroni(min(best.values()), tried) > alpha:
            break
        beside.append(min(best, key=lambda q: best[q]))
    remarks += [
        f"covariate '{q}' is known for too few subjects, or is determined by the other covariates"
        for q in rows
        if not rows[q]
    ]
    found = [t for r in rows.values() for t in r]
    return Trends(corrected(found), tried, tuple(beside), "" if found else "no slope is determined", tuple(remarks))


@dataclass(frozen=True)
class _Search:
    """What all fits of covariates have in common."""

    likelihoods: PersonLikelihoods
    covariance: np.ndarray
    regressors: Mapping[str, tuple[np.ndarray, str]]
    kept: np.ndarray

    def slopes(self, beside: list[str], name: str) -> list[Trend]:
        """Slopes of all elements on one covariate, with others in the model; empty if they cannot be estimated."""
        columns = np.array([self.regressors[q][0] for q in [*beside, name]]).T
        rows = np.all(np.isfinite(columns), axis=1)
        n, k = int(rows.sum()), columns.shape[1]
        if n < max(MINIMUM_PERSONS, k + _SPARE_PERSONS):
            return []
        x = columns[rows]
        sd = x.std(axis=0)
        if not np.all(sd > 0):
            return []
        z = np.hstack([np.ones((n, 1)), (x - x.mean(axis=0)) / sd])
        if np.linalg.svd(z, compute_uv=False)[-1] < COLLINEAR * np.sqrt(n):
            return []
        p = len(self.likelihoods.elements)
        design = np.einsum("nk,pq->npkq", z, np.eye(p)).reshape(n, p, -1)
        fit = fit_normal_population(self.likelihoods.persons(rows), design, FullCovariance(self.covariance))
        wanted = {k * p + int(e): self.likelihoods.elements[e] for e in self.kept}
        wanted = {c: e for c, e in wanted.items() if fit.variance[c, c] < LARGEST_SLOPE_SD**2}
        return trends_of(fit, wanted, name, self.regressors[name][1], float(sd[-1]))
