"""People who are described much worse than most are searched alone, from starts far from the population.

A person may stay in a local optimum although most people, and so the population, are at the right one. Starts drawn
from the population do not help if the person's own values lie at its edge: with a line of distributed mass, these are
the people whose first standing wave lies inside the band. One such person among 45 cost 1800 nats, and a wrong
explanation was chosen. So these people are searched from starts that are spread several times as wide as the
population, by the bounded and by the exact error, under a prior of the same width. A thorough search also begins at the
person's own optimum with only those elements drawn that lie outside of this spread. The population's evidence decides
whether the optimum that is found replaces the old one.

With one person there is no population to begin around. An effect whose fit begins where the network without it has
left the elements then stays in that network's valley: a springpot beside the tissue gained 630 nats with a skin that
was two hundred times too compliant, and 875 with the right one. So the only person is searched with the effect in the
network, from random starts and with one element changed at a time, as the network alone was.
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

_ANYWHERE, _SPREAD = 64, 2.5
"""Random starts of the only person, and the standard deviation of their log elements: that of a network's search."""

_CHANGES = (-4.0, -2.0, 2.0, 4.0)
"""Changes of one log element from where the only person is. By choice: a wrong model leaves single elements wrong."""

_APART, _VALLEYS = 0.3, 8
"""Difference of a log element from which two ends are in different valleys, that of common solutions of a network; and
largest number of valleys that are tried, by choice."""

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


def starts_of_the_only_person(fit: Refit, rng: np.random.Generator) -> np.ndarray:
    """Starts of the only person's parameters, shape (S, P).

    Where searches of the first recording with all parameters free have ended, one for each valley; and where the fit is
    with one element changed.

    Parameters
    ----------
    fit : Refit
        Of one person.
    rng : Generator
    """
    model, data = fit.model, fit.data[0]
    n, size = model.n_elements, fit.u.shape[1]
    centre, sd = fit.u[0].copy(), np.empty(size)
    own = ~model.shared
    centre[own], sd[own] = fit.population.mu, np.sqrt(np.diag(fit.population.covariance))
    centre[n:], sd[n:] = [p.centre for p in model.parameters], [p.prior_sd for p in model.parameters]
    one = replace(
        data, z=data.z[:1], weight=data.weight[:1], deviations=np.zeros((1, size)), count=data.count / len(data.z)
    )  # fmt: skip
    starts = np.tile(fit.u[0], (_ANYWHERE, 1))
    starts[:, :n] = centre[:n] + _SPREAD * rng.normal(size=(_ANYWHERE, n))
    changed = np.tile(fit.u[0], (n * len(_CHANGES), 1))
    changed[np.arange(len(changed)), np.repeat(np.arange(n), len(_CHANGES))] += np.tile(_CHANGES, n)
    starts = np.concatenate([fit.u[:1], changed, starts])
    precision = np.diag(sd**-2.0)
    near, values, _ = all_modes(model.kernel, one, starts, centre, precision, _FIRST_STEPS)
    best = np.argsort(values, kind="stable")[: 2 * _STARTS]
    ends, values, _ = all_modes(model.kernel, one, near[best], centre, precision, _STEPS)
    distinct: list[np.ndarray] = []
    for k in np.argsort(values, kind="stable"):
        if np.isfinite(values[k]) and all(np.abs(ends[k, :n] - other[:n]).max() > _APART for other in distinct):
            distinct.append(ends[k])
    return np.concatenate([distinct[:_VALLEYS], changed])
