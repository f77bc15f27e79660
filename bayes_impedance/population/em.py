r"""A point estimate of the population, by expectation-maximisation: the starting point of the exact computation.

Two steps alternate. Each person's posterior is approximated by a normal at its mode under the current population:

* E: :math:`\theta_i \sim N(m_i, C_i)` with :math:`C_i = (H_i + T^{-1})^{-1}`; the deviations of the repetitions are set
  to their conditional mode under N(0, diag rho^2), with their sum constrained to zero;
* M: :math:`\mu = \overline{m_i}`, :math:`T = \overline{(m_i-\mu)(m_i-\mu)^T + C_i}`,
  :math:`\rho^2 = \overline{E\,d^2}` over the contrasts.

This is not the result: the normal approximation per person is wrong by a posterior standard deviation for weakly
determined elements. But importance draws are proposed around it, and it shows which elements the recordings determine.
Each person's fit stays in the process that computed it (:mod:`bayes_impedance.population.e_step`); an iteration sends
the population there and receives sums.

**Determined** is judged from the data alone, because an informative prior makes a posterior narrow too. For element p
the information of all recordings together, with the other elements o free within the population, is

.. math:: I_p = \sum_i H_{pp} - H_{po}\,(H_{oo} + T_{oo}^{-1})^{-1} H_{op},

and the element is determined if :math:`I_p^{-1/2} < 0.3`: on its natural scale it is then more than three standard
errors from zero, so neither a smaller nor a larger value fits as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter, methodcaller
from pathlib import Path

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.redundancy import inseparable
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import Mode
from bayes_impedance.population.e_step import (
    Begun,
    PersonFit,
    Sums,
    begin,
    contrasts_of,
    evidence,
    expect,
    information_of_elements,
    information_of_means,
    spread,
    sums,
)
from bayes_impedance.population.importance_likelihood import Contrasts
from bayes_impedance.population.parameters import Prior
from bayes_impedance.population.starting_fits import FirstFits
from bayes_impedance.runtime.checkpoint import load_arrays, save_arrays
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.sharded import Kept

DETERMINED_SD = 0.3
"""Largest standard error of a determined log element, from all recordings without a prior; derived above."""

_MAX_ROUNDS, _FEWEST_ROUNDS = 60, 6
"""Iterations. By choice, 60 at most: the estimate need not be exact. At least 6, as 1 and 4 try extra starts."""
_AT_REST = -1.0
"""Marks, in place of the distance moved, that the last iteration, from many starting points, is done."""
_TRIAL_ROUNDS, _TRIAL_POINTS = 10, 100
"""Iterations and frequencies per person in comparing modes. By choice: few, as their evidences differ by much."""
_TOLERANCE = 0.02
"""Iterations end when the population moves by less than this, in its standard errors. By choice: see `_MAX_ROUNDS`."""
_PRIOR_PERSONS = 2.0
"""Pseudo-persons with independent elements, added to the covariance. By choice: few persons stay non-singular."""
_SMALLEST_DISPERSION = 0.02
"""Least sd of logarithms between persons. By choice: reweighting cannot widen draws that lie almost in one point."""


@dataclass(frozen=True)
class Estimate:
    """Point estimate of the population, and each person's mode under it.

    Attributes
    ----------
    mu : ndarray, shape (P,)
    slopes : ndarray, shape (P, Q)
    covariance : ndarray, shape (P, P)
        T, between persons, of a person's mean over the repetitions.
    between_repetitions : ndarray, shape (P,)
    data : Kept of Likelihood
        The likelihoods that were given to the estimation.
    fits : Kept of PersonFit
        Each person's fit under this population.
    scale : ndarray, shape (N,)
        Each person's noise scale.
    converged : ndarray of bool, shape (N,)
        Whether the person's mode passes the gradient test.
    deviations : tuple of ndarray, shape (J, P)
        Each person's deviations of the repetitions.
    mu_sd : ndarray, shape (P,)
        Approximate posterior standard deviation of mu.
    data_sd : ndarray, shape (P,)
        Standard error of a common log element from all recordings together, without prior: infinite if they hold no
        information, or if other elements can replace it exactly (:mod:`bayes_impedance.network.redundancy`).
    rounds : int
    rivals : tuple of float
        Differences in log evidence between this mode of the population and the other modes found.
    """

    mu: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray
    between_repetitions: np.ndarray
    data: Kept
    fits: Kept
    scale: np.ndarray
    converged: np.ndarray
    deviations: tuple[np.ndarray, ...]
    mu_sd: np.ndarray
    data_sd: np.ndarray
    rounds: int
    rivals: tuple[float, ...]

    @property
    def determined(self) -> np.ndarray:
        """Which elements the recordings determine, shape (P,)."""
        return self.data_sd < DETERMINED_SD

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Each person's mode, collected from the workers."""
        return tuple(self.fits.gathered(attrgetter("mode")))

    @property
    def likelihoods(self) -> tuple[Likelihood, ...]:
        """Each person's likelihood at the estimated deviations of the repetitions, collected from the workers."""
        return tuple(d.moved(own) for d, own in zip(self.data.gathered(), self.deviations, strict=True))

    @property
    def contrasts(self) -> tuple[Contrasts, ...]:
        """One for each number of repetitions above one, collected from the workers."""
        return tuple(contrasts_of(self.fits.gathered()).values())

    def forget(self) -> None:
        """Release the persons' likelihoods and fits, which take memory; they are not needed once draws are made."""
        self.data.forget()
        self.fits.forget()


