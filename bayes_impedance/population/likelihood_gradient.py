r"""The gradient of the population likelihood with respect to the population's parameters.

By Fisher's identity the gradient of a log marginal likelihood is the posterior mean of that of the complete data. With
the weights of a person's draws, in the coordinates u in which the reference population is a standard normal (factor
:math:`F`), under a population of mean v and precision A there,

.. math:: \frac{\partial \ln p}{\partial v} = A\,(\mathrm E[u] - v), \qquad
          \frac{\partial \ln p}{\partial T} = \tfrac12\, T^{-1}
          \Big(F\,\mathrm E\big[(u - v)(u - v)^T\big]\,F^T - T\Big)\, T^{-1},

where T is the covariance of a person's mean over J repetitions, :math:`\Sigma + \operatorname{diag}(\rho^2)/J`. The
moments are one more matrix product of weights with the same monomials from which the weights are computed. Monomials in
parameters that are the same for everybody change the draws' log likelihoods, with their mean coefficients, and shift v
along the person's path (:mod:`bayes_impedance.population.shared_draws`); so do those in dispersions between repetitions
(:mod:`bayes_impedance.population.moved_dispersions`), without a shift. Where draws are sheared
(:mod:`bayes_impedance.population.shears`), Mu stands in the place of u, and

.. math:: \frac{\partial \ln p}{\partial M} = M^{-T} - A\,\mathrm E\big[(M u - v)\,u^T\big] .

**With tails** (:mod:`bayes_impedance.population.heavy_tails`) the likelihood of person i is the sum over nodes g of
:math:`w_g\,p_{ig}`, with the normal population of covariance :math:`\lambda_g\Sigma` at each. By the same identity its
gradient is the mean of theirs with the probability :math:`r_{ig} = w_g p_{ig}/\sum_h w_h p_{ih}` of each node. With
respect to :math:`\kappa = 1/\nu` it is :math:`\sum_{ig} r_{ig}\,\partial_\kappa \ln w_g` and, as the nodes move too,
:math:`\sum_g \partial_\kappa \ln\lambda_g \sum_{pq} S^g_{pq}\,\lambda_g\Sigma_{pq}`, where :math:`S^g` is the
derivative with respect to the covariance at node g.

**Of two groups** (:mod:`bayes_impedance.population.two_components`) it is the mean over groups in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from bayes_impedance.population.exponentials import normalise_rows
from bayes_impedance.population.heavy_tails import mixture_of
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.shapes import normal_parts
from bayes_impedance.population.shared_draws import monomial_slopes
from bayes_impedance.population.shears import sheared_moments
from bayes_impedance.population.two_components import through_groups


@dataclass(frozen=True, kw_only=True)
class ParameterGradient:
    """Derivatives of a log density with respect to W sets of population parameters.

    Attributes
    ----------
    mu : ndarray, shape (W, P)
    covariance : ndarray, shape (W, P, P)
        With respect to the covariance between persons: symmetric, a small change dS changes the density by the sum of
        the products of entries.
    between_repetitions : ndarray, shape (W, P)
    slopes : ndarray, shape (W, P, Q)
    shared : ndarray, shape (W, S)
    tail : ndarray, shape (W,)
        With respect to the reciprocal degrees of freedom; zero of normal populations.
    share : ndarray, shape (W,)
    separation : ndarray, shape (W, P)
        Of two groups; zero if there are none.
    """

    mu: np.ndarray
    covariance: np.ndarray
    between_repetitions: np.ndarray
    slopes: np.ndarray
    shared: np.ndarray
    tail: np.ndarray
    share: np.ndarray
    separation: np.ndarray

    def __add__(self, other: ParameterGradient) -> ParameterGradient:
        return ParameterGradient(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})


def likelihood_gradient(marginal: ImportanceLikelihood, parameters: PopulationParameters) -> ParameterGradient:
    """Gradient of the log likelihood of W sets of population parameters, summed over persons.

    Parameters
    ----------
    marginal : ImportanceLikelihood
    parameters : PopulationParameters
    """
    return _of_mixture(marginal, parameters) if parameters.mixed else _normal(marginal, parameters, None)


def _of_mixture(marginal: ImportanceLikelihood, parameters: PopulationParameters) -> ParameterGradient:
    """The gradient of populations with tails, or of two groups."""
    parts, log_weight = normal_parts(parameters)
    shape = log_weight.shape
    node = marginal.terms(parts)[0] + log_weight.reshape(-1, 1)
    node = node.reshape(*shape, node.shape[1]) - marginal.terms(parameters)[0][:, None]
    probability = np.exp(node)
    each = _normal(marginal, parts, probability.reshape(-1, node.shape[2]))

    def by_node(values: np.ndarray) -> np.ndarray:
        return values.reshape(*shape, *values.shape[1:])

    repetitions = by_node(each.between_repetitions).sum(axis=1)
    for contrasts in marginal.contrasts:
        repetitions = repetitions + contrasts.slope(parameters.between_repetitions)
    whole = replace(
        each,
        mu=by_node(each.mu).sum(axis=1),
        between_repetitions=repetitions,
        slopes=by_node(each.slopes).sum(axis=1),
        shared=by_node(each.shared).sum(axis=1),
        tail=np.zeros(shape[0]),
        share=np.zeros(shape[0]),
        separation=np.zeros(parameters.mu.shape),
    )
    if parameters.groups is not None:
        on_within = by_node(each.covariance).sum(axis=1)
        found = through_groups(parameters, by_node(each.mu), on_within, probability.sum(axis=2))
        return replace(whole, covariance=found[0], share=found[1], separation=found[2])
    mixture = mixture_of(parameters)
    on_factor = np.sum(each.covariance * parts.covariance, axis=(1, 2)).reshape(shape)
    factor = np.exp(mixture.log_factor).reshape(-1, 1, 1)
    return replace(
        whole,
        covariance=by_node(factor * each.covariance).sum(axis=1),
        tail=np.sum(probability.sum(axis=2) * mixture.weight_slope + on_factor * mixture.factor_slope, axis=1),
    )


def _normal(
    marginal: ImportanceLikelihood, parameters: PopulationParameters, probability: np.ndarray | None
) -> ParameterGradient:
    """The gradient of normal populations; if persons count in part, (W, N), that of these parts without contrasts."""
    n_sets, n_elements = parameters.mu.shape
    factor, rows, columns = marginal.reference_factor, *marginal.pairs
    n_squares, n_quadratic = rows.size, rows.size + n_elements
    moving = marginal.moving(parameters)
    mean = np.zeros((n_sets, n_elements))
    slopes = np.zeros((n_sets, n_elements, marginal.covariates.shape[1]))
    on_monomials = np.zeros((n_sets, moving.shape[1]))
    on_terms: np.ndarray | float = 0.0
    on_shears: np.ndarray | float = 0.0
    scatter = {int(j): np.zeros((n_sets, n_elements, n_elements)) for j in np.unique(marginal.repetitions)}
    precisions = {j: marginal.population_in_reference(parameters, j)[0] for j in scatter}
    all_moments = _moments(marginal, parameters, probability)
    for j in scatter:
        persons = np.flatnonzero(marginal.repetitions == j)
        moments = all_moments[:, persons]
        v = np.broadcast_to(
            marginal.means_in_reference(parameters, persons, moving), (n_sets, persons.size, n_elements)
        )
        counted = np.ones((n_sets, persons.size)) if probability is None else probability[:, persons]
        part = counted[..., None] * v  # moments are weighted too
        first, squares = moments[:, :, n_squares:n_quadratic], moments[:, :, :n_squares]
        if moving.size:
            t, shears = np.ascontiguousarray(moving[:, : marginal.shears.shape[1]]), marginal.shears_in_u[persons]
            first, squares, own = sheared_moments(precisions[j], v, counted, t, shears, first, squares, rows, columns)
            on_shears += own
        squares = squares.sum(axis=1)
        cross = np.swapaxes(first, 1, 2) @ v
        scatter[j] += np.swapaxes(part, 1, 2) @ v - cross - np.swapaxes(cross, 1, 2)
        scatter[j][:, rows, columns] += squares
        scatter[j][:, columns, rows] += squares * (rows != columns)
        pull = (first - part) @ precisions[j] @ marginal.whitening
        mean += pull.sum(axis=1)
        slopes += np.swapaxes(pull, 1, 2) @ marginal.covariates[persons]
        if moving.size:
            on_monomials += moments[:, :, n_quadratic + 1 : n_quadratic + 1 + moving.shape[1]].sum(axis=1)
            path = np.moveaxis(marginal.path[persons], 1, 0)
            on_monomials -= pull.reshape(n_sets, -1) @ path.reshape(len(path), -1).T
        if marginal.span is not None:
            on_terms = on_terms + moments[:, :, n_quadratic + 1 + moving.shape[1] :].sum(axis=1)
    covariance = np.zeros((n_sets, n_elements, n_elements))
    repetitions = np.zeros((n_sets, n_elements))
    for j, spread in scatter.items():
        alike = marginal.repetitions == j
        n = int(np.sum(alike)) if probability is None else probability[:, alike].sum(axis=1)[:, None, None]
        inverse = marginal.whitening.T @ precisions[j] @ marginal.whitening  # of T
        own = 0.5 * (inverse @ (factor @ spread @ factor.T) @ inverse - n * inverse)
        covariance += own
        repetitions += 2 * parameters.between_repetitions / j * np.diagonal(own, axis1=1, axis2=2)
    for contrasts in marginal.contrasts if probability is None else ():
        repetitions += contrasts.slope(parameters.between_repetitions)
    if marginal.span is not None:
        repetitions += marginal.span.slopes(parameters.between_repetitions, np.asarray(on_terms))
    shared = np.zeros((n_sets, 0))
    if marginal.sharing is not None and parameters.shared is not None:
        turning = monomial_slopes(marginal.sharing.standardised(parameters.shared))
        shared = marginal.sharing.slopes(np.einsum("wm,wms->ws", on_monomials, turning) + on_shears)
        shared = shared * (marginal.sharing.beyond(parameters.shared) == 0.0)[:, None]  # at the edge draws stay
    return ParameterGradient(
        mu=mean,
        covariance=covariance,
        between_repetitions=repetitions,
        slopes=slopes,
        shared=shared,
        tail=np.zeros(n_sets),
        share=np.zeros(n_sets),
        separation=np.zeros((n_sets, n_elements)),
    )


def _moments(
    marginal: ImportanceLikelihood, parameters: PopulationParameters, probability: np.ndarray | None
) -> np.ndarray:
    """Means of every person's monomials over the weighted draws, (W, N, m); parts of them where persons count so."""
    n_monomials = marginal.pairs[0].size + len(marginal.blocks[0][2])
    result = np.empty((len(parameters.mu), marginal.repetitions.size, n_monomials))
    features = np.empty((0, 0), dtype=np.float32)
    for (persons, values, _), (_, _, coordinates) in zip(marginal.exponents(parameters), marginal.blocks, strict=True):
        normalise_rows(values)
        if probability is not None:
            values *= probability[:, persons, None].astype(np.float32)
        features = marginal.monomials(coordinates, features)
        own = features.reshape(len(features), persons.size, marginal.n_draws)
        result[:, persons] = np.swapaxes(np.swapaxes(values, 0, 1) @ own.transpose(1, 2, 0), 0, 1)
    return result
