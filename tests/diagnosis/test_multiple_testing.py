"""Corrections by hand, and their family-wise error rate."""

import numpy as np
from scipy.stats import binom

from bayes_impedance.diagnosis.multiple_testing import bonferroni, holm


def test_holm_by_hand() -> None:
    np.testing.assert_allclose(holm(np.array([0.04, 0.01, 0.03, 0.9])), [0.09, 0.04, 0.09, 0.9])
    np.testing.assert_array_equal(holm(np.array([0.5, 0.6])), [1.0, 1.0])
    assert holm(np.zeros(0)).size == 0


def test_the_smallest_of_holm_is_that_of_bonferroni() -> None:
    p = np.random.default_rng(1).random(20) ** 3
    assert holm(p).min() == bonferroni(float(p.min()), 20)
    assert bonferroni(0.4, 3) == 1.0


def test_one_false_alarm_among_true_hypotheses_is_as_rare_as_promised() -> None:
    """Three of ten hypotheses are false: of the seven others one is rejected in at most five per cent."""
    rng = np.random.default_rng(2)
    alarms = 0
    for _ in range(2000):
        p = np.r_[np.zeros(3), rng.random(7)]
        alarms += holm(p)[3:].min() < 0.05
    assert alarms <= binom.isf(1e-3, 2000, 0.05)
    assert alarms >= binom.ppf(1e-3, 2000, 1 - (1 - 0.05 / 7) ** 7)  # and not rarer than independent tests make it
