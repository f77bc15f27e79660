"""The importance-sampled likelihood of a population against closed forms, with the error that it reports."""

from __future__ import annotations

import numpy as np
import pytest
from persons_with_draws import REFERENCE_COVARIANCE, N, P, contrasts_of, gaussian_draws, parameters, people
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.exponentials import sums_of_exponentials
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.parameters import PopulationParameters


def closed_form(p, centres, covariances, repetitions, covariates):
    """ln N(m_i; mu + B x_i, Sigma + diag(rho^2)/J_i + C_i), shape (W, N)."""
    return np.array(
        [
            [
                multivariate_normal(
                    p.mu[w] + p.slopes[w] @ x, p.covariance[w] + np.diag(p.between_repetitions[w] ** 2) / j + c
                ).logpdf(m)
                for m, c, j, x in zip(centres, covariances, repetitions, covariates, strict=True)
            ]
            for w in range(p.mu.shape[0])
        ]
    )


# A 5-sigma error must be far below the differences that matter, or the comparison shows nothing.
@pytest.mark.parametrize("n_covariates", [0, 2])
@pytest.mark.parametrize("own_means", [False, True])
def test_gaussian_persons_have_a_closed_form(n_covariates, own_means):
    centres, covariances, repetitions = people()
    rng = np.random.default_rng(1)
    covariates = rng.normal(size=(N, n_covariates))
    means = 0.1 * rng.normal(size=(N, P)) if own_means else np.tile([0.05, -0.1, 0.0], (N, 1))
    draws, constants = gaussian_draws(centres, covariances, means, 4096, 2)
    marginal = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, covariates, ())
    p = parameters(6, covariates=n_covariates)
    terms, effective = marginal.terms(p, effective=True)
    expected = closed_form(p, centres, covariances, repetitions, covariates)
    error = np.sqrt(1 / effective - 1 / 4096)
    assert np.all(np.abs(terms + constants - expected) < 5 * error + 1e-5)  # 1e-5: single precision
    assert error.max() < 0.05 < np.ptp(expected, axis=0).min()
    np.testing.assert_allclose(marginal(p), terms.sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(marginal.variance(p), np.sum(error**2, axis=1), rtol=1e-12)
    total = np.abs(marginal(p) + constants.sum() - expected.sum(axis=1))
    assert np.all(total < 5 * np.sqrt(marginal.variance(p)) + 1e-4)


def test_reported_variance_is_the_variance_over_seeds():
    centres, covariances, repetitions = people()
    means, p = np.zeros((N, P)), parameters(1, seed=3)
    values, reported = [], []
    for seed in range(200):
        draws, constants = gaussian_draws(centres, covariances, means, 256, seed)
        marginal = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, np.zeros((N, 0)), ())
        values.append(marginal.terms(p)[0][0] + constants)
        reported.append(1 / marginal.terms(p, effective=True)[1][0] - 1 / 256)
    ratio = np.var(values, axis=0) / np.mean(reported, axis=0)
    assert np.all((ratio > 0.5) & (ratio < 2))
    assert np.mean(ratio) == pytest.approx(1, abs=0.2)
    expected = closed_form(p, centres, covariances, repetitions, np.zeros((N, 0)))[0]
    # The logarithm of an unbiased estimate is low by half its variance.
    bias = np.mean(values, axis=0) + 0.5 * np.mean(reported, axis=0) - expected
    assert np.all(np.abs(bias) < 5 * np.sqrt(np.var(values, axis=0) / 200))


def test_repetitions_narrow_the_mean():
    """The same draws with other numbers of repetitions: only T = Sigma + diag(rho^2)/J knows of them."""
    centres, covariances, _ = people()
    means, covariates = np.zeros((N, P)), np.zeros((N, 0))
    draws, constants = gaussian_draws(centres, covariances, means, 2048, 4)
    p = parameters(4, seed=5)
    for j in (1, 2, 10):
        repetitions = np.full(N, j)
        marginal = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, covariates, ())
        terms, effective = marginal.terms(p, effective=True)
        expected = closed_form(p, centres, covariances, repetitions, covariates)
        assert np.all(np.abs(terms + constants - expected) < 5 * np.sqrt(1 / effective - 1 / 2048) + 1e-5)


