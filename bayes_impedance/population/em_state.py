r"""The state of the expectation-maximisation and one iteration of it.

The equations are derived in :mod:`bayes_impedance.population.em`, those of the parameters that are the same for
everybody in :mod:`bayes_impedance.population.shared`, and the weights of persons in a population with heavier tails in
:mod:`bayes_impedance.population.heavy_tails`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter

import numpy as np
from scipy.linalg import block_diag

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population.alignment import aligned
from bayes_impedance.population.e_step import (
    PersonFit,
    Sums,
    begin,
    evidence,
    expect,
    expect_weighted,
    information_of_elements,
    information_of_means,
    spread,
    squared_distances,
    standard_errors,
    sums,
)
from bayes_impedance.population.far_people import LEAST_DISPERSION
from bayes_impedance.population.heavy_tails import HEAVIEST, estimated_tail, weights_of
from bayes_impedance.population.packed_fits import packed, unpacked
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.shared import (
    Placed,
    Pooling,
    SharedEquations,
    objective,
    shared_equations,
    step_of,
    summed,
)
from bayes_impedance.runtime.sharded import Kept
from bayes_impedance.units import MAD_TO_SD

PRIOR_PERSONS, LKJ = 2.0, 2.0
"""Pseudo-persons with independent elements, added to the covariance: the weight of the prior LKJ(2) of correlations,
and in proportion to its concentration. With them the covariance of few persons is not singular."""
SMALLEST_DISPERSION = 0.02
"""Least sd of logarithms between persons. By choice: reweighting cannot widen draws that lie almost in one point, and
the covariance must stay invertible."""
_NO_PRIOR = 1e-6
"""Precision in place of a prior's. By choice: a standard deviation of a thousand only keeps what the recordings do not
see from being singular."""
_SHORTER = 6
"""Most lengths that are tried of a step of shared parameters, each a quarter of the one before. By choice: a thousandth
of the step, below which the iteration goes on without it."""


def _placed(fit: PersonFit) -> Placed:
    return Placed(fit.theta, fit.deviations)


def _following(place: Placed, equations: SharedEquations, step: np.ndarray) -> Placed:
    return place.following(equations, step)


class State:
    """Current state of the iteration.

    Parameters
    ----------
    pooling : Pooling
    data : Kept of Likelihood
    prior : Prior
        Of all P parameters.
    covariates : ndarray, shape (N, Q)
    correlated : bool
    theta : ndarray, shape (N, P)
        Each person's starting point; of shared parameters the median is taken.
    repeated : bool
    one_person : bool
    tails : bool
        Whether the population is a Student t. Its degrees of freedom are then estimated along, and persons far from the
        centre count less; shared parameters and common searches take everybody as equal, which moves only the point of
        departure.
    """

    def __init__(
        self,
        pooling: Pooling,
        data: Kept,
        prior: Prior,
        covariates: np.ndarray,
        correlated: bool,
        theta: np.ndarray,
        repeated: bool,
        one_person: bool,
        tails: bool = False,
    ) -> None:
        self.pooling, self.data = pooling, data
        self.prior = prior.of(pooling.varying) if pooling.names else prior
        self.shared_prior = prior.of(pooling.shared)
        self.phi = np.median(theta[:, pooling.shared], axis=0)
        if pooling.names:
            theta = theta[:, pooling.varying]
        self.covariates, self.correlated = covariates, correlated
        self.n_persons = len(theta)
        self.tail = 0.5 * HEAVIEST if tails else None  # the prior's median
        self.weights = np.ones(self.n_persons) if tails else None
        self.mu = np.median(theta, axis=0)
        self.slopes = np.zeros((self.mu.size, covariates.shape[1]))
        deviation = MAD_TO_SD * np.median(np.abs(theta - self.mu), axis=0)
        self.covariance = np.diag(np.clip(1.5 * deviation, 0.2, 2.0) ** 2)
        self.fixed = one_person
        if one_person:
            self.mu, self.covariance = self.prior.centre.copy(), self.prior.covariance
        self.rho = np.full(self.mu.size, 0.1) if repeated else np.zeros(self.mu.size)
        self.fits = data.each(begin, theta)
        self.beginnings: np.ndarray | None = theta  # until everybody has been fitted
        self.begun = False  # whether everybody has been fitted with the shared parameters as they are

    def snapshot(self) -> dict[str, np.ndarray]:
        """Arrays that determine the next iteration, for the checkpoint."""
        return {
            "mu": self.mu.copy(),  # of both, an iteration writes into the array itself
            "slopes": self.slopes.copy(),
            "covariance": self.covariance,
            "rho": self.rho,
            "phi": self.phi,
            **packed(self.fits),
            **({} if self.weights is None else {"weights": self.weights, "tail": np.array(self.tail)}),
        }

    def restore(self, snapshot: Mapping[str, np.ndarray]) -> None:
        """Restore the state from what `snapshot` returned."""
        self.mu, self.slopes = snapshot["mu"].copy(), snapshot["slopes"].copy()
        self.covariance, self.rho = snapshot["covariance"], snapshot["rho"]
        self.phi = snapshot["phi"]
        self.fits = unpacked(self.data, snapshot)
        if "weights" in snapshot:
            self.weights, self.tail = snapshot["weights"], float(snapshot["tail"])
        self.begun, self.beginnings = True, None  # snapshots are taken after an iteration

    def take_population(self, other: State) -> None:
        """Take over another state's population, not its persons (before the first iteration)."""
        self.mu, self.slopes = other.mu.copy(), other.slopes.copy()  # an iteration writes into them
        self.covariance, self.rho, self.phi, self.tail = other.covariance, other.rho, other.phi, other.tail

    def take_population_of(self, theta: np.ndarray) -> None:
        """Take median and dispersions of some people's varying parameters (n, V), before the first iteration."""
        self.mu = np.median(theta, axis=0)
        self.covariance = np.diag(np.maximum(theta.std(axis=0, ddof=1), LEAST_DISPERSION) ** 2)

    def exchange(self, arrangement: np.ndarray) -> None:
        """Give equal parts of the network each other's values, in everybody and in the population (after an iteration).

        Parameters
        ----------
        arrangement : ndarray of int, shape (P,)
            Parameter k takes the value of parameter ``arrangement[k]``; shared ones of shared ones.
        """
        own = np.searchsorted(self.pooling.varying, arrangement[self.pooling.varying])
        kept = self.snapshot()
        columns = ["theta", "deviations", "expanded", "rho"] + ["mu"] * (not self.fixed)
        kept |= {name: kept[name][..., own] for name in columns}
        kept["phi"] = kept["phi"][np.searchsorted(self.pooling.shared, arrangement[self.pooling.shared])]
        if not self.fixed:
            kept |= {"slopes": kept["slopes"][own], "covariance": kept["covariance"][np.ix_(own, own)]}
        self.restore(kept)

    def found(self) -> tuple[np.ndarray, np.ndarray]:
        """Central values of all parameters and their standard errors, (P,) each: of one person, the person's own."""
        centres = self.theta[0] if self.fixed else self.pooling.whole(self.mu, self.phi)
        return centres, self.pooling.whole(self.mu_sd(), np.ones(self.phi.size))

    @property
    def means(self) -> np.ndarray:
        """Population mean of each person, shape (N, P)."""
        return np.asarray(self.mu + self.covariates @ self.slopes.T)

    def iterate(self, extra_starts: np.ndarray | None) -> float:
        """One iteration; returns how far the population moved, in its standard errors."""
        if self.begun and self.fits.remembers_inputs:
            self.fits = unpacked(self.data, packed(self.fits))
        means = self.means
        moved = self._move_shared()
        starts = None
        if extra_starts is not None:
            starts = np.concatenate([means[:, None], extra_starts], axis=1)
        precision = np.linalg.inv(self.covariance)
        kernel = self.pooling.at(self.phi)
        if self.beginnings is not None and self.rho.any():
            fits = refitted(self.data, self.fits, kernel, precision, self.rho, means, None, self.weights)
            self.fits = self.data.each(partial(aligned, kernel, precision, self.rho), fits, means, self.beginnings)
        self.beginnings = None
        self.fits = refitted(self.data, self.fits, kernel, precision, self.rho, means, starts, self.weights)
        old_mu, old_covariance, old_rho = self.mu.copy(), self.covariance, self.rho
        if self.weights is not None:
            square = np.concatenate(self.fits.ask(squared_distances, precision, columns=[means]))
            self.tail = estimated_tail(square, self.mu.size)
            self.weights = weights_of(square, self.tail, self.mu.size)
        sums_here = partial(sums, centre=self.prior.centre, rho=self.rho)
        self._maximise(self.fits.ask(sums_here, columns=[self.covariates, *self._counted]))
        sd = np.sqrt(np.diag(old_covariance) / self.n_persons + 1e-12)
        shift = np.abs(self.mu - old_mu) / sd
        stretch = np.abs(np.log(np.diag(self.covariance) / np.diag(old_covariance)))
        wobble = np.abs(self.rho - old_rho) / np.maximum(self.rho, 0.01)
        return float(max(moved, np.max(shift), np.max(stretch), np.max(wobble)))

    @property
    def _counted(self) -> list[np.ndarray]:
        """The persons' weights, if there are any, as columns of sums over persons."""
        return [] if self.weights is None else [self.weights]

    def align(self) -> None:
        """Search the recordings of everybody who is described badly one by one (after an iteration, before another)."""
        own = partial(aligned, self.pooling.at(self.phi), np.linalg.inv(self.covariance), self.rho)
        self.fits = self.data.each(own, self.fits, self.means)

    @property
    def theta(self) -> np.ndarray:
        """Everybody's parameters, the shared ones included, shape (N, P)."""
        return self.pooling.whole(np.array(self.fits.gathered(attrgetter("theta"))), self.phi)

    def _move_shared(self) -> float:
        """A step of the parameters that are the same for all, and everybody along; its length in standard errors."""
        if not self.pooling.names or not self.begun:
            self.begun = True
            return 0.0
        equations = self.shared_equations()
        curvature, gradient = self._information(equations)
        offset = self.shared_prior.local_precision(self.phi) @ (self.phi - self.shared_prior.centre)
        step = step_of(curvature, gradient - offset)
        size = self.phi.size
        places = self.fits.each(_placed)
        before = self._objective(self.phi, self.mu, places)
        for _ in range(_SHORTER):
            there = places.each(_following, equations, np.tile(step, (self.n_persons, 1)))
            phi, mu = self.phi + step[:size], self.mu + step[size:]
            if self._objective(phi, mu, there) <= before:
                self.phi, self.mu, self.fits = phi, mu, there
                return float(np.sqrt(max(step @ curvature @ step, 0.0)))
            step = 0.25 * step
        return 0.0

    def _objective(self, phi: np.ndarray, mu: np.ndarray, places: Kept) -> float:
        """Negative log posterior of everybody's places, of the shared parameters and the mean, up to a constant."""
        own = partial(objective, self.pooling.at(phi), np.linalg.inv(self.covariance), self.rho)
        total = float(sum(self.data.each(own, places, mu + self.covariates @ self.slopes.T).ask(sum)))
        total += self.shared_prior.misfit(phi) + self.prior.misfit(mu)
        return total if np.isfinite(total) else np.inf

    def shared_equations(self) -> Kept:
        """Everybody's equations of the shared parameters, as :class:`SharedEquations`."""
        return equations_of(self.data, self.fits, self.pooling, self.phi, np.linalg.inv(self.covariance), self.rho)

    def shared_covariance(self, with_prior: bool) -> np.ndarray:
        """Approximate posterior covariance (S, S) of the shared parameters; without their prior if not asked for.

        What is known from other recordings is data: a delay of the load beside one of the rig is as determined as the
        calibration determines the rig's.
        """
        curvature = self._information(self.shared_equations(), with_prior)[0]
        return np.asarray(np.linalg.inv(curvature)[: self.phi.size, : self.phi.size])

    def _information(self, equations: Kept, with_prior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        parts = equations.ask(summed)
        own = self.shared_prior.local_precision(self.phi)
        if not with_prior:
            known = np.flatnonzero(self.shared_prior.known)
            own = _NO_PRIOR * np.eye(self.phi.size)
            own[np.ix_(known, known)] += self.shared_prior.of(known).precision
        prior = block_diag(own, self.prior.local_precision(self.mu))
        return _total(c for c, _ in parts) + prior, _total(g for _, g in parts)

    def _maximise(self, parts: Sequence[Sums]) -> None:
        if any(part.squares for part in parts):
            self.rho = self._repetition_dispersion(parts)
        if self.fixed:
            return
        design, target = _total(part.design for part in parts), _total(part.target for part in parts)
        # Prior: centre_sd for the mean, slope_sd for the slopes, relative to the spread between persons.
        variance, sds = np.diag(self.covariance), self.prior.local_sds(self.mu)
        for e in range(self.mu.size):
            ridge = variance[e] / np.r_[sds[e] ** 2, np.full(len(design) - 1, self.prior.slope_sd**2)]
            solution = np.linalg.solve(design + np.diag(ridge), target[e])
            self.mu[e], self.slopes[e] = self.prior.centre[e] + solution[0], solution[1:]
        # A second pass over the persons: squaring the deviations from the new mean avoids cancellation.
        square = _total(self.fits.ask(spread, columns=[self.means, *self._counted])) + _total(
            part.uncertainty for part in parts
        )
        persons = PRIOR_PERSONS * self.prior.concentration / LKJ
        # The prior's scale of the dispersions limits what few persons and much noise would give.
        limit = np.maximum(self.prior.dispersion_sds, SMALLEST_DISPERSION) ** 2
        weak = persons * np.diag(np.clip(variance, SMALLEST_DISPERSION**2, limit))
        covariance = (square + weak) / (self.n_persons + persons)
        floor = np.maximum(np.diag(covariance), SMALLEST_DISPERSION**2)
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
        weighted = 0.0 if self.weights is None else 0.5 * self.mu.size * float(np.sum(np.log(self.weights)))
        prior = -self.prior.misfit(self.mu) - self.shared_prior.misfit(self.phi)
        return (
            prior
            + sum(self.fits.ask(evidence, self.rho))
            - 0.5 * self.n_persons * float(sign * log_determinant)
            + weighted
        )

    def mu_sd(self) -> np.ndarray:
        """Approximate posterior standard deviation of mu, shape (P,)."""
        if self.fixed:
            return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.fits.gathered()[0].mode.precision))))
        precision = np.linalg.inv(self.covariance)
        prior = np.eye(self.mu.size) / self.prior.local_sds(self.mu) ** 2
        rows = [(precision, np.zeros_like(prior) if k else prior) for k in range(len(self.fits.parts))]
        information = _total(self.fits.ask_in_turn(information_of_means, rows))
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))

    def data_sd(self) -> np.ndarray:
        """Standard error of each element from all recordings together, without a prior on it, shape (P,)."""
        return standard_errors(_total(self.fits.ask(information_of_elements, np.linalg.inv(self.covariance))))


