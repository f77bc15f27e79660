"""Populations with heavier tails: the mixture against the t density and quadrature, limits, gradients, draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from persons_with_draws import (
    REFERENCE_COVARIANCE,
    N,
    P,
    contrasts_of,
    gaussian_draws,
    parameters,
    people,
    require_gradient,
)
from scipy.integrate import quad
from scipy.stats import invgamma, kstest, multivariate_normal, multivariate_t

from bayes_impedance.population.heavy_tails import (
    FARTHEST,
    HEAVIEST,
    coordinate_of,
    drawn_factors,
    estimated_tail,
    log_t,
    mixture_of,
    nodes_of,
    tail_of,
    weights_of,
)
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.parameters import Coordinates, PopulationParameters
from bayes_impedance.population.prior import Prior

STEP = 1e-2
"""Of differences in coordinates: likelihoods are in single precision."""


def with_tails(sets: PopulationParameters, degrees_of_freedom: float) -> PopulationParameters:
    return replace(sets, tail=np.full(len(sets.mu), 1 / degrees_of_freedom))


def likelihood_of_people(n_draws: int = 4096, n_covariates: int = 0) -> tuple[ImportanceLikelihood, np.ndarray]:
    centres, covariances, repetitions = people()
    covariates = np.random.default_rng(1).normal(size=(N, n_covariates))
    draws, constants = gaussian_draws(centres, covariances, np.zeros((N, P)), n_draws, 2)
    contrasts = [contrasts_of(c, n=3, seed=c) for c in (1, 2)]
    means = np.zeros((N, P))
    return ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, covariates, contrasts), constants


@pytest.mark.parametrize("p", [1, 3, 8])
@pytest.mark.parametrize("nu", [2.1, 4, 30, 1e3, 1e5])
def test_nodes_give_the_density_of_a_t_distribution(p, nu):
    x, weight = (own[0][:, None] for own in nodes_of(np.array([1 / nu]), p))
    near, far = np.linspace(0, 100, 201), np.linspace(100, FARTHEST, 51)
    for square, error in ((near, 0.006), (far, 0.02)):
        value = np.logaddexp.reduce(weight - 0.5 * p * x - 0.5 * np.exp(-x) * square, axis=0)
        point = np.zeros((square.size, p))
        point[:, 0] = np.sqrt(square)
        exact = multivariate_t(np.zeros(p), np.eye(p), df=nu).logpdf(point) + 0.5 * p * np.log(2 * np.pi)
        np.testing.assert_allclose(value, exact, atol=error)
        np.testing.assert_allclose(log_t(square, 1 / nu, p), exact, atol=1e-7)


def test_likelihood_of_persons_against_quadrature_over_the_factor():
    """Persons with normal likelihoods: for one factor lambda their density is normal, and quad integrates over it."""
    centres, covariances, repetitions = people()
    marginal, constants = likelihood_of_people()
    sets = with_tails(parameters(2), 3.0)
    terms, effective = marginal.terms(sets)[0], marginal.terms(sets, effective=True)[1]
    expected = np.empty((2, N))
    for w in range(2):
        for i, (m, c, j) in enumerate(zip(centres, covariances, repetitions, strict=True)):

            def density(x, w=w, m=m, c=c, j=j):
                factor = np.exp(x)
                own = factor * sets.covariance[w] + np.diag(sets.between_repetitions[w] ** 2) / j + c
                return invgamma(1.5, scale=1.5).pdf(factor) * factor * multivariate_normal(sets.mu[w], own).pdf(m)

            expected[w, i] = np.log(quad(density, -8, 12, limit=200)[0])
    error = np.sqrt(1 / effective - 1 / 4096)
    assert np.all(np.abs(terms + constants - expected) < 5 * error + 0.005)
    assert error.max() < 0.05


def test_of_many_degrees_of_freedom_is_the_normal_population():
    marginal, _ = likelihood_of_people(512)
    normal = parameters(5)
    limit = with_tails(normal, 1e6)
    np.testing.assert_allclose(marginal.terms(limit)[0], marginal.terms(normal)[0], atol=1e-3)
    np.testing.assert_allclose(marginal(limit), marginal(normal), atol=1e-3 * N)
    np.testing.assert_allclose(marginal.variance(limit), marginal.variance(normal), rtol=1e-2)
    finite = marginal.terms(with_tails(normal, 4.0))[0] - marginal.terms(normal)[0]
    assert np.abs(finite).max() > 0.05  # the limit is one


def test_both_ways_to_sum_over_nodes_agree(monkeypatch):
    """Terms sum over draws first, weights of single draws over nodes first; in chunks of populations or at once."""
    marginal, _ = likelihood_of_people(512, n_covariates=2)
    sets = with_tails(parameters(7, covariates=2), 3.0)
    terms = marginal.terms(sets)[0]
    weights = marginal.log_weights(sets).astype(float)
    np.testing.assert_allclose(np.log(np.mean(np.exp(weights), axis=2)), terms, atol=1e-4)
    monkeypatch.setattr("bayes_impedance.population.importance_likelihood._CHUNK", 3 * 12 * 4 * 512)
    np.testing.assert_array_equal(marginal.terms(sets)[0], terms)
    np.testing.assert_array_equal(marginal.log_weights(sets), weights)


@pytest.mark.parametrize("correlated", [True, False])
def test_gradient(correlated):
    marginal, _ = likelihood_of_people(256, n_covariates=1)
    rng = np.random.default_rng(5)
    coordinates = Coordinates(
        prior=Prior(centre=np.zeros(P)),
        correlated=correlated,
        repetitions=True,
        n_covariates=1,
        free=(0, 2),
        held_mu=np.full(P, 0.1),
        held_dispersion=np.full(P, 0.4),
        bend_persons=np.full(P, 0.15),
        bend_repetitions=np.full(P, 0.05),
        tails=True,
    )
    u = 0.3 * rng.normal(size=(5, coordinates.n_dimensions)) + 1.2 * coordinates.even
    u[:, :2] *= 0.1  # of the prior's three

    require_gradient(marginal, coordinates, u, STEP, 2e-3)


def test_coordinate_has_a_standard_normal_prior():
    """1/nu is uniform on (0, 1/2): the change of variables gives the normal density."""
    rng = np.random.default_rng(3)
    tail = tail_of(rng.normal(size=4000))
    assert kstest(tail / HEAVIEST, "uniform").pvalue > 0.01
    np.testing.assert_allclose([tail_of(np.array(coordinate_of(t))) for t in (0.001, 0.25, 0.49)], [0.001, 0.25, 0.49])
    assert np.isfinite(coordinate_of(0.5))


def test_parameters_survive_packing():
    coordinates = Coordinates(
        prior=Prior(centre=np.zeros(P)),
        correlated=True,
        repetitions=True,
        n_covariates=0,
        free=(0, 1, 2),
        held_mu=np.zeros(P),
        held_dispersion=np.ones(P),
        tails=True,
    )
    covariance, nothing = REFERENCE_COVARIANCE, np.zeros((P, 0))
    vector = coordinates.pack(np.ones(P), covariance, np.full(P, 0.1), nothing, None, 0.3)
    found = coordinates.unpack(vector[None])
    assert found.tail == pytest.approx(0.3)
    np.testing.assert_allclose(found.covariance[0], covariance)
    assert found[np.array([0, 0])].tail.shape == (2,)


def test_drawn_people_follow_the_t_distribution():
    factors = drawn_factors(np.full(20_000, 1 / 5), (20_000,), np.random.default_rng(1))
    assert kstest(factors**2, invgamma(2.5, scale=2.5).cdf).pvalue > 0.01
    shared = drawn_factors(np.array([[0.1], [0.4]]), (2, 5000), np.random.default_rng(2))
    assert np.quantile(shared[1], 0.99) > 1.5 * np.quantile(shared[0], 0.99)
    light = drawn_factors(np.full(1000, 1e-6), (1000,), np.random.default_rng(3))
    np.testing.assert_allclose(light, 1.0, atol=0.01)


def test_weights_are_the_mean_precision_over_nodes():
    """E[1/lambda] given the distance, by the nodes' own probabilities."""
    square, nu = 7.0, 4.0
    x, weight = (own[0] for own in nodes_of(np.array([1 / nu]), P))
    probability = np.exp(weight - 0.5 * P * x - 0.5 * np.exp(-x) * square)
    expected = np.sum(probability * np.exp(-x)) / probability.sum()
    assert weights_of(np.array([square]), 1 / nu, P)[0] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(("nu", "low", "high"), [(3.0, 2.4, 4.0), (np.inf, 60.0, np.inf)])
def test_degrees_of_freedom_of_many_distances(nu, low, high):
    rng = np.random.default_rng(4)
    square = np.sum(rng.normal(size=(2000, P)) ** 2, axis=1)
    if np.isfinite(nu):
        square = square * drawn_factors(np.full(2000, 1 / nu), (2000,), rng) ** 2
    assert low < 1 / estimated_tail(square, P) < high


def test_slopes_of_nodes_are_differences():
    sets = with_tails(parameters(1), 4.0)
    mixture = mixture_of(sets)
    (x, w), (x2, w2) = nodes_of(np.array([0.25]), P), nodes_of(np.array([0.251]), P)
    np.testing.assert_allclose((x2 - x) / 0.001, mixture.factor_slope, rtol=0.02, atol=1e-3)
    np.testing.assert_allclose((w2 - w) / 0.001, mixture.weight_slope, rtol=0.05, atol=0.2)