def test_order_of_the_persons_does_not_matter():
    centres, covariances, repetitions = people()
    means = 0.1 * np.random.default_rng(6).normal(size=(N, P))
    covariates = np.random.default_rng(7).normal(size=(N, 1))
    draws, _ = gaussian_draws(centres, covariances, means, 128, 8)
    p = parameters(3, covariates=1)
    order = np.random.default_rng(9).permutation(N)
    one = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, covariates, ())
    other = ImportanceLikelihood(
        [draws[i] for i in order], means[order], REFERENCE_COVARIANCE, repetitions[order], covariates[order], ()
    )
    np.testing.assert_allclose(other.terms(p)[0], one.terms(p)[0][:, order], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(other.log_weights(p), one.log_weights(p)[:, order], rtol=1e-5, atol=1e-5)


def test_zero_slopes_equal_no_covariates():
    """The path with an own row of coefficients for each person, and the one that all persons share."""
    centres, covariances, repetitions = people()
    means = np.tile([0.05, -0.1, 0.0], (N, 1))
    draws, _ = gaussian_draws(centres, covariances, means, 256, 3)
    p = parameters(5)
    zero = PopulationParameters(
        mu=p.mu,
        between_persons=p.between_persons,
        correlation_cholesky=p.correlation_cholesky,
        between_repetitions=p.between_repetitions,
        slopes=np.zeros((5, P, 2)),
    )
    covariates = np.random.default_rng(1).normal(size=(N, 2))
    shared = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, np.zeros((N, 0)), ())
    own = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, covariates, ())
    for one, other in zip(shared.terms(p, effective=True), own.terms(zero, effective=True), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(shared.log_weights(p), own.log_weights(zero), rtol=1e-5, atol=1e-5)


def test_log_weights_are_ratio_times_population():
    centres, covariances, repetitions = people()
    means = np.zeros((N, P))
    draws, _ = gaussian_draws(centres, covariances, means, 64, 3)
    p = parameters(2)
    log_weights = ImportanceLikelihood(
        draws, means, REFERENCE_COVARIANCE, repetitions, np.zeros((N, 0)), ()
    ).log_weights(p)
    assert log_weights.shape == (2, N, 64)
    for w in range(2):
        for i, d in enumerate(draws):
            covariance = p.covariance[w] + np.diag(p.between_repetitions[w] ** 2) / repetitions[i]
            expected = d.log_ratio + multivariate_normal(p.mu[w], covariance).logpdf(d.theta)
            difference = log_weights[w, i] - expected
            np.testing.assert_allclose(difference, difference[0], atol=2e-5)


def test_effective_draws_are_the_inverse_sum_of_squares():
    rng = np.random.default_rng(0)
    log_weight = rng.normal(size=50)
    log_weight -= np.logaddexp.reduce(log_weight)
    draws = Draws(np.zeros((50, P)), log_weight, log_weight)
    assert draws.effective == pytest.approx(1 / np.sum(np.exp(log_weight) ** 2), rel=1e-12)


# Contrasts


def people_of(contrasts):
    """Curvature and gradient of one person after the other."""
    return zip(np.moveaxis(contrasts.information, -1, 0), contrasts.gradient.T, strict=True)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_contrasts_equal_a_multivariate_normal_density(count):
    """Their maximum H^-1 b is N(0, H^-1 + D^2); relative to its density without dispersion."""
    c = contrasts_of(count)
    rho = np.random.default_rng(1).uniform(0.01, 0.5, (7, P))
    expected = np.zeros(7)
    for w in range(7):
        for h, b in people_of(c):
            covariance = np.linalg.inv(h)
            x, d = covariance @ b, np.diag(np.tile(rho[w] ** 2, count))
            expected[w] += multivariate_normal(None, covariance + d).logpdf(x)
            expected[w] -= multivariate_normal(None, covariance).logpdf(x)
    np.testing.assert_allclose(c.log_likelihood(rho), expected, rtol=1e-9, atol=1e-9)
    assert np.ptp(expected) > 1


def test_contrasts_equal_quadrature_in_one_dimension():
    """exp(b d - H d^2/2) averaged over d from N(0, rho^2)."""
    c = Contrasts(np.array([[[7.0]]]), np.array([[4.0]]))
    for rho in (0.1, 0.5, 3.0):
        value = quad(lambda d, rho=rho: np.exp(4 * d - 3.5 * d**2) * norm.pdf(d, scale=rho), -30 * rho, 30 * rho)[0]
        assert c.log_likelihood(np.array([[rho]]))[0] == pytest.approx(np.log(value), rel=1e-8)


def test_contrasts_need_no_inverse_of_the_information():
    """An element that the data do not see says nothing about its dispersion."""
    c = contrasts_of(2)
    unseen = [2, 5]
    blind = Contrasts(c.information.copy(), c.gradient.copy())
    blind.information[unseen] = blind.information[:, unseen] = 0.0
    blind.gradient[unseen] = 0.0
    rho = np.array([[0.1, 0.2, 0.01], [0.1, 0.2, 5.0], [0.1, 0.2, 0.0]])
    values = blind.log_likelihood(rho)
    np.testing.assert_allclose(values, values[0], rtol=1e-12)
    seen = [0, 1, 3, 4]
    two = Contrasts(c.information[np.ix_(seen, seen)].copy(), c.gradient[seen].copy())
    np.testing.assert_allclose(values[0], two.log_likelihood(rho[:1, :2])[0], rtol=1e-12)


def test_contrasts_are_smooth_at_zero():
    """sum_p rho_p^2 (b_p^2 - H_pp)/2 to second order, the same on both sides, and exactly 0 at 0."""
    c = contrasts_of(3)
    assert c.log_likelihood(np.zeros((1, P)))[0] == 0.0
    slope = np.zeros(P)
    for h, b in people_of(c):
        slope += 0.5 * (b**2 - np.diag(h)).reshape(3, P).sum(axis=0)
    direction = np.array([1.0, 0.5, 2.0])
    for size in (1e-3, 1e-4, 1e-6):
        values = c.log_likelihood(np.array([size * direction, -size * direction]))
        np.testing.assert_allclose(values[0], values[1], rtol=1e-12)
        np.testing.assert_allclose(values[0] / size**2, slope @ direction**2, rtol=20 * size)


def test_likelihood_with_contrasts_is_the_sum():
    centres, covariances, repetitions = people()
    draws, _ = gaussian_draws(centres, covariances, np.zeros((N, P)), 128, 3)
    arguments = (draws, np.zeros((N, P)), REFERENCE_COVARIANCE, repetitions, np.zeros((N, 0)))
    contrasts = [contrasts_of(count, n=np.sum(repetitions == count + 1)) for count in (1, 2, 4)]
    p = parameters(4)
    with_contrasts, without = ImportanceLikelihood(*arguments, contrasts), ImportanceLikelihood(*arguments, ())
    expected = without(p) + sum(c.log_likelihood(p.between_repetitions) for c in contrasts)
    np.testing.assert_allclose(with_contrasts(p), expected, rtol=1e-12)
    still = parameters(4, rho=False)
    np.testing.assert_allclose(with_contrasts(still), without(still), rtol=1e-12)


@pytest.mark.parametrize("k", [1, 7, 64, 512])
@pytest.mark.parametrize("centre", [-3e9, -300.0, 0.0, 50.0])
def test_sums_of_exponentials_equal_those_in_double_precision(k, centre):
    values = (centre - 40 * np.random.default_rng(k).random((5, 3, k)) ** 3).astype(np.float32)
    values[0, 0, 0] = -np.inf if k > 1 else centre
    peaks, totals, squares = sums_of_exponentials(values)
    assert np.array_equal(peaks, values.max(axis=2))
    terms = np.exp(values.astype(float) - peaks[..., None])
    np.testing.assert_allclose(totals, terms.sum(axis=2), rtol=1e-6)
    np.testing.assert_allclose(squares, (terms**2).sum(axis=2), rtol=2e-6)


def test_a_draw_that_is_not_a_number_makes_its_person_none_and_no_other():
    values = np.zeros((1, 3, 16), dtype=np.float32)
    values[0, 0, 5], values[0, 1] = np.nan, -np.inf
    assert np.array_equal(np.isnan(sums_of_exponentials(values)[1]), [[True, True, False]])
