r"""A point estimate of the population, by expectation-maximisation: the starting point of the exact computation.

Two steps alternate. Each person's posterior is approximated by a normal at its mode under the current population:

* E: :math:`\theta_i \sim N(m_i, C_i)` with :math:`C_i = (H_i + T^{-1})^{-1}`; the deviations of the repetitions are set
  to their conditional mode under N(0, diag rho^2), with their sum constrained to zero;
* M: :math:`\mu = \overline{m_i}`, :math:`T = \overline{(m_i-\mu)(m_i-\mu)^T + C_i}`,
  :math:`\rho^2 = \overline{E\,d^2}` over the contrasts.

In a population with heavier tails (:mod:`bayes_impedance.population.heavy_tails`) T becomes
:math:`\lambda_i T` for person i, and :math:`E[1/\lambda_i] = (\nu+P)/(\nu+q_i)` is the person's weight in E and M,
with q the expected squared distance (Lange, Little and Taylor 1989). The degrees of freedom maximise the density of the
distances in each iteration (ECME of Liu and Rubin 1995).

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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.parameters import LOG
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import Mode
from bayes_impedance.population.calibrated import inseparable_given
from bayes_impedance.population.common_solutions import ALIGNED, APART, best_common, from_another
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.e_step import PersonFit, contrasts_of
from bayes_impedance.population.em_state import State, equations_of, refitted
from bayes_impedance.population.order import arranged
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.starting_fits import FirstFits
from bayes_impedance.population.two_components import Groups, estimated_groups
from bayes_impedance.runtime.checkpoint import load_arrays, save_arrays
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.sharded import Kept

DETERMINED_SD, DETERMINED_BOUNDED = 0.3, 1.0
"""Largest standard error of a determined log element, from all recordings without a prior; derived above. And of a
parameter on a signed or bounded scale, where zero is as possible as any other value: by choice, well within their
priors, whose standard deviations are 3 and 1.5."""

_MAX_ROUNDS, _FEWEST_ROUNDS = 60, 6
"""Iterations. By choice, 60 at most: the estimate need not be exact. At least 6, as 1 and 4 try extra starts."""
_AT_REST = -1.0
"""Marks, in place of the distance moved, that the last iteration, from many starting points, is done."""
_TOLERANCE = 0.02
"""Iterations end when the population moves by less than this, in its standard errors. By choice: see `_MAX_ROUNDS`."""
_MOST_TOGETHER = 4
"""Most times that everybody begins anew from one solution. By choice: each time the evidence is higher. Of five
populations with people in other valleys one gained 129 after the second time, and three had come to rest before."""


@dataclass(frozen=True, kw_only=True)
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
    limits : ndarray, shape (P,)
        Below which `data_sd` counts as determined.
    pooling : Pooling
    shared : ndarray, shape (S,)
        Parameters that are the same for everybody; the P others differ.
    shared_covariance : ndarray, shape (S, S)
        Approximate posterior covariance.
    shared_data_sd : ndarray, shape (S,)
        Their standard deviations by the recordings alone; infinite if these do not see them.
    shared_determined : ndarray of bool, shape (S,)
    shared_equations : Kept of SharedEquations, optional
        How everybody's parameters follow the shared ones.
    rounds : int
    rivals : tuple of float
        Differences in log evidence between this mode of the population and the other modes found.
    tail : float, optional
        Reciprocal degrees of freedom of a Student t population.
    weights : ndarray, shape (N,), optional
        Each person's weight in it.
    groups : Groups, optional
        One, of a population of two groups; elements that the recordings do not determine have no separation.
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
    limits: np.ndarray
    pooling: Pooling
    shared: np.ndarray
    shared_covariance: np.ndarray
    shared_data_sd: np.ndarray
    shared_determined: np.ndarray
    shared_equations: Kept | None
    rounds: int
    rivals: tuple[float, ...]
    tail: float | None = None
    weights: np.ndarray | None = None
    groups: Groups | None = None

    @property
    def determined(self) -> np.ndarray:
        """Which elements the recordings determine, shape (P,)."""
        return self.data_sd < self.limits

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Each person's mode, collected from the workers."""
        return tuple(self.fits.gathered(attrgetter("mode")))

    @property
    def likelihoods(self) -> tuple[Likelihood, ...]:
        """Each person's likelihood at the estimated deviations of the repetitions, collected from the workers."""
        return tuple(d.moved(own) for d, own in zip(self.data.gathered(), self.deviations, strict=True))

    @property
    def stretches(self) -> np.ndarray:
        """Factors on the covariance of the population from which each person is drawn, at least one: shape (N,)."""
        return np.ones(self.scale.size) if self.weights is None else 1 / np.minimum(self.weights, 1.0)

    @property
    def contrasts(self) -> tuple[Contrasts, ...]:
        """One for each number of repetitions above one, collected from the workers."""
        return tuple(contrasts_of(self.fits.gathered()).values())

    def forget(self) -> None:
        """Release the persons' likelihoods and fits, which take memory; they are not needed once draws are made."""
        self.data.forget()
        self.fits.forget()
        if self.shared_equations is not None:
            self.shared_equations.forget()


