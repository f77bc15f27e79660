r"""Importance sampling of one person's exact posterior under a reference population.

The proposal q is a mixture: mostly a multivariate t (10 degrees of freedom: tails heavier than the target's), at
first around the person's mode, and in part the reference population itself, which covers regions far from the mode
and bounds the importance weights (defensive mixture, Owen and Zhou 2000). Draws and weights of one round give the
mean and covariance of the next round's t, which allows for posteriors that are wider on one side than the curvature
at the mode suggests. If the best round is poor, the draws of all rounds count, as if each came from the mixture
of all proposals (adaptive multiple importance sampling, Cornuet et al. 2012). Of these M draws only K are kept,
because all that follows is computed for each of them: draw k with probability :math:`\pi_k \propto \sqrt{w_k}`, at
most one, where :math:`w_k` is its weight under the reference, and with the weight :math:`w_k/\pi_k` (Horvitz and
Thompson 1952). The root is a compromise between weights that become equal and draws that count under other
populations than the reference. No draw is chosen twice, so that the squared weights still say how large the error is.
Points come from scrambled Sobol sequences, which cover eight dimensions far more evenly than random ones.

Each draw is stored as its log elements and :math:`\ln L(\theta) - \ln q(\theta)`. Multiplied with **any** population
density :math:`N(\theta; \mu, \Sigma)` and averaged, this estimates the person's marginal likelihood under that
population: the reference only determines where the draws lie. It must be near the true population and a little wider: a
much wider one leaves few effective draws for elements that a single person hardly determines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv, gammaln, ndtri

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.absolute_density import Deviations
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import Ridge, marginal_log_likelihood
from bayes_impedance.person.mode import Mode
from bayes_impedance.person.valley import follow


def widening(n_persons: int) -> float:
    """Factor by which the standard deviations of the reference population exceed the estimated ones.

    The dispersion of n persons is known to about 1/sqrt(2 n) of itself: 8 % for 71 of them, 30 % for six.
    """
    return float(1 + 1 / np.sqrt(2 * n_persons))


_DEGREES_OF_FREEDOM = 10.0
"""Degrees of freedom of the proposal's multivariate t. By choice: tails clearly heavier than a normal target's at
little loss of effective draws."""

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

_LEAST_ROOT = 1e-6
"""Least root of a weight, relative to the largest, with which the probability of being chosen goes. By choice: a draw
of a smaller weight counts for nothing, but some must be chosen where too few have more."""


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
        Follow a curved valley (:mod:`bayes_impedance.person.valley`) instead of adapting one t.

    Returns
    -------
    Draws
        Their ``effective`` number measures their quality.
    """
    if along_valley:
        theta, log_q = _propose_along(kernel, likelihood, mode, reference, n, seed)
        return _weighted(theta, marginal_log_likelihood(kernel, likelihood, ridge, theta) - log_q, reference)
    centre = mode.theta
    laplace = covariance = np.linalg.inv(ridge.precision + np.linalg.inv(reference.covariance))
    made, best = _Rounds(kernel, likelihood, ridge, reference), None
    for attempt, child in enumerate(seed.spawn(_MOST_ROUNDS)):
        share = _DEFENSIVE if attempt else _EXPLORING
        draws = made.another(_Proposal(centre, covariance, share), n if attempt else min(n, 256), child)
        if attempt and (best is None or draws.effective > best.effective):
            best = draws
        if best is not None and best.effective > _ENOUGH * n:
            break
        # Weights are tempered until enough draws are effective to estimate a covariance.
        log_weight = draws.log_weight
        while np.exp(-np.logaddexp.reduce(2 * log_weight)) < 6 * centre.size:
            log_weight = 0.7 * log_weight
            log_weight = log_weight - np.logaddexp.reduce(log_weight)
        weight = np.exp(log_weight)
        centre = weight @ draws.theta
        offset = draws.theta - centre
        covariance = (offset * weight[:, None]).T @ offset + 0.02 * laplace
    assert best is not None  # at least two rounds are made
    return best if best.effective >= _POOR * n else made.chosen(n, seed.spawn(1)[0])


@dataclass(frozen=True)
class _Proposal:
    """A mixture of a t and a share of the reference; centre (P,) and covariance (P, P) are those of the t."""

    centre: np.ndarray
    covariance: np.ndarray
    share: float

    def log_density(self, theta: np.ndarray, reference: Reference) -> np.ndarray:
        """Log density at points (n, P), shape (n,)."""
        log_t = _log_t(theta, self.centre, np.linalg.cholesky(self.covariance))
        log_reference = reference.log_density(theta) - 0.5 * self.centre.size * np.log(2 * np.pi)
        return np.asarray(np.logaddexp(np.log1p(-self.share) + log_t, np.log(max(self.share, 1e-300)) + log_reference))


