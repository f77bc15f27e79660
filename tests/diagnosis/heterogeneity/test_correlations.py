"""Correlations between elements: false alarms, recovery, elements that nobody sees."""

from __future__ import annotations

import numpy as np
from populations_of_likelihoods import covariance, informations, mostly, observed, population, rarely

from bayes_impedance.diagnosis.heterogeneity.correlations import correlation_test


def test_correlations_raise_no_false_alarms():
    rng = np.random.default_rng(20)
    p_values = []
    for k in range(60):
        people = observed(
            rng, population(rng, 10 + k % 40, covariance(3, r=0)), informations(rng, 10 + k % 40, 3, unseen=1)
        )
        p_values.append(correlation_test(people, k, 100).p_corrected)
    assert rarely(int(np.sum(np.array(p_values) < 0.05)), len(p_values), 0.05)
    assert rarely(int(np.sum(np.array(p_values) <= 0.005)), len(p_values), 0.005)


def test_a_correlation_is_found_and_its_interval_is_honest():
    rng = np.random.default_rng(21)
    t = 0.09 * np.eye(4)
    t[0, 1] = t[1, 0] = -0.5 * 0.09
    inside, found = 0, 0
    for k in range(40):
        result = correlation_test(observed(rng, population(rng, 71, t), informations(rng, 71, 4, 0.05)), k, 60)
        assert result.tried == 7
        pair = next(c for c in result.pairs if {c.first, c.second} == {"n1", "n2"})
        inside += pair.q05 < -0.5 < pair.q95
        found += result.p_corrected < 0.005 and result.pairs[0] is pair
    assert mostly(inside, 40, 0.9)
    assert mostly(found, 40, 0.75)  # expected statistic 4.2 before noise, and 3.2 is needed


def test_correlations_of_unseen_elements_are_not_tested():
    rng = np.random.default_rng(22)
    h = informations(rng, 30, 3)
    h[:, 0], h[:, :, 0] = 0, 0
    result = correlation_test(observed(rng, population(rng, 30, covariance(3, r=0)), h), 0, 60)
    assert [(c.first, c.second) for c in result.pairs] == [("n2", "n3")]
    assert result.remarks == ("n1 is not determined by the recordings",)
    h[:, 1], h[:, :, 1] = 0, 0
    assert "fewer than two" in correlation_test(observed(rng, population(rng, 30, covariance(3)), h), 0).reason