def estimate(
    pooling: Pooling,
    data: Kept,
    first: FirstFits,
    prior: Prior,
    covariates: np.ndarray,
    correlated: bool,
    seed: np.random.SeedSequence,
    progress: Progress,
    one_person: bool = False,
    checkpoint: Path | None = None,
    tails: bool = False,
) -> Estimate:
    """Expectation-maximisation until the population moves by less than 2 % of its standard errors.

    Parameters
    ----------
    pooling : Pooling
        The network, and which of its P parameters are the same for everybody.
    data : Kept of Likelihood
        One per person, N of them. The fits are kept in the same processes.
    first : FirstFits
        Of all P parameters.
    prior : Prior
        Of all P parameters.
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
    tails : bool
        Whether the population is a Student t.
    """
    n, p = len(first.theta), pooling.varying.size
    everybody = np.arange(n)
    repeated = max(data.ask(_most_repetitions)) > 1

    def state_from(theta: np.ndarray, data: Kept, people: np.ndarray) -> State:
        return State(pooling, data, prior, covariates[people], correlated, theta, repeated, one_person, tails)

    rounds, moved, rivals = 0, np.inf, tuple[float, ...]()
    together, jumped = 0, np.zeros(n, dtype=bool)
    kept = None if checkpoint is None else load_arrays(checkpoint)
    if kept is not None:
        state = state_from(first.theta, data, everybody)
        state.restore(kept)
        rounds, moved, rivals = int(kept["rounds"]), float(kept["moved"]), tuple(kept["rivals"].tolist())
        together, jumped = int(kept["together"]), kept["jumped"]
    elif len(first.common) > 1 and not one_person:
        begun, rivals = best_common(pooling.kernel, prior.order, state_from, data, first, progress)
        state = state_from(begun, data, everybody)
    else:
        state = state_from(first.theta, data, everybody)

    def keep() -> None:
        if checkpoint is not None:
            own = {"rounds": rounds, "moved": moved, "rivals": np.array(rivals), "together": together, "jumped": jumped}
            save_arrays(checkpoint, state.snapshot() | own)

    def searched(starts: np.ndarray) -> float:
        """One iteration from other starting points too; whose solution is better than where they were is noted."""
        change = state.iterate(starts)
        jumped[np.array(state.fits.gathered(attrgetter("mode.apart"))) > APART] = True
        return change

    while True:
        while moved >= 0 and rounds < _MAX_ROUNDS and not (rounds >= _FEWEST_ROUNDS and moved < _TOLERANCE):
            rounds += 1
            again = rounds in (1, 4)
            moved = searched(first.alternatives[..., pooling.varying]) if again else state.iterate(None)
            if rounds in ALIGNED:
                state.align()
            progress("population estimate", rounds, _MAX_ROUNDS)
            keep()
        if moved >= 0:
            # A last iteration from many starting points, as the population itself may hold a person in a local optimum.
            spread = np.linalg.cholesky(state.covariance) @ np.random.default_rng(seed).normal(size=(n, p, 4))
            searched(state.means[:, None, :] + np.swapaxes(spread, 1, 2))
            moved = _AT_REST
            keep()
        if one_person or together == _MOST_TOGETHER:
            break
        found, gain = from_another(pooling.kernel, prior.order, state_from, data, state, jumped, progress)
        if found is None:
            break
        rivals = tuple(rival + gain for rival in rivals)
        if np.abs(np.median(found.theta, axis=0) - np.median(state.theta, axis=0)).max() > APART:
            rivals = (gain, *rivals)  # else only some persons were elsewhere
        state = found
        rounds, moved, together, jumped = 0, np.inf, together + 1, np.zeros(n, dtype=bool)
    if prior.order:
        state.iterate(None)  # standard errors need everybody's fit under the population as it now is
        state.exchange(arranged(prior.order, pooling.kernel, *state.found()))
    state.iterate(None)
    progress("population estimate", _MAX_ROUNDS, _MAX_ROUNDS)
    outcomes = state.fits.gathered(_outcome)
    kernel = pooling.kernel
    unseen = np.isin(kernel.elements, inseparable_given(kernel, prior))
    limits = np.array([DETERMINED_SD if p.link == LOG else DETERMINED_BOUNDED for p in kernel.parameters])
    shared_sd = np.sqrt(np.diag(state.shared_covariance(with_prior=False))) if pooling.names else np.zeros(0)
    shared_sd = np.where(unseen[pooling.shared], np.inf, shared_sd)
    data_sd = np.where(unseen[pooling.varying], np.inf, state.data_sd())
    mu, mu_sd = state.mu, state.mu_sd()
    if not one_person and np.any(seen := data_sd < limits[pooling.varying]):
        mu = mu.copy()
        mu[seen] = state.prior.of(np.flatnonzero(seen)).order.nearest(mu[seen], mu_sd[seen])
    return Estimate(
        mu=mu,
        slopes=state.slopes,
        covariance=state.covariance,
        between_repetitions=state.rho,
        data=data,
        fits=state.fits,
        scale=np.array([scale for scale, _, _ in outcomes]),
        converged=np.array([converged for _, converged, _ in outcomes]),
        deviations=tuple(deviations for _, _, deviations in outcomes),
        mu_sd=mu_sd,
        data_sd=data_sd,
        limits=limits[pooling.varying],
        pooling=pooling,
        shared=state.phi,
        shared_covariance=state.shared_covariance(with_prior=True) if pooling.names else np.zeros((0, 0)),
        shared_data_sd=shared_sd,
        shared_determined=(shared_sd < limits[pooling.shared]) | prior.known[pooling.shared],
        shared_equations=state.shared_equations() if pooling.names else None,
        rounds=rounds,
        rivals=rivals,
        tail=state.tail,
        weights=state.weights,
    )


