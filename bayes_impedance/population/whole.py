"""From the parameters that are sampled to all parameters of the network, in the units of their own scales.

A fit samples the parameters that differ between people and those that are the same for all in blocks of their own, the
signed ones in units of their natural values. What leaves the fit has one column for each parameter of the network, in
the network's order: a shared one has no dispersion and the same value for everybody.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.shared import Pooling


class Whole:
    """The map to all P parameters of a network.

    Parameters
    ----------
    pooling : Pooling
        Of the kernel in which the fit was made.

    Attributes
    ----------
    kernel : Kernel
        In which a signed parameter is its own value.
    """

    def __init__(self, pooling: Pooling) -> None:
        self.pooling = pooling
        self.kernel = Kernel(pooling.kernel.network) if pooling.kernel.scales else pooling.kernel
        scales = pooling.kernel.scales
        signed = {p.name for p in pooling.kernel.parameters if p.link == SIGNED}
        self.unit = np.array([scales.get(name, 1.0) if name in signed else 1.0 for name in pooling.kernel.elements])

    def parameters(self, sampled: PopulationParameters) -> PopulationParameters:
        """W sets with a column for every parameter."""
        if not self.pooling.names:
            return replace(sampled, mu=sampled.mu * self.unit, between_persons=sampled.between_persons * self.unit)
        complete = all_columns(sampled, self.pooling.varying, self.pooling.shared)
        return replace(complete, mu=complete.mu * self.unit)

    def persons(self, theta: np.ndarray, shared: np.ndarray | None) -> np.ndarray:
        """Everybody's parameters, (W, N, P), of varying ones (W, N, V) and shared ones (W, S).

        If all are varying logarithms it is the array that was given: of many people it is the largest there is.
        """
        whole = self.pooling.whole(theta, shared[:, None, :]) if shared is not None and self.pooling.names else theta
        return whole if np.all(self.unit == 1.0) else np.asarray(whole * self.unit)

    def without(self, varying: np.ndarray) -> np.ndarray:
        """Deviations or dispersions (..., P) of varying parameters (..., V); zero for the shared ones."""
        return self.pooling.whole(varying, np.zeros(len(self.pooling.names)))

    def prior(self, prior: Prior) -> Prior:
        """The prior in the units of the parameters' own scales."""
        if np.all(self.unit == 1.0):
            return prior
        return replace(
            prior,
            centre=prior.centre * self.unit,
            centre_sd=prior.centre_sds * self.unit,
            dispersion_sd=prior.dispersion_sds * self.unit,
        )


def all_columns(sampled: PopulationParameters, varying: np.ndarray, shared: np.ndarray) -> PopulationParameters:
    """W sets with a column for every parameter; a shared one has no dispersion.

    Parameters
    ----------
    sampled : PopulationParameters
        Of V varying parameters, with the values of S shared ones.
    varying, shared : ndarray of int, shape (V,) and (S,)
        Columns of the parameters, P = V + S.
    """
    assert sampled.shared is not None  # there are shared parameters
    w, p = len(sampled.mu), varying.size + shared.size
    mu, tau, rho = np.empty((w, p)), np.zeros((w, p)), np.zeros((w, p))
    mu[:, varying], mu[:, shared] = sampled.mu, sampled.shared
    tau[:, varying], rho[:, varying] = sampled.between_persons, sampled.between_repetitions
    cholesky, slopes = np.tile(np.eye(p), (w, 1, 1)), np.zeros((w, p, sampled.slopes.shape[2]))
    cholesky[:, varying[:, None], varying] = sampled.correlation_cholesky
    slopes[:, varying] = sampled.slopes
    groups = sampled.groups
    if groups is not None:
        separation = np.zeros((w, p))
        separation[:, varying] = groups.separation
        groups = replace(groups, separation=separation)
    return PopulationParameters(
        mu=mu,
        between_persons=tau,
        correlation_cholesky=cholesky,
        between_repetitions=rho,
        slopes=slopes,
        shared=sampled.shared,
        tail=sampled.tail,
        groups=groups,
    )