def estimate(
    kernel: Kernel,
    data: Kept,
    first: FirstFits,
    prior: Prior,
    covariates: np.ndarray,
    correlated: bool,
    seed: np.random.SeedSequence,
    progress: Progress,
    one_person: bool = False,
    checkpoint: Path | None = None,
) -> Estimate:
    """Expectation-maximisation until the population moves by less than 2 % of its standard errors.

    Parameters
    ----------
    kernel : Kernel
    data : Kept of Likelihood
        One per person, N of them. The fits are kept in the same processes.
    first : FirstFits
    prior : Prior
    covariates : ndarray, shape (N, Q)
        Standardised.
    correlated : bool
        Full covariance, or diagonal.
    seed : SeedSequence
        For the additional starting points of the last iteration.
    progress : callable
    one_person : bool
        Leave the population at the broad prior and estimate only the dispersion between repetitions.
    checkpoint : Path, optional
        File that holds the latest iteration; an interrupted estimation continues from it.
    """
    n, p = first.theta.shape
    repeated = max(data.ask(_most_repetitions)) > 1

    def state_from(theta: np.ndarray, data: Kept) -> _State:
        return _State(kernel, data, prior, covariates, correlated, theta, repeated, one_person)

    rounds, moved, rivals = 0, np.inf, tuple[float, ...]()
    kept = None if checkpoint is None else load_arrays(checkpoint)
    if kept is not None:
        state = state_from(first.theta, data)
        state.restore(kept)
        rounds, moved, rivals = int(kept["rounds"]), float(kept["moved"]), tuple(kept["rivals"].tolist())
    elif len(first.common) > 1 and not one_person:
        begun, rivals = _best_common(kernel.elements, state_from, data, first, progress)
        state = state_from(begun, data)
    else:
        state = state_from(first.theta, data)

    def keep() -> None:
        if checkpoint is not None:
            save_arrays(checkpoint, state.told() | {"rounds": rounds, "moved": moved, "rivals": np.array(rivals)})

    while moved >= 0 and rounds < _MAX_ROUNDS and not (rounds >= _FEWEST_ROUNDS and moved < _TOLERANCE):
        rounds += 1
        moved = state.iterate(first.alternatives if rounds in (1, 4) else None)
        progress("population estimate", rounds, _MAX_ROUNDS)
        keep()
    if moved >= 0:
        # A last iteration from many starting points, as the population itself may hold a person in a local optimum.
        spread = np.linalg.cholesky(state.covariance) @ np.random.default_rng(seed).normal(size=(n, p, 4))
        state.iterate(state.means[:, None, :] + np.swapaxes(spread, 1, 2))
        moved = _AT_REST
        keep()
    state.iterate(None)
    progress("population estimate", _MAX_ROUNDS, _MAX_ROUNDS)
    outcomes = state.fits.gathered(_outcome)
    return Estimate(
        state.mu,
        state.slopes,
        state.covariance,
        state.rho,
        data,
        state.fits,
        np.array([scale for scale, _, _ in outcomes]),
        np.array([converged for _, converged, _ in outcomes]),
        tuple(deviations for _, _, deviations in outcomes),
        state.mu_sd(),
        np.where(np.isin(kernel.elements, inseparable(kernel.network)), np.inf, state.data_sd()),
        rounds,
        rivals,
    )


