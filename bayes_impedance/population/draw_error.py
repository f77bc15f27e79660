r"""The error that the finite number of importance draws leaves in a population's posterior.

The log likelihood of person i under population s is the logarithm of a mean over K draws. With :math:`w_{ik}(s)` the
weights of the draws, normalised to sum to one, its error is to first order :math:`\sum_k w_{ik}(s)\,\epsilon_{ik}`,
where the :math:`\epsilon_{ik}` are independent, of variance one, and **the same for every population**. What is common
to all populations does no harm. The posterior mean of a function f of the population parameters is shifted by the
covariance of f with the error of the log likelihood over the posterior, so its variance over repeated draws is

.. math:: \operatorname{var} \hat f \approx \sum_{ik} \operatorname{Cov}_s\big(f(s),\, w_{ik}(s)\big)^2 .

With z a coordinate, transformed by its ranks so that it is a standard normal, the ends of its 90 % interval are
:math:`\bar z \pm 1.645` times its spread, so that :math:`f = z \pm 1.645\,(z^2 - 1)/2` is the first-order influence on
them; without the ranks a single far population would determine it. The result is the standard error of the worst end of
all coordinates, in posterior standard deviations. It is found from populations of the chain; the effective number of
draws near the mode says nothing about tails, nor about which differences between populations matter.

First order means that regions must have draws. If the weights of a person collapse to a few draws where the chain goes,
the true error is larger than the estimate; so the smallest effective number of draws over persons,
:math:`\min_i 1/\sum_k w_{ik}^2`, is kept too, at its 5 % quantile over populations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from bayes_impedance.display import Brief
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.sharded_likelihood import KeptDraws
from bayes_impedance.units import NORMAL_Q95

ERROR_WANTED = 0.08
"""Standard error of the ends of 90 % intervals by the draws, in posterior standard deviations, up to which draws hold.
By choice, a little below the chain's own error, which is 0.086 with the 600 effective samples of a quick fit:
sqrt(0.05 * 0.95 / 600) over the normal density at the 5 % quantile. Measured: below 0.02 where the band is wide, with 2
to 71 persons; 0.1 to 0.45 in narrow bands, where it is met by draws made anew."""

POPULATIONS = 256
"""Populations of the chain over which covariances are taken. By choice: as many independent ones find 0.1 of the
standard deviation of the log likelihood's error even if nothing goes with it; that is 0.01 where the error is met."""

_RARELY = 0.05
"""Quantile over populations of the smallest effective number of draws: the tail that a 90 % interval is about."""


@dataclass(frozen=True, kw_only=True, repr=False)
class DrawError(Brief):
    """Error by the finite number of draws.

    Attributes
    ----------
    interval_end : float
        Standard error of the worst end of a 90 % interval over the sampled coordinates, in posterior standard
        deviations; infinite if weights are not finite.
    least_effective : float
        Effective number of draws of the worst person, 5 % quantile over populations of the chain.
    beyond : float
        Largest share of an element's dispersions between repetitions beyond one end of the range in which the draws'
        likelihoods are known (:mod:`bayes_impedance.population.moved_dispersions`).
    """

    interval_end: float
    least_effective: float
    beyond: float = 0.0


def draw_error(marginal: KeptDraws, coordinates: np.ndarray, parameters: PopulationParameters) -> DrawError:
    """Estimate the error by the draws.

    Parameters
    ----------
    marginal : KeptDraws
    coordinates : ndarray, shape (S, D)
        Sampled from the posterior.
    parameters : PopulationParameters
        The same S sets.
    """
    rows = np.unique(np.linspace(0, len(coordinates) - 1, POPULATIONS).astype(int))
    some = coordinates[rows]
    ranks = some.argsort(axis=0, kind="stable").argsort(axis=0)
    z = ndtri((ranks + 0.5) / len(rows))
    bend = 0.5 * NORMAL_Q95 * (z**2 - 1)
    influence = np.hstack([z + bend, z - bend])
    influence -= influence.mean(axis=0)
    squares, least = marginal.influences(parameters[rows], influence / len(rows))
    if not (np.all(np.isfinite(squares)) and np.all(np.isfinite(least))):
        return DrawError(interval_end=np.inf, least_effective=0.0)
    return DrawError(interval_end=float(np.sqrt(squares.max())), least_effective=float(np.quantile(least, _RARELY)))


def noise_within(variance: float, n_persons: int, n_coordinates: int) -> float:
    """Monte-Carlo variance of log-likelihood differences inside the posterior.

    The same draws serve every population, so only the change of their error between populations matters. The error
    changes when a population moves by its own dispersion. The posterior of N persons is narrower than the dispersion by
    the square root of N, in each of its D coordinates: of the variance V, V D/N remains.
    """
    return variance * min(1.0, n_coordinates / n_persons)
