r"""Quadratic log likelihood of each person's log elements, and its marginal under a normal population.

Near its mode, a person's log likelihood is

.. math:: \ln p(z_i\,|\,\theta) = b_i^T\theta - \tfrac12\,\theta^T H_i\,\theta + \text{const},

where H may be singular: the band need not determine every element. With :math:`\theta_i \sim N(m_i, T)`, any root
:math:`T = LL^T` and :math:`g_i = b_i - H_i m_i` the integral over the elements has the closed form

.. math:: \ln p_i = b_i^T m_i - \tfrac12 m_i^T H_i m_i - \tfrac12 \ln|I + L^T H_i L|
          + \tfrac12\, g_i^T L\,(I + L^T H_i L)^{-1} L^T g_i ,

which needs no inverse of H, nor of T.

Tests based on it: whether elements follow a covariate or drift
(:mod:`bayes_impedance.diagnosis.heterogeneity.regression`), vary together
(:mod:`bayes_impedance.diagnosis.heterogeneity.correlations`), or differ in a group of people
(:mod:`bayes_impedance.diagnosis.heterogeneity.subgroups`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.population.e_step import information_on_each, standard_errors


@dataclass(frozen=True)
class PersonLikelihoods:
    """Log likelihoods of N persons' P log elements: linear . theta - theta^T information theta / 2.

    Attributes
    ----------
    elements : tuple of str
    linear : ndarray, shape (N, P)
    information : ndarray, shape (N, P, P)
        Symmetric, positive semidefinite, possibly singular; `linear` lies in its range.
    """

    elements: tuple[str, ...]
    linear: np.ndarray
    information: np.ndarray

    def __post_init__(self) -> None:
        n, p = len(self), len(self.elements)
        if self.linear.shape != (n, p) or self.information.shape != (n, p, p):
            raise InputError(
                f"likelihoods of {p} elements: linear has shape {self.linear.shape} and information "
                f"{self.information.shape}, give (N, {p}) and (N, {p}, {p})"
            )
        if not (np.all(np.isfinite(self.linear)) and np.all(np.isfinite(self.information))):
            raise InputError("likelihoods contain numbers that are not finite: leave those subjects out")

    def __len__(self) -> int:
        return int(self.linear.shape[0])

    def around(self, centre: np.ndarray) -> PersonLikelihoods:
        """The same likelihoods of theta - centre; centre (P,) or (N, P)."""
        shift = np.einsum("npq,nq->np", self.information, np.broadcast_to(centre, self.linear.shape))
        return PersonLikelihoods(self.elements, self.linear - shift, self.information)

    def persons(self, chosen: np.ndarray) -> PersonLikelihoods:
        """Likelihoods of some persons, by a mask or by indices."""
        return PersonLikelihoods(self.elements, self.linear[chosen], self.information[chosen])


def log_marginal(likelihoods: PersonLikelihoods, means: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Log likelihood of each person with the elements integrated out.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
    means : ndarray, shape (N, P) or (P,)
        Of the population at each person.
    covariance : ndarray, shape (P, P)
        Between persons; it may be singular, or zero.

    Returns
    -------
    ndarray, shape (N,)
        Up to the constant that each log likelihood is given with.
    """
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    means = np.broadcast_to(means, likelihoods.linear.shape)
    gradient = likelihoods.around(means).linear
    inner = np.eye(means.shape[1]) + root.T @ likelihoods.information @ root
    white = gradient @ root
    gain = np.einsum("np,np->n", white, np.linalg.solve(inner, white[..., None])[..., 0])
    at_mean = np.einsum("np,np->n", means, likelihoods.linear + gradient)
    return np.asarray(0.5 * (at_mean + gain - np.linalg.slogdet(inner)[1]))


def data_sd(likelihoods: PersonLikelihoods, covariance: np.ndarray) -> np.ndarray:
    """Standard error of a common log element from all data together, the others free within the population, (P,)."""
    return standard_errors(information_on_each(likelihoods.information, np.linalg.inv(covariance)))
