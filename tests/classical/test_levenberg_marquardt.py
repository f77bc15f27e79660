"""Many small least squares problems at once."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from bayes_impedance.classical.levenberg_marquardt import minimise_many

X = np.linspace(0, 3, 25)
Y = 2.0 * np.exp(-0.7 * X) + 0.3 + 0.01 * np.cos(9 * X)


def decay(theta):
    """exp(a) exp(-exp(b) x) + exp(c), less the data."""
    a, b, c = np.exp(theta.T)[..., None]
    fall = a * np.exp(-b * X)
    return fall + c - Y, np.stack([fall, -b * X * fall, np.broadcast_to(c, fall.shape)], axis=-1)


def test_every_start_of_the_basin_ends_where_minpack_does():
    start = np.random.default_rng(1).normal(0, 0.5, (40, 3))
    end, cost = minimise_many(decay, start, 60)
    reference = least_squares(lambda t: decay(t[None])[0][0], np.zeros(3), method="lm")
    found = np.abs(end - reference.x).max(axis=1) < 1e-5
    assert found.mean() > 0.9
    np.testing.assert_allclose(cost[found], 2 * reference.cost, rtol=1e-9)
    assert np.all(cost >= 2 * reference.cost * (1 - 1e-9))


def test_never_ends_worse_than_it_began():
    start = np.random.default_rng(2).normal(0, 5, (50, 3))
    before = np.sum(np.nan_to_num(decay(start)[0], posinf=1e6) ** 2, axis=1)
    _, cost = minimise_many(decay, start, 5)
    assert np.all(cost <= before * (1 + 1e-12))


@pytest.mark.parametrize("iterations", [0, 30])
def test_starts_that_cannot_be_evaluated_are_the_worst_and_disturb_nobody(iterations):
    start = np.array([[0.5, -0.4, -1.0], [800.0, 0.0, 0.0]])  # exp(800) is infinite
    end, cost = minimise_many(decay, start, iterations)
    alone, _ = minimise_many(decay, start[:1], iterations)
    np.testing.assert_allclose(end[0], alone[0], rtol=1e-12)
    assert cost[1] > 1e6 * cost[0]
    np.testing.assert_array_equal(end[1], start[1])
