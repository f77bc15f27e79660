r"""Effects that bring poles of their own, such as lines, on a grid of coefficients.

A line whose standing waves lie inside the band cannot be reached from a coefficient of zero: on the way its poles cross
the band, and every crossing is another optimum. Nor does the score at zero see it, where the poles are narrow and at
other frequencies in everybody. So a grid of coefficients is tried in each person. With the coefficient at x, the
log elements e distributed as in the population, with mean mu and covariance C in one recording, and the noise scale
integrated out (:mod:`bayes_impedance.diagnosis.fit.fitter`), the logarithm of what a recording and its elements have in
common is

.. math:: q_i(x, e) = -(\alpha + N_i)\,\ln\bigl(\beta + \tfrac12\,|r_i(x, e)|^2\bigr)
                      - \tfrac12\,(e - \mu)^T C^{-1} (e - \mu) ,

and with the elements integrated out by Laplace's method, J being the derivatives of the whitened residuals r,

.. math:: \ell_i(x) = \max_e q_i(x, e) - \tfrac12 \ln\bigl|w\,J^TJ + C^{-1}\bigr| , \qquad
          w = \frac{\alpha + N_i}{\beta + \tfrac12 |(1 - QQ^T)\,r_i|^2}

with Q a basis of what the elements can absorb. The largest is sought with one Gauss-Newton step, and more where x may
be the person's: a step is believed as far as it, or the one before it, has gained what its expansion said. Where a
narrow pole passes a frequency of the recording, an expansion may promise hundreds of units that are not there.
Logarithms of people's coefficients are normal, with a centre c and a standard deviation s that nobody knows; with each
pair of G on a grid as likely as any other, the **evidence** of the effect over nothing is

.. math:: e = \frac1G \sum_{c, s} \prod_i \int e^{\ell_i(x) - \ell_i(0)}\, p(x \mid c, s)\, dx .

It is a ratio of marginal likelihoods, whose mean is one when nothing is missing, whatever the grid: by Markov's
inequality it exceeds 1/p with a probability of p at most. The elements have to be integrated out for that. At their
best values a person's ratio has the mean :math:`\prod_k 1/\cos\varphi_k`, with the angles between what the elements
can absorb with the effect and without it: of 62 populations without an effect nine had more than 8 units, and one 48.
Integrated out, none has any. The population is that of the fit without the effect, so strong effects, with which it
would be another, are understated: a refit has to gain in the end. The largest term says where a refit begins, and each
person begins at the own most probable coefficient of that distribution. Some people are asked about the whole grid
first, and all about the part of it that these find likeliest; one recording of each person tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import logsumexp

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import carried, extended, extended_start
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.normal_equations import at_many
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.sensitivity import local_impedances, spot_of
from bayes_impedance.diagnosis.selection.compare import FEWEST_TO_VARY
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood
from bayes_impedance.person.small_matrices import ROUNDING, inverse

_SMALLEST, _FIRST_WAVE, _STEP = 0.1, 2.5, 1.04
"""Least coefficient that is tried, that with which the first standing wave enters the band, and the factor between
neighbours; relative to the coefficient that equals the place at the upper end of the band, where w is. By choice: with
that factor a pole is moved by 2 %, and frequencies of sweeps are 1 to 10 % apart. A person's likelihood may be narrower
than that: on another grid 68 people said 598 for 717. On any grid the mean is one under nothing."""

_BELOW = 4.0
"""Least ratio of the first standing wave to the lowest frequency: larger coefficients are not tried. By choice: of a
line whose waves fill the whole band no recording shows the element that it stands for. With a grid that ended at the
third wave in the band, a compliance whose fifth was in it was not found."""

_SPREADS = (0.1, 0.3, 0.6)
"""Standard deviations s. By choice: people differ by 0.2 to 0.5, and twice as much is twice as many grid points."""

_EVERY = 5
"""Grid points from one centre c to the next: 0.2, two standard deviations of the narrowest distribution."""

_WINDOW, _NEAR = 41, 0.5
"""Around what some people say: half-width of the grid, in its points, and of that of the centres. By choice: 1.6, two
standard deviations of the widest distribution from the furthest centre, nearly; and two steps of the centres."""

_REACH, _OWN = 2.0, 41
"""Half-width of the grid on which a person's own coefficient is sought, in standard deviations, and its points: as
dense as the other grid for the widest distribution."""

_PEOPLE = 16
"""Number of people from whom the whole grid is tried; all are asked about the best coefficients of the best places. By
choice: of 68 people with a line that all of them say is there by 717 units, sixteen said so by 21."""

_DOUBT, _LONGEST = 20.0, 0.5
"""Behind a person's largest log likelihood: where one step of the elements leaves no more, others are made. And the
longest step of an element. By choice. A line of 0.3 of the mass in front of it, which a refit finds 106 better, is 83
better after one step and 105 after two."""

_STEPS = 2
"""Further steps of the elements where a coefficient may be the person's. By choice: eighteen people with a narrow pole
say 2130 units together with one, 2350 with two and 2480 with four."""

_LITTLE = 0.1
"""Gain of a step that an expansion may promise without being asked. By choice: of so short a step it is right."""

MOST = 5
"""Largest number of places at which all people are asked, and of refits. By choice."""


@dataclass(frozen=True, kw_only=True)
class LevelEvidence:
    """What the grid says of an effect at a place.

    Attributes
    ----------
    candidate : Candidate
    size, spread : float
        Centre of the coefficients, in the effect's unit, and standard deviation of their logarithm, where it is
        largest.
    log_e : float
        Natural logarithm of the evidence e over nothing.
    """

    candidate: Candidate
    size: float
    spread: float
    log_e: float


@dataclass(frozen=True, kw_only=True)
class FirstRecordings:
    """First recordings of N people, and how their elements are distributed.

    Attributes
    ----------
    model : Model
    u : ndarray, shape (N, P)
        Its parameters in them.
    data : sequence of Likelihood
    mean : ndarray, shape (E,)
        Of the log elements.
    precision : ndarray, shape (E, E)
        Inverse of the covariance of the log elements of a recording.
    """

    model: Model
    u: np.ndarray
    data: Sequence[Likelihood]
    mean: np.ndarray
    precision: np.ndarray

    @classmethod
    def of(cls, fit: Refit, people: Sequence[int]) -> FirstRecordings:
        """Those of some of the people in a fit."""
        n, population = fit.model.n_elements, fit.population
        covariance = population.covariance[:n, :n] + np.diag(population.rho[:n] ** 2)
        return cls(
            model=fit.model,
            u=fit.u[np.searchsorted(fit.owner, people)],
            data=[fit.data[i] for i in people],
            mean=population.mu[:n],
            precision=inverse(covariance),
        )

    def with_elements_free(
        self, larger: Model, u: np.ndarray, data: Likelihood
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log likelihood of one recording with the elements integrated out, and their step to the most probable ones.

        Parameters
        ----------
        larger : Model
            With the effect.
        u : ndarray, shape (K, P')
            Its parameters.
        data : Likelihood

        Returns
        -------
        here : ndarray, shape (K,)
            Log likelihood with elements integrated out if these were the most probable ones.
        gain : ndarray, shape (K,)
            By which it is larger at those of the quadratic expansion.
        step : ndarray, shape (K, E)
            To them, to be subtracted.
        """
        e = slice(0, larger.n_elements)
        chi, gradient, information = at_many(larger, u, data.omega, data.z[0], data.weight[0])
        inside, slope = information[:, e, e], gradient[:, e]
        free = inside + ROUNDING * np.trace(inside, axis1=1, axis2=2)[:, None, None] * np.eye(larger.n_elements)
        least = np.maximum(chi - np.sum(slope * np.linalg.solve(free, slope[..., None])[..., 0], axis=1), 0.0)
        shape = SCALE_SHAPE + data.omega.size
        weight = shape / (SCALE_SHAPE + 0.5 * least)
        both = weight[:, None, None] * inside + self.precision
        both = both * (1 + ROUNDING * np.eye(larger.n_elements))
        away = u[:, e] - self.mean
        slopes = weight[:, None] * slope + away @ self.precision
        step = np.linalg.solve(both, slopes[..., None])[..., 0]
        distance = np.einsum("kp,pq,kq->k", away, self.precision, away)
        here = -shape * np.log(SCALE_SHAPE + 0.5 * chi) - 0.5 * distance
        after = chi - 2 * np.sum(step * slope, axis=1) + np.einsum("kp,kpq,kq->k", step, inside, step)
        gone = np.einsum("kp,pq,kq->k", away - step, self.precision, away - step)
        there = -shape * np.log(SCALE_SHAPE + 0.5 * np.maximum(after, 0.0)) - 0.5 * gone
        return here - 0.5 * np.linalg.slogdet(both)[1], there - here, step


