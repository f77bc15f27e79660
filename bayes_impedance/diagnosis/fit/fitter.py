r"""Fit of a model with additions to a population by damped Gauss-Newton steps and expectation-maximisation.

Recording j of person i has its own parameters :math:`u_{ij} = (v_{ij}, \varphi)`: varying ones (the elements, and
coefficients that differ between people), and shared ones. The population is

.. math:: v_{ij} \sim N(v_i, R),\ R = \operatorname{diag}\rho^2, \qquad v_i \sim N(\mu, T).

**People.** With the shared parameters held, one Gauss-Newton step per round solves for all :math:`v_{ij}` and
:math:`v_i`: with :math:`A_{ij} = w_i H_{ij} + R^{-1}`,

.. math:: K_i = T^{-1} + \sum_j (R^{-1} - R^{-1}A_{ij}^{-1}R^{-1}),

each person damped on its own. **Additions**: shared parameters and the means of varying coefficients move to the
maximum of :mod:`~bayes_impedance.diagnosis.fit.normal_equations`, with the elements of every recording free. With the
elements held to the population's distribution instead, maximising over u (not integrating) would bias the additions
by many standard errors. The dispersion of a varying coefficient is held at a fraction of its mean: single persons say
too little about it for expectation-maximisation to converge. **Population** of the elements:
expectation-maximisation as in :mod:`bayes_impedance.population.em`.

The **evidence** of a person is Laplace's approximation of the likelihood with all :math:`v_{ij}`, :math:`v_i` and the
noise scale integrated out:

.. math:: \ell_i = -(\alpha + N_i)\ln(\beta + \tfrac12\chi_i^2) - \tfrac12\sum_j \delta_{ij}^TR^{-1}\delta_{ij}
   - \tfrac12 (v_i-\mu)^TT^{-1}(v_i-\mu) - \tfrac12\sum_j\ln|A_{ij}R| - \tfrac12\ln|K_iT|.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model, with_dispersions
from bayes_impedance.diagnosis.fit.normal_equations import (
    Equations,
    Population,
    Stack,
    counts,
    equations_at,
    marginal,
    quadratic,
    sums,
    weights_of,
)
from bayes_impedance.diagnosis.fit.only_person import settled_alone
from bayes_impedance.diagnosis.fit.outliers_alone import ends_of_outliers
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.person.mode import ROUNDING
from bayes_impedance.population.em_state import PRIOR_PERSONS, SMALLEST_DISPERSION

_LONGEST_STEP, _LONGEST_SHARE = 1.0, 0.3
"""Largest step of the additions, in prior standard deviations or units of the coefficient, and as a share of it if that
is more: a filter in the middle of the band has 100 units. By choice."""

_ALONE_TRIES = 3
"""Starts of a round in which people who are described much worse than most are searched alone, as long as that finds
better optima. By choice. Of 125 people of a battery's recordings who were searched three times around one population,
the second or the third search was better in 2, by 0.5 and 2.1."""

_DAMPING = 1e-3
"""Of a person's first step, relative to the curvature. By choice."""


@dataclass(frozen=True)
class _Blocks:
    """Linear algebra of one round; names as in the module's docstring."""

    inverse: np.ndarray  # A^-1, (M, V, V)
    pull: np.ndarray  # b, (M, V)
    precision: np.ndarray  # K, (N, V, V)

    def log_determinants(self, owner: np.ndarray, population: Population) -> np.ndarray:
        """Sum of ln|A R| over a person's recordings and ln|K T|, shape (N,)."""
        log_a = -np.linalg.slogdet(self.inverse)[1] + 2 * np.sum(np.log(_rho(population)))
        outer = np.linalg.slogdet(self.precision)[1] + np.linalg.slogdet(population.covariance)[1]
        return np.asarray(np.bincount(owner, log_a, minlength=len(self.precision)) + outer)


