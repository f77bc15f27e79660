"""Everybody's draws, where they were made: a likelihood of many persons of which only sums travel.

Draws are what grows with the number of persons, a few hundred kilobytes for each. They are kept in parts of some dozens
to hundreds of persons, in this process or by the workers of a cluster, which evaluate the population's likelihood on
them: a set of population parameters goes there and one number comes back. Parts depend on the number of persons alone
and are summed in order, so the result does not depend on who has worked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from bayes_impedance.draws import Draws, Reference, draw
from bayes_impedance.empirical_bayes import Estimate
from bayes_impedance.hierarchy import PopulationParameters
from bayes_impedance.kernel import Kernel
from bayes_impedance.likelihood import Likelihood, find_ridge
from bayes_impedance.marginal import Contrasts, Marginal
from bayes_impedance.persons import Cluster, Result, map_persons, parts_of
from bayes_impedance.starts import Progress
from bayes_impedance.subject import Mode

_SETS_AT_ONCE = 50


@dataclass(frozen=True)
class Part:
    """Some persons' draws and their likelihood.

    Attributes
    ----------
    theta : ndarray, shape (n, K, P)
        Everybody's draws.
    log_ratio : ndarray, shape (n, K)
        ln L - ln q of each.
    marginal : Marginal
    number : int
        Of the part.
    """

    theta: np.ndarray
    log_ratio: np.ndarray
    marginal: Marginal
    number: int


@dataclass(frozen=True)
class _Plan:
    """What all persons' draws are made with."""

    kernel: Kernel
    rho: np.ndarray
    covariance: np.ndarray
    n_draws: int


class KeptDraws:
    """The likelihood of population parameters, all persons together.

    Parameters
    ----------
    parts : sequence
        Parts, or what a cluster knows them by.
    executor : Executor
        Which keeps them.
    """

    def __init__(self, parts: Sequence[Any], executor: Executor) -> None:
        self._parts, self._executor = list(parts), executor

    @classmethod
    def made(
        cls,
        kernel: Kernel,
        point: Estimate,
        means: np.ndarray,
        covariance: np.ndarray,
        covariates: np.ndarray,
        n_draws: int,
        seed: np.random.SeedSequence,
        executor: Executor,
        progress: Progress,
    ) -> KeptDraws:
        """Draw for everybody under a reference population.

        Parameters
        ----------
        kernel : Kernel
        point : Estimate
            With everybody's mode and likelihood.
        means : ndarray, shape (N, P)
            Of the reference population.
        covariance : ndarray, shape (P, P)
            Its covariance, already widened.
        covariates : ndarray, shape (N, Q)
        n_draws : int
            For each person, a power of two.
        seed : SeedSequence
        executor : Executor
        progress : callable
        """
        n = len(means)
        plan = _Plan(kernel, point.between_repetitions, covariance, n_draws)
        seeds = seed.spawn(n)
        repetitions = np.array([d.z.shape[0] for d in point.likelihoods])
        shared = [
            (k, means[rows], repetitions[rows], covariates[rows], _contrasts_of(point.contrasts, repetitions, rows))
            for k, rows in enumerate(parts_of(n))
        ]
        kept: list[Any] = []
        if isinstance(executor, Cluster):
            for rows, common in zip(parts_of(n), shared, strict=True):
                own = point.likelihoods[rows], point.modes[rows], seeds[rows]
                kept.append(executor.keep(_drawn_part, plan, *own, *common))
            for part, rows in zip(kept, parts_of(n), strict=True):
                executor.ask([part], _size)
                progress("draws", rows.stop, n)
            return cls(kept, executor)
        everybody = []
        drawn = map_persons(executor, partial(_draws_of, plan), point.likelihoods, point.modes, means, seeds)
        for i, draws in enumerate(drawn):
            everybody.append(draws)
            progress("draws", i + 1, n)
        for rows, common in zip(parts_of(n), shared, strict=True):
            kept.append(_part(plan, everybody[rows], *common))
        return cls(kept, executor)

    def _ask(self, function: Callable[..., Result], *arguments: Any) -> list[Result]:
        if isinstance(self._executor, Cluster):
            return self._executor.ask(self._parts, function, *arguments)
        return [function(part, *arguments) for part in self._parts]

    def __call__(self, parameters: PopulationParameters) -> np.ndarray:
        """Log likelihood of W sets of population parameters, shape (W,)."""
        return np.asarray(np.sum(self._ask(_log_likelihood, parameters), axis=0))

    def variance(self, parameters: PopulationParameters) -> np.ndarray:
        """Monte-Carlo variance of the log likelihood, summed over persons, shape (W,)."""
        return np.asarray(np.sum(self._ask(_variance, parameters), axis=0))

    def effective(self, parameters: PopulationParameters) -> np.ndarray:
        """Everybody's smallest effective number of draws under W sets, shape (N,)."""
        return np.concatenate(self._ask(_effective, parameters))

    def pareto_k(self, parameters: PopulationParameters) -> np.ndarray:
        """Tail of everybody's weights under the first set, shape (N,)."""
        return np.concatenate(self._ask(_pareto_k, parameters[:1]))

    def gathered(self) -> tuple[np.ndarray, np.ndarray]:
        """Everybody's draws, (N, K, P), and their ln L - ln q, (N, K): all of them travel."""
        both = self._ask(_draws_and_ratios)
        return np.concatenate([a for a, _ in both]), np.concatenate([b for _, b in both])

    def persons(self, parameters: PopulationParameters, seed: np.random.SeedSequence) -> tuple[np.ndarray, np.ndarray]:
        """One draw of everybody's log elements for each set, (W, N, P), and everybody's log likelihood, (W, N)."""
        asked = self._ask(_resampled, parameters, seed.spawn(len(self._parts)))
        return np.concatenate([a[0] for a in asked], axis=1), np.concatenate([a[1] for a in asked], axis=1)


