"""Distributions of people around a mean, with a covariance: normal, Student t, or two groups.

In the coordinates in which the mean is zero and the covariance one (of a Student t: its scale matrix) the three differ
only by what :mod:`bayes_impedance.population.heavy_tails` and :mod:`bayes_impedance.population.two_components` say.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.population.heavy_tails import drawn_factors, log_t, mixture_of
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.two_components import Groups, drawn_people, parts_of_groups


def standard_people(
    normal: np.ndarray, tail: np.ndarray | None, groups: Groups | None, rng: np.random.Generator
) -> np.ndarray:
    """People of W populations in these coordinates.

    Parameters
    ----------
    normal : ndarray, shape (W, ..., P)
        Standard normal; it is returned if the populations are normal.
    tail : ndarray, shape (W,), optional
        Reciprocal degrees of freedom of Student t populations.
    groups : Groups, optional
        Of W populations of two groups.
    rng : Generator

    Returns
    -------
    ndarray, shape (W, ..., P)
    """
    if tail is not None:
        each = np.reshape(tail, (-1, *np.ones(normal.ndim - 2, dtype=int)))
        return np.asarray(normal * drawn_factors(each, normal.shape[:-1], rng)[..., None])
    return normal if groups is None else drawn_people(groups, normal, rng)


def log_standard_density(white: np.ndarray, tail: float | None, groups: Groups | None) -> np.ndarray:
    """Log density of people (N, P) in these coordinates, shape (N,), relative to (2 pi)^(-P/2); groups of one set."""
    square = np.sum(white**2, axis=1)
    if tail is not None:
        return log_t(square, tail, white.shape[1])
    if groups is not None:
        return np.asarray(np.logaddexp.reduce(groups.of_people(white[None]), axis=-1)[0])
    return np.asarray(-0.5 * square)


def normal_parts(parameters: PopulationParameters) -> tuple[PopulationParameters, np.ndarray]:
    """The G normal populations of which each of W populations is a mixture.

    Returns
    -------
    parts : PopulationParameters
        W G sets, those of one mixture one after the other.
    log_weight : ndarray, shape (W, G)
    """
    if parameters.groups is not None:
        return parts_of_groups(parameters)
    mixture = mixture_of(parameters)
    return mixture.parameters, mixture.log_weight
