r"""A point estimate of the population, by expectation-maximisation: the anchor of the exact computation.

In turn, with everybody's posterior taken as normal around its mode under the current population,

* E: :math:`\theta_i \sim N(m_i, C_i)` with :math:`C_i = (H_i + T^{-1})^{-1}`; the deviations of the repetitions move to
  their conditional mode under N(0, diag rho^2), with their sum kept at zero;
* M: :math:`\mu = \overline{m_i}`, :math:`T = \overline{(m_i-\mu)(m_i-\mu)^T + C_i}`,
  :math:`\rho^2 = \overline{E\,d^2}` over the contrasts.

This is not the result (a normal approximation per person is off by a posterior standard deviation for weakly determined
elements), but it is where the exact draws are made, and it tells which elements the recordings determine at all.

**Determined** is a matter of the data alone: a prior that is far away makes a posterior narrow too. For element p the
information of all recordings together, with the other elements o free within the population, is

.. math:: I_p = \sum_i H_{pp} - H_{po}\,(H_{oo} + T_{oo}^{-1})^{-1} H_{op},

and the element is determined if :math:`I_p^{-1/2} < 0.3`: on its natural scale it is then more than three standard
errors from being absent, so neither a smaller nor a larger value fits as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayes_impedance.hierarchy import Prior
from bayes_impedance.kernel import Kernel
from bayes_impedance.likelihood import Likelihood, repetition_equations
from bayes_impedance.marginal import Contrasts
from bayes_impedance.noise import contrasts
from bayes_impedance.persons import map_persons
from bayes_impedance.starts import FirstFits, Progress
from bayes_impedance.subject import Mode, find_mode

DETERMINED_SD = 0.3
"""An element is determined if all recordings together give its logarithm at least this well, without any prior."""

_MAX_ROUNDS = 60
_TRIAL_ROUNDS, _TRIAL_POINTS = 10, 100
_TOLERANCE = 0.02
_PRIOR_PERSONS = 2.0
_SMALLEST_DISPERSION = 0.02


@dataclass(frozen=True)
class Estimate:
    """The population as a point estimate, and everybody's mode under it.

    Attributes
    ----------
    mu : ndarray, shape (P,)
    slopes : ndarray, shape (P, Q)
    covariance : ndarray, shape (P, P)
        Of a person's mean over the repetitions: T.
    between_repetitions : ndarray, shape (P,)
    modes : tuple of Mode
    likelihoods : tuple of Likelihood
        With the deviations of the repetitions.
    contrasts : tuple of Contrasts
        One for each number of repetitions above one.
    mu_sd : ndarray, shape (P,)
        Approximate posterior standard deviation of mu.
    data_sd : ndarray, shape (P,)
        Standard error of a common log element from all recordings together, without prior: infinite if unseen.
    rounds : int
    rivals : tuple of float
        By how much the log evidence of other solutions for the whole population falls short of this one's.
    """

    mu: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray
    between_repetitions: np.ndarray
    modes: tuple[Mode, ...]
    likelihoods: tuple[Likelihood, ...]
    contrasts: tuple[Contrasts, ...]
    mu_sd: np.ndarray
    data_sd: np.ndarray
    rounds: int
    rivals: tuple[float, ...]

    @property
    def determined(self) -> np.ndarray:
        """Which elements the recordings determine, shape (P,)."""
        return self.data_sd < DETERMINED_SD


def estimate(
    kernel: Kernel,
    likelihoods: tuple[Likelihood, ...],
    first: FirstFits,
    prior: Prior,
    covariates: np.ndarray,
    correlated: bool,
    seed: np.random.SeedSequence,
    executor: Executor,
    progress: Progress,
    one_person: bool = False,
) -> Estimate:
    """Expectation-maximisation until the population moves by less than 2 % of what is known about it.

    Parameters
    ----------
    kernel : Kernel
    likelihoods : tuple of Likelihood
        One per person, N of them.
    first : FirstFits
    prior : Prior
    covariates : ndarray, shape (N, Q)
        Standardised.
    correlated : bool
        Full covariance, or diagonal.
    seed : SeedSequence
        Of the last round's additional starts.
    executor : Executor
    progress : callable
    one_person : bool
        Leave the population at the broad prior and estimate only the dispersion between repetitions.
    """
    n, p = first.theta.shape

    def state_from(theta: np.ndarray, data: Sequence[Likelihood]) -> _State:
        return _State(kernel, list(data), prior, covariates, correlated, theta, one_person)

    begin, rivals = first.theta, tuple[float, ...]()
    if len(first.common) > 1 and not one_person:
        begin, rivals = _best_common(kernel.elements, state_from, likelihoods, first, executor, progress)
    state = state_from(begin, likelihoods)
    rounds = 0
    for rounds in range(1, _MAX_ROUNDS + 1):
        extra = first.alternatives if rounds in (1, 4) else None
        moved = state.iterate(executor, extra)
        progress("population estimate", rounds, _MAX_ROUNDS)
        if rounds >= 6 and moved < _TOLERANCE:
            break
    # A last round from many places: nobody may be left in a local optimum of the population's own making.
    spread = np.linalg.cholesky(state.covariance) @ np.random.default_rng(seed).normal(size=(n, p, 4))
    state.iterate(executor, state.means[:, None, :] + np.swapaxes(spread, 1, 2))
    state.iterate(executor, None)
    progress("population estimate", _MAX_ROUNDS, _MAX_ROUNDS)
    return Estimate(
        state.mu,
        state.slopes,
        state.covariance,
        state.rho,
        tuple(state.modes),
        tuple(state.likelihoods),
        state.contrasts(),
        state.mu_sd(),
        state.data_sd(),
        rounds,
        rivals,
    )


def _best_common(
    elements: Sequence[str],
    state_from: Callable[[np.ndarray, Sequence[Likelihood]], _State],
    likelihoods: Sequence[Likelihood],
    first: FirstFits,
    executor: Executor,
    progress: Progress,
) -> tuple[np.ndarray, tuple[float, ...]]:
    """Where everybody should begin, (N, P), and by how much the other choices are worse.

    Persons who begin in different optima give a population that spans them all, and whose inflated dispersion keeps
    everybody where they are. So each solution that all could share is tried as a population of its own, on thinned
    data, and the one with the highest evidence wins.
    """
    thinned = [d.thinned(_TRIAL_POINTS) for d in likelihoods]
    evidence, ends = [], []
    for c, theta in enumerate(first.common):
        state = state_from(theta, thinned)
        for _ in range(_TRIAL_ROUNDS):
            state.iterate(executor, None)
        evidence.append(state.log_evidence())
        ends.append(state.theta)
        progress("common solutions", c + 1, len(first.common))
    order = np.argsort(evidence)[::-1]
    middles = [_by_kind(elements, np.median(end, axis=0)) for end in ends]
    others = [k for k in order[1:] if np.abs(middles[k] - middles[order[0]]).max() > 0.3]
    return ends[order[0]], tuple(float(evidence[order[0]] - evidence[k]) for k in others)


def _by_kind(elements: Sequence[str], theta: np.ndarray) -> np.ndarray:
    """Log elements in an order that does not change when equal parts of a network change places."""
    return np.asarray(theta[np.lexsort((theta, np.array([ord(e[0]) for e in elements])))])


def _expect(
    kernel: Kernel,
    precision: np.ndarray,
    rho: np.ndarray,
    likelihood: Likelihood,
    starts: np.ndarray,
    mean: np.ndarray,
) -> tuple[Mode, Likelihood, tuple[np.ndarray, np.ndarray]]:
    """One person's mode, the likelihood with the deviations that belong to it, and the equations of the repetitions."""
    mode = find_mode(kernel, likelihood, starts, mean, precision)
    equations = repetition_equations(kernel, likelihood, mode.theta)
    return mode, _realigned(likelihood, mode, equations, rho), equations


