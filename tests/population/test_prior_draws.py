"""Draws from the prior have its distributions."""

import numpy as np
from scipy.stats import halfnorm, kstest, norm

from bayes_impedance.population.prior import Prior
from bayes_impedance.population.prior_draws import draw_prior

N = 2000


def test_each_parameter_has_its_own_distribution() -> None:
    prior = Prior(
        centre=np.array([1.0, -2.0, 0.0]),
        centre_sd=np.array([3.0, 0.5, 1.0]),
        dispersion_sd=np.array([1.0, 0.2, 0.4]),
        slope_sd=0.7,
    )
    drawn = draw_prior(prior, N, 1, n_covariates=1)
    for k in range(3):
        assert kstest(drawn.mu[:, k], norm(prior.centre[k], prior.centre_sds[k]).cdf).pvalue > 1e-3
        for of in (drawn.between_persons, drawn.between_repetitions):
            assert kstest(of[:, k], halfnorm(scale=prior.dispersion_sds[k]).cdf).pvalue > 1e-3
    assert kstest(drawn.slopes.ravel(), norm(0, 0.7).cdf).pvalue > 1e-3


def test_correlations_are_those_of_lkj() -> None:
    """Under LKJ(eta) each correlation of P elements is Beta(b, b) on (-1, 1), b = eta - 1 + P / 2."""
    for concentration in (1.0, 8.0):
        drawn = draw_prior(Prior(centre=np.zeros(3), concentration=concentration), N, 2)
        b = concentration - 1 + 1.5
        for i, j in ((1, 0), (2, 0), (2, 1)):
            r = drawn.correlation[:, i, j]
            assert kstest((r + 1) / 2, "beta", args=(b, b)).pvalue > 1e-3


def test_shared_parameters_are_correlated_as_known_and_have_no_dispersion() -> None:
    correlation = np.eye(3)
    correlation[0, 2] = correlation[2, 0] = 0.8
    prior = Prior(centre=np.zeros(3), centre_sd=np.array([1.0, 2.0, 3.0]), correlation=correlation)
    drawn = draw_prior(prior, N, 3, shared=np.array([True, False, True]), repetitions=False)
    assert np.all(drawn.between_persons[:, [0, 2]] == 0)
    assert np.all(drawn.between_persons[:, 1] > 0)
    assert np.all(drawn.between_repetitions == 0)
    assert abs(np.corrcoef(drawn.mu.T)[0, 2] - 0.8) < 0.05


def test_the_same_seed_gives_the_same_draws() -> None:
    one, two = (draw_prior(Prior(centre=np.zeros(2)), 5, 7) for _ in range(2))
    assert np.array_equal(one.mu, two.mu)