def _begun_at(_: Likelihood, theta: np.ndarray, deviations: np.ndarray) -> Begun:
    return Begun(theta, deviations)


def _most_repetitions(part: Sequence[Likelihood]) -> int:
    return max(len(d.z) for d in part)


def _outcome(fit: PersonFit) -> tuple[float, bool, np.ndarray]:
    return fit.mode.scale, fit.mode.converged, fit.deviations


def _place(fit: PersonFit) -> tuple[np.ndarray, np.ndarray]:
    """Log elements and deviations of a person, from which the next iteration starts."""
    return fit.theta, fit.deviations


def _best_common(
    elements: Sequence[str],
    state_from: Callable[[np.ndarray, Kept], _State],
    data: Kept,
    first: FirstFits,
    progress: Progress,
) -> tuple[np.ndarray, tuple[float, ...]]:
    """Each person's starting point, (N, P), and the differences in log evidence of the alternatives.

    If persons start in different optima, the estimated population spans all of them, and its inflated dispersion then
    holds each person in the optimum it started from. So each common solution is tried as a population of its own, on
    thinned data, and the one with the highest evidence is taken.
    """
    thinned = data.each(methodcaller("thinned", _TRIAL_POINTS))
    found, ends = [], []
    for c, theta in enumerate(first.common):
        state = state_from(theta, thinned)
        for _ in range(_TRIAL_ROUNDS):
            state.iterate(None)
        found.append(state.log_evidence())
        ends.append(np.array(state.fits.gathered(attrgetter("theta"))))
        progress("common solutions", c + 1, len(first.common))
    order = np.argsort(found)[::-1]
    middles = [_by_kind(elements, np.median(end, axis=0)) for end in ends]
    others = [k for k in order[1:] if np.abs(middles[k] - middles[order[0]]).max() > 0.3]
    return ends[order[0]], tuple(float(found[order[0]] - found[k]) for k in others)


def _by_kind(elements: Sequence[str], theta: np.ndarray) -> np.ndarray:
    """Log elements sorted within each kind, so that exchanging equal parts of a network changes nothing."""
    return np.asarray(theta[np.lexsort((theta, np.array([ord(e[0]) for e in elements])))])


