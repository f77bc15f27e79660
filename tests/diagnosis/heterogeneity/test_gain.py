"""Held-out gain of covariates and drift: cross-validated regression as a special case, and nothing from nothing."""

from __future__ import annotations

import numpy as np
from populations_of_likelihoods import covariance, informations, observed, population, repetitions
from scipy.stats import norm

from bayes_impedance.diagnosis.folds import FOLDS
from bayes_impedance.diagnosis.heterogeneity.gain import gain_of_covariate, gain_within_persons
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods


def test_gain_of_a_covariate_is_cross_validated_regression():
    """Elements known exactly: ordinary regression in each fold, residual variance with its degrees of freedom."""
    rng = np.random.default_rng(40)
    x = rng.normal(size=30)
    y = 0.3 * x + rng.normal(0, 0.4, 30)
    data = PersonLikelihoods(("n1",), 1e8 * y[:, None], np.full((30, 1, 1), 1e8))
    gains = np.zeros(30)
    fold = np.random.default_rng(7).permutation(30) % FOLDS
    for k in range(FOLDS):
        inside, outside = fold == k, fold != k
        for degree, sign in ((1, 1), (0, -1)):
            line = np.polyfit(x[outside], y[outside], degree)
            sd = np.sqrt(np.sum((y[outside] - np.polyval(line, x[outside])) ** 2) / (outside.sum() - degree - 1))
            gains[inside] += sign * norm.logpdf(y[inside], np.polyval(line, x[inside]), sd)
    gain, se = gain_of_covariate(data, 3 * x + 5, ["n1"], 7)
    np.testing.assert_allclose([gain, se], [gains.sum(), np.sqrt(30) * gains.std(ddof=1)], rtol=2e-3)


def test_a_covariate_that_nothing_follows_gains_nothing_on_other_people():
    rng = np.random.default_rng(41)
    gains = []
    for _ in range(25):
        people = observed(rng, population(rng, 25, covariance(2)), informations(rng, 25, 2))
        gains.append(gain_of_covariate(people, rng.normal(size=25), ["n1"], 1)[0])
    assert np.mean(gains) < 0.0


def test_gain_of_a_drift():
    rng = np.random.default_rng(42)
    real = [gain_within_persons(repetitions(rng, 20, 2, 3, beta=0.08), ["n1", "n2"], 1) for _ in range(5)]
    none = [gain_within_persons(repetitions(rng, 20, 2, 3), ["n1", "n2"], 1) for _ in range(12)]
    assert min(gain - 2 * se for gain, se in real) > 0
    assert np.mean([gain for gain, _ in none]) < 0.0
