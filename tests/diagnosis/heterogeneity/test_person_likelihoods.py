"""Everybody's quadratic likelihood: closed forms of the marginal, and what all persons say about an element."""

from __future__ import annotations

import numpy as np
import pytest
from populations_of_likelihoods import covariance, informations, names, observed, population
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods, data_sd, log_marginal
from bayes_impedance.diagnosis.heterogeneity.within_persons import RepetitionLikelihoods
from bayes_impedance.errors import InputError


def test_log_marginal_is_a_normal_density():
    rng = np.random.default_rng(0)
    h, t = informations(rng, 7, 3), covariance(3)
    people = observed(rng, population(rng, 7, t), h)
    means = -5 + rng.normal(0, 0.2, (7, 3))
    expected = []
    for b, hi, m in zip(people.linear, h, means, strict=True):
        y = np.linalg.solve(hi, b)
        peak = 0.5 * y @ b + 0.5 * (3 * np.log(2 * np.pi) - np.linalg.slogdet(hi)[1])
        expected.append(multivariate_normal(y, t + np.linalg.inv(hi)).logpdf(m) + peak)
    np.testing.assert_allclose(log_marginal(people, means, t), expected, rtol=1e-10)


def test_log_marginal_is_an_integral():
    people = PersonLikelihoods(("n1",), np.array([[1.3], [0.0], [-4.0]]), np.array([[[2.0]], [[0.0]], [[9.0]]]))
    values = log_marginal(people, np.array([0.4]), np.array([[0.25]]))
    for value, b, h in zip(values, (1.3, 0, -4), (2, 0, 9), strict=True):
        integral = quad(lambda x, b=b, h=h: norm.pdf(x, 0.4, 0.5) * np.exp(b * x - 0.5 * h * x * x), -6, 6)[0]
        np.testing.assert_allclose(value, np.log(integral), atol=1e-9)


def test_an_element_that_is_not_seen_drops_out_of_the_marginal():
    rng = np.random.default_rng(1)
    h, t = informations(rng, 6, 3, unseen=1), covariance(3)
    people = observed(rng, population(rng, 6, t), h)
    dark = people.persons(np.arange(0, 6, 2))
    rest = PersonLikelihoods(names(2), dark.linear[:, 1:], dark.information[:, 1:, 1:])
    np.testing.assert_allclose(log_marginal(dark, np.full(3, -5.0), t), log_marginal(rest, np.full(2, -5.0), t[1:, 1:]))


def test_without_dispersion_the_marginal_is_the_likelihood_at_the_mean():
    rng = np.random.default_rng(2)
    people = observed(rng, population(rng, 4, covariance(2)), informations(rng, 4, 2))
    m = np.array([-5.1, -4.8])
    expected = people.linear @ m - 0.5 * np.einsum("p,npq,q->n", m, people.information, m)
    np.testing.assert_allclose(log_marginal(people, m, np.zeros((2, 2))), expected, rtol=1e-12)


def test_data_sd_counts_only_what_the_others_leave():
    # Two elements of which only the sum is seen: with the other one held by the population, something is known.
    h = np.full((10, 2, 2), 1e6)
    t = np.diag([0.04, 0.09])
    np.testing.assert_allclose(
        data_sd(PersonLikelihoods(names(2), np.zeros((10, 2)), h), t), [0.3, 0.2] / np.sqrt(10), rtol=1e-3
    )
    dark = data_sd(PersonLikelihoods(names(2), np.zeros((3, 2)), np.zeros((3, 2, 2))), t)
    assert np.all(np.isinf(dark))


def test_shapes_are_checked():
    with pytest.raises(InputError, match="give"):
        PersonLikelihoods(names(2), np.zeros((3, 2)), np.zeros((3, 2, 3)))
    with pytest.raises(InputError, match="not finite"):
        PersonLikelihoods(names(1), np.full((3, 1), np.nan), np.ones((3, 1, 1)))
    with pytest.raises(InputError, match="own number"):
        RepetitionLikelihoods(names(1), (np.zeros((2, 1)),), (np.ones((2, 1, 1)),), (np.array([0, 0]),))
