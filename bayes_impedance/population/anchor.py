"""The reference population of everybody's draws, and where it is moved when draws do not suffice."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.person.choosing import Nearby
from bayes_impedance.population.parameters import PopulationParameters

_AROUND = 1.2
"""Factor on the standard deviations of the mean of some populations from which draws are made for all of them.
Computed with normal likelihoods of 71 virtual fingertips from 20 to 800 Hz: under populations near the posterior 0.07
(5 % quantile) and 0.55 (median) of the draws are effective with 1.08, 0.15 and 0.53 with 1.2, 0.18 and 0.44 with
1.4."""

_CHOSEN_FOR = 32
"""Populations for which draws are chosen. By choice: a person's weights under as many span those under the others."""


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
    near : Nearby, optional
        Populations for which draws are chosen from many.
    """

    mu: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray
    reach: float
    along_valley: bool = False
    near: Nearby | None = None

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

    @classmethod
    def among(cls, there: PopulationParameters, repetitions: np.ndarray) -> Anchor:
        """The same, wide enough for all of them, and with draws that are chosen for them.

        How slopes differ between them is left out of the choice.
        """
        some = there[np.unique(np.linspace(0, len(there.mu) - 1, _CHOSEN_FOR).astype(int))]
        middle = cls.of(there, repetitions, _AROUND, False)
        near = Nearby(some.mu - middle.mu, _of_means(some, repetitions))
        return replace(middle, near=near)

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
