r"""The posterior density of the population's parameters, in the coordinates that are sampled.

Prior times marginal likelihood, in the coordinates of :mod:`bayes_impedance.population.parameters`, with the importance
draws from which the likelihood is computed. Elements that the recordings do not determine have a fixed population
distribution, independent of the others. The draws cover it, so that the other elements are averaged over it, but it has
no sampled coordinate and no number is reported.
"""

from __future__ import annotations

from concurrent.futures import Executor
from copy import copy
from dataclasses import replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.mcmc.ensemble import Chains, SamplerSettings, sample
from bayes_impedance.mcmc.laplace import at_quantiles, normal_approximation
from bayes_impedance.person.importance_draws import widening
from bayes_impedance.population.anchor import Anchor, of_limited_growth
from bayes_impedance.population.coordinates_gradient import pulled_back
from bayes_impedance.population.draw_error import DrawError, draw_error, noise_within
from bayes_impedance.population.draws_again import DrawsAgain
from bayes_impedance.population.em import Estimate, moved_to
from bayes_impedance.population.moved_dispersions import range_of
from bayes_impedance.population.parameters import Coordinates, PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.sharded_likelihood import KeptDraws
from bayes_impedance.population.shared_draws import Sharing
from bayes_impedance.population.starting_point import bend_of, starting_point, starting_scale
from bayes_impedance.runtime.progress import Progress

VARIANCE_WANTED = 0.25
"""Monte-Carlo variance of the log likelihood (a standard deviation of 0.5) below which draws are enough. By choice: a
quarter of the variance that is refused (:data:`bayes_impedance.population.diagnostics.VARIANCE_LIMIT`)."""
FEWEST_DRAWS, RARELY = 80.0, 0.05
"""Effective draws that each subject's likelihood must rest on in all but one of twenty cases, over subjects and over
populations near the posterior. With 80 its Monte-Carlo error is 11 %. Measured: where central values were 1 to 4
standard deviations off an independent integration, the number was 2 to 52; where draws held, 119 and more."""
_MORE_DRAWS = (1, 4, 8, 8)
"""Factor on the number of draws of the settings in each attempt; the reference is moved to the posterior in between. By
choice: the largest are needed for difficult data only."""
_WIDER = 2.0
"""Factor on the reference's standard deviations where populations wider than it are not covered. By choice."""
_BEYOND_CHAIN = 2.0
"""Factor on the standard deviations of the reference population that follows from a chain, along valleys. Measured from
100 to 101 Hz: least effective number of draws (5 % quantile of populations) 37 with 1, 57 with 1.5, 120 with 2."""
_PILOT = SamplerSettings(ensembles=2, burn_in=(60, 60), chunk=60, longest=60)
"""Short chains, to whose mean and covariance the reference is moved. By choice: convergence is not required."""
_LARGEST_COORDINATE = 8.0
"""Limit on the coordinates. Most are standard normal under the prior, with a probability of 1e-15 beyond eight."""
_SPREAD_ALLOWED = 1.2
"""Largest spread of the shared parameters about the origin of the draws, relative to the one for which the draws were
moved. By choice: with 1.2 their reach is 2.5 standard deviations, and 1.2 % of a normal distribution is beyond it."""
_WELL_WITHIN = 0.5
"""Part of the reach within which the posterior's curvature at its mode is believed. By choice: the steps by which it is
found are about a standard deviation long, and must not leave the reach."""
_CENTRINGS, _MOST_GROWTH = 5, 4.0
"""Most times that draws are moved to the posterior's mode, and most by which the variance of shared parameters grows
each time. By choice: the mode is known within the reach only, so far ones are reached in steps."""
_MOST_MOVES = 4
"""Most times that draws are made while the range of dispersions between repetitions moves. By choice: each time its end
is half as far again from the middle, so that after three moves it is three times as far."""
_STEEP = 2.0
"""What is subtracted at one unit beyond the reach of the shared parameters. By choice: four times as steep as a normal
density there."""
_PILOTS = 64
"""Populations at which the Monte-Carlo variance is computed. By choice: they cost as much as a step of an ensemble."""
_ROUGH_VARIANCE, _FEWEST_ROUGH = 0.25, 64
"""Monte-Carlo variance of the log likelihood whose gradient is taken, by fewer draws, and least number of them. By
choice: the error of the energy along a trajectory is then half a unit. With a variance of 0.3 about 0.53 of the
proposals are accepted, with 1.3 only 0.1."""
_FEWER = 4
"""Divisor of the number of draws from which the mode is found. By choice: it is known to a fraction of a standard
deviation, and most of the time goes into the draws."""