class Refitter:
    """Fits models to the recordings of one dataset.

    Parameters
    ----------
    data : sequence of Likelihood
        One per person.
    executor : Executor
        Runs persons in parallel.
    one_person : bool
        There is no population; mu and T stay at the prior.
    """

    def __init__(self, data: Sequence[Likelihood], executor: Executor, one_person: bool = False) -> None:
        self.data = tuple(data)
        self.executor = executor
        self.one_person = one_person
        self.stack = Stack.of(self.data)
        self.owner = self.stack.owner
        self.counts = counts(self.data)
        self.repeated = any(d.z.shape[0] > 1 for d in self.data)

    def subset(self, people: np.ndarray) -> Refitter:
        """Refitter of some of the people."""
        return Refitter([self.data[i] for i in people], self.executor, self.one_person)

    def fit(
        self,
        model: Model,
        u: np.ndarray,
        population: Population,
        rounds: int = 40,
        hold_population: bool = False,
        hold_additions: bool = False,
        tolerance: float = 0.02,
    ) -> Refit:
        """Fit a model.

        Parameters
        ----------
        model : Model
        u : ndarray, shape (M, P)
            Start.
        population : Population
            Start.
        rounds : int
            Largest number of rounds.
        hold_population, hold_additions : bool
            Hold the elements' population, or shared parameters and mean coefficients.
        tolerance : float
            The fit has converged when no step exceeds this many standard deviations.
        """
        shared = model.shared
        varying = ~shared
        n = len(self.data)
        u = u.copy()
        population = replace(population, covariance=with_dispersions(model, population.covariance, population.mu))
        persons = _means(u[:, varying], self.owner, n)
        damping = np.full(n, _DAMPING)
        equations = equations_at(model, self.stack, u, self.executor)
        settled = False
        moving = np.ones(n, dtype=bool)
        hold_population = hold_population or self.one_person
        alone = hold_population and not self.one_person and (hold_additions or not model.parameters)
        for _ in range(rounds):
            u, persons, equations, damping, steps = self._move_people(
                model, u, persons, equations, population, damping, moving
            )
            moved = float(steps.max())
            if model.parameters and not hold_additions:
                u, persons, population, equations, step = self._move_additions(model, u, persons, population, equations)
                moved = max(moved, step)
            drift = 0.0
            if not hold_population:
                blocks = self._blocks(model, equations, u, persons, population, np.zeros(n))
                population, drift = self._maximise(model, u[:, varying], persons, blocks, population)
            elif self.one_person and self.repeated:
                blocks = self._blocks(model, equations, u, persons, population, np.zeros(n))
                updated, _ = self._maximise(model, u[:, varying], persons, blocks, population)
                population = replace(population, rho=updated.rho)
            if moved < tolerance and drift < tolerance:
                settled = True
                break
            if alone:  # nothing that a person depends on changes any more; a step may be short because it is damped
                moving &= ~((steps < tolerance) & (damping <= _DAMPING))
        blocks = self._blocks(model, equations, u, persons, population, np.zeros(n))
        value = self._objective(equations.chi, u[:, varying], persons, population)
        evidence = -value - 0.5 * blocks.log_determinants(self.owner, population)
        return Refit(
            model=model,
            data=self.data,
            u=u,
            persons=persons,
            population=population,
            equations=equations,
            evidence=evidence,
            settled=settled,
        )

    def settle(self, fit: Refit, seed: int, tries: int = 6, rounds: int = 3, hold: bool = False) -> Refit:
        """Look for better optima of every person, from the median person and from draws, until none is found.

        One person in a local optimum looks like missing physics. The only person is searched in another way
        (:mod:`.only_person`).

        Parameters
        ----------
        fit : Refit
        seed : int
        tries : int
            Starts per person and round, of a population.
        rounds : int
            Largest number of rounds.
        hold : bool
            Hold population and additions.
        """
        rng = np.random.default_rng(seed)
        if self.one_person:
            return settled_alone(self, fit, rng, rounds, hold)
        varying = ~fit.model.shared
        n = len(self.data)
        for _ in range(rounds):
            best_u, best_evidence = fit.u.copy(), fit.evidence.copy()
            factor = np.linalg.cholesky(fit.population.covariance)
            hopeful = np.ones(n, dtype=bool)
            for k in range(tries):
                start = fit.u.copy()
                if k == 0:  # of most people: the median is not drawn away by those in another optimum
                    start[:, varying] = np.median(fit.persons, axis=0)
                else:
                    draw = fit.population.mu + rng.normal(size=(n, factor.shape[0])) @ factor.T
                    start[:, varying] = draw[self.owner]
                if k < _ALONE_TRIES:
                    start = ends_of_outliers(fit, start, rng, self.executor, hopeful)
                trial = self.fit(fit.model, start, fit.population, 15, hold_population=True, hold_additions=True)
                better = trial.evidence > best_evidence + 0.2
                hopeful &= better
                best_evidence = np.where(better, trial.evidence, best_evidence)
                best_u = np.where(better[self.owner, None], trial.u, best_u)
            if not np.any(best_evidence > fit.evidence):
                break
            fit = self.fit(fit.model, best_u, fit.population, hold_population=hold, hold_additions=hold)
        return fit

    def _objective(self, chi: np.ndarray, v: np.ndarray, persons: np.ndarray, population: Population) -> np.ndarray:
        """Negative log posterior of each person, shape (N,)."""
        total = np.bincount(self.owner, chi, minlength=len(self.data))
        value = (SCALE_SHAPE + self.counts) * np.log(SCALE_SHAPE + 0.5 * total)
        delta = (v - persons[self.owner]) / _rho(population)
        value = value + 0.5 * np.bincount(self.owner, np.sum(delta**2, axis=1), minlength=len(self.data))
        offset = persons - population.mu
        return np.asarray(value + 0.5 * np.sum(offset * np.linalg.solve(population.covariance, offset.T).T, axis=1))

    def _blocks(
        self,
        model: Model,
        equations: Equations,
        u: np.ndarray,
        persons: np.ndarray,
        population: Population,
        damping: np.ndarray,
    ) -> _Blocks:
        varying = ~model.shared
        w = weights_of(self.owner, self.counts, equations.chi)[self.owner]
        h = w[:, None, None] * equations.information[:, varying][:, :, varying]
        r = _rho(population) ** -2.0
        a = h + np.diag(r)
        diagonal = np.einsum("mpp->mp", h)
        a[:, np.arange(r.size), np.arange(r.size)] += (damping[self.owner, None] + ROUNDING) * diagonal
        inverse = np.linalg.inv(a)
        pull = -w[:, None] * equations.gradient[:, varying] - r * (u[:, varying] - persons[self.owner])
        kept = np.diag(r) - r[:, None] * inverse * r
        precision = np.linalg.inv(population.covariance) + sums(kept, self.owner, len(self.data))
        return _Blocks(inverse, pull, precision)

    def _move_people(
        self,
        model: Model,
        u: np.ndarray,
        persons: np.ndarray,
        equations: Equations,
        population: Population,
        damping: np.ndarray,
        people: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, Equations, np.ndarray, np.ndarray]:
        """A step of the parameters of some people (bool, (N,)), shortened where it would increase the objective.

        The last value returned is the length of each person's step, in standard deviations; shape (N,).
        """
        varying, n = ~model.shared, len(self.data)
        before = self._objective(equations.chi, u[:, varying], persons, population)
        blocks = self._blocks(model, equations, u, persons, population, damping)
        r = _rho(population) ** -2.0
        free = np.einsum("mpq,mq->mp", blocks.inverse, blocks.pull)
        pulls = sums(r * (u[:, varying] - persons[self.owner]) + r * free, self.owner, n)
        offset = persons - population.mu
        right = pulls - np.linalg.solve(population.covariance, offset.T).T
        step_v = np.linalg.solve(blocks.precision, right[..., None])[..., 0]
        step_u = free + np.einsum("mpq,mq->mp", blocks.inverse, r * step_v[self.owner])
        part = np.minimum(1.0, 2.0 / np.maximum(_most(np.abs(step_u).max(axis=1), self.owner, n), 1e-12))
        trial_u, trial_v, trial = u.copy(), persons.copy(), equations
        moving = people
        for _ in range(5):
            rows = np.flatnonzero(moving[self.owner])
            trial_u[np.ix_(rows, varying)] = u[np.ix_(rows, varying)] + (part[self.owner, None] * step_u)[rows]
            trial_v[moving] = (persons + part[:, None] * step_v)[moving]
            trial = equations_at(model, self.stack, trial_u, self.executor, moving, trial)
            after = self._objective(trial.chi, trial_u[:, varying], trial_v, population)
            worse = moving & ~(after <= before + 1e-6)
            damping = np.where(worse, np.minimum(10 * damping, 1e6), damping)
            damping = np.where(moving & ~worse, np.maximum(damping / 3, 1e-9), damping)
            if not worse.any():
                break
            part = np.where(worse, 0.25 * part, part)
            moving = worse
        else:  # people for whom no shorter step is an improvement do not move
            rows = moving[self.owner]
            trial_u[rows], trial_v[moving] = u[rows], persons[moving]
            trial = trial.with_rows(rows, equations)
        length = np.sqrt(np.maximum(np.einsum("np,npq,nq->n", step_v, blocks.precision, step_v), 0.0))
        return trial_u, trial_v, trial, damping, np.where(people, length, 0.0)

    def _move_additions(
        self, model: Model, u: np.ndarray, persons: np.ndarray, population: Population, equations: Equations
    ) -> tuple[np.ndarray, np.ndarray, Population, Equations, float]:
        """A step of shared parameters and mean coefficients, with each person's response.

        The last value returned is its size, in standard deviations.

        The step descends on the data's part of the objective alone, so only that part is checked.
        """
        n_elements = model.n_elements
        varying = ~model.shared[n_elements:]
        h, d, response = quadratic(model, self.data, u, equations, population.covariance)
        now = u[0, n_elements:].copy()
        now[varying] = population.mu[n_elements:]
        tau = np.zeros(now.size)
        tau[varying] = np.sqrt(np.diag(population.covariance)[n_elements:])
        target = marginal(model, h, d, tau)
        step = target.mean - now
        prior = np.array([p.prior_sd for p in model.parameters])
        linear = np.array([p.is_coefficient for p in model.parameters])
        longest = np.maximum(_LONGEST_STEP * np.minimum(prior, 1.0), _LONGEST_SHARE * np.abs(now) * linear)
        step /= max(1.0, float(np.abs(step / longest).max()))
        before = self._misfit(equations.chi)
        # A well-determined coefficient does not follow the population's mean: dc_i/dmu = (1 + T D_cc)^-1.
        follows = np.linalg.inv(np.eye(int(varying.sum())) + np.diag(tau[varying] ** 2) @ d[:, varying][:, :, varying])
        for _ in range(6):
            own = np.tile(step, (len(self.data), 1))
            own[:, varying] = follows @ step[varying]
            trial_u = u.copy()
            trial_u[:, n_elements:] += own[self.owner]
            trial_u[:, :n_elements] += np.clip(np.einsum("mea,ma->me", response, own[self.owner]), -1.0, 1.0)
            trial = equations_at(model, self.stack, trial_u, self.executor)
            if self._misfit(trial.chi) <= before + 0.5:
                mu = population.mu.copy()
                mu[n_elements:] += step[varying]
                moved = persons.copy()
                moved[:, n_elements:] += own[:, varying]
                follow = trial_u[:, :n_elements] - u[:, :n_elements]
                moved[:, :n_elements] += _means(follow, self.owner, len(self.data))
                shifted = replace(population, mu=mu, covariance=with_dispersions(model, population.covariance, mu))
                length = float(np.sqrt(max(step @ target.precision @ step, 0.0)))
                return trial_u, moved, shifted, trial, length
            step = 0.3 * step
        return u, persons, population, equations, 0.0

    def _misfit(self, chi: np.ndarray) -> float:
        total = np.bincount(self.owner, chi, minlength=len(self.data))
        value = np.sum((SCALE_SHAPE + self.counts) * np.log(SCALE_SHAPE + 0.5 * total))
        return float(value) if np.isfinite(value) else np.inf

    def _maximise(
        self, model: Model, v: np.ndarray, persons: np.ndarray, blocks: _Blocks, population: Population
    ) -> tuple[Population, float]:
        """One M step, and the change of the population in standard deviations."""
        n, size = persons.shape
        posterior = np.linalg.inv(blocks.precision)
        elements = np.arange(size) < model.n_elements
        mu = np.where(elements, persons.mean(axis=0), population.mu)
        offset = persons - mu
        variance = np.clip(np.diag(population.covariance), SMALLEST_DISPERSION**2, 1.0)
        covariance = (offset.T @ offset + posterior.sum(axis=0) + PRIOR_PERSONS * np.diag(variance)) / (
            n + PRIOR_PERSONS
        )
        floor = np.maximum(np.diag(covariance), SMALLEST_DISPERSION**2)
        covariance = covariance + np.diag(floor - np.diag(covariance))
        if n < size + 2:  # a full sample covariance would be singular
            covariance = np.diag(floor)
        covariance[~elements] = population.covariance[~elements]
        covariance[:, ~elements] = population.covariance[:, ~elements]
        rho = population.rho
        if self.repeated:
            r = _rho(population) ** -2.0
            follow = blocks.inverse * r - np.eye(size)
            spread = blocks.inverse + follow @ posterior[self.owner] @ np.swapaxes(follow, 1, 2)
            square = (v - persons[self.owner]) ** 2 + np.einsum("mpp->mp", spread)
            many = np.array([d.z.shape[0] > 1 for d in self.data])[self.owner]
            rho = np.sqrt((square[many].sum(axis=0) + 2 * 0.05**2) / (many.sum() + 2))
            rho = np.where(elements, np.clip(rho, LEAST_RHO, 1.0), LEAST_RHO)
        sd = np.sqrt(np.diag(population.covariance) / n)
        shift = np.abs(mu - population.mu) / sd
        stretch = np.abs(np.log(np.diag(covariance) / np.diag(population.covariance))) * 0.5
        return Population(mu, covariance, rho), float(max(shift.max(), stretch.max()))


def _rho(population: Population) -> np.ndarray:
    return np.asarray(np.maximum(population.rho, LEAST_RHO))


def _means(values: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    return np.asarray(sums(values, owner, n) / np.bincount(owner, minlength=n)[:, None])


def _most(values: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    largest = np.zeros(n)
    np.maximum.at(largest, owner, values)
    return largest
