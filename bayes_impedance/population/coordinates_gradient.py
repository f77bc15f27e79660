r"""From derivatives with respect to population parameters to those with respect to the sampled coordinates.

The coordinates are those of :mod:`bayes_impedance.population.parameters`. With S the derivative with respect to
:math:`\Sigma = D L L^T D`, :math:`D = \operatorname{diag}\tau`, those with respect to dispersions and to the Cholesky
factor L of the correlation matrix are

.. math:: \frac{\partial}{\partial \tau_p} = 2\,(S D L L^T)_{pp}, \qquad
          \frac{\partial}{\partial L} = 2\, D S D L \ \text{(lower triangle)} .

Row i of L is :math:`L_{ij} = r_{ij} \prod_{k<j} \sqrt{1 - r_{ik}^2}` with :math:`r_{ii} = 1`, and
:math:`r = \tanh u`, hence :math:`\partial L_{ij}/\partial u_{ik} = -r_{ik} L_{ij}` for k < j, and
:math:`(1 - r_{ij}^2) \prod_{k<j} \sqrt{1 - r_{ik}^2}` for k = j.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.population.heavy_tails import tail_slope
from bayes_impedance.population.likelihood_gradient import ParameterGradient
from bayes_impedance.population.parameters import Coordinates, PopulationParameters
from bayes_impedance.population.two_components import share_slope


def pulled_back(
    coordinates: Coordinates, vector: np.ndarray, parameters: PopulationParameters, gradient: ParameterGradient
) -> np.ndarray:
    """Gradient of the log posterior density, likelihood and prior, with respect to the coordinates.

    Parameters
    ----------
    coordinates : Coordinates
    vector : ndarray, shape (W, D)
    parameters : PopulationParameters
        The same sets: ``coordinates.unpack(vector)``.
    gradient : ParameterGradient
        Of the log likelihood.

    Returns
    -------
    ndarray, shape (W, D)
    """
    free, prior = np.array(coordinates.free, dtype=int), coordinates.prior
    centre, persons, repetitions, slopes, partial, tail, separation, share, shared = coordinates.blocks(vector)
    tau, factor = parameters.between_persons, parameters.correlation_cholesky
    scaled = gradient.covariance * tau[:, None, :]  # S D
    on_tau = 2 * np.einsum("wpq,wqp->wp", scaled, parameters.correlation)
    parts = [
        coordinates.centres.slope(centre, gradient.mu[:, free]),
        on_tau[:, free] * coordinates.dispersion_slope(persons, coordinates.bend_persons)
        + coordinates.dispersion_prior_slope(persons, coordinates.bend_persons),
    ]
    if coordinates.repetitions:
        bend = coordinates.bend_repetitions
        on_rho = gradient.between_repetitions[:, free] * coordinates.dispersion_slope(repetitions, bend)
        parts.append(on_rho + coordinates.dispersion_prior_slope(repetitions, bend))
    parts.append(prior.slope_sd * gradient.slopes[:, free].reshape(slopes.shape) - slopes)
    if coordinates.correlated:
        on_factor = 2 * tau[:, :, None] * scaled @ factor
        block = (slice(None), free[:, None], free)
        on_partial = _through_partial(on_factor[block], factor[block], np.tanh(partial))
        parts.append(on_partial - 2 * coordinates.levels() * np.tanh(partial))
    if coordinates.tails:
        parts.append(gradient.tail[:, None] * tail_slope(tail) - tail)
    if coordinates.groups:
        parts.append(coordinates.separation_unit * gradient.separation[:, free] - separation)
        parts.append(gradient.share[:, None] * share_slope(share) - share)
    if coordinates.shared_free:
        on_shared = gradient.shared[:, list(coordinates.shared_free)]
        parts.append(np.einsum("ws,wst->wt", on_shared, coordinates.shared_slope(shared)) - shared)
    return np.concatenate(parts, axis=1)


def _through_partial(on_factor: np.ndarray, factor: np.ndarray, partial: np.ndarray) -> np.ndarray:
    """Derivatives with respect to atanh of the partial correlations (W, n (n-1)/2), from those to the factor."""
    result = np.empty_like(partial)
    k, n = 0, factor.shape[1]
    products = on_factor * factor
    for i in range(1, n):
        rest = np.ones(len(partial))
        for j in range(i):
            r = partial[:, k]
            result[:, k] = on_factor[:, i, j] * (1 - r**2) * rest - r * products[:, i, j + 1 : i + 1].sum(axis=1)
            rest = rest * np.sqrt(1 - r**2)
            k += 1
    return result
