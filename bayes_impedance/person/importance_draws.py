r"""Importance sampling of one person's exact posterior under a reference population.

The proposal q is a mixture: mostly a multivariate t (10 degrees of freedom: tails heavier than the target's) along a
bent surface, at first that of conditional modes (:mod:`bayes_impedance.person.first_proposal`), later one that is
fitted to draws (:mod:`bayes_impedance.person.bent_proposal`), and in part the reference population itself, which covers
regions far from the mode and bounds the importance weights (defensive mixture, Owen and Zhou 2000). Draws and weights
of all rounds so far, as if each came from the mixture of all proposals (adaptive multiple importance sampling, Cornuet
et al. 2012), give the mean, covariance and bend of the next round's t.
The best round is the result. If it is poor, or if a valley was followed, which no later round needs to cover, draws are
chosen from those of all rounds (:mod:`bayes_impedance.person.choosing`). If the populations are known under which they
are to count, the better of the two is taken: a choice from all rounds is mostly better by half, but it keeps every draw
that was far out.
Points come from Sobol sequences (:mod:`bayes_impedance.person.shifted_sobol`), which cover eight dimensions far more
evenly than random ones.

Each draw is stored as its log elements and :math:`\ln L(\theta) - \ln q(\theta)`. Multiplied with **any** population
density :math:`N(\theta; \mu, \Sigma)` and averaged, this estimates the person's marginal likelihood under that
population: the reference only determines where the draws lie. It must be near the true population and a little wider: a
much wider one leaves few effective draws for elements that a single person hardly determines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.absolute_density import Deviations
from bayes_impedance.person.bent_proposal import BentT
from bayes_impedance.person.choosing import Nearby, inclusion
from bayes_impedance.person.first_proposal import along_conditional_modes
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import Ridge, marginal_log_likelihood
from bayes_impedance.person.mode import Mode
from bayes_impedance.person.shifted_sobol import uniform_points
from bayes_impedance.person.valley import Valley, follow


def widening(n_persons: int) -> float:
    """Factor by which the standard deviations of the reference population exceed the estimated ones.

    The dispersion of n persons is known to about 1/sqrt(2 n) of itself: 8 % for 71 of them, 30 % for six.
    """
    return float(1 + 1 / np.sqrt(2 * n_persons))


_EXPLORING, _DEFENSIVE = 0.5, 0.125
"""Share of the reference population in the proposal of the first round and of the later ones.

By choice: half of the first round explores regions away from the mode; later an eighth bounds every weight by
eight times the likelihood, at the cost of an eighth of the draws.
"""

_MOST_ROUNDS, _ENOUGH, _POOR = 6, 0.5, 0.25
"""Most rounds, the effective share of the draws after which no more are made, and the share of the best round below
which the draws of all rounds count. By choice: the first round explores, and the proposal changes little after four
more. Choosing from all rounds makes small weights equal and leaves the largest as they are, so that the tail of the
weights looks heavier than it is (largest Pareto k of 33 people: 0.58 in the best round, 0.69 in all rounds, 1.09 when
chosen from these); where one round is not poor that is not worth it."""

_MANY = 2.0
"""Effective number of draws of all rounds, relative to those that are chosen for given populations, after which no more
are made. By choice: half as many of them would be lost by making more."""

_TO_BEND = 12.0
"""Least effective number of draws of all rounds, per element, from which a bent t is fitted. By choice: six products
are regressed in each direction, so that each coefficient rests on a dozen draws or more."""


@dataclass(frozen=True)
class Reference:
    """The reference (anchor) population: importance draws are proposed from posteriors under it.

    Attributes
    ----------
    mean : ndarray, shape (P,)
        The mean for this person, covariates included.
    covariance : ndarray, shape (P, P)
    """

    mean: np.ndarray
    covariance: np.ndarray

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Logarithm of the normal density at theta (S, P), shape (S,)."""
        factor = np.linalg.cholesky(self.covariance)
        u = np.linalg.solve(factor, (theta - self.mean).T)
        return np.asarray(-0.5 * np.sum(u**2, axis=0) - np.sum(np.log(np.diag(factor))))


