r"""Search for people whose resonance, time constant or corner is fitted at another frequency than their own.

In one coefficient the impedance is nearly linear, and a person's own value is found from anywhere. In a frequency it is
not: a narrow resonance that starts an octave off meets no slope that leads to it. Its mass then goes to zero, or below,
which describes such a person as well as having none. People of a population may well be an octave apart, and a
few who ended there move the mean, widen the dispersion, and look like people who lack the effect.

Starts that are drawn from the population (:meth:`~bayes_impedance.diagnosis.fit.fitter.Refitter.settle`) rarely come
near the frequency of somebody at its edge. So each frequency is set to values on a grid over the population, in
everybody at once, with the coefficient at its mean and everything else as it is. A few rounds tell from which of these
a person's fit is best; from there it is made to rest, and kept if the person's evidence is larger.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import TYPICAL_DISPERSION, Model
from bayes_impedance.diagnosis.fit.only_person import BETTER
from bayes_impedance.diagnosis.fit.refit import Refit

_TIMES = ("Hz", "s")
"""Units of the shapes that are searched. An exponent or a damping ratio changes the curve gradually and everywhere."""

_STEPS = np.linspace(-2.5, 2.5, 11)
"""Starts, in standard deviations between people. By choice: one in a hundred people is outside, and at a typical
dispersion neighbours are a sixth apart, as much as a resonance with a damping ratio of 0.1 is wide."""

_FIRST_ROUNDS, _ROUNDS = 3, 20
"""Rounds from each start, and from the best. By choice: the first only rank the starts."""


def searched_shapes(refitter: Refitter, fit: Refit) -> Refit:
    """The fit with everybody's own frequencies and time constants searched over the population's range.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit

    Returns
    -------
    Refit
        The same object if nobody has a better optimum elsewhere.
    """
    for coefficient, shape in _own_times(fit.model):
        fit = _searched(refitter, fit, coefficient, shape)
    return fit


def _own_times(model: Model) -> list[tuple[int, int]]:
    """Columns of the coefficient and the shape, of every frequency or time that differs between people."""
    found = []
    for i, addition in enumerate(model.additions):
        if addition.effect.operation:
            columns = model.columns(i)
            for column, own in zip(columns[1:], addition.effect.coefficients[1:], strict=True):
                if own.unit in _TIMES and own.link == "log" and not model.shared[column]:
                    found.append((columns[0], column))
    return found


def _searched(refitter: Refitter, fit: Refit, coefficient: int, shape: int) -> Refit:
    model, population = fit.model, fit.population
    centre = population.mu[np.cumsum(~model.shared) - 1]  # by the kernel's columns
    spread = max(model.parameters[shape - model.n_elements].dispersion, TYPICAL_DISPERSION)
    best, u = np.full(fit.evidence.size, -np.inf), fit.u
    for step in _STEPS:
        start = fit.u.copy()
        start[:, coefficient] = centre[coefficient]
        start[:, shape] = centre[shape] + step * spread
        trial = refitter.fit(model, start, population, _FIRST_ROUNDS, hold_population=True, hold_additions=True)
        better = trial.evidence > best
        best = np.where(better, trial.evidence, best)
        u = np.where(better[fit.owner, None], trial.u, u)
    there = refitter.fit(model, u, population, _ROUNDS, hold_population=True, hold_additions=True)
    better = there.evidence > fit.evidence + BETTER
    if not better.any():
        return fit
    u = np.where(better[fit.owner, None], there.u, fit.u)
    again = refitter.fit(model, u, population)
    return again if again.evidence.sum() > fit.evidence.sum() else fit
