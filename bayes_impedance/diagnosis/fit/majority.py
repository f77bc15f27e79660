"""Refit of people who are apart from the others, from starts among these: they may only be in another optimum.

A person's likelihood may have a second optimum, nearly as good, at quite different elements. People whose fits ended
there differ from everybody else, and several of them look like a group. They are therefore fitted again under the
population of the others alone, from its centre and from searches of their own. If a person's evidence is larger there,
the person is counted with the others. The population is then fitted again, and kept if the evidence of all people is
larger. It is narrower then, so that whoever had stayed in the group is tried once more.

The optima need not differ in what they describe. In ``(m1-n1)|((m2|n3)-m3)`` either branch can have either resonance,
with other elements and the same impedance: 8 of 45 people, whose fits had begun at a model without a line that was
there, had exchanged them, and all were described to within their noise. They widened the standard deviation of a log
element from 0.3 to 2.4, and the evidence of all people was 1489 less than with everybody in one optimum. So people far
from most are looked for in every explanation at rest (:func:`gathered`), not only where a group is about to be named.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.outliers_alone import search_alone
from bayes_impedance.diagnosis.fit.recordings_alone import recordings_alone
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.person.bounded_search import GROSS
from bayes_impedance.population.far_people import LEAST_DISPERSION, far_from_most

_FEWEST = 3
"""People from whom a centre and dispersions are taken. By choice: of two the covariance says nothing."""

_PASSES = 3
"""Largest number of trials of a group. By choice: the first moves most of those whom it can."""

_ROUNDS = 30
"""Rounds of the refit under the others' population. By choice: each person has a few parameters."""


def gathered(refitter: Refitter, fit: Refit) -> Refit:
    """The fit with people whose elements are far from most people's started among the others, if that is better.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        With a population.
    """
    far = far_from_most(fit.persons[:, : fit.model.n_elements])
    wrong = np.median(fit.weight**-0.5) >= GROSS  # for most people: there is nowhere to bring the others to
    if refitter.one_person or wrong or not far.any():
        return fit
    return _until_none_moves(refitter, fit, far)


def joined(refitter: Refitter, fit: Refit, group: np.ndarray) -> Refit:
    """The fit with people of a group started among the others, or the reverse, if that is better; else the fit itself.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    group : ndarray of bool, shape (N,)
    """
    for movers in sorted((group, ~group), key=np.sum):  # the fewer first
        if movers.any():
            fit = _until_none_moves(refitter, fit, movers)
    return fit


def _until_none_moves(refitter: Refitter, fit: Refit, movers: np.ndarray) -> Refit:
    rng = np.random.default_rng(0)  # for starts alone
    for _ in range(_PASSES):
        if not movers.any() or (~movers).sum() < _FEWEST:
            break
        fit, moved = _moved(refitter, fit, movers, rng)
        if not moved.any():
            break
        movers = movers & ~moved
    return fit


def _moved(refitter: Refitter, fit: Refit, movers: np.ndarray, rng: np.random.Generator) -> tuple[Refit, np.ndarray]:
    """The fit with those who are better off among the others there, and who they are, bool, (N,)."""
    elements = np.arange(fit.model.n_elements)
    others = fit.persons[~movers][:, elements]
    mu, covariance = fit.population.mu.copy(), fit.population.covariance.copy()
    mu[elements] = np.median(others, axis=0)
    variance = np.maximum(others.var(axis=0, ddof=1), LEAST_DISPERSION**2)
    covariance[elements], covariance[:, elements] = 0.0, 0.0
    covariance[elements, elements] = variance
    population = Population(mu, covariance, fit.population.rho)
    start, u, evidence = fit.u.copy(), fit.u, fit.evidence
    start[np.ix_(movers[fit.owner], elements)] = mu[elements]
    for search in (False, True):
        begin = start
        if search:
            people = np.flatnonzero(movers)
            begin = search_alone(fit, start, people, population, rng, thorough=True, executor=refitter.executor)
        trial = refitter.fit(fit.model, begin, population, _ROUNDS, hold_population=True, hold_additions=True)
        if search:  # one recording in another gap would cost more than all others gain
            trial = recordings_alone(refitter, trial, hold=True, among=movers)
        better = movers & (trial.evidence > evidence)
        u = np.where(better[fit.owner, None], trial.u, u)
        evidence = np.where(better, trial.evidence, evidence)
    moved = evidence > fit.evidence
    if not moved.any():
        return fit, moved
    again = refitter.fit(fit.model, u, fit.population)
    return (again, moved) if again.evidence.sum() > fit.evidence.sum() else (fit, np.zeros_like(moved))
