"""Restricted maximum likelihood: derivatives, the integral that it is, its maximum, classical special cases."""

from __future__ import annotations

import numpy as np
import pytest
from populations_of_likelihoods import covariance, informations, observed, population
from scipy.integrate import quad
from scipy.stats import norm

from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import log_marginal
from bayes_impedance.diagnosis.heterogeneity.reml import (
    AdditiveCovariance,
    FullCovariance,
    Problem,
    centred_fit,
    fit_normal_population,
)


@pytest.mark.parametrize("kind", ["full", "additive"])
def test_scoring_is_the_derivative_of_the_objective(kind):
    rng = np.random.default_rng(3)
    people = observed(rng, population(rng, 9, covariance(3), 0.0), informations(rng, 9, 3, unseen=1))
    x = np.stack([np.ones(9), rng.normal(size=9)], axis=1)
    design = np.einsum("nk,pq->npkq", x, np.eye(3)).reshape(9, 3, -1)
    parts = np.stack([np.diag([1.0, 1, 0]), np.diag([0.0, 0, 1])])
    structure = (
        FullCovariance(covariance(3))
        if kind == "full"
        else AdditiveCovariance(covariance(3, 0.1), parts, np.array([0.05, 0.2]))
    )
    problem = Problem.of(people, design, structure.matrix)
    gradient = problem.fit(structure).scoring()[0]
    step = 1e-4 * np.eye(gradient.size)
    ends = [[problem.fit(structure.moved(s * e)).objective for s in (1, -1)] for e in step]
    np.testing.assert_allclose(gradient, np.diff(ends)[:, 0] / -2e-4, atol=1e-5)


def test_objective_is_the_restricted_likelihood():
    # The likelihood of any T with the coefficients integrated out numerically differs by one constant.
    rng = np.random.default_rng(4)
    people = observed(rng, population(rng, 5, covariance(1), 0.0), informations(rng, 5, 1))
    design = np.ones((5, 1, 1))
    problem = Problem.of(people, design, np.eye(1))
    difference = []
    for variance in (0.01, 0.1, 1.0):
        t = np.array([[variance]])

        offset = float(np.sum(log_marginal(people, problem.fit(FullCovariance(t)).coefficients, t)))

        def integrand(m, t=t, offset=offset):
            return norm.pdf(m, 0, 10) * np.exp(np.sum(log_marginal(people, np.array([m]), t)) - offset)

        integral = quad(integrand, -3, 3, points=[0.0], limit=200)[0]
        difference.append(np.log(integral) + offset - problem.fit(FullCovariance(t)).objective)
    np.testing.assert_allclose(difference, difference[0], atol=1e-7)


def test_the_fit_is_a_maximum_wherever_it_starts():
    rng = np.random.default_rng(5)
    people = observed(rng, population(rng, 40, covariance(4), 0.0), informations(rng, 40, 4, unseen=1))
    design = np.broadcast_to(np.eye(4), (40, 4, 4))
    fits = [fit_normal_population(people, design, FullCovariance(s * np.eye(4))) for s in (0.002, 0.09, 3.0)]
    for fit in fits:
        gradient, information = fit.scoring()
        assert gradient @ np.linalg.solve(information, gradient) < 1e-4
        np.testing.assert_allclose(fit.covariance, fits[0].covariance, atol=2e-3 * 0.09)


def test_a_step_to_a_singular_covariance_is_shortened(monkeypatch):
    rng = np.random.default_rng(5)
    people = observed(rng, population(rng, 40, covariance(4), 0.0), informations(rng, 40, 4, unseen=1))
    design, start = np.broadcast_to(np.eye(4), (40, 4, 4)), FullCovariance(0.9 * np.eye(4))
    plain, moved, refused = fit_normal_population(people, design, start), FullCovariance.moved, []

    def singular(self, step):
        if np.abs(step).max() > 0.5:
            refused.append(step)
            return FullCovariance(-np.eye(4))
        return moved(self, step)

    monkeypatch.setattr(FullCovariance, "moved", singular)
    fit = fit_normal_population(people, design, start)
    assert refused
    np.testing.assert_allclose(fit.covariance, plain.covariance, atol=2e-3 * 0.09)


def test_huge_information_is_no_trouble():
    # 1e9 of information at log elements near -12: differences of 1e11 decide about numbers of order one.
    rng = np.random.default_rng(6)
    theta = population(rng, 30, covariance(3), -12.0)
    centre, fit = centred_fit(observed(rng, theta, informations(rng, 30, 3, sd=3e-5)))
    np.testing.assert_allclose(centre, theta.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(np.diag(fit.covariance), theta.var(axis=0, ddof=1), rtol=0.1)
