r"""The posterior of the population's parameters, as a sampler meets it.

Prior times marginal likelihood, in the coordinates of :mod:`bayes_impedance.hierarchy`, with the draws that the
likelihood rests on. Elements that nobody's recording shows are held at a population of their own: the draws cover it,
so that the others are averaged over it, but no coordinate has it and no number is reported.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np

from bayes_impedance.draws import WIDENING, Draws, Reference, draw
from bayes_impedance.empirical_bayes import Estimate
from bayes_impedance.errors import InputError
from bayes_impedance.hierarchy import Coordinates, Prior
from bayes_impedance.kernel import Kernel
from bayes_impedance.marginal import Marginal
from bayes_impedance.sampling import SamplerSettings, sample
from bayes_impedance.starts import Progress

_VARIANCE_WANTED = 0.25
_MORE_DRAWS = (1, 4, 8)
_PILOT = SamplerSettings(ensembles=2, burn_in=(60, 100), chunk=60, longest=60)


class Posterior:
    """Posterior density of the population's parameters.

    Parameters
    ----------
    repetitions : ndarray of int, shape (N,)
        Number of repetitions of each person.
    kernel : Kernel
    prior : Prior
    correlated : bool
        Full covariance, or diagonal.
    n_draws : int
        Draws for each person to begin with.
    point : Estimate
        The anchor.
    covariates : ndarray, shape (N, Q)
        Standardised.

    Attributes
    ----------
    coordinates : Coordinates
        Of what is sampled.
    draws : list of Draws
        Everybody's, once they are made.
    marginal : Marginal
        The likelihood that rests on them.
    redrawn : int
        How often the reference population was moved.

    Raises
    ------
    InputError
        If the recordings determine no element.
    """

    def __init__(
        self,
        repetitions: np.ndarray,
        kernel: Kernel,
        prior: Prior,
        correlated: bool,
        n_draws: int,
        point: Estimate,
        covariates: np.ndarray,
    ) -> None:
        self.kernel, self.n_draws, self.point, self.covariates = kernel, n_draws, point, covariates
        self.repetitions = repetitions
        determined = point.determined
        # Elements that nobody's recording shows keep a population of their own: draws cover it, no coordinate has it.
        self.covariance = point.covariance.copy()
        held = ~determined
        self.covariance[held, :] = 0
        self.covariance[:, held] = 0
        self.covariance[held, held] = 1.0
        self.coordinates = Coordinates(
            prior,
            correlated,
            bool(self.repetitions.max() > 1),
            covariates.shape[1],
            tuple(np.flatnonzero(determined)),
            point.mu,
            np.ones(point.mu.size),
        )
        if not self.coordinates.free:
            raise InputError(
                "the recordings determine no element of the network: check the unit, the frequencies and the network"
            )
        self.draws: list[Draws] = []

    def log_probability(self, u: np.ndarray) -> np.ndarray:
        """Log posterior density of coordinates (W, D), up to a constant: shape (W,)."""
        value = np.full(u.shape[0], -np.inf)
        # Beyond this no prior mass is left, and correlation matrices cease to be positive definite in rounding.
        inside = np.all(np.abs(u) < 9.0, axis=1)
        if np.any(inside):
            value[inside] = self.marginal(self.coordinates.unpack(u[inside])) + self.coordinates.log_prior(u[inside])
        return np.where(np.isfinite(value), value, -np.inf)

    def start(self) -> np.ndarray:
        """The point estimate in sampled coordinates, shape (D,)."""
        mean_repetitions = float(np.mean(self.repetitions))
        between = self.covariance - np.diag(self.point.between_repetitions**2) / mean_repetitions
        return self.coordinates.pack(
            self.point.mu, _positive(between), self.point.between_repetitions, self.point.slopes
        )

    def start_scale(self) -> np.ndarray:
        """Rough posterior standard deviations of the coordinates, shape (D,)."""
        n = self.repetitions.size
        few = 1 / np.sqrt(n + 4)
        repetitions = 1 / np.sqrt(np.sum(self.repetitions - 1) + 4)
        sizes = self.coordinates.sizes
        prior = self.coordinates.prior
        centre = self.point.mu_sd[list(self.coordinates.free)] / prior.centre_sd
        widths = (few, repetitions, few / prior.slope_sd, few)
        return np.concatenate([centre, *(np.full(k, w) for k, w in zip(sizes[1:], widths, strict=True))])

    def draw(self, seed: np.random.SeedSequence, executor: Executor, progress: Progress) -> None:
        """Draws for everybody; while the weights are poor, moves the reference population and draws more.

        Poor weights mean that the population's spread in some direction is smaller than a person's uncertainty there:
        no reference suits both a small and a vanishing spread, so numbers have to help.
        """
        mu, covariance, slopes = self.point.mu, self.covariance, self.point.slopes
        rounds = seed.spawn(len(_MORE_DRAWS))
        for redrawn, child in enumerate(rounds):
            means = mu + self.covariates @ slopes.T
            n_draws = _MORE_DRAWS[redrawn] * self.n_draws
            self.marginal = self._marginal(means, covariance * WIDENING**2, n_draws, child, executor, progress)
            self.redrawn = redrawn
            pilot = np.random.default_rng(child.spawn(1)[0]).normal(size=(16, self.coordinates.n_dimensions))
            nearby = self.coordinates.unpack(self.start() + self.start_scale() * pilot)
            if np.median(self.marginal.variance(nearby)) < _VARIANCE_WANTED or redrawn == len(rounds) - 1:
                return
            chains = sample(
                self.log_probability,
                self.start(),
                self.start_scale(),
                _PILOT,
                child,
                lambda _, done, total: progress("moving the reference", done, total),
            )
            there = self.coordinates.unpack(chains.coordinates.reshape(-1, self.coordinates.n_dimensions))
            mu, slopes = there.mu.mean(axis=0), there.slopes.mean(axis=0)
            covariance = there.covariance.mean(axis=0) + np.diag(
                np.mean(there.between_repetitions**2, axis=0) / np.mean(self.repetitions)
            )

    def _marginal(
        self,
        means: np.ndarray,
        covariance: np.ndarray,
        n_draws: int,
        seed: np.random.SeedSequence,
        executor: Executor,
        progress: Progress,
    ) -> Marginal:
        n = self.repetitions.size
        children = seed.spawn(n)

        def one(i: int) -> Draws:
            reference = Reference(means[i], covariance)
            return draw(self.kernel, self.point.likelihoods[i], self.point.modes[i], reference, n_draws, children[i])

        self.draws = []
        for i, draws in enumerate(executor.map(one, range(n))):
            self.draws.append(draws)
            progress("draws", i + 1, n)
        return Marginal(self.draws, means, covariance, self.repetitions, self.covariates, self.point.contrasts)


def _positive(matrix: np.ndarray) -> np.ndarray:
    """The nearest matrix with variances of at least 1e-4 and correlations that are not extreme."""
    variance = np.maximum(np.diag(matrix), 1e-4)
    correlation = matrix / np.sqrt(np.outer(variance, variance))
    values, vectors = np.linalg.eigh(correlation)
    repaired = (vectors * np.maximum(values, 0.02)) @ vectors.T
    scale = np.sqrt(variance / np.diag(repaired))
    return np.asarray(repaired * np.outer(scale, scale))
