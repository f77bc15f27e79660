"""Refit of people who seem to form a group, from starts among the others: the group may be only a local optimum.

A person's likelihood may have a second optimum, nearly as good, at quite different elements. People whose fits ended
there differ from everybody else, and several of them look like a group. They are therefore fitted again under the
population of the others alone, from its centre and from searches of their own. If a person's evidence is larger there,
the person is counted with the others. The population is then fitted again, and kept if the evidence of all people is
larger.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.outliers_alone import search_alone
from bayes_impedance.diagnosis.fit.refit import Refit

_FEWEST = 3
"""People from whom a centre and dispersions are taken. By choice: of two the covariance says nothing."""

_SMALLEST_DISPERSION = 0.1
"""Least standard deviation between the people who are joined. By choice: a few people who happen to be alike must not
exclude others; people differ by 0.2 to 0.5."""

_ROUNDS = 30
"""Rounds of the refit under the others' population. By choice: each person has a few parameters."""


def joined(refitter: Refitter, fit: Refit, group: np.ndarray) -> Refit:
    """The fit with people of a group started among the others, or the reverse, if that is better; else the fit itself.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    group : ndarray of bool, shape (N,)
    """
    for movers in sorted((group, ~group), key=np.sum):  # the fewer first
        if movers.any() and (~movers).sum() >= _FEWEST:
            fit = _moved(refitter, fit, movers)
    return fit


def _moved(refitter: Refitter, fit: Refit, movers: np.ndarray) -> Refit:
    elements = np.arange(fit.model.n_elements)
    others = fit.persons[~movers][:, elements]
    mu, covariance = fit.population.mu.copy(), fit.population.covariance.copy()
    mu[elements] = np.median(others, axis=0)
    variance = np.maximum(others.var(axis=0, ddof=1), _SMALLEST_DISPERSION**2)
    covariance[elements], covariance[:, elements] = 0.0, 0.0
    covariance[elements, elements] = variance
    start = fit.u.copy()
    rows = np.flatnonzero(movers[fit.owner])
    start[np.ix_(rows, elements)] = mu[elements]
    population = Population(mu, covariance, fit.population.rho)
    u, evidence = fit.u, fit.evidence
    rng = np.random.default_rng(0)  # for starts alone
    people = np.flatnonzero(movers)
    alone = search_alone(fit, start, people, population, rng, thorough=True, executor=refitter.executor)
    for begin in (start, alone):
        trial = refitter.fit(fit.model, begin, population, _ROUNDS, hold_population=True, hold_additions=True)
        better = movers & (trial.evidence > evidence)
        u = np.where(better[fit.owner, None], trial.u, u)
        evidence = np.where(better, trial.evidence, evidence)
    if np.array_equal(u, fit.u):
        return fit
    again = refitter.fit(fit.model, u, fit.population)
    return again if again.evidence.sum() > fit.evidence.sum() else fit