def with_groups(point: Estimate, covariates: np.ndarray) -> Estimate:
    """The estimate with two groups of people, found among their modes; covariates (N, Q).

    Raises
    ------
    InputError
        If the recordings determine no element that differs between people.
    """
    seen = np.flatnonzero(point.determined)
    if not seen.size:
        raise InputError(
            "the recordings determine no element that differs between subjects, so there are no groups: take another "
            "distribution, or check the unit, the frequencies and the network"
        )
    away = np.array(point.fits.gathered(attrgetter("theta"))) - point.mu - covariates @ point.slopes.T
    factor = np.linalg.cholesky(point.covariance[np.ix_(seen, seen)])
    found = estimated_groups(np.linalg.solve(factor, away[:, seen].T).T)
    separation = np.zeros((1, point.mu.size))
    separation[:, seen] = found.separation
    return replace(point, groups=replace(found, separation=separation))


def moved_to(point: Estimate, shared: np.ndarray, means: np.ndarray, covariance: np.ndarray) -> Estimate:
    """The same estimate with everybody's mode at other shared parameters and under another population.

    Parameters
    ----------
    point : Estimate
    shared : ndarray, shape (S,)
    means : ndarray, shape (N, V)
        Population mean of each person.
    covariance : ndarray, shape (V, V)
    """
    precision, rho = np.linalg.inv(covariance), point.between_repetitions
    kernel = point.pooling.at(shared)
    fits = refitted(point.data, point.fits, kernel, precision, rho, means, weights=point.weights)
    equations = equations_of(point.data, fits, point.pooling, shared, precision, rho)
    return replace(point, fits=fits, shared=shared, shared_equations=equations)


def _most_repetitions(part: Sequence[Likelihood]) -> int:
    return max(len(d.z) for d in part)


def _outcome(fit: PersonFit) -> tuple[float, bool, np.ndarray]:
    return fit.mode.scale, fit.mode.converged, fit.deviations