class Posterior:
    """Posterior density of the population's parameters.

    Parameters
    ----------
    repetitions : ndarray of int, shape (N,)
        Number of repetitions of each person.
    prior : Prior
        Of all parameters.
    correlated : bool
        Full covariance, or diagonal.
    n_draws : int
        Draws for each person to begin with.
    point : Estimate
        Point estimate, from which the first reference population is taken.
    covariates : ndarray, shape (N, Q)
        Standardised.

    Attributes
    ----------
    coordinates : Coordinates
        Of the sampled vector.
    marginal : KeptDraws
        Marginal likelihood from the draws of all persons; available after :meth:`draw`.
    mode, normal_covariance : ndarray, shape (D,) and (D, D)
        Normal approximation of the posterior, from which sampling may start.
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
        prior: Prior,
        correlated: bool,
        n_draws: int,
        point: Estimate,
        covariates: np.ndarray,
    ) -> None:
        self.n_draws, self.point, self.covariates = n_draws, point, covariates
        self.pooling, shared_free = point.pooling, np.flatnonzero(point.shared_determined)
        curvature = np.linalg.inv(point.shared_covariance)[np.ix_(shared_free, shared_free)]
        self.shared_covariance = np.linalg.inv(curvature)  # of those that are sampled, while the others are held
        self.sharing: Sharing | None = None
        self.repetitions, self.redrawn = repetitions, 0
        determined, held = point.determined, ~point.determined
        self.covariance = point.covariance.copy()
        self.covariance[held | held[:, None]] = 0
        self.covariance[held, held] = 1.0
        own = prior.of(self.pooling.varying) if self.pooling.names else prior
        self.span = range_of(point.fits, own, point.between_repetitions)
        self.coordinates = Coordinates(
            prior=own,
            correlated=correlated,
            repetitions=bool(self.repetitions.max() > 1),
            n_covariates=covariates.shape[1],
            free=tuple(np.flatnonzero(determined)),
            held_mu=point.mu,
            held_dispersion=np.ones(point.mu.size),
            shared_prior=prior.of(self.pooling.shared) if self.pooling.names else None,
            shared_free=tuple(shared_free),
            held_shared=point.shared,
            bend_persons=bend_of(np.sqrt(np.diag(self.covariance)), own),
            bend_repetitions=bend_of(point.between_repetitions, own, self.span),
            tails=point.tail is not None,
            groups=point.groups is not None,
        )
        if not (self.coordinates.free or self.coordinates.shared_free):
            raise InputError(
                "the recordings determine no element of the network: check the unit, the frequencies and the network"
            )

    def log_probability(self, u: np.ndarray) -> np.ndarray:
        """Log posterior density of coordinates (W, D), up to a constant: shape (W,)."""
        value = np.full(u.shape[0], -np.inf)
        # Beyond this the prior probability is negligible and dispersions are rounded to zero.
        inside = np.all(np.abs(u) < _LARGEST_COORDINATE, axis=1)
        if np.any(inside):
            value[inside] = self._inside(u[inside])
        return np.where(np.isfinite(value), value, -np.inf)

    def _inside(self, u: np.ndarray) -> np.ndarray:
        try:
            parameters = self.coordinates.unpack(u)
            return np.asarray(self.marginal(parameters) + self.coordinates.log_prior(u) - self._beyond(parameters))
        except np.linalg.LinAlgError:  # one correlation matrix is singular by rounding: refuse it, not the others
            if len(u) == 1:
                return np.array([-np.inf])
            return np.concatenate([self._inside(row) for row in np.array_split(u, 2)])

    def gradient(self, u: np.ndarray) -> np.ndarray:
        """Nearly the gradient of :meth:`log_probability` with respect to coordinates (W, D), from fewer draws.

        Zero where the density is.
        """
        result = np.zeros(u.shape)
        inside = np.all(np.abs(u) < _LARGEST_COORDINATE, axis=1)
        if np.any(inside):
            result[inside] = self._gradient_inside(u[inside])
        return np.where(np.isfinite(result), result, 0.0)

    def _gradient_inside(self, u: np.ndarray) -> np.ndarray:
        try:
            parameters = self.coordinates.unpack(u)
            own = self.marginal.gradient(parameters, self.rough_draws)
            if self.sharing is not None and parameters.shared is not None:
                own = replace(own, shared=own.shared - self.sharing.beyond_slope(parameters.shared, _STEEP))
            return pulled_back(self.coordinates, u, parameters, own)
        except np.linalg.LinAlgError:  # as above
            if len(u) == 1:
                return np.zeros(u.shape)
            return np.concatenate([self._gradient_inside(row) for row in np.array_split(u, 2)])

    def _beyond(self, parameters: PopulationParameters) -> np.ndarray:
        """What is subtracted beyond the reach of the shared parameters, where the draws stay at its edge: (W,)."""
        if self.sharing is None or parameters.shared is None:
            return np.zeros(len(parameters.mu))
        return np.asarray(_STEEP * self.sharing.beyond(parameters.shared) ** 2)

    def draw(self, seed: np.random.SeedSequence, executor: Executor, progress: Progress) -> None:
        """Draw for all persons; while the effective number of draws is too small, move the reference and draw more.

        Draws are made for the populations near the posterior's mode. If they are too few for these, more are made, for
        those of a short chain. Should not even the reference itself have enough, somebody's posterior is a curved
        valley of which one surface covers a part; so it is, along a ridge, if more are needed than may be. Proposals
        then follow the valley (:mod:`bayes_impedance.person.valley`) under a wider reference, until draws suffice.
        """
        few, repetitions = self._few, self.repetitions  # persons times draws is kept about constant
        reach = widening(repetitions.size)
        anchor = Anchor(mu=self.point.mu, slopes=self.point.slopes, covariance=self.covariance, reach=reach)
        self.mode = starting_point(self.coordinates, self.point, self.covariance, self.repetitions)
        scale = starting_scale(self.coordinates, self.point, self.shared_covariance, self.repetitions)
        self.normal_covariance = np.diag(scale**2)
        n_draws = _MORE_DRAWS[0] * self.n_draws * few
        for self.redrawn, child in enumerate(seed.spawn(len(_MORE_DRAWS))):
            self._draw_centred(anchor, n_draws, child, executor, progress)
            populations = self._nearby(child.spawn(1)[0])
            noise = noise_within(self._variance(populations), repetitions.size, self.mode.size) / VARIANCE_WANTED
            lacking = FEWEST_DRAWS / float(np.quantile(self.marginal.effective(populations), RARELY))
            if (noise < 1 and lacking <= 1) or self.redrawn == len(_MORE_DRAWS) - 1:
                return
            at_home = float(np.quantile(self.marginal.effective_at_home(), RARELY))
            needed = n_draws * 2 ** int(np.ceil(np.log2(max(noise, lacking, 1.0))))
            around = at_home >= FEWEST_DRAWS and needed <= max(_MORE_DRAWS) * self.n_draws * few
            around = around and not anchor.along_valley
            n_draws = needed if around else _MORE_DRAWS[self.redrawn + 1] * self.n_draws * few
            reach *= _WIDER if lacking > 1 and not around else 1.0
            chains = sample(
                self.log_probability,
                self.mode,
                self.normal_covariance,
                _PILOT,
                child,
                lambda _, done, total: progress("moving the reference", done, total),
                even=self.coordinates.even,
            )
            self._reach(there := self._sampled(chains))
            anchor = Anchor.among(there, repetitions) if around else Anchor.of(there, repetitions, reach, lacking > 1)

    def error(self, chains: Chains) -> DrawError:
        """Error by the draws in the posterior that was sampled."""
        flat, there = chains.coordinates.reshape(-1, self.coordinates.n_dimensions), self._sampled(chains)
        return replace(draw_error(self.marginal, flat, there), beyond=self._beyond_range(there))

    def moved_to(
        self, chains: Chains, excess: float, seed: np.random.SeedSequence, executor: Executor, progress: Progress
    ) -> Posterior:
        """The posterior from other draws for the populations of a chain, whose error exceeds the wanted by a factor.

        A person's posterior, averaged over these populations, is that under a population of their mean covariance plus
        the covariance of their means: such a reference reaches as far as the chain's populations together.
        """
        other, there = copy(self), self._sampled(chains)
        reach = _BEYOND_CHAIN if self.along_valley else widening(self.repetitions.size)
        anchor = Anchor.of(there, self.repetitions, reach, self.along_valley).and_between(there)
        if not self.along_valley:
            anchor = replace(anchor, near=Anchor.among(there, self.repetitions).near)
        again = DrawsAgain(
            first=self.n_draws * self._few,
            last=self.drawn,
            n_persons=self.repetitions.size,
            shared=bool(self.coordinates.shared_free),
        )
        n_draws = again.number(excess, other._reach(there))
        other._share_as(there, anchor.means(self.covariates), anchor.covariance)
        other._draw_centred(anchor, n_draws, seed, executor, progress, True)
        other.along_valley = self.along_valley or excess > 1  # should these draws not hold either
        other._variance(there[np.linspace(0, len(there.mu) - 1, _PILOTS).astype(int)])
        other.redrawn = self.redrawn + 1
        return other

    def _sampled(self, chains: Chains) -> PopulationParameters:
        return self.coordinates.unpack(chains.coordinates.reshape(-1, self.coordinates.n_dimensions))

    @property
    def _few(self) -> int:
        """Factor on the number of draws: with few persons the population is uncertain and draws are cheap."""
        return int(2 ** int(np.clip(np.round(np.log2(64 / self.repetitions.size)), 0, 3)))

    def _draw_centred(
        self,
        anchor: Anchor,
        n_draws: int,
        seed: np.random.SeedSequence,
        executor: Executor,
        progress: Progress,
        centred: bool = False,
    ) -> None:
        """Draw for the populations near the mode, and with shared parameters centred."""
        means, covariance = anchor.means(self.covariates), anchor.covariance
        if not (centred or anchor.along_valley or anchor.near):
            self._find_mode(anchor, n_draws // _FEWER, seed, executor, progress)
            anchor = Anchor.among(self._nearby(seed.spawn(1)[0]), self.repetitions)
        self._draw_within(anchor, n_draws, seed, executor, progress)
        if self._spread_of_shared() > _SPREAD_ALLOWED:
            self._centre_shared(means, covariance)
            self._draw_within(anchor, n_draws, seed, executor, progress)

    def _find_mode(
        self, anchor: Anchor, n_draws: int, seed: np.random.SeedSequence, executor: Executor, progress: Progress
    ) -> None:
        """From few draws, made again while the posterior's mode lies elsewhere than where their likelihoods hold."""
        means, covariance = anchor.means(self.covariates), anchor.covariance
        for _ in range(_CENTRINGS):
            self._draw_once(anchor, n_draws, seed, executor, progress)
            near = self._spread_of_shared() <= _SPREAD_ALLOWED
            if self.coordinates.shared_free:  # even if near: else all draws may find it beyond the limit
                self._centre_shared(means, covariance)
            if not self._reach_mode() and near:
                return

    def _nearby(self, seed: np.random.SeedSequence) -> PopulationParameters:
        """Populations near the posterior's mode, from its normal approximation."""
        pilot = np.random.default_rng(seed).normal(size=(_PILOTS, self.mode.size))
        return self._unpacked(self.mode + pilot @ np.linalg.cholesky(self.normal_covariance).T)

    def _unpacked(self, u: np.ndarray) -> PopulationParameters:
        return self.coordinates.unpack(np.clip(u, -_LARGEST_COORDINATE, _LARGEST_COORDINATE))

    def _variance(self, populations: PopulationParameters) -> float:
        """Mean Monte-Carlo variance of the log likelihood; says how many draws are enough for gradients."""
        variance = float(np.mean(self.marginal.variance(populations)))
        needed = self.drawn * variance / _ROUGH_VARIANCE if np.isfinite(variance) else self.drawn
        self.rough_draws = int(np.clip(needed, min(_FEWEST_ROUGH, self.drawn), self.drawn))
        return variance

    def _draw_within(
        self, anchor: Anchor, n_draws: int, seed: np.random.SeedSequence, executor: Executor, progress: Progress
    ) -> None:
        """Draw, and again while dispersions between repetitions near the mode lie beyond their range."""
        for _ in range(_MOST_MOVES):
            self._draw_once(anchor, n_draws, seed, executor, progress)
            if not self._reach_mode():
                return

    def _reach_mode(self) -> bool:
        """Move the range of dispersions between repetitions outward to the quantiles of the normal approximation."""
        return self._reach(self._unpacked(at_quantiles(self.mode, self.normal_covariance)))

    def _reach(self, there: PopulationParameters) -> bool:
        """Move the range of dispersions between repetitions outward to these populations, if they lie beyond it."""
        before, free = self.span, list(self.coordinates.free)  # others are held, wherever their range is
        self.span = None if before is None else before.reaching(there.between_repetitions, free)
        return self.span is not before

    def _beyond_range(self, there: PopulationParameters) -> float:
        """Largest share of a sampled dispersion between repetitions beyond an end of its range."""
        if self.span is None:
            return 0.0
        return float(self.span.beyond(there.between_repetitions)[:, list(self.coordinates.free)].max(initial=0))

    def _draw_once(
        self, anchor: Anchor, n_draws: int, seed: np.random.SeedSequence, executor: Executor, progress: Progress
    ) -> None:
        """Draw under a reference population, and find the mode and the normal approximation of the posterior."""
        self.drawn, self.along_valley = n_draws, anchor.along_valley
        if own := self.coordinates.shared_free:
            self.sharing = Sharing.around(self.pooling, self.point.shared, self.shared_covariance, own)
        kernel, sharing, span = self.pooling.at(self.point.shared), self.sharing, self.span
        self.marginal = KeptDraws.made(
            kernel, self.point, anchor, self.covariates, n_draws, seed, executor, progress, sharing, span
        )
        # Each mode is looked for where the last was found. The prior alone has a precision of one in most coordinates.
        self.rough_draws = n_draws  # all of them, until the variance says how many suffice
        self.mode, self.normal_covariance = normal_approximation(
            self.log_probability, self.gradient, self.mode, self.normal_covariance, 0.5
        )

    def _shared_approximation(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (S',) and covariance (S', S') of the free shared parameters in the normal approximation."""
        own = slice(-len(self.coordinates.shared_free), None)
        return self.coordinates.shared_moments(self.mode[own], self.normal_covariance[own, own])

    def _centre_shared(self, means: np.ndarray, covariance: np.ndarray) -> None:
        """Move the shared parameters of the draws, and everybody's mode along, to the normal approximation."""
        free = list(self.coordinates.shared_free)
        (mean, moment), before, origin = self._shared_approximation(), self.point.shared[free], self.point.shared.copy()
        origin[free] = mean
        self.point = moved_to(self.point, origin, means, covariance)
        ours = np.linalg.cholesky(self.shared_covariance)
        if self.sharing and np.linalg.norm(np.linalg.solve(ours, mean - before)) > _WELL_WITHIN * self.sharing.reach:
            return  # so near the edge, beyond which the density is not known, its curvature there is none
        self.shared_covariance = of_limited_growth(ours, moment, _MOST_GROWTH)

    def _share_as(self, there: PopulationParameters, means: np.ndarray, covariance: np.ndarray) -> None:
        """Move the shared parameters of the draws to those of a chain."""
        if there.shared is None or not self.coordinates.shared_free:
            return
        free, origin = list(self.coordinates.shared_free), self.point.shared.copy()
        origin[free] = there.shared[:, free].mean(axis=0)
        self.shared_covariance = np.atleast_2d(np.cov(there.shared[:, free].T))
        self.point = moved_to(self.point, origin, means, covariance)

    def _spread_of_shared(self) -> float:
        """Largest spread of the shared parameters about the origin of the draws, in the units of their reach."""
        return 0.0 if self.sharing is None else self.sharing.spread(*self._shared_approximation())
