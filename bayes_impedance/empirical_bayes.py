r"""A point estimate of the population, by expectation-maximisation: the anchor of the exact computation.

In turn, with everybody's posterior taken as normal around its mode under the current population,

* E: :math:`\theta_i \sim N(m_i, C_i)` with :math:`C_i = (H_i + T^{-1})^{-1}`; the deviations of the repetitions move to
  their conditional mode under N(0, diag rho^2), with their sum kept at zero;
* M: :math:`\mu = \overline{m_i}`, :math:`T = \overline{(m_i-\mu)(m_i-\mu)^T + C_i}`,
  :math:`\rho^2 = \overline{E\,d^2}` over the contrasts.

This is not the result (a normal approximation per person is off by a posterior standard deviation for weakly determined
elements), but it is where the exact draws are made, and it tells which elements the recordings determine at all: the
information about mu is

.. math:: I_\mu = \sum_i T^{-1} - T^{-1}(H_i + T^{-1})^{-1}T^{-1} + 3^{-2} .
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from bayes_impedance.hierarchy import Prior
from bayes_impedance.kernel import Kernel
from bayes_impedance.likelihood import Likelihood, repetition_equations
from bayes_impedance.marginal import Contrasts
from bayes_impedance.noise import contrasts
from bayes_impedance.starts import FirstFits, Progress
from bayes_impedance.subject import Mode, find_mode

IDENTIFIED_SD = 1.0
"""An element counts as determined when the population's mean logarithm is known better than this: a factor e."""

_MAX_ROUNDS = 60
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
    contrasts : Contrasts or None
    mu_sd : ndarray, shape (P,)
        Approximate posterior standard deviation of mu.
    rounds : int
    """

    mu: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray
    between_repetitions: np.ndarray
    modes: tuple[Mode, ...]
    likelihoods: tuple[Likelihood, ...]
    contrasts: Contrasts | None
    mu_sd: np.ndarray
    rounds: int

    @property
    def determined(self) -> np.ndarray:
        """Which elements the recordings determine, shape (P,)."""
        return self.mu_sd < IDENTIFIED_SD


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
    state = _State(kernel, list(likelihoods), prior, covariates, correlated, first, one_person)
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
        rounds,
    )


class _State:
    """The estimate while it moves."""

    def __init__(
        self,
        kernel: Kernel,
        likelihoods: list[Likelihood],
        prior: Prior,
        covariates: np.ndarray,
        correlated: bool,
        first: FirstFits,
        one_person: bool,
    ) -> None:
        self.kernel, self.likelihoods, self.prior = kernel, likelihoods, prior
        self.covariates, self.correlated = covariates, correlated
        self.theta = first.theta.copy()
        self.repetitions = np.array([d.z.shape[0] for d in likelihoods])
        self.mu = np.median(first.theta, axis=0)
        self.slopes = np.zeros((self.mu.size, covariates.shape[1]))
        deviation = 1.4826 * np.median(np.abs(first.theta - self.mu), axis=0)
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

        def expect(i: int) -> tuple[Mode, Likelihood, tuple[np.ndarray, np.ndarray]]:
            starts = self.theta[i : i + 1]
            if extra_starts is not None:
                starts = np.vstack([starts, means[i], extra_starts[i]])
            mode = find_mode(self.kernel, self.likelihoods[i], starts, means[i], precision)
            equations = repetition_equations(self.kernel, self.likelihoods[i], mode.theta)
            return mode, self._realigned(self.likelihoods[i], mode, equations), equations

        results = list(executor.map(expect, range(len(self.likelihoods))))
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

    def _realigned(self, likelihood: Likelihood, mode: Mode, equations: tuple[np.ndarray, np.ndarray]) -> Likelihood:
        """Deviations at their conditional mode, by one Gauss-Newton step with a Lagrange multiplier for their sum."""
        n_repetitions = likelihood.z.shape[0]
        if n_repetitions == 1:
            return likelihood
        w = mode.scale**-2
        gradient, information = equations
        curvature = w * information + np.diag(1 / np.maximum(self.rho, 1e-3) ** 2)
        inverse = np.linalg.inv(curvature)
        pull = -w * gradient - likelihood.deviations / np.maximum(self.rho, 1e-3) ** 2
        free = np.einsum("jpq,jq->jp", inverse, pull)
        multiplier = -np.linalg.solve(inverse.sum(axis=0), (likelihood.deviations + free).sum(axis=0))
        step = free + inverse @ multiplier
        longest = np.abs(step).max()
        if longest > 0.5:
            step = step * (0.5 / longest)
        return likelihood.moved(likelihood.deviations + step)

    def contrasts(self) -> Contrasts | None:
        """Curvature and gradient of the contrasts at zero deviation, linearised where the deviations were."""
        most = int(self.repetitions.max())
        if most == 1:
            return None
        n, p = self.theta.shape
        information, gradient = np.zeros((n, p, p)), np.zeros((n, most - 1, p))
        for i, (mode, likelihood, (g, h)) in enumerate(zip(self.modes, self.before, self.equations, strict=True)):
            w, j = mode.scale**-2, self.repetitions[i]
            information[i] = w * h.mean(axis=0)
            # Each repetition is expanded around its own deviation, where g is small, with the curvature that all
            # share: with its own, (H_j - mean H) delta_j would leak from stiff directions into weak ones.
            pull = likelihood.deviations @ information[i] - w * g
            gradient[i, : j - 1] = contrasts(j) @ pull
        return Contrasts(information, gradient, self.repetitions - 1)

    def _maximise(self, found: Contrasts | None) -> None:
        if found is not None:
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
        spread = offset.T @ offset + sum(np.linalg.inv(mode.precision) for mode in self.modes)
        weak = _PRIOR_PERSONS * np.diag(np.clip(variance, _SMALLEST_DISPERSION**2, 1.0))
        covariance = (spread + weak) / (n + _PRIOR_PERSONS)
        floor = np.maximum(np.diag(covariance), _SMALLEST_DISPERSION**2)
        self.covariance = np.diag(floor) if not self.correlated else covariance + np.diag(floor - np.diag(covariance))

    def _repetition_dispersion(self, found: Contrasts) -> np.ndarray:
        total, count = np.full(self.mu.size, 2 * 0.05**2), 2.0  # two contrasts' worth of a 5 % prior
        inverse_square = np.diag(1 / np.maximum(self.rho, 1e-3) ** 2)
        for i in range(len(self.modes)):
            posterior = np.linalg.inv(found.information[i] + inverse_square)
            for c in range(found.count[i]):
                mean = posterior @ found.gradient[i, c]
                total += mean**2 + np.diag(posterior)
                count += 1
        return np.asarray(np.clip(np.sqrt(total / count), 1e-3, 1.0))

    def mu_sd(self) -> np.ndarray:
        """Approximate posterior standard deviation of mu, shape (P,)."""
        if self.fixed:
            return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.modes[0].precision))))
        precision = np.linalg.inv(self.covariance)
        information = np.eye(self.mu.size) / self.prior.centre_sd**2
        for mode in self.modes:
            information += precision - precision @ np.linalg.inv(mode.information + precision) @ precision
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))