@dataclass(frozen=True)
class Draws:
    """Weighted draws of one person.

    Attributes
    ----------
    theta : ndarray, shape (K, P)
        Log elements.
    log_ratio : ndarray, shape (K,)
        ln L - ln q, up to a constant.
    log_weight : ndarray, shape (K,)
        Logarithm of the weights under the reference, normalised to sum to one.
    constant : float
        What `log_ratio` lacks of the log density (:func:`bayes_impedance.person.absolute_density.log_constant`).
    deviations : Deviations, optional
        Likelihood of other dispersions between repetitions than that at which they were integrated out.
    """

    theta: np.ndarray
    log_ratio: np.ndarray
    log_weight: np.ndarray
    constant: float = 0.0
    deviations: Deviations | None = None

    @property
    def effective(self) -> float:
        """Effective number of draws under the reference, 1 / sum of squared weights."""
        return float(np.exp(-np.logaddexp.reduce(2 * self.log_weight)))


def draw(
    kernel: Kernel,
    likelihood: Likelihood,
    mode: Mode,
    ridge: Ridge,
    reference: Reference,
    n: int,
    seed: np.random.SeedSequence,
    along_valley: bool = False,
    near: Nearby | None = None,
) -> Draws:
    """Draw from a person's posterior under the reference population.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    mode : Mode
        The person's mode under the reference.
    ridge : Ridge
        How the deviations of the repetitions depend on theta.
    reference : Reference
        The reference population, already widened.
    n : int
        Number of draws, a power of two.
    seed : SeedSequence
    along_valley : bool
        Propose along a curved valley (:mod:`bayes_impedance.person.valley`) first, and more only if that is poor.
    near : Nearby, optional
        Populations for which draws are made.

    Returns
    -------
    Draws
        Their ``effective`` number measures their quality.
    """
    made, best = _Rounds(kernel, likelihood, ridge, reference, near), None
    if along_valley:
        valley = follow(kernel, likelihood, mode.theta, reference.mean, np.linalg.inv(reference.covariance))
        alone = made.another(valley, _DEFENSIVE, n, seed.spawn(1)[0])
        if alone.effective >= _POOR * n:
            return alone
    laplace = np.linalg.inv(ridge.precision + np.linalg.inv(reference.covariance))
    population = reference.mean, reference.covariance
    first = along_conditional_modes(kernel, likelihood, mode.theta, *population, laplace)
    proposal, share = first, _EXPLORING

    def quality(some: Draws) -> float:
        """Effective number under the populations for which draws are made."""
        return some.effective if near is None else near.effective(some.theta, some.log_ratio, reference.mean)

    for attempt, child in enumerate(seed.spawn(_MOST_ROUNDS)):
        draws = made.another(proposal, share, n if attempt else min(n, 256), child)
        if attempt and (best is None or quality(draws) > quality(best)):
            best = draws
        if near is None and best is not None and best.effective > _ENOUGH * n:
            break
        # Of all rounds: a proposal that follows one poor round is no better than that.
        every = made.together()
        if near is not None and every.effective > _MANY * n:
            break
        share = _DEFENSIVE
        if not attempt:  # what the exploring round found of the posterior is less than the surface knows
            continue
        enough = every.effective >= _TO_BEND * mode.theta.size
        log_weight = _tempered(every.log_weight, 6.0 * mode.theta.size)
        proposal = BentT.fitted(every.theta, log_weight, reference.covariance, 0.02 * laplace, enough)
    assert best is not None  # at least two rounds are made
    if near is None and best.effective >= _POOR * n and not along_valley:
        return best
    chosen = made.chosen(n, seed.spawn(1)[0])
    return chosen if near is None or along_valley else max(chosen, best, key=quality)


def _tempered(log_weight: np.ndarray, least: float) -> np.ndarray:
    """Weights made more equal until enough draws are effective to estimate a covariance, or half of them are."""
    least = min(least, 0.5 * log_weight.size)  # of fewer draws than are enough not even equal weights would do
    while np.exp(-np.logaddexp.reduce(2 * log_weight)) < least:
        log_weight = 0.7 * log_weight
        log_weight = log_weight - np.logaddexp.reduce(log_weight)
    return log_weight