class _Rounds:
    """The draws of several rounds; the arguments are those of :func:`draw`."""

    def __init__(self, kernel: Kernel, likelihood: Likelihood, ridge: Ridge, reference: Reference) -> None:
        self._of = kernel, likelihood, ridge
        self._reference = reference
        self._proposals: list[tuple[_Proposal, int]] = []
        self._theta: list[np.ndarray] = []
        self._log_likelihood: list[np.ndarray] = []

    def another(self, proposal: _Proposal, n: int, seed: np.random.SeedSequence) -> Draws:
        """Make one round, and return its draws alone."""
        theta = _propose(proposal.centre, proposal.covariance, self._reference, proposal.share, n, seed)
        own = replace(proposal, share=round(proposal.share * n) / n)
        log_likelihood = marginal_log_likelihood(*self._of, theta)
        self._proposals.append((own, n))
        self._theta.append(theta)
        self._log_likelihood.append(log_likelihood)
        return _weighted(theta, log_likelihood - own.log_density(theta, self._reference), self._reference)

    def together(self) -> Draws:
        """The draws of all rounds, as if each came from the mixture of all proposals."""
        theta, log_likelihood = np.concatenate(self._theta), np.concatenate(self._log_likelihood)
        of_each = [np.log(n / len(theta)) + q.log_density(theta, self._reference) for q, n in self._proposals]
        log_ratio = log_likelihood - np.logaddexp.reduce(of_each, axis=0)
        return _weighted(theta, log_ratio, self._reference)

    def chosen(self, n: int, seed: np.random.SeedSequence) -> Draws:
        """As many of all rounds' draws as are kept, each with its probability of being chosen taken into account."""
        every = self.together()
        inclusion = _inclusion(every.log_weight, n)
        ticks = np.arange(n) + np.random.default_rng(seed.spawn(1)[0]).random()
        rows = np.minimum(np.searchsorted(np.cumsum(inclusion), ticks, side="right"), len(inclusion) - 1)
        log_ratio = every.log_ratio[rows] + np.log(n / len(inclusion)) - np.log(inclusion[rows])
        return _weighted(every.theta[rows], log_ratio, self._reference)


def _inclusion(log_weight: np.ndarray, n: int) -> np.ndarray:
    """Probabilities, of sum n and at most one, that go with the root of the weights."""
    root = np.exp(0.5 * (log_weight - log_weight.max()))
    root = np.maximum(root, _LEAST_ROOT)
    result = np.ones(len(root))
    certain = np.zeros(len(root), dtype=bool)
    while True:
        rest = ~certain
        result[rest] = root[rest] * (n - certain.sum()) / root[rest].sum()
        if not np.any(result[rest] > 1):
            return result
        certain |= result > 1
        result[certain] = 1.0


def _weighted(theta: np.ndarray, log_ratio: np.ndarray, reference: Reference) -> Draws:
    """Draws with their weights under the reference."""
    log_weight = log_ratio + reference.log_density(theta)
    return Draws(theta, log_ratio, log_weight - np.logaddexp.reduce(log_weight))


def _propose_along(
    kernel: Kernel, likelihood: Likelihood, mode: Mode, reference: Reference, n: int, seed: np.random.SeedSequence
) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, P) of the valley's mixture and a share of the reference, and their log density (n,)."""
    valley = follow(kernel, likelihood, mode.theta, reference.mean, np.linalg.inv(reference.covariance))
    dimension, nu, rng = reference.mean.size, _DEGREES_OF_FREEDOM, np.random.default_rng(seed)
    from_reference = round(_DEFENSIVE * n)
    which = np.searchsorted(
        np.cumsum(valley.weight), (np.arange(n - from_reference) + rng.random()) / (n - from_reference)
    )
    which = np.minimum(which, len(valley.weight) - 1)
    stretch = np.sqrt(nu / rng.chisquare(nu, which.size))
    own = valley.centre[which] + stretch[:, None] * np.einsum(
        "npq,nq->np", valley.factor[which], rng.normal(size=(which.size, dimension))
    )
    anywhere = rng.normal(size=(from_reference, dimension)) @ np.linalg.cholesky(reference.covariance).T
    theta = np.vstack([own, reference.mean + anywhere])
    log_t = np.full(n, -np.inf)
    for centre, factor, weight in zip(valley.centre, valley.factor, valley.weight, strict=True):
        log_t = np.logaddexp(log_t, np.log(weight) + _log_t(theta, centre, factor))
    log_reference = reference.log_density(theta) - 0.5 * dimension * np.log(2 * np.pi)
    return theta, np.logaddexp(np.log1p(-_DEFENSIVE) + log_t, np.log(_DEFENSIVE) + log_reference)


def _propose(
    centre: np.ndarray,
    covariance: np.ndarray,
    reference: Reference,
    share: float,
    n: int,
    seed: np.random.SeedSequence,
) -> np.ndarray:
    """Points (n, P) of the mixture of a t and a share of the reference."""
    from scipy.stats import qmc  # half a second to import

    dimension, nu = centre.size, _DEGREES_OF_FREEDOM
    from_reference = round(share * n)
    seeds = seed.spawn(2)

    def uniform(size: int, columns: int, child: np.random.SeedSequence) -> np.ndarray:
        sequence = qmc.Sobol(columns, rng=np.random.default_rng(child))
        power = int(np.ceil(np.log2(max(size, 1))))  # whole powers of two keep the points balanced
        return np.asarray(np.clip(sequence.random(2**power)[:size], 1e-12, 1 - 1e-12))

    own = uniform(n - from_reference, dimension + 1, seeds[0])
    stretch = np.sqrt(nu / (2 * gammaincinv(nu / 2, own[:, -1])))
    factor = np.linalg.cholesky(covariance)
    return np.vstack(
        [
            centre + (ndtri(own[:, :-1]) * stretch[:, None]) @ factor.T,
            reference.mean
            + ndtri(uniform(from_reference, dimension, seeds[1])) @ np.linalg.cholesky(reference.covariance).T,
        ]
    )


def _log_t(theta: np.ndarray, centre: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Log density of the multivariate t at theta (n, P), shape (n,), from a triangular factor of its scale matrix."""
    dimension, nu = centre.size, _DEGREES_OF_FREEDOM
    square = np.sum(np.linalg.solve(factor, (theta - centre).T) ** 2, axis=0)
    return np.asarray(
        gammaln((nu + dimension) / 2)
        - gammaln(nu / 2)
        - 0.5 * dimension * np.log(nu * np.pi)
        - np.sum(np.log(np.diag(factor)))
        - 0.5 * (nu + dimension) * np.log1p(square / nu)
    )
