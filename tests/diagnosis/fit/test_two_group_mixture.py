"""The steps of expectation-maximisation that all two-group mixtures share: Bayes' rule, and extremes."""

import numpy as np

from bayes_impedance.diagnosis.fit.two_group_mixture import log_mixture, membership, share_of


def test_membership_is_bayes_rule_and_the_mixture_its_denominator() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.normal(size=(2, 3, 7))
    share = np.array([0.1, 0.5, 0.9])
    total = (1 - share)[:, None] * np.exp(first) + share[:, None] * np.exp(second)
    np.testing.assert_allclose(membership(second - first, share), share[:, None] * np.exp(second) / total)
    np.testing.assert_allclose(first + log_mixture(second - first, share), np.log(total))
    np.testing.assert_allclose(membership(second[0] - first[0], 0.1), membership(second - first, share)[0])


def test_extreme_ratios_do_not_overflow() -> None:
    ratio = np.array([-1e5, 1e5])
    np.testing.assert_allclose(membership(ratio, 0.3), [0, 1], atol=1e-300)
    np.testing.assert_allclose(log_mixture(ratio, 0.3), [np.log(0.7), 1e5 + np.log(0.3)])


def test_one_round_does_not_lower_the_likelihood() -> None:
    ratio = np.random.default_rng(2).normal(0, 3, 50)
    share, before = 0.5, -np.inf
    for _ in range(20):
        value = float(log_mixture(ratio, share).sum())
        assert value >= before - 1e-12
        before, share = value, float(share_of(membership(ratio, share), 0.01))


def test_the_share_keeps_both_groups() -> None:
    np.testing.assert_allclose(share_of(np.array([[0.0, 0.0], [1.0, 1.0], [0.2, 0.6]]), 0.05), [0.05, 0.95, 0.4])
