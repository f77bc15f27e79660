"""The normal approximation: exact for a normal density, and found along ridges, from afar and beside an edge."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri

from bayes_impedance.mcmc.laplace import at_quantiles, normal_approximation


def _normal(mean, covariance):
    precision = np.linalg.inv(covariance)

    def log_density(x):
        offset = x - mean
        return -0.5 * np.einsum("wp,pq,wq->w", offset, precision, offset)

    return log_density, lambda x: -(x - mean) @ precision


def test_normal_density_is_found_exactly():
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(6, 6)) * np.geomspace(1e-3, 0.3, 6)[:, None]
    mean, covariance = rng.normal(size=6), factor @ factor.T
    sd = np.sqrt(np.diag(covariance))
    start = mean + 2 * sd
    mode, found = normal_approximation(*_normal(mean, covariance), start, np.diag(sd**2), 1e-3)
    np.testing.assert_allclose(mode, mean, atol=1e-6 * sd.min())
    np.testing.assert_allclose(found / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=1e-6)


@pytest.mark.parametrize("factor", [0.01, 0.1, 10.0])
def test_wrong_width_of_the_start_is_corrected(factor):
    covariance = np.array([[1.0, 0.9], [0.9, 1.0]])
    _, found = normal_approximation(*_normal(np.zeros(2), covariance), np.ones(2), factor * np.eye(2), 0.1)
    np.testing.assert_allclose(found, covariance, rtol=0.01)


@pytest.mark.parametrize("width", [0.1, 0.05, 0.03])
def test_curved_ridge_oblique_to_the_coordinates(width):
    """A ridge up to thirty times longer than wide, y = x + 0.03 x^2, entered 2.4 standard deviations from its middle.

    Differences along the coordinates put its middle 0.4 standard deviations off and find half of its variance.
    """

    def log_density(points):
        x, y = points.T
        return -0.5 * x**2 - 0.5 * ((y - x - 0.03 * x**2) / width) ** 2

    def gradient(points):
        x, y = points.T
        pull = (y - x - 0.03 * x**2) / width**2
        return np.stack([-x + pull * (1 + 0.06 * x), -pull], axis=1)

    start = np.array([2.4, 2.4 + 0.03 * 2.4**2])
    mode, found = normal_approximation(log_density, gradient, start, np.eye(2), 0.05)
    assert np.linalg.norm(mode) < 0.1
    assert found[0, 0] == pytest.approx(1.0, rel=0.15)
    assert found[0, 1] / found[0, 0] == pytest.approx(1.0, abs=0.05)


def test_differences_that_leave_the_support_are_shortened():
    def log_density(points):
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(np.all(points > 0, axis=1), np.sum(3 * np.log(np.abs(points)) - points, axis=1), -np.inf)

    def gradient(points):
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(np.all(points > 0, axis=1)[:, None], 3 / points - 1, 0.0)

    mode, found = normal_approximation(log_density, gradient, np.array([1.0, 6.0]), np.diag([9.0, 100.0]), 0.01)
    np.testing.assert_allclose(mode, 3.0, atol=0.3)
    np.testing.assert_allclose(np.diag(found), 3.0, rtol=0.3)


def test_not_wider_than_the_prior():
    """A direction without any curvature keeps the given precision."""
    _, found = normal_approximation(
        lambda x: -0.5 * x[:, 0] ** 2, lambda x: x * [-1.0, 0.0], np.zeros(2), np.eye(2), 0.25
    )
    assert found[0, 0] == pytest.approx(1.0)
    assert found[1, 1] == pytest.approx(4.0)


def test_start_outside_the_support_is_kept():
    mode, found = normal_approximation(lambda x: np.full(len(x), -np.inf), np.zeros_like, np.ones(2), np.eye(2), 0.5)
    np.testing.assert_array_equal(mode, 1.0)
    np.testing.assert_array_equal(found, np.eye(2))


def test_quantiles_of_each_coordinate_are_those_of_the_approximation():
    mode, covariance = np.array([1.0, -2.0]), np.array([[4.0, 1.9], [1.9, 1.0]])
    points = at_quantiles(mode, covariance)
    limits = mode + np.sqrt(np.diag(covariance)) * ndtri(0.975)
    assert np.mean(points > limits, axis=0).tolist() == [0.025, 0.025]
    assert np.allclose(points.mean(axis=0), mode)
