"""Single recordings of people whose other recordings are described better are searched alone.

The fit moves all recordings of a person together. Where nothing damps a resonance, a recording may be left on the wrong
side of a point of the frequency grid, and looks as if physics were missing
(:mod:`bayes_impedance.population.alignment`).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.population.alignment import searched_alone
from bayes_impedance.runtime.executors import map_persons

_ROUNDS = 3
"""Largest number of searches, each from the fit of the one before. By choice: one crosses a point of the grid."""

_LEAST_GAIN = 0.5
"""Log evidence by which a person must be described better. By choice: less is error of convergence."""


def recordings_alone(refitter: Refitter, fit: Refit) -> Refit:
    """The fit in which recordings that are described worse than the person's others were searched.

    What was added is the same in all recordings of a person, and is held meanwhile.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    """
    if not refitter.repeated:
        return fit
    n = fit.model.n_elements
    own = partial(_places, fit.model.kernel)
    ends = np.cumsum([len(d.z) for d in fit.data])[:-1]
    for _ in range(_ROUNDS):
        rho = np.zeros(fit.u.shape[1])
        rho[:n] = np.maximum(fit.population.rho[:n], LEAST_RHO)
        rows = np.split(fit.u, ends)
        centres = [np.concatenate([person[:n], u[0, n:]]) for person, u in zip(fit.persons, rows, strict=True)]
        found = list(map_persons(refitter.executor, own, fit.data, rows, centres, [rho] * len(rows)))
        if all(np.array_equal(there, here) for there, here in zip(found, rows, strict=True)):
            return fit
        u = np.concatenate(found)
        trial = refitter.fit(fit.model, u, fit.population, hold_population=True, hold_additions=True)
        better = trial.evidence > fit.evidence + _LEAST_GAIN
        if not better.any():
            return fit
        fit = refitter.fit(fit.model, np.where(better[fit.owner, None], trial.u, fit.u), fit.population)
    return fit


def _places(kernel: Kernel, likelihood: Likelihood, u: np.ndarray, centre: np.ndarray, rho: np.ndarray) -> np.ndarray:
    return u if len(u) == 1 else searched_alone(kernel, likelihood, u, centre, rho, everyone=False)
