"""The population likelihood, computed in batches of persons where their draws are kept; workers send back only sums.

The memory for draws grows with the number of persons, about ten kilobytes for each. They are kept in parts
(batches) of some dozens to hundreds of persons, in this process or by the workers of a cluster, which evaluate the
likelihood on them: a set of population parameters is sent there and one number is returned. The division into parts
depends only on the number of persons, and parts are summed in order, so the result does not depend on the number of
workers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.absolute_density import Deviations
from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.population.anchor import Anchor
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.e_step import PersonFit, contrasts_of
from bayes_impedance.population.em import Estimate
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.likelihood_gradient import ParameterGradient, likelihood_gradient
from bayes_impedance.population.moved_dispersions import DispersionRange
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.person_densities import constants_of, log_densities
from bayes_impedance.population.person_draws import DrawingPlan, PersonDraws, draws_of
from bayes_impedance.population.shared import SharedEquations
from bayes_impedance.population.shared_draws import Sharing, monomials
from bayes_impedance.runtime.executors import Cluster, map_persons
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.sharded import Kept, parts_of

_SETS_AT_ONCE = 50
"""Sets of population parameters for which a part's draws are weighted at once. By choice: about half the number of the
sampler's walkers; the weights of a block of four persons then take less than a megabyte."""


@dataclass(frozen=True)
class Part:
    """Draws of some persons, as the likelihood computed from them holds them.

    Attributes
    ----------
    marginal : ImportanceLikelihood
    deviations : tuple of Deviations or None
        Each person's likelihood of other dispersions between repetitions.
    effective : ndarray, shape (n,)
        Each person's effective number of draws under the reference population.
    constant : ndarray, shape (n,)
        What `marginal` lacks of each person's log density.
    """

    marginal: ImportanceLikelihood
    deviations: tuple[Deviations | None, ...]
    effective: np.ndarray
    constant: np.ndarray

    @classmethod
    def of(cls, marginal: ImportanceLikelihood, draws: Sequence[Draws], rho: np.ndarray) -> Part:
        """From the persons' draws, which are not kept; rho (P,) is where their deviations were integrated out."""
        effective = np.array([own.effective for own in draws])
        return cls(marginal, tuple(own.deviations for own in draws), effective, constants_of(draws, rho))

    def log_densities(self, parameters: PopulationParameters) -> np.ndarray:
        """Log density of each person's recordings under W sets, shape (W, n)."""
        return log_densities(self.marginal, self.deviations, self.constant, parameters)

    def __len__(self) -> int:
        """Number of persons."""
        return len(self.constant)

    def __sizeof__(self) -> int:
        """Size in bytes: a scheduler that knows it does not copy a large part to an idle worker."""
        return self.marginal.nbytes


