r"""Fit of a model with additions to a population by damped Gauss-Newton steps and expectation-maximisation.

Recording j of person i has its own parameters :math:`u_{ij} = (v_{ij}, \varphi)`: varying ones (the elements, and
coefficients that differ between people), and shared ones. The population is

.. math:: v_{ij} \sim N(v_i, R),\ R = \operatorname{diag}\rho^2, \qquad v_i \sim N(\mu, T).

**People.** With the shared parameters held, one Gauss-Newton step per round (with the curvature of
:mod:`.second_order`) solves for all :math:`v_{ij}` and :math:`v_i`: with :math:`A_{ij} = w_i H_{ij} + R^{-1}`,

.. math:: K_i = T^{-1} + \sum_j (R^{-1} - R^{-1}A_{ij}^{-1}R^{-1}),

each person damped on its own, and more where a step does not descend. **Additions**: shared parameters and the means of
varying coefficients move to the maximum of :mod:`~bayes_impedance.diagnosis.fit.normal_equations`, with the elements of
every recording free. With the elements held to the population's distribution instead, maximising over u (not
integrating) would bias the additions by many standard errors. The dispersion of a varying coefficient is held at a
fraction of its mean: single persons say too little about it for expectation-maximisation to converge. A step is made
with this dispersion as it is, and it follows the mean afterwards (:mod:`.additions_step`). If a run of rounds loses
much nevertheless, it ends at the best place that it met.
**Population** of the elements: expectation-maximisation as in :mod:`bayes_impedance.population.em`.

The **evidence** of a person is Laplace's approximation of the likelihood with all :math:`v_{ij}`, :math:`v_i` and the
noise scale integrated out:

.. math:: \ell_i = -(\alpha + N_i)\ln(\beta + \tfrac12\chi_i^2) - \tfrac12\sum_j \delta_{ij}^TR^{-1}\delta_{ij}
   - \tfrac12 (v_i-\mu)^TT^{-1}(v_i-\mu) - \tfrac12\sum_j\ln|A_{ij}R| - \tfrac12\ln|K_iT|.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.fit.additions_step import move_additions
from bayes_impedance.diagnosis.fit.few_frequencies import few_frequencies, worth_it
from bayes_impedance.diagnosis.fit.model import Model, with_dispersions
from bayes_impedance.diagnosis.fit.normal_equations import (
    Equations,
    Population,
    Stack,
    counts,
    equations_at,
)
from bayes_impedance.diagnosis.fit.only_person import BETTER, settled_alone
from bayes_impedance.diagnosis.fit.outliers_alone import ends_of_outliers
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.rounds import (
    DAMPING,
    Blocks,
    Layout,
    Plan,
    State,
    blocks_of,
    damped_anew,
    log_misfit,
    maximised,
    means_of,
    objective,
    person_steps,
)
from bayes_impedance.diagnosis.fit.second_order import SecondOrder
from bayes_impedance.person.likelihood import Likelihood

_ALONE_TRIES = 3
"""Starts of a round in which people who are described much worse than most are searched alone, as long as that finds
better optima. By choice. Of 125 people of a battery's recordings who were searched three times around one population,
the second or the third search was better in 2, by 0.5 and 2.1."""

_TRIES = 6
"""Steps of a person that are tried in a round, each damped ten times as much as the one before. By choice: the last is
so short that the gradient decides alone."""

_ROUNDING = 1e-6
"""Log likelihood by which a person's objective may grow in a step."""

RAN_AWAY = 10.0
"""Log evidence by which a run of rounds may end below the best that it had on its way; else it ends there. By choice:
of 582 runs in three ordinary populations 49 lost 1 to 10 and none more; where fits ran away it was 12 to 9000."""

_SUMMINGS = 2
"""How often recordings are summed up in a fit. By choice: the second time is around a place near the optimum, where
sums are nearly exact; where one round with all frequencies still moves the fit, more sums would not help."""

