"""People who are described much worse than most are searched alone, from starts far from the population.

A person may stay in a local optimum although most people, and so the population, are at the right one. Starts drawn
from the population do not help if the person's own values lie at its edge: with a line of distributed mass, these are
the people whose first standing wave lies inside the band. One such person among 45 cost 1800 nats, and a wrong
explanation was chosen. So these people are searched from starts that are spread several times as wide as the
population, by the bounded and by the exact error, under a prior of the same width. A thorough search also begins at the
person's own optimum with only those elements drawn that lie outside of this spread. The population's evidence decides
whether the optimum that is found replaces the old one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.person.bounded_search import bounded_search
from bayes_impedance.person.mode import all_modes

_BADLY = 2.0
"""Noise scale, over the median person's, from which a person counts as described badly. By choice: people's noise
differs by less, and a wrong optimum costs more."""

_WIDER, _STARTS = 3.0, 16
"""Spread of the starts in the population's standard deviations, and their number. By choice: people three standard
deviations off occur, and a start costs a millisecond."""

_NARROW = 128
"""Starts in which only the elements outside of that spread are drawn. By choice: an undamped resonance has an optimum
in each gap between frequencies, of which a decade has a hundred."""

_MOST = 0.25
"""Largest share of people who are searched alone: where more are described badly, the model is wrong."""

_HELD = 1e-4
"""Prior width that holds shared parameters at their values. By choice: far below their standard errors."""

_FIRST_STEPS, _STEPS = 4, 40
"""Largest numbers of steps of the exact search, from all starts and from the best. By choice, the second as in the
first fits."""


def ends_of_outliers(fit: Refit, start: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The start (M, P), in which people who are described badly begin where a search of their own has ended.

    Parameters
    ----------
    fit : Refit
    start : ndarray, shape (M, P)
    rng : Generator
    """
    scale = fit.weight**-0.5
    badly = np.flatnonzero(scale > _BADLY * np.median(scale))
    if badly.size == 0 or badly.size > _MOST * scale.size:
        return start
    return search_alone(fit, start, badly, fit.population, rng)


def search_alone(
    fit: Refit,
    start: np.ndarray,
    people: np.ndarray,
    population: Population,
    rng: np.random.Generator,
    thorough: bool = False,
) -> np.ndarray:
    """The start (M, P), in which some people begin where a search of their own has ended.

    Parameters
    ----------
    fit : Refit
    start : ndarray, shape (M, P)
    people : ndarray of int
    population : Population
        Around which the starts are spread.
    rng : Generator
    thorough : bool
        Also begin at a person's own optimum with only those elements drawn that lie far outside of the population.
    """
    varying = ~fit.model.shared
    precision = np.eye(varying.size) / _HELD**2
    precision[np.ix_(varying, varying)] = np.linalg.inv(population.covariance) / _WIDER**2
    factor, sd = _WIDER * np.linalg.cholesky(population.covariance), np.sqrt(np.diag(population.covariance))
    start = start.copy()
    for i in people:
        rows = np.flatnonzero(fit.owner == i)
        data = fit.data[i]
        one = replace(
            data, z=data.z[:1], weight=data.weight[:1], deviations=np.zeros((1, varying.size)),
            count=data.count / len(data.z),
        )  # fmt: skip
        centre = fit.u[rows[0]].copy()
        centre[varying] = population.mu
        starts = np.tile(centre, (_STARTS + _NARROW, 1))
        starts[:, varying] += rng.normal(size=(len(starts), factor.shape[0])) @ factor.T
        lost = np.zeros(varying.size, dtype=bool)
        lost[varying] = np.abs(fit.u[rows[0]] - centre)[varying] > _WIDER * sd
        # The others may be right already: in fewer dimensions a narrow optimum is hit sooner.
        starts[_STARTS:, ~lost] = fit.u[rows[0], ~lost]
        starts = starts if thorough and lost.any() else starts[:_STARTS]
        nearer = bounded_search(fit.model.kernel, one, starts, centre, precision)
        everywhere = np.concatenate([starts, nearer])
        near, values, _ = all_modes(fit.model.kernel, one, everywhere, centre, precision, _FIRST_STEPS)
        best = np.argsort(values, kind="stable")[: 2 * _STARTS]
        ends, values, _ = all_modes(fit.model.kernel, one, near[best], centre, precision, _STEPS)
        start[np.ix_(rows, np.flatnonzero(varying))] = ends[int(np.argmin(values))][varying]
    return start
