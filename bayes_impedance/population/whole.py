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
        assert sampled.shared is not None  # there are shared parameters
        w, v = len(sampled.mu), self.pooling.varying
        cholesky = np.tile(np.eye(self.unit.size), (w, 1, 1))
        cholesky[:, v[:, None], v] = sampled.correlation_cholesky
        slopes = np.zeros((w, self.unit.size, sampled.slopes.shape[2]))
        slopes[:, v] = sampled.slopes
        return PopulationParameters(
            mu=self.pooling.whole(sampled.mu, sampled.shared) * self.unit,
            between_persons=self.without(sampled.between_persons),
            correlation_cholesky=cholesky,
            between_repetitions=self.without(sampled.between_repetitions),
            slopes=slopes,
            shared=sampled.shared,
        )

    def persons(self, theta: np.ndarray, shared: np.ndarray | None) -> np.ndarray:
        """Everybody's parameters, (W, N, P), of varying ones (W, N, V) and shared ones (W, S)."""
        if shared is None or not self.pooling.names:
            return np.asarray(theta * self.unit)
        return np.asarray(self.pooling.whole(theta, shared[:, None, :]) * self.unit)

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