@dataclass(frozen=True)
class _Proposal:
    """A mixture of a t, or of a valley's normal distributions, and a share of the reference."""

    own: BentT | Valley
    share: float

    def log_density(self, theta: np.ndarray, log_reference: np.ndarray) -> np.ndarray:
        """Log density at points (n, P), where that of the reference is given: shape (n,)."""
        log_own = np.log1p(-self.share) + self.own.log_density(theta)
        return np.asarray(np.logaddexp(log_own, np.log(max(self.share, 1e-300)) + log_reference))


class _Rounds:
    """The draws of several rounds; the arguments are those of :func:`draw`."""

    def __init__(
        self, kernel: Kernel, likelihood: Likelihood, ridge: Ridge, reference: Reference, near: Nearby | None
    ) -> None:
        self._of = kernel, likelihood, ridge
        self._reference, self._near = reference, near
        self._proposals: list[tuple[_Proposal, int]] = []
        self._theta: list[np.ndarray] = []
        self._log_likelihood: list[np.ndarray] = []
        self._log_reference: list[np.ndarray] = []
        self._log_q: list[list[np.ndarray]] = []  # of each proposal, at the draws of each round

    def another(self, own: BentT | Valley, share: float, n: int, seed: np.random.SeedSequence) -> Draws:
        """Make one round, and return its draws alone."""
        theta = _propose(own, self._reference, share, n, seed)
        log_likelihood = marginal_log_likelihood(*self._of, theta)
        self._theta.append(theta)
        self._log_likelihood.append(log_likelihood)
        constant = 0.5 * theta.shape[1] * np.log(2 * np.pi)
        self._log_reference.append(self._reference.log_density(theta) - constant)
        for (proposal, _), values in zip(self._proposals, self._log_q, strict=True):
            values.append(proposal.log_density(theta, self._log_reference[-1]))
        proposal = _Proposal(own, round(share * n) / n)
        self._proposals.append((proposal, n))
        self._log_q.append([proposal.log_density(*at) for at in zip(self._theta, self._log_reference, strict=True)])
        return _weighted(theta, log_likelihood - self._log_q[-1][-1], self._reference)

    def together(self) -> Draws:
        """The draws of all rounds, as if each came from the mixture of all proposals."""
        total = sum(n for _, n in self._proposals)
        of_each = [
            np.log(n / total) + np.concatenate(values)
            for (_, n), values in zip(self._proposals, self._log_q, strict=True)
        ]
        log_ratio = np.concatenate(self._log_likelihood) - np.logaddexp.reduce(of_each, axis=0)
        return _weighted(np.concatenate(self._theta), log_ratio, self._reference)

    def chosen(self, n: int, seed: np.random.SeedSequence) -> Draws:
        """As many of all rounds' draws as are kept, each with its probability of being chosen taken into account."""
        every = self.together()
        near = self._near
        log_root = 0.5 * every.log_weight
        if near is not None:
            log_root = near.log_roots(every.theta, every.log_ratio, self._reference.mean)
        chance = inclusion(log_root, n)
        ticks = np.arange(n) + np.random.default_rng(seed.spawn(1)[0]).random()
        rows = np.minimum(np.searchsorted(np.cumsum(chance), ticks, side="right"), len(chance) - 1)
        log_ratio = every.log_ratio[rows] + np.log(n / len(chance)) - np.log(chance[rows])
        return _weighted(every.theta[rows], log_ratio, self._reference)


def _weighted(theta: np.ndarray, log_ratio: np.ndarray, reference: Reference) -> Draws:
    """Draws with their weights under the reference."""
    log_weight = log_ratio + reference.log_density(theta)
    return Draws(theta, log_ratio, log_weight - np.logaddexp.reduce(log_weight))


def _propose(
    own: BentT | Valley, reference: Reference, share: float, n: int, seed: np.random.SeedSequence
) -> np.ndarray:
    """Points (n, P) of the mixture of a proposal and a share of the reference."""
    seeds, from_reference = seed.spawn(2), round(share * n)
    normal = ndtri(uniform_points(from_reference, reference.mean.size, seeds[1]))
    anywhere = reference.mean + normal @ np.linalg.cholesky(reference.covariance).T
    return np.vstack([own.drawn(n - from_reference, seeds[0]), anywhere])