class _State:
    """Current state of the iteration."""

    def __init__(
        self,
        kernel: Kernel,
        data: Kept,
        prior: Prior,
        covariates: np.ndarray,
        correlated: bool,
        theta: np.ndarray,
        repeated: bool,
        one_person: bool,
    ) -> None:
        self.kernel, self.data, self.prior = kernel, data, prior
        self.covariates, self.correlated = covariates, correlated
        self.n_persons = len(theta)
        self.mu = np.median(theta, axis=0)
        self.slopes = np.zeros((self.mu.size, covariates.shape[1]))
        deviation = 1.4826 * np.median(np.abs(theta - self.mu), axis=0)
        self.covariance = np.diag(np.clip(1.5 * deviation, 0.2, 2.0) ** 2)
        self.fixed = one_person
        if one_person:
            self.mu, self.covariance = prior.centre.copy(), np.eye(self.mu.size) * prior.centre_sd**2
        self.rho = np.full(self.mu.size, 0.1) if repeated else np.zeros(self.mu.size)
        self.fits = data.each(begin, theta)

    def told(self) -> dict[str, np.ndarray]:
        """Arrays that determine the next iteration, for the checkpoint."""
        places = self.fits.gathered(_place)
        return {
            "mu": self.mu,
            "slopes": self.slopes,
            "covariance": self.covariance,
            "rho": self.rho,
            "theta": np.array([theta for theta, _ in places]),
            "deviations": np.concatenate([deviations for _, deviations in places]),
            "repetitions": np.array([len(deviations) for _, deviations in places]),
        }

    def restore(self, told: Mapping[str, np.ndarray]) -> None:
        """Restore the state from what `told` returned."""
        self.mu, self.slopes, self.covariance, self.rho = (told[k] for k in ("mu", "slopes", "covariance", "rho"))
        own = np.split(told["deviations"], np.cumsum(told["repetitions"])[:-1])
        self.fits = self.data.each(_begun_at, told["theta"], own)

    @property
    def means(self) -> np.ndarray:
        """Population mean of each person, shape (N, P)."""
        return np.asarray(self.mu + self.covariates @ self.slopes.T)

    def iterate(self, extra_starts: np.ndarray | None) -> float:
        """One iteration; returns how far the population moved, in its standard errors."""
        means = self.means
        starts = np.empty((self.n_persons, 0, self.mu.size))
        if extra_starts is not None:
            starts = np.concatenate([means[:, None], extra_starts], axis=1)
        step = partial(expect, self.kernel, np.linalg.inv(self.covariance), self.rho)
        self.fits = self.data.each(step, self.fits, means, starts)
        old_mu, old_covariance, old_rho = self.mu.copy(), self.covariance, self.rho
        self._maximise(self.fits.ask(sums, self.prior.centre, self.rho, columns=[self.covariates]))
        sd = np.sqrt(np.diag(old_covariance) / self.n_persons + 1e-12)
        shift = np.abs(self.mu - old_mu) / sd
        stretch = np.abs(np.log(np.diag(self.covariance) / np.diag(old_covariance)))
        wobble = np.abs(self.rho - old_rho) / np.maximum(self.rho, 0.01)
        return float(max(np.max(shift), np.max(stretch), np.max(wobble)))

    def _maximise(self, parts: Sequence[Sums]) -> None:
        if any(part.squares for part in parts):
            self.rho = self._repetition_dispersion(parts)
        if self.fixed:
            return
        design, target = _total(part.design for part in parts), _total(part.target for part in parts)
        # Prior: centre_sd for the mean, slope_sd for the slopes, relative to the spread between persons.
        variance = np.diag(self.covariance)
        for e in range(self.mu.size):
            ridge = variance[e] / np.r_[self.prior.centre_sd**2, np.full(len(design) - 1, self.prior.slope_sd**2)]
            solution = np.linalg.solve(design + np.diag(ridge), target[e])
            self.mu[e], self.slopes[e] = self.prior.centre[e] + solution[0], solution[1:]
        # A second pass over the persons: squaring the deviations from the new mean avoids cancellation.
        square = _total(self.fits.ask(spread, columns=[self.means])) + _total(part.uncertainty for part in parts)
        weak = _PRIOR_PERSONS * np.diag(np.clip(variance, _SMALLEST_DISPERSION**2, 1.0))
        covariance = (square + weak) / (self.n_persons + _PRIOR_PERSONS)
        floor = np.maximum(np.diag(covariance), _SMALLEST_DISPERSION**2)
        self.covariance = np.diag(floor) if not self.correlated else covariance + np.diag(floor - np.diag(covariance))

    def _repetition_dispersion(self, parts: Sequence[Sums]) -> np.ndarray:
        total, count = np.full(self.mu.size, 2 * 0.05**2), 2.0  # two contrasts' worth of a 5 % prior
        for j in sorted({j for part in parts for j in part.squares}):
            own = [part.squares[j] for part in parts if j in part.squares]
            total += _total(square for square, _ in own)
            count += sum(n for _, n in own)
        return np.asarray(np.clip(np.sqrt(total / count), 1e-3, 1.0))

    def log_evidence(self) -> float:
        """Laplace approximation of the log marginal likelihood of the population, with the prior of its centre."""
        sign, log_determinant = np.linalg.slogdet(self.covariance)
        prior = -0.5 * float(np.sum(((self.mu - self.prior.centre) / self.prior.centre_sd) ** 2))
        return prior + sum(self.fits.ask(evidence, self.rho)) - 0.5 * self.n_persons * float(sign * log_determinant)

    def mu_sd(self) -> np.ndarray:
        """Approximate posterior standard deviation of mu, shape (P,)."""
        if self.fixed:
            return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.fits.gathered()[0].mode.precision))))
        precision = np.linalg.inv(self.covariance)
        prior = np.eye(self.mu.size) / self.prior.centre_sd**2
        rows = [(precision, np.zeros_like(prior) if k else prior) for k in range(len(self.fits.parts))]
        information = _total(self.fits.ask_in_turn(information_of_means, rows))
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))

    def data_sd(self) -> np.ndarray:
        """Standard error of each element from all recordings together, without a prior on it, shape (P,)."""
        information = _total(self.fits.ask(information_of_elements, np.linalg.inv(self.covariance)))
        return np.array([total**-0.5 if total > 0 else np.inf for total in information])


def _total(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Sum in the order of the parts."""
    return np.asarray(np.sum(list(parts), axis=0))