def refitted(
    data: Kept,
    fits: Kept,
    kernel: Kernel,
    precision: np.ndarray,
    rho: np.ndarray,
    means: np.ndarray,
    starts: np.ndarray | None = None,
    weights: np.ndarray | None = None,
) -> Kept:
    """Everybody's fit under a population, from where they are and from further starting points (N, S, V).

    If weights (N,) are given, the population's precision is multiplied by them.
    """
    if starts is None:
        starts = np.empty((len(means), 0, means.shape[1]))
    if weights is not None:
        return data.each(partial(expect_weighted, kernel, precision, rho), fits, means, starts, weights)
    return data.each(partial(expect, kernel, precision, rho), fits, means, starts)


def equations_of(
    data: Kept, fits: Kept, pooling: Pooling, phi: np.ndarray, precision: np.ndarray, rho: np.ndarray
) -> Kept:
    """Everybody's equations of the shared parameters, as :class:`SharedEquations`."""
    return data.each(partial(_shared_equations, pooling, phi, precision, rho), fits)


def _shared_equations(
    pooling: Pooling, phi: np.ndarray, precision: np.ndarray, rho: np.ndarray, likelihood: Likelihood, fit: PersonFit
) -> SharedEquations:
    return shared_equations(pooling, phi, precision, rho, likelihood, fit.mode.theta, fit.mode.scale, fit.expanded)


def _total(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Sum in the order of the parts."""
    return np.asarray(np.sum(list(parts), axis=0))
