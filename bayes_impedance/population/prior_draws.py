"""Draws of population parameters from their prior, through the coordinates in which the posterior is sampled."""

from __future__ import annotations

import numpy as np

from bayes_impedance.population.parameters import Coordinates, PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.whole import all_columns


def draw_prior(
    prior: Prior,
    n: int,
    seed: int | np.random.Generator,
    *,
    shared: np.ndarray | None = None,
    correlated: bool = True,
    repetitions: bool = True,
    n_covariates: int = 0,
    tails: bool = False,
    groups: bool = False,
) -> PopulationParameters:
    """Draw sets of population parameters from a prior.

    Parameters
    ----------
    prior : Prior
        Of P parameters.
    n : int
        Number of sets.
    seed : int or Generator
    shared : ndarray of bool, shape (P,), optional
        Which parameters are the same for everybody; none if not given.
    correlated : bool
        Whether the covariance is full.
    repetitions : bool
        Whether there is a dispersion between repetitions.
    n_covariates : int
    tails : bool
        Whether the population is a Student t.
    groups : bool
        Whether it has two groups.

    Returns
    -------
    PopulationParameters
        With a column for every parameter; a shared one has no dispersion.
    """
    rng = np.random.default_rng(seed)
    p = prior.centre.size
    same = np.zeros(p, dtype=bool) if shared is None else np.asarray(shared, dtype=bool)
    varying, common = np.flatnonzero(~same), np.flatnonzero(same)
    v = varying.size
    coordinates = Coordinates(
        prior=prior.of(varying),
        correlated=correlated,
        repetitions=repetitions,
        n_covariates=n_covariates,
        free=tuple(range(v)),
        held_mu=np.zeros(v),
        held_dispersion=np.zeros(v),
        shared_prior=prior.of(common) if common.size else None,
        shared_free=tuple(range(common.size)),
        held_shared=np.zeros(common.size) if common.size else None,
        tails=tails,
        groups=groups,
    )
    vector = rng.normal(size=(n, coordinates.n_dimensions))
    if coordinates.centres.order:
        vector[:, :v] = coordinates.centres.drawn(n, rng)
    if correlated and v > 1:
        # Partial correlations are Beta(b, b) on (-1, 1), and their coordinates atanh of them.
        partial = 2 * rng.beta(coordinates.levels(), coordinates.levels(), size=(n, v * (v - 1) // 2)) - 1
        start = sum(coordinates.sizes[:4])
        vector[:, start : start + partial.shape[1]] = np.arctanh(partial)
    drawn = coordinates.unpack(vector)
    return all_columns(drawn, varying, common) if common.size else drawn