def _drawn_part(
    plan: _Plan,
    likelihoods: Sequence[Likelihood],
    modes: Sequence[Mode],
    seeds: Sequence[np.random.SeedSequence],
    number: int,
    means: np.ndarray,
    *common: Any,
) -> Part:
    draws = [_draws_of(plan, *row) for row in zip(likelihoods, modes, means, seeds, strict=True)]
    return _part(plan, draws, number, means, *common)


def _part(
    plan: _Plan,
    draws: Sequence[Draws],
    number: int,
    means: np.ndarray,
    repetitions: np.ndarray,
    covariates: np.ndarray,
    contrasts: Sequence[Contrasts],
) -> Part:
    marginal = Marginal(draws, means, plan.covariance, repetitions, covariates, contrasts)
    return Part(np.array([d.theta for d in draws]), np.array([d.log_ratio for d in draws]), marginal, number)


def _draws_of(plan: _Plan, likelihood: Likelihood, mode: Mode, mean: np.ndarray, seed: np.random.SeedSequence) -> Draws:
    # The ridge holds rho at the estimate; the contrasts carry the likelihood of other values.
    ridge = find_ridge(plan.kernel, likelihood, mode.theta, mode.scale, plan.rho)
    return draw(plan.kernel, likelihood, mode, ridge, Reference(mean, plan.covariance), plan.n_draws, seed)


def _contrasts_of(contrasts: Sequence[Contrasts], repetitions: np.ndarray, rows: slice) -> tuple[Contrasts, ...]:
    """The contrasts of some persons; there is one for each number of repetitions above one, in ascending order."""
    chosen = np.zeros(repetitions.size, dtype=bool)
    chosen[rows] = True
    found = []
    for j, group in zip(np.unique(repetitions[repetitions > 1]), contrasts, strict=True):
        own = chosen[repetitions == j]
        if own.any():
            information, gradient = group.information[..., own], group.gradient[..., own]
            found.append(Contrasts(np.ascontiguousarray(information), np.ascontiguousarray(gradient)))
    return tuple(found)


def _draws_and_ratios(part: Part) -> tuple[np.ndarray, np.ndarray]:
    return part.theta, part.log_ratio


def _size(part: Part) -> int:
    return len(part.theta)


def _log_likelihood(part: Part, parameters: PopulationParameters) -> np.ndarray:
    return part.marginal(parameters)


def _variance(part: Part, parameters: PopulationParameters) -> np.ndarray:
    return part.marginal.variance(parameters)


def _effective(part: Part, parameters: PopulationParameters) -> np.ndarray:
    return np.asarray(part.marginal.terms(parameters, effective=True)[1].min(axis=0))


def _pareto_k(part: Part, parameters: PopulationParameters) -> np.ndarray:
    from bayes_impedance.arviz_adapter import pareto_k

    return np.asarray(pareto_k(part.marginal.log_weights(parameters)[0]))


def _resampled(
    part: Part, parameters: PopulationParameters, seeds: Sequence[np.random.SeedSequence]
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seeds[part.number])
    n_sets, n = parameters.mu.shape[0], len(part.theta)
    theta = np.empty((n_sets, n, parameters.mu.shape[1]))
    for start in range(0, n_sets, _SETS_AT_ONCE):
        log_weight = part.marginal.log_weights(parameters[slice(start, start + _SETS_AT_ONCE)])
        weight = np.exp(log_weight - log_weight.max(axis=2, keepdims=True))
        cumulative = np.cumsum(weight, axis=2)
        level = rng.random((*cumulative.shape[:2], 1)) * cumulative[:, :, -1:]
        chosen = np.minimum((cumulative < level).sum(axis=2), weight.shape[2] - 1)
        theta[start : start + _SETS_AT_ONCE] = part.theta[np.arange(n), chosen]
    return theta, part.marginal.terms(parameters)[0]