def _realigned(
    likelihood: Likelihood, mode: Mode, equations: tuple[np.ndarray, np.ndarray], rho: np.ndarray
) -> Likelihood:
    """Deviations at their conditional mode, by one Gauss-Newton step with a Lagrange multiplier for their sum."""
    n_repetitions = likelihood.z.shape[0]
    if n_repetitions == 1:
        return likelihood
    w = mode.scale**-2
    gradient, information = equations
    curvature = w * information + np.diag(1 / np.maximum(rho, 1e-3) ** 2)
    inverse = np.linalg.inv(curvature)
    pull = -w * gradient - likelihood.deviations / np.maximum(rho, 1e-3) ** 2
    free = np.einsum("jpq,jq->jp", inverse, pull)
    multiplier = -np.linalg.solve(inverse.sum(axis=0), (likelihood.deviations + free).sum(axis=0))
    step = free + inverse @ multiplier
    longest = np.abs(step).max()
    if longest > 0.5:
        step = step * (0.5 / longest)
    return likelihood.moved(likelihood.deviations + step)


class _State:
    """The estimate while it moves."""

    def __init__(
        self,
        kernel: Kernel,
        likelihoods: list[Likelihood],
        prior: Prior,
        covariates: np.ndarray,
        correlated: bool,
        theta: np.ndarray,
        one_person: bool,
    ) -> None:
        self.kernel, self.likelihoods, self.prior = kernel, likelihoods, prior
        self.covariates, self.correlated = covariates, correlated
        self.theta = theta.copy()
        self.repetitions = np.array([d.z.shape[0] for d in likelihoods])
        self.mu = np.median(theta, axis=0)
        self.slopes = np.zeros((self.mu.size, covariates.shape[1]))
        deviation = 1.4826 * np.median(np.abs(theta - self.mu), axis=0)
        self.covariance = np.diag(np.clip(1.5 * deviation, 0.2, 2.0) ** 2)
        self.fixed = one_person
        if one_person:
            self.mu, self.covariance = prior.centre.copy(), np.eye(self.mu.size) * prior.centre_sd**2
        self.rho = np.full(self.mu.size, 0.1) if self.repetitions.max() > 1 else np.zeros(self.mu.size)
        self.modes: list[Mode] = []
        self.equations: list[tuple[np.ndarray, np.ndarray]] = []
        self.before = likelihoods

    @property
    def means(self) -> np.ndarray:
        """Population mean of each person, shape (N, P)."""
        return np.asarray(self.mu + self.covariates @ self.slopes.T)

    def iterate(self, executor: Executor, extra_starts: np.ndarray | None) -> float:
        """One round; how far the population moved, in standard deviations of what is known about it."""
        precision = np.linalg.inv(self.covariance)
        means = self.means

        starts = self.theta[:, None]
        if extra_starts is not None:
            starts = np.concatenate([starts, means[:, None], extra_starts], axis=1)
        expect = partial(_expect, self.kernel, precision, self.rho)
        results = list(map_persons(executor, expect, self.likelihoods, starts, means))
        self.modes = [mode for mode, _, _ in results]
        # The equations belong to the deviations with which they were computed.
        self.before = self.likelihoods
        self.equations = [equations for _, _, equations in results]
        found = self.contrasts()
        self.likelihoods = [likelihood for _, likelihood, _ in results]
        self.theta = np.array([mode.theta for mode in self.modes])
        old_mu, old_covariance, old_rho = self.mu.copy(), self.covariance, self.rho
        self._maximise(found)
        sd = np.sqrt(np.diag(old_covariance) / len(self.modes) + 1e-12)
        shift = np.abs(self.mu - old_mu) / sd
        stretch = np.abs(np.log(np.diag(self.covariance) / np.diag(old_covariance)))
        wobble = np.abs(self.rho - old_rho) / np.maximum(self.rho, 0.01)
        return float(max(np.max(shift), np.max(stretch), np.max(wobble)))

    def contrasts(self) -> tuple[Contrasts, ...]:
        """Curvature and gradient of the contrasts at zero deviation, expanded where the deviations were."""
        found = []
        for j in np.unique(self.repetitions[self.repetitions > 1]):
            rows, group = contrasts(int(j)), np.flatnonzero(self.repetitions == j)
            w = np.array([self.modes[i].scale ** -2 for i in group])
            g, h = (np.array([self.equations[i][k] for i in group]) for k in (0, 1))
            deviations = np.array([self.before[i].deviations for i in group])
            size = rows.shape[0] * h.shape[-1]
            # Every repetition keeps its own curvature: contrasts of equal curvatures would be independent, but sharing
            # the mean one makes the dispersion of weakly determined elements 3 % too small.
            pairs = np.einsum("cj,dj->cdj", rows, rows)
            information = np.einsum("n,cdj,njpq->cpdqn", w, pairs, h).reshape(size, size, -1)
            pull = np.einsum("njpq,njq->njp", h, deviations) - g
            gradient = np.einsum("n,cj,njp->cpn", w, rows, pull).reshape(size, -1)
            found.append(Contrasts(np.ascontiguousarray(information), np.ascontiguousarray(gradient)))
        return tuple(found)

    def _maximise(self, found: tuple[Contrasts, ...]) -> None:
        if found:
            self.rho = self._repetition_dispersion(found)
        if self.fixed:
            return
        n, p = self.theta.shape
        design = np.hstack([np.ones((n, 1)), self.covariates])
        # Prior: centre_sd for the mean, slope_sd for the slopes, relative to the spread between persons.
        variance = np.diag(self.covariance)
        for e in range(p):
            ridge = variance[e] / np.r_[self.prior.centre_sd**2, np.full(design.shape[1] - 1, self.prior.slope_sd**2)]
            target = self.theta[:, e] - self.prior.centre[e]
            solution = np.linalg.solve(design.T @ design + np.diag(ridge), design.T @ target)
            self.mu[e], self.slopes[e] = self.prior.centre[e] + solution[0], solution[1:]
        offset = self.theta - self.means
        spread = offset.T @ offset + np.linalg.inv([mode.precision for mode in self.modes]).sum(axis=0)
        weak = _PRIOR_PERSONS * np.diag(np.clip(variance, _SMALLEST_DISPERSION**2, 1.0))
        covariance = (spread + weak) / (n + _PRIOR_PERSONS)
        floor = np.maximum(np.diag(covariance), _SMALLEST_DISPERSION**2)
        self.covariance = np.diag(floor) if not self.correlated else covariance + np.diag(floor - np.diag(covariance))

    def _repetition_dispersion(self, found: tuple[Contrasts, ...]) -> np.ndarray:
        p = self.mu.size
        total, count = np.full(p, 2 * 0.05**2), 2.0  # two contrasts' worth of a 5 % prior
        inverse_square = 1 / np.maximum(self.rho, 1e-3) ** 2
        for group in found:
            size, n = group.gradient.shape
            precision = np.moveaxis(group.information, -1, 0) + np.diag(np.tile(inverse_square, size // p))
            posterior = np.linalg.inv(precision)
            mean = np.einsum("npq,qn->np", posterior, group.gradient)
            square = mean**2 + np.diagonal(posterior, axis1=1, axis2=2)
            total += square.reshape(n, -1, p).sum(axis=(0, 1))
            count += n * size // p
        return np.asarray(np.clip(np.sqrt(total / count), 1e-3, 1.0))

    def log_evidence(self) -> float:
        """Laplace's approximation of the log marginal likelihood of the population, with the prior of its centre."""
        sign, log_determinant = np.linalg.slogdet(self.covariance)
        total = -0.5 * float(np.sum(((self.mu - self.prior.centre) / self.prior.centre_sd) ** 2))
        for mode in self.modes:
            total -= mode.objective + 0.5 * (np.linalg.slogdet(mode.precision)[1] + sign * log_determinant)
        return total + sum(float(group.log_likelihood(self.rho[None])[0]) for group in self.contrasts())

    def mu_sd(self) -> np.ndarray:
        """Approximate posterior standard deviation of mu, shape (P,)."""
        if self.fixed:
            return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.modes[0].precision))))
        precision = np.linalg.inv(self.covariance)
        information = np.eye(self.mu.size) / self.prior.centre_sd**2
        for mode in self.modes:
            information += precision - precision @ np.linalg.inv(mode.information + precision) @ precision
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))

    def data_sd(self) -> np.ndarray:
        """Standard error of each element from all recordings together, without a prior on it, shape (P,)."""
        precision = np.linalg.inv(self.covariance)
        result = np.empty(self.mu.size)
        for p in range(self.mu.size):
            others = np.arange(self.mu.size) != p
            total = 0.0
            for mode in self.modes:
                h = mode.information
                rest = h[np.ix_(others, others)] + precision[np.ix_(others, others)]
                total += h[p, p] - h[p, others] @ np.linalg.solve(rest, h[others, p])
            result[p] = total**-0.5 if total > 0 else np.inf
        return result
