r"""Starts of effects that bring poles of their own, such as lines: a coefficient from a grid.

A line whose standing waves lie inside the band cannot be reached from a coefficient of zero: on the way its poles cross
the band, and every crossing is another optimum. So a grid of coefficients is tried in each person. With the coefficient
at x, the elements after one Gauss-Newton step and the person's noise scale integrated out
(:mod:`bayes_impedance.diagnosis.fit.fitter`), the person's log likelihood is

.. math:: \ell_i(x) = -(\alpha + N_i)\,\ln\bigl(\beta + \tfrac12\,|(1 - QQ^T)\,r_i(x)|^2\bigr)

with Q a basis of what the elements can absorb there. The median of the best x is everybody's start, because a person
whose best lies far from it has probably found another optimum; the gain of all people together says which effects and
places are refitted first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.person_residuals import directions, real_and_imaginary
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.sensitivity import local_impedances, spot_of
from bayes_impedance.person.likelihood import SCALE_SHAPE

_SMALLEST, _FIRST_WAVE, _STEP = 0.1, 2.5, 1.6
"""Least coefficient that is tried, that with which the first standing wave enters the band, and the factor between
neighbours; relative to the coefficient that equals the place at the upper end of the band, where w is. By choice."""

_BELOW = 4.0
"""Least ratio of the first standing wave to the lowest frequency: larger coefficients are not tried. By choice: of a
line whose waves fill the whole band no recording shows the element that it stands for. With a grid that ended at the
third wave in the band, a compliance whose fifth was in it was not found: the median of people's best led nowhere."""

_PEOPLE, _POINTS = 16, 100
"""Largest numbers of people and of frequencies for the grid. By choice: only a start is wanted."""

_PLACES_EACH = 2
"""Places at which one effect is refitted before others are. By choice. Elements are as the model without the effect has
left them, and what the grid gains is a weak sign: a line in the right place gained 0.6 and 1.0 of the best in two
populations of fingertips, and 0.24 of it, behind five others at wrong places, in a third that it then described 2.6
times as well as anything else. In a fourth it gained 6.4 in the 16 people of 57 that are asked, behind three other
places, and 127 from there."""

MOST = 5
"""Largest number of refits from such starts. By choice."""


def level_start(fit: Refit, candidate: Candidate) -> tuple[float, float]:
    """A coefficient in the effect's unit, the median of people's best, and what these gain together in log likelihood.

    A person's best is found from one recording, of some of the people and at some of the frequencies if there are many.
    """
    model = extended(fit.model, candidate, "varying", 0.0)
    u = extended_start(fit, model)[0]
    (column,) = model.columns(len(model.additions) - 1)
    scale, secant = candidate.effect.coefficients[0].scale(model.scales), candidate.effect.traits.secant
    assert secant is not None  # by whom this is called
    best, gain = [], 0.0
    for i in range(0, len(fit.data), -(-len(fit.data) // _PEOPLE)):
        row = int(np.flatnonzero(fit.owner == i)[0])
        data = fit.data[i]
        at = slice(None, None, -(-data.omega.size // _POINTS))
        omega, z, weight = data.omega[at], (data.z[0, 0] + 1j * data.z[0, 1])[at], data.weight[0, at]
        here = local_impedances(fit.model, fit.u[[row]], omega)[spot_of(candidate)].z
        values = np.append(0.0, float(secant({"level": 1.0}, omega, here)[0]) * _levels(omega))
        trial = np.repeat(u[[row]], values.size, axis=0)
        trial[:, column] = values / scale
        own = -(SCALE_SHAPE + omega.size) * np.log(SCALE_SHAPE + 0.5 * _misfits(model, trial, omega, z, weight))
        own = np.nan_to_num(own, nan=-np.inf)
        k = 1 + int(np.argmax(own[1:]))
        best.append(values[k])
        gain += float(own[k] - own[0])
    return float(np.median(best)), gain


def _levels(omega: np.ndarray) -> np.ndarray:
    """Coefficients to try, relative to the one that equals the place at the upper end of the band."""
    waves = max(float(omega.max() / omega.min()) / _BELOW, 1.0)
    largest = _FIRST_WAVE * waves**2
    number = 1 + int(np.ceil(np.log(largest / _SMALLEST) / np.log(_STEP)))
    return np.geomspace(_SMALLEST, largest, number)


def _misfits(model: Model, u: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Squares (K,) of the whitened residuals of one recording outside of what the elements absorb at each u (K, P)."""
    there, slope = model.kernel.derivative(u, omega / (2 * np.pi))
    r = real_and_imaginary((z - there) * np.sqrt(weight))
    basis, _ = directions(real_and_imaginary(slope[:, : model.n_elements] * np.sqrt(weight)), 0.0)  # they may come back
    return np.asarray(np.sum(r**2, axis=1) - np.sum(np.einsum("kfp,kf->kp", basis, r) ** 2, axis=1))


def best_levels(fit: Refit, candidates: Sequence[Candidate]) -> list[tuple[Candidate, float]]:
    """The effects and places whose grid gains most, with the coefficient of :func:`level_start`.

    Two places of every effect come first, and then the others.
    """
    sites = {(c.effect, c.place): c for c in candidates if c.effect.operation and c.effect.traits.secant is not None}
    rows = [(c, *level_start(fit, c)) for c in sites.values()]
    rows = sorted((row for row in rows if row[2] > 0), key=lambda row: -row[2])
    places: dict[Effect, int] = {}
    first: list[tuple[Candidate, float]] = []
    later: list[tuple[Candidate, float]] = []
    for candidate, size, _ in rows:
        places[candidate.effect] = places.get(candidate.effect, 0) + 1
        (first if places[candidate.effect] <= _PLACES_EACH else later).append((candidate, size))
    return [*first, *later][:MOST]


def from_level(refitter: Refitter, fit: Refit, candidate: Candidate, size: float, rounds: int) -> Refit:
    """Refit with an effect that differs between people, everybody's coefficient beginning at one value."""
    model = extended(fit.model, candidate, "varying", 0.0)
    u, population = extended_start(fit, model)
    (column,) = model.columns(len(model.additions) - 1)
    u[:, column] = size / candidate.effect.coefficients[0].scale(model.scales)
    mu = population.mu.copy()
    mu[int(np.flatnonzero(np.flatnonzero(~model.shared) == column)[0])] = u[0, column]
    return refitter.fit(model, u, replace(population, mu=mu), rounds)
