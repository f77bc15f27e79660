"""The reference population under which everybody's draws are made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.population.parameters import PopulationParameters


@dataclass(frozen=True, kw_only=True)
class Anchor:
    """A reference population, and how draws are made under it.

    Attributes
    ----------
    mu : ndarray, shape (P,)
    slopes : ndarray, shape (P, Q)
    covariance : ndarray, shape (P, P)
    reach : float
        Factor on its standard deviations.
    along_valley : bool
        Propose along each person's curved valley.
    """

    mu: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray
    reach: float
    along_valley: bool = False

    def means(self, covariates: np.ndarray) -> np.ndarray:
        """Mean of each person (N, P) with covariates (N, Q)."""
        return np.asarray(self.mu + covariates @ self.slopes.T)

    @property
    def wide(self) -> np.ndarray:
        """The covariance of the population that is drawn from, (P, P)."""
        return self.covariance * self.reach**2

    @classmethod
    def of(cls, there: PopulationParameters, repetitions: np.ndarray, reach: float, along_valley: bool) -> Anchor:
        """The mean of some populations, for persons with these numbers of repetitions (N,)."""
        return cls(
            mu=there.mu.mean(axis=0),
            slopes=there.slopes.mean(axis=0),
            covariance=_of_means(there, repetitions).mean(axis=0),
            reach=reach,
            along_valley=along_valley,
        )

    def and_between(self, there: PopulationParameters) -> Anchor:
        """The same, its covariance increased by that of the means of some populations."""
        covariance = self.covariance
        for own in (there.mu, *np.moveaxis(there.slopes, 2, 0)):  # covariates have a mean square of one
            covariance = covariance + np.atleast_2d(np.cov(own.T))
        return replace(self, covariance=covariance)


def _of_means(there: PopulationParameters, repetitions: np.ndarray) -> np.ndarray:
    """Covariances of the means of a person's repetitions, shape (W, P, P)."""
    variance = there.between_repetitions**2 / float(np.mean(repetitions))
    return np.asarray(there.covariance + variance[:, :, None] * np.eye(variance.shape[1]))


def of_limited_growth(before: np.ndarray, after: np.ndarray, most: float) -> np.ndarray:
    """A covariance (S, S), its variances changed along each axis by no more than a factor.

    Parameters
    ----------
    before : ndarray, shape (S, S)
        Lower Cholesky factor of the covariance before.
    after : ndarray, shape (S, S)
        The covariance that is wanted.
    most : float
    """
    relative = np.linalg.solve(before, np.linalg.solve(before, after).T)
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    factor = before @ vectors * np.sqrt(np.clip(values, 1 / most, most))
    return np.asarray(factor @ factor.T)
