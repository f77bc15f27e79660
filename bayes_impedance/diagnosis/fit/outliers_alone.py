"""People who are described much worse than most are searched alone, from starts far from the population.

A person may stay in a local optimum although most people, and so the population, are at the right one. Starts drawn
from the population do not help if the person's own values lie at its edge: with a line of distributed mass, these are
the people whose first standing wave lies inside the band. One such person among 45 cost 1800 nats, and a wrong
explanation was chosen. So these people are searched from starts that are spread several times as wide as the
population, by the bounded and by the exact error, under a prior of the same width. A thorough search also begins at the
person's own optimum with only those elements drawn that lie outside of this spread. The population's evidence decides
whether the optimum that is found replaces the old one.

The search is that of a person's first recording. From its end the others are searched where it does not describe them:
repositioning moves an undamped resonance by more than its width, and a person of whom one recording has come to the
others' optimum and two have not would be counted as worse there.
"""

from __future__ import annotations

from concurrent.futures import Executor
from functools import partial

import numpy as np

from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import GROSS, best_mode, bounded_search
from bayes_impedance.person.gaps import other_gaps
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.population.alignment import HELD, searched_alone

_WORSE, BADLY = 1.25, 2.0
"""Noise scales, over the median person's, from which a person is searched, and counts as described badly. By choice:
people's noise differs by 10 or 20 %, and never by the second. Where a line's resonance lay one gap of the frequencies
off, people's scales were 1.3 to 1.9; 64 people together were 1427 better than without the line when they were searched,
and 962 when only the second counted, where a resonator in place of the line was 1313."""

_WIDER, _STARTS = 3.0, 64
"""Spread of the starts in the population's standard deviations, and their number. By choice: people three standard
deviations off occur. Of 40 people whose mass beside an undamped resonance is so, with noise of 0.4 %, 34 were found
from 64 starts in 13 ms each, and 29 from 16 in 6 ms; of 60 people of that network two were not found, and called a
group."""

_NARROW = 128
"""Starts in which only the elements outside of that spread are drawn. By choice: an undamped resonance has an optimum
in each gap between frequencies, of which a decade has a hundred."""

_MOST, _MOST_OF_A_RIGHT_MODEL = 0.25, 0.5
"""Largest share of people who are searched alone, the worst described: where more are described badly, the model is
wrong, and nobody is. Where it describes the median person to within :data:`GROSS` times the noise it is right for most,
and up to half may be in other valleys: a line whose poles lie inside the band was within 1.9 times the noise of 36 of
56 people, and six to a hundred and twenty times it off in the others."""


def ends_of_outliers(
    fit: Refit,
    start: np.ndarray,
    rng: np.random.Generator,
    executor: Executor | None = None,
    among: np.ndarray | None = None,
) -> np.ndarray:
    """The start (M, P), in which people who are described badly begin where a search of their own has ended.

    Parameters
    ----------
    fit : Refit
    start : ndarray, shape (M, P)
    rng : Generator
    executor : Executor, optional
        Distributes the people.
    among : ndarray of bool, shape (N,), optional
        People who may be searched; all if not given.
    """
    scale = fit.weight**-0.5
    median = float(np.median(scale))
    relative = scale / median
    most = int((_MOST_OF_A_RIGHT_MODEL if median < GROSS else _MOST) * scale.size)
    if np.count_nonzero(relative > BADLY) > most:
        return start
    worst = np.sort(np.argsort(-relative, kind="stable")[:most])
    badly = worst[relative[worst] > _WORSE]
    badly = badly if among is None else badly[among[badly]]
    return start if badly.size == 0 else search_alone(fit, start, badly, fit.population, rng, executor=executor)


def search_alone(
    fit: Refit,
    start: np.ndarray,
    people: np.ndarray,
    population: Population,
    rng: np.random.Generator,
    thorough: bool = False,
    executor: Executor | None = None,
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
    executor : Executor, optional
        Distributes the people; without it they are searched one after the other.
    """
    varying = ~fit.model.shared
    precision = np.eye(varying.size) / HELD**2
    precision[np.ix_(varying, varying)] = np.linalg.inv(population.covariance) / _WIDER**2
    factor, sd = _WIDER * np.linalg.cholesky(population.covariance), np.sqrt(np.diag(population.covariance))
    data, centres, begins = [], [], []
    for i in people:
        own = fit.u[np.flatnonzero(fit.owner == i)[0]]
        centre = own.copy()
        centre[varying] = population.mu
        starts = np.tile(centre, (_STARTS + _NARROW, 1))
        starts[:, varying] += rng.normal(size=(len(starts), factor.shape[0])) @ factor.T
        lost = np.zeros(varying.size, dtype=bool)
        lost[varying] = np.abs(own - centre)[varying] > _WIDER * sd
        # The others may be right already: in fewer dimensions a narrow optimum is hit sooner.
        starts[_STARTS:, ~lost] = own[~lost]
        data.append(fit.data[i])
        centres.append(centre)
        begins.append(starts if thorough and lost.any() else starts[:_STARTS])
    rho = np.zeros(varying.size)
    rho[: fit.model.n_elements] = np.maximum(population.rho[: fit.model.n_elements], LEAST_RHO)
    search = partial(_ends, fit.model.kernel, precision, rho)
    ends = (map if executor is None else executor.map)(search, data, centres, begins)
    start = start.copy()
    for i, own_ends in zip(people, ends, strict=True):
        start[np.ix_(fit.owner == i, varying)] = own_ends[:, varying]
    return start


def _ends(
    kernel: Kernel, precision: np.ndarray, rho: np.ndarray, data: Likelihood, centre: np.ndarray, starts: np.ndarray
) -> np.ndarray:
    """The best optimum of a person's first recording from any start (S, P), and of the others from there; (J, P)."""
    one = data.recording(0, centre.size)
    ends = np.concatenate([starts, bounded_search(kernel, one, starts, centre, precision)])
    end = best_mode(kernel, one, ends, centre, precision)[0]
    sd = np.sqrt(np.diag(np.linalg.inv(precision)))
    across = other_gaps(kernel, one, end[None], sd > HELD, sd)
    if len(across):
        end = best_mode(kernel, one, np.concatenate([end[None], across]), centre, precision)[0]
    places = np.tile(end, (len(data.z), 1))
    return places if len(places) == 1 else searched_alone(kernel, data, places, end, rho)
