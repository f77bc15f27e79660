"""Short runs of the sampler on a normal distribution, and comparison of their results."""

from __future__ import annotations

import numpy as np

from bayes_impedance.mcmc.ensemble import (
    Chains,
    SamplerSettings,
    sample,
)

D = 20
SHORT = SamplerSettings(ensembles=2, burn_in=(20, 30), chunk=20, longest=60, rhat=0.0, effective=np.inf)


def silent(stage, done, total):
    """Progress that nobody watches."""


class Gaussian:
    """A correlated normal distribution, vectorised."""

    def __init__(self, dimensions=D, seed=0, mean=None):
        rng = np.random.default_rng(seed)
        a = rng.normal(size=(dimensions, 2 * dimensions))
        scale = np.exp(rng.normal(0, 1, dimensions))
        self.mean = 3 * rng.normal(size=dimensions) if mean is None else mean
        self.covariance = scale[:, None] * (a @ a.T / (2 * dimensions)) * scale
        self.precision = np.linalg.inv(self.covariance)
        self.sd = np.sqrt(np.diag(self.covariance))

    def __call__(self, x):
        offset = x - self.mean
        return -0.5 * np.einsum("wi,ij,wj->w", offset, self.precision, offset)

    def normal_scores(self, x):
        """Independent standard normal numbers, if x follows this distribution."""
        return np.linalg.solve(np.linalg.cholesky(self.covariance), (x - self.mean).T).T


def as_bytes(chains):
    return tuple(np.ascontiguousarray(getattr(chains, name)).tobytes() for name in Chains.__dataclass_fields__)


def run(seed=1, settings=SHORT, log_probability=None, checkpoint=None):
    target = Gaussian(5, seed=1)
    log_probability = log_probability or target
    return sample(log_probability, target.mean, target.sd, settings, np.random.SeedSequence(seed), silent, checkpoint)


def changed(settings, **fields):
    return SamplerSettings(**{**settings.__dict__, **fields})
