"""Single recordings are searched alone where one may be in another optimum than the person's others.

The fit moves all recordings of a person together. Where nothing damps a resonance, a recording may be left on the wrong
side of a point of the frequency grid, and looks as if physics were missing
(:mod:`bayes_impedance.population.alignment`). That need not show in a person's noise: people's noise differs by 10 or
20 %, and one recording of two in the wrong gap raised it by 16 % and cost 395 nats. So where a resonance is narrower
than the gaps (:mod:`bayes_impedance.person.gaps`) every recording is searched, also of people who have only one, whose
elements then have the population's distribution about its centre.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import best_end
from bayes_impedance.person.gaps import other_gaps
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.population.alignment import HELD, searched_alone
from bayes_impedance.runtime.executors import map_persons

_ROUNDS = 3
"""Largest number of searches, each from the fit of the one before. By choice: what one search has found shows others
where to look."""

_LEAST_GAIN = 0.5
"""Log evidence by which a person must be described better. By choice: less is error of convergence."""


def recordings_alone(refitter: Refitter, fit: Refit, hold: bool = False, among: np.ndarray | None = None) -> Refit:
    """The fit in which recordings were searched that may be in another optimum.

    What was added is the same in all recordings of a person, and is held meanwhile.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    hold : bool
        Hold population and additions, also of the fit that is returned.
    among : ndarray of bool, shape (N,), optional
        People whose recordings are searched; all if not given.
    """
    n, varying = fit.model.n_elements, ~fit.model.shared
    ends = np.cumsum([len(d.z) for d in fit.data])[:-1]
    for _ in range(_ROUNDS):
        rho = np.zeros(varying.size)
        rho[:n] = np.maximum(fit.population.rho[:n], LEAST_RHO)
        between = np.eye(varying.size) / HELD**2
        between[np.ix_(varying, varying)] = np.linalg.inv(fit.population.covariance)
        own = partial(_places, fit.model.kernel, rho, between)
        rows = np.split(fit.u, ends)
        centres = [u[0].copy() for u in rows]
        for centre, u, person in zip(centres, rows, fit.persons, strict=True):
            if len(u) == 1:
                centre[varying] = fit.population.mu
            else:
                centre[:n] = person[:n]
        found = list(rows)
        people = list(range(len(rows))) if among is None else np.flatnonzero(among).tolist()
        chosen = ([values[i] for i in people] for values in (fit.data, rows, centres))
        for i, there in zip(people, map_persons(refitter.executor, own, *chosen), strict=True):
            found[i] = there
        if all(np.array_equal(there, here) for there, here in zip(found, rows, strict=True)):
            return fit
        u = np.concatenate(found)
        trial = refitter.fit(fit.model, u, fit.population, hold_population=True, hold_additions=True)
        better = trial.evidence > fit.evidence + _LEAST_GAIN
        if not better.any():
            return fit
        u = np.where(better[fit.owner, None], trial.u, fit.u)
        fit = refitter.fit(fit.model, u, fit.population, hold_population=hold, hold_additions=hold)
    return fit


def _places(
    kernel: Kernel, rho: np.ndarray, between: np.ndarray, likelihood: Likelihood, u: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """Log elements (J, P) of a person's recordings, some of them searched; `between` is the population's precision."""
    if len(u) > 1:
        return searched_alone(kernel, likelihood, u, centre, rho, sharp=True)
    alone = likelihood.recording(0, centre.size)
    across = other_gaps(kernel, alone, u, np.diag(between) < HELD**-2)
    if not len(across):
        return u
    return best_end(kernel, alone, np.concatenate([u, across]), centre, between)[None]