def has_levels(candidate: Candidate) -> bool:
    """Whether an effect brings poles of its own."""
    return bool(candidate.effect.operation) and candidate.effect.traits.secant is not None


def best_levels(fit: Refit, candidates: Sequence[Candidate], executor: Executor) -> tuple[LevelEvidence, ...]:
    """The effects and places of which the grid says that they are there, rather than not, best first.

    Parameters
    ----------
    fit : Refit
        Of the model without them.
    candidates : sequence of Candidate
        Of which only effects with poles of their own are taken, each at a place once.
    executor : Executor
        Distributes effects and places.
    """
    sites = {(c.effect, c.place): c for c in candidates if has_levels(c)}
    if len(fit.data) < FEWEST_TO_VARY or not sites:
        return ()
    some, everybody = range(0, len(fit.data), -(-len(fit.data) // _PEOPLE)), range(len(fit.data))
    of_some = partial(level_evidence, FirstRecordings.of(fit, some))
    of_all = partial(level_evidence, FirstRecordings.of(fit, everybody))
    best = sorted(executor.map(of_some, sites.values()), key=lambda own: -own.log_e)[:MOST]
    if len(some) < len(everybody):
        best = list(executor.map(of_all, (own.candidate for own in best), best))
    return tuple(sorted((own for own in best if own.log_e > 0), key=lambda own: -own.log_e))


def level_evidence(
    first: FirstRecordings,
    candidate: Candidate,
    around: LevelEvidence | None = None,
) -> LevelEvidence:
    """Evidence of one effect at one place, from one recording of each person.

    Parameters
    ----------
    first : FirstRecordings
        Of those who are asked, with the model without it.
    candidate : Candidate
    around : LevelEvidence, optional
        What some of these people say. Only centres near theirs are tried; the others count as none, so that the
        evidence is at most too small.
    """
    levels = _log_levels(first, candidate)
    log_x, centres = levels, levels[::_EVERY]
    if around is not None:
        size = float(np.log(around.size))
        log_x = size + np.log(_STEP) * np.arange(-_WINDOW, _WINDOW + 1)
        centres = log_x[_WINDOW % _EVERY :: _EVERY]
        centres = centres[np.abs(centres - size) < _NEAR]
    gains = _gains(first, candidate, np.exp(log_x))
    terms = np.array([[_together(gains, _prior(log_x, c, s)) for c in centres] for s in _SPREADS])
    k, best = np.unravel_index(int(np.argmax(terms)), terms.shape)
    log_e = float(logsumexp(terms) - np.log(len(_SPREADS) * len(levels[::_EVERY])))
    return LevelEvidence(candidate=candidate, size=float(np.exp(centres[best])), spread=_SPREADS[k], log_e=log_e)


def _log_levels(first: FirstRecordings, candidate: Candidate) -> np.ndarray:
    """Logarithms of the coefficients that are tried, (K,)."""
    secant = candidate.effect.traits.secant
    assert secant is not None  # by whom this is called
    units, ratios = [], []
    for d, own in zip(first.data, first.u, strict=True):
        here = local_impedances(first.model, own[None], d.omega)[spot_of(candidate)].z
        units.append(float(secant({"level": 1.0}, d.omega, here)[0]))
        ratios.append(float(d.omega.max() / d.omega.min()))
    return np.asarray(np.log(np.median(units)) + np.log(_levels(max(ratios))))


def from_level(refitter: Refitter, fit: Refit, level: LevelEvidence, rounds: int) -> Refit:
    """Refit with an effect that differs between people, everybody beginning at the own most probable coefficient."""
    model = extended(fit.model, level.candidate, "varying", 0.0)
    u, population = extended_start(fit, model)
    (column,) = model.columns(len(model.additions) - 1)
    own = level.size * np.exp(level.spread * np.linspace(-_REACH, _REACH, _OWN))
    gains = _gains(FirstRecordings.of(fit, range(len(fit.data))), level.candidate, own)
    best = own[np.argmax(gains + _prior(np.log(own), float(np.log(level.size)), level.spread), axis=1)]
    u[:, column] = best[fit.owner] / level.candidate.effect.coefficients[0].scale(model.scales)
    mu = population.mu.copy()
    mu[int(np.flatnonzero(np.flatnonzero(~model.shared) == column)[0])] = u[:, column].mean()
    return refitter.fit(model, u, replace(population, mu=mu), rounds)


def _levels(ratio: float) -> np.ndarray:
    """Coefficients to try, relative to the one that equals the place at the upper end of a band of that ratio."""
    waves = max(ratio / _BELOW, 1.0)
    largest = _FIRST_WAVE * waves**2
    number = 1 + int(np.ceil(np.log(largest / _SMALLEST) / np.log(_STEP)))
    return np.geomspace(_SMALLEST, largest, number)


def _prior(log_x: np.ndarray, centre: float, spread: float) -> np.ndarray:
    """Log probability of the points (K,) of a grid with that factor between neighbours."""
    unit = spread * np.sqrt(2 * np.pi) / np.log(_STEP)
    return np.asarray(-0.5 * ((log_x - centre) / spread) ** 2 - np.log(unit))


def _together(gains: np.ndarray, log_prior: np.ndarray) -> float:
    return float(logsumexp(gains + log_prior, axis=1).sum())


def _gains(first: FirstRecordings, candidate: Candidate, values: np.ndarray) -> np.ndarray:
    """Log likelihood of everybody with each of the coefficients (K,), less that with zero; shape (N, K)."""
    larger = extended(first.model, candidate, "varying", 0.0)
    (column,) = larger.columns(len(larger.additions) - 1)
    scale, e = candidate.effect.coefficients[0].scale(larger.scales), slice(0, larger.n_elements)
    result = []
    for own, d in zip(carried(first.model, larger, first.u), first.data, strict=True):
        trial = np.repeat(own[None], len(values) + 1, axis=0)
        trial[:, column] = np.append(0.0, values) / scale
        here, promised, step = first.with_elements_free(larger, trial, d)
        believed = np.ones(len(trial))
        for _ in range(_STEPS):
            least = np.nanmax(here + believed * promised) - _DOUBT  # with no coefficient it is a number
            near = np.flatnonzero((here + promised > least) & (promised > _LITTLE))
            tried = trial[near]
            tried[:, e] -= np.clip(step[near], -_LONGEST, _LONGEST)
            there, more, further = first.with_elements_free(larger, tried, d)
            believed[near] = np.clip((there - here[near]) / promised[near], 0, 1)
            better = there > here[near]
            moved, back = near[better], near[~better]
            trial[moved], here[moved], promised[moved], step[moved] = (a[better] for a in (tried, there, more, further))
            step[back], promised[back] = 0.5 * step[back], 0.75 * promised[back]
        likely = here + believed * promised
        result.append(np.nan_to_num(likely[1:] - likely[0], nan=-np.inf))
    return np.array(result)