class KeptDraws:
    """The likelihood of population parameters, all persons together.

    Parameters
    ----------
    parts : sequence
        Parts, or the cluster's handles (futures) of them.
    executor : Executor
        Keeps the parts.
    """

    def __init__(self, parts: Sequence[Any], executor: Executor) -> None:
        self._kept = Kept(executor, parts)

    @classmethod
    def made(
        cls,
        kernel: Kernel,
        point: Estimate,
        anchor: Anchor,
        covariates: np.ndarray,
        n_draws: int,
        seed: np.random.SeedSequence,
        executor: Executor,
        progress: Progress,
        sharing: Sharing | None = None,
        span: DispersionRange | None = None,
    ) -> KeptDraws:
        """Draw for all persons under a reference population.

        Parameters
        ----------
        kernel : Kernel
        point : Estimate
            With each person's mode and likelihood.
        anchor : Anchor
            The reference population.
        covariates : ndarray, shape (N, Q)
        n_draws : int
            For each person, a power of two.
        seed : SeedSequence
        executor : Executor
        progress : callable
        sharing : Sharing, optional
            If there are parameters that are the same for everybody: how far they may move.
        span : DispersionRange, optional
            How far dispersions between repetitions may move; draws are made at its middle, or at the point estimate.
        """
        means = anchor.means(covariates)
        n = len(means)
        plan = DrawingPlan(
            kernel=kernel,
            rho=point.between_repetitions if span is None else span.middle,
            covariance=anchor.wide,
            n_draws=n_draws,
            along_valley=anchor.along_valley,
            sharing=sharing,
            span=span,
            near=anchor.near,
        )
        seeds = seed.spawn(n)
        if isinstance(executor, Cluster):
            equations = (
                [None] * len(point.data.parts) if point.shared_equations is None else point.shared_equations.parts
            )
            columns = zip(point.data.parts, point.fits.parts, equations, parts_of(n), strict=True)
            far = point.stretches
            kept = [
                executor.keep(_drawn_part, plan, data, fits, own, means[rows], covariates[rows], seeds[rows], far[rows])
                for data, fits, own, rows in columns
            ]
            for part, rows in zip(kept, parts_of(n), strict=True):
                executor.ask(len, [(part,)])
                progress("draws", rows.stop, n)
            return cls(kept, executor)
        data, fits = point.data.gathered(), point.fits.gathered()
        equations = [None] * n if point.shared_equations is None else point.shared_equations.gathered()
        drawn = map_persons(executor, partial(draws_of, plan), data, fits, equations, means, seeds, point.stretches)
        watched = _watched(drawn, n, progress)
        rows_of = parts_of(n)
        parts = [_part(plan, watched, *_repetitions_of(fits[r]), means[r], covariates[r]) for r in rows_of]
        return cls(parts, executor)

    def __call__(self, parameters: PopulationParameters) -> np.ndarray:
        """Log likelihood of W sets of population parameters, shape (W,)."""
        return np.asarray(np.sum(self._kept.ask(_log_likelihood, parameters), axis=0))

    def log_density(self, parameters: PopulationParameters) -> np.ndarray:
        """Log density of all recordings under W sets, shape (W,): with what the likelihood leaves out for these draws.

        Likelihoods from different draws differ by a constant; these do not.
        """
        return np.asarray(np.sum([np.sum(own, axis=1) for own in self._kept.ask(_log_densities, parameters)], axis=0))

    def gradient(self, parameters: PopulationParameters, n_draws: int) -> ParameterGradient:
        """Gradient of the log likelihood of W sets of population parameters, from about `n_draws` of each person's."""
        return reduce(ParameterGradient.__add__, self._kept.ask(_gradient, parameters, n_draws))

    def variance(self, parameters: PopulationParameters) -> np.ndarray:
        """Monte-Carlo variance of the log likelihood, summed over persons, shape (W,)."""
        return np.asarray(np.sum(self._kept.ask(_variance, parameters), axis=0))

    def effective(self, parameters: PopulationParameters) -> np.ndarray:
        """Each person's effective number of draws under W sets, shape (W, N)."""
        return np.concatenate(self._kept.ask(_effective, parameters), axis=1)

    def effective_at_home(self) -> np.ndarray:
        """Each person's effective number of draws under the reference population, shape (N,)."""
        return np.concatenate(self._kept.ask(_effective_at_home))

    def influences(self, parameters: PopulationParameters, influence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How the weights of the draws go with functions of W sets of parameters.

        Parameters
        ----------
        parameters : PopulationParameters
        influence : ndarray, shape (W, F)
            Functions of the sets, with a mean of zero, divided by W.

        Returns
        -------
        squares : ndarray, shape (F,)
            Squared covariance of each function with each draw's normalised weight, summed over draws and persons.
        least : ndarray, shape (W,)
            Smallest effective number of draws over persons.
        """
        both = self._kept.ask(_influences, parameters, influence)
        return np.asarray(np.sum([a for a, _ in both], axis=0)), np.asarray(np.min([b for _, b in both], axis=0))

    def missed(self) -> float:
        """What moving the draws with shared parameters misses of the log likelihood, at most, at test points."""
        return float(np.abs(np.sum(self._kept.ask(_missed), axis=0)).max(initial=0.0))

    def pareto_k(self, parameters: PopulationParameters) -> np.ndarray:
        """Pareto k of each person's weights under the first set, shape (N,)."""
        return np.concatenate(self._kept.ask(_pareto_k, parameters[:1]))

    def gathered(self) -> tuple[np.ndarray, np.ndarray]:
        """Draws of all persons, (N, K, P), and their ln L - ln q, (N, K), up to a constant for each person.

        All are sent to this process.
        """
        both = self._kept.ask(_draws_and_ratios)
        return np.concatenate([a for a, _ in both]), np.concatenate([b for _, b in both])

    def persons(self, parameters: PopulationParameters, seed: np.random.SeedSequence) -> tuple[np.ndarray, np.ndarray]:
        """For each set, one draw of each person's log elements, (W, N, P), single precision; log densities, (W, N)."""
        n_sets, n_elements = parameters.mu.shape
        rows = [(parameters, child) for child in seed.spawn(len(self._kept.parts))]
        sizes = self._kept.ask(len)
        n = sum(sizes)
        theta, log_likelihood = np.empty((n_sets, n, n_elements), dtype=np.float32), np.empty((n_sets, n))
        end = 0
        for size, part in zip(sizes, self._kept.ask_in_turn(_resampled, rows), strict=True):
            theta[:, end : end + size], log_likelihood[:, end : end + size] = part
            end += size
        return theta, log_likelihood


def part_of(
    kernel: Kernel,
    rho: np.ndarray,
    data: Sequence[Likelihood],
    fits: Sequence[PersonFit],
    means: np.ndarray,
    covariance: np.ndarray,
    covariates: np.ndarray,
    n_draws: int,
    seeds: Sequence[np.random.SeedSequence],
    along_valley: bool,
    span: DispersionRange | None,
    stretches: np.ndarray,
) -> Part:
    """Draw for some persons, in this process; the arguments are those of :meth:`KeptDraws.made`.

    `stretches` (N,) are factors on the covariance of the reference population for each person.
    """
    plan = DrawingPlan(
        kernel=kernel,
        rho=rho,
        covariance=covariance,
        n_draws=n_draws,
        along_valley=along_valley,
        sharing=None,
        span=span,
    )
    return _drawn_part(plan, data, fits, None, means, covariates, seeds, stretches)


def _drawn_part(
    plan: DrawingPlan,
    data: Sequence[Likelihood],
    fits: Sequence[PersonFit],
    equations: Sequence[SharedEquations] | None,
    means: np.ndarray,
    covariates: np.ndarray,
    seeds: Sequence[np.random.SeedSequence],
    stretches: np.ndarray,
) -> Part:
    own = [None] * len(data) if equations is None else equations
    drawn = (draws_of(plan, *row) for row in zip(data, fits, own, means, seeds, stretches, strict=True))
    return _part(plan, drawn, *_repetitions_of(fits), means, covariates)


def _repetitions_of(fits: Sequence[PersonFit]) -> tuple[np.ndarray, tuple[Contrasts, ...]]:
    """Numbers of repetitions, and the contrasts between them."""
    return np.array([len(fit.deviations) for fit in fits]), tuple(contrasts_of(fits).values())


def _part(
    plan: DrawingPlan,
    drawn: Iterable[PersonDraws],
    repetitions: np.ndarray,
    contrasts: Sequence[Contrasts],
    means: np.ndarray,
    covariates: np.ndarray,
) -> Part:
    """A part with one person per row of `means`."""
    draws, how, responses = [], [], []
    for _, own in zip(means, drawn, strict=False):
        draws.append(own.draws)
        if own.moved is not None:
            how.append(own.moved)
        if own.response is not None:
            responses.append(own.response)
    marginal = ImportanceLikelihood(
        draws, means, plan.covariance, repetitions, covariates, contrasts, plan.sharing, how, plan.span, responses
    )
    return Part.of(marginal, draws, np.maximum(plan.rho, LEAST_RHO))


def _watched(drawn: Iterable[PersonDraws], n: int, progress: Progress) -> Iterator[PersonDraws]:
    for i, draws in enumerate(drawn):
        progress("draws", i + 1, n)
        yield draws


def _draws_and_ratios(part: Part) -> tuple[np.ndarray, np.ndarray]:
    marginal = part.marginal
    n_elements = marginal.whitening.shape[0]
    theta, log_ratio = np.empty((len(part), marginal.n_draws, n_elements)), np.empty((len(part), marginal.n_draws))
    for _, persons, rows in marginal.blocks:
        own = rows.reshape(len(rows), persons.size, marginal.n_draws)
        theta[persons] = marginal.draws_of(persons, np.moveaxis(own[:n_elements], 0, 2))
        log_ratio[persons] = own[n_elements]
    return theta, log_ratio


def _log_likelihood(part: Part, parameters: PopulationParameters) -> np.ndarray:
    return part.marginal(parameters)


def _log_densities(part: Part, parameters: PopulationParameters) -> np.ndarray:
    return part.log_densities(parameters)


def _gradient(part: Part, parameters: PopulationParameters, n_draws: int) -> ParameterGradient:
    return likelihood_gradient(part.marginal.thinned(n_draws), parameters)


def _missed(part: Part) -> np.ndarray:
    return part.marginal.missed


def _variance(part: Part, parameters: PopulationParameters) -> np.ndarray:
    return part.marginal.variance(parameters)


def _effective(part: Part, parameters: PopulationParameters) -> np.ndarray:
    return np.asarray(part.marginal.terms(parameters, effective=True)[1])


def _effective_at_home(part: Part) -> np.ndarray:
    return part.effective


def _influences(part: Part, parameters: PopulationParameters, influence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    squares, least = np.zeros(influence.shape[1]), np.full(len(influence), np.inf)
    transposed = influence.T.astype(np.float32)
    for _, log_weight, _ in part.marginal.exponents(parameters):
        weight = np.exp(log_weight - log_weight.max(axis=2, keepdims=True))
        weight /= weight.sum(axis=2, keepdims=True)
        least = np.minimum(least, 1 / np.sum(weight**2, axis=2).max(axis=1))
        covariance = transposed @ weight.reshape(len(weight), -1)
        squares += np.sum(covariance**2, axis=1, dtype=float)
    return squares, least


def _pareto_k(part: Part, parameters: PopulationParameters) -> np.ndarray:
    from bayes_impedance.mcmc.convergence import pareto_k

    return np.asarray(pareto_k(part.marginal.log_weights(parameters)[0]))


def _resampled(
    part: Part, parameters: PopulationParameters, seed: np.random.SeedSequence
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    marginal, (n_sets, n_elements), n = part.marginal, parameters.mu.shape, len(part)
    theta = np.empty((n_sets, n, n_elements))
    for start in range(0, n_sets, _SETS_AT_ONCE):
        some = parameters[slice(start, start + _SETS_AT_ONCE)]
        level = rng.random((some.mu.shape[0], n, 1))
        for (persons, log_weight, _), (_, _, rows) in zip(marginal.exponents(some), marginal.blocks, strict=True):
            weight = np.exp(log_weight - log_weight.max(axis=2, keepdims=True))
            cumulative = np.cumsum(weight, axis=2)
            own = level[:, persons] * cumulative[:, :, -1:]
            chosen = np.minimum((cumulative < own).sum(axis=2), weight.shape[2] - 1)
            u = rows[:n_elements].reshape(n_elements, persons.size, -1)
            there = np.moveaxis(u[:, np.arange(persons.size)[:, None], chosen.T], 0, 2)
            theta[start : start + _SETS_AT_ONCE, persons] = np.swapaxes(marginal.draws_of(persons, there), 0, 1)
    if marginal.sharing is not None and parameters.shared is not None:
        t, away = marginal.sharing.standardised(parameters.shared), theta - marginal.reference_means
        theta += np.einsum("nmp,wm->wnp", marginal.path, monomials(t))
        theta += np.einsum("ws,nspq,wnq->wnp", t, marginal.shears, away, optimize=True)
    return theta, part.log_densities(parameters)