_GAIN_ERROR, _GAIN_SHARE = 1.0, 0.05
"""Largest error of a person's log likelihood by summed-up recordings, and largest as a share of its change. By choice:
far from the optimum the first does not matter, since another sum and rounds with all frequencies follow. A resonance
narrower than the nodes are apart is off by as much as it gains: its person could end in another gap of the grid."""


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

    Attributes
    ----------
    many_frequencies : bool
        Whether recordings are summed up at fewer frequencies on the way (:mod:`.few_frequencies`).
    """

    def __init__(self, data: Sequence[Likelihood], executor: Executor, one_person: bool = False) -> None:
        self.data = tuple(data)
        self.executor = executor
        self.one_person = one_person
        self.stack = Stack.of(self.data)
        self.owner = self.stack.owner
        self.counts = counts(self.data)
        self.repeated = any(d.z.shape[0] > 1 for d in self.data)
        self.layout = Layout(self.owner, self.counts, np.array([len(d.z) > 1 for d in self.data])[self.owner])
        self.many_frequencies = worth_it(self.stack)

    def subset(self, people: np.ndarray) -> Refitter:
        """Refitter of some of the people."""
        return Refitter([self.data[i] for i in people], self.executor, self.one_person)

    def without(self, silent: np.ndarray) -> Refitter:
        """Refitter of people some of whom do not feel some parameters (bool, (N, P)), because they lack the effect."""
        other = copy(self)
        other.stack = replace(self.stack, silent=silent[self.owner])
        return other

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
        plan = Plan(
            model=model,
            hold_population=hold_population or self.one_person,
            hold_additions=hold_additions or not model.parameters,
            tolerance=tolerance,
        )
        population = replace(population, covariance=with_dispersions(model, population.covariance, population.mu))
        state = State(
            u=u.copy(),
            persons=means_of(u[:, ~model.shared], self.owner, len(self.data)),
            population=population,
            equations=equations_at(model, self.stack, u, self.executor),
            damping=np.full(len(self.data), DAMPING),
            second_order=SecondOrder.unknown(len(u), u.shape[1], len(self.data)),
        )
        state, left = self._with_few_frequencies(plan, state, rounds)
        if not state.settled:
            state, _ = self._rounds(plan, self.stack, state, left)
        return Refit(
            model=model,
            data=self.data,
            u=state.u,
            persons=state.persons,
            population=state.population,
            equations=state.equations,
            evidence=self._evidence(model, state),
            settled=state.settled,
        )

    def _with_few_frequencies(self, plan: Plan, state: State, left: int) -> tuple[State, int]:
        """Rounds with recordings that are summed up, each time followed by one with all; and how many are left."""
        for _ in range(_SUMMINGS if self.many_frequencies else 0):
            small = few_frequencies(plan.model, self.stack, state.u, self.executor) if left > 1 else None
            if small is None:
                break
            there, used = self._rounds(plan, small, state, left - 1)
            exact = equations_at(plan.model, self.stack, there.u, self.executor)
            if not self._sums_held(state.equations, there.equations, exact):
                break
            there = replace(there, equations=exact)
            state, last = self._rounds(plan, self.stack, there, 1)
            left -= used + last
            if state.settled:
                break
        return state, left

    def _sums_held(self, before: Equations, summed_up: Equations, after: Equations) -> bool:
        """Whether everybody's gain is what the summed-up recordings say it is."""
        start, said, end = (log_misfit(self.layout, own.chi) for own in (before, summed_up, after))
        return bool(np.all(np.abs(said - end) <= np.maximum(_GAIN_ERROR, _GAIN_SHARE * np.abs(start - end))))

    def _evidence(self, model: Model, state: State, blocks: Blocks | None = None) -> np.ndarray:
        """Log evidence of each person, shape (N,); from the undamped blocks of the state if they are known."""
        blocks = blocks or self._undamped(model, state)
        v = state.u[:, ~model.shared]
        value = objective(self.layout, model, state.equations.chi, v, state.persons, state.population)
        return np.asarray(-value - 0.5 * blocks.log_determinants(self.owner, model, state.population))

    def _undamped(self, model: Model, state: State) -> Blocks:
        nothing = np.zeros(len(self.data))
        return blocks_of(self.layout, model, state.equations, state.u, state.persons, state.population, nothing)

    def _rounds(self, plan: Plan, stack: Stack, state: State, most: int) -> tuple[State, int]:
        """At most so many rounds with the data of a stack, until the fit is at rest there; and how many were made."""
        model, n = plan.model, len(self.data)
        varying = ~model.shared
        share, used = 1.0, 0
        moving = np.ones(n, dtype=bool)
        alone = plan.hold_population and not self.one_person and plan.hold_additions
        state = replace(state, settled=False)
        best, most_evidence, evidence = state, -np.inf, -np.inf
        while used < most and not state.settled:
            used += 1
            state, steps = self._move_people(model, stack, state, moving)
            moved, drift = float(steps.max()), 0.0
            if not plan.hold_additions:
                state, share, step = move_additions(self.data, self.layout, stack, self.executor, model, state, share)
                moved = max(moved, step)
            if alone:
                state = replace(state, settled=moved < plan.tolerance)
                # Nothing that a person depends on changes any more; a step may be short because it is damped.
                moving &= ~((steps < plan.tolerance) & (state.damping <= DAMPING))
                continue
            blocks = self._undamped(model, state)
            evidence = float(self._evidence(model, state, blocks).sum())
            if evidence > most_evidence:
                best, most_evidence = state, evidence
            if not plan.hold_population or (self.one_person and self.repeated):
                v, population = state.u[:, varying], state.population
                there, change = maximised(self.layout, model, v, state.persons, blocks, population)
                if plan.hold_population:
                    there = replace(population, rho=there.rho)
                else:
                    drift = change
                state = replace(state, population=there)
            state = replace(state, settled=moved < plan.tolerance and drift < plan.tolerance)
        return (state if evidence >= most_evidence - RAN_AWAY else best), used

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
                better = trial.evidence > best_evidence + BETTER
                hopeful &= better
                best_evidence = np.where(better, trial.evidence, best_evidence)
                best_u = np.where(better[self.owner, None], trial.u, best_u)
            if not np.any(best_evidence > fit.evidence):
                break
            fit = self.fit(fit.model, best_u, fit.population, hold_population=hold, hold_additions=hold)
        return fit

    def _move_people(self, model: Model, stack: Stack, state: State, people: np.ndarray) -> tuple[State, np.ndarray]:
        """A step of the parameters of some people (bool, (N,)), damped more where it would increase the objective.

        Also returns the length of each person's step, in standard deviations; shape (N,).
        """
        varying, n, layout = ~model.shared, len(self.data), self.layout
        u, persons, equations, learned = state.u, state.persons, state.equations, state.second_order
        before = objective(layout, model, equations.chi, u[:, varying], persons, state.population)
        trial_u, trial_v, trial = u.copy(), persons.copy(), equations
        moving, damping, length = people, state.damping.copy(), np.zeros(n)
        for k in range(_TRIES):
            who, rows = np.flatnonzero(moving), np.flatnonzero(moving[self.owner])
            step = person_steps(layout, model, replace(state, damping=damping, second_order=learned), moving)
            trial_u[np.ix_(rows, varying)] = u[np.ix_(rows, varying)] + step.u
            trial_v[who] = persons[who] + step.v
            trial = equations_at(model, stack, trial_u, self.executor, moving, trial)
            after = objective(layout, model, trial.chi, trial_u[:, varying], trial_v, state.population)
            moved = np.where(moving[self.owner, None], trial_u - u, 0.0)
            learned = learned.after(self.owner, moved, equations, trial)
            if k == 0:
                length[who] = step.length
            fall = (before - after)[who]
            worse = ~(fall >= -_ROUNDING)
            damping[who] = damped_anew(damping[who], fall, step.promised, worse)
            moving = np.zeros(n, dtype=bool)
            moving[who[worse]] = True
            if not worse.any():
                break
        else:  # people for whom no shorter step is an improvement do not move
            rows = moving[self.owner]
            trial_u[rows], trial_v[moving] = u[rows], persons[moving]
            trial = trial.with_rows(rows, equations)
        state = replace(state, u=trial_u, persons=trial_v, equations=trial, damping=damping, second_order=learned)
        return state, length
