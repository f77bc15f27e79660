"""The sampler for a density that is expensive to evaluate, against densities that can be drawn from directly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import gamma, norm

from bayes_impedance.diagnosis.fit.interpolated_density import Explored, design, explored, quadratic_through

DRAWS = 4000


def test_a_quadratic_is_found_again() -> None:
    rng = np.random.default_rng(1)
    for size in (1, 2, 3, 5):
        slope, root = rng.normal(size=size), rng.normal(size=(size, size))
        bent = root @ root.T + np.eye(size)
        x = np.array(design(size))
        heights = 7.0 + x @ slope - 0.5 * np.einsum("kp,pq,kq->k", x, bent, x)
        constant, gradient, curvature = quadratic_through(x, heights)
        assert constant == pytest.approx(7.0, abs=1e-6)
        np.testing.assert_allclose(gradient, slope, atol=1e-6)
        np.testing.assert_allclose(curvature, bent, atol=1e-6)


def rough(density: Callable[[np.ndarray], float]) -> Callable[[np.ndarray], float]:
    """With the unevenness that refits have: they stop at slightly different places."""
    return lambda x: density(x) + 0.02 * np.sin(37 * float(np.sum(x)))


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_a_normal_distribution_is_drawn_from(size: int) -> None:
    rng = np.random.default_rng(size)
    turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
    sd = np.geomspace(0.05, 2.0, size)
    precision = (turn / sd**2) @ turn.T

    def density(x: np.ndarray) -> float:
        return -0.5 * float(x @ precision @ x)

    start = turn @ (0.8 * sd * rng.choice([-1, 1], size))
    found = explored(rough(density), start, turn * (0.6 * sd), 3, DRAWS)
    assert found.rests
    z = (found.draws @ turn) / sd
    np.testing.assert_allclose(z.mean(axis=0), 0, atol=0.15)
    np.testing.assert_allclose(np.cov(z.T), np.eye(size), atol=0.25)


def test_skewed_and_bent_densities_keep_their_shape() -> None:
    """Quantiles to a quarter of a standard deviation, of densities of which a normal distribution is no picture."""
    skewed = explored(
        rough(lambda x: 3 * float(x[0]) - 3 * np.exp(float(x[0]))), np.array([0.3]), np.array([[0.3]]), 1, DRAWS
    )
    levels = (0.05, 0.5, 0.95)
    exact = np.log(gamma(3).ppf(levels) / 3)
    np.testing.assert_allclose(np.quantile(skewed.draws[:, 0], levels), exact, atol=0.12)

    def ridge(x: np.ndarray) -> float:
        return -0.5 * float(x[0]) ** 2 - 0.5 * ((float(x[1]) - 0.3 * float(x[0]) ** 2) / 0.3) ** 2

    bent = explored(rough(ridge), np.array([0.5, 0.0]), 0.4 * np.eye(2), 1, DRAWS)
    np.testing.assert_allclose(np.quantile(bent.draws[:, 0], levels), norm.ppf(levels), atol=0.3)
    residual = (bent.draws[:, 1] - 0.3 * bent.draws[:, 0] ** 2) / 0.3
    assert abs(residual.mean()) < 0.2
    assert 0.8 < residual.std() < 1.25
    # A straight line through the draws is horizontal, and their bend is the ridge's.
    assert np.polyfit(bent.draws[:, 0], bent.draws[:, 1], 2)[0] == pytest.approx(0.3, abs=0.06)


def test_a_ridge_without_end_does_not_rest_and_is_believed_only_where_it_was_seen() -> None:
    found = explored(lambda x: -0.5 * float(x[1]) ** 2, np.zeros(2), 0.3 * np.eye(2), 1, DRAWS)
    assert not found.rests
    seen = np.ptp(found.points[:, 0])
    assert seen > 5
    assert found.points[:, 0].min() - seen < found.draws[:, 0].min()
    assert found.draws[:, 0].max() < found.points[:, 0].max() + seen


def test_the_same_seed_gives_the_same_draws() -> None:
    def found(seed: int) -> Explored:
        return explored(lambda x: -0.5 * float(x @ x), np.zeros(2), np.eye(2), seed, 100)

    np.testing.assert_array_equal(found(1).draws, found(1).draws)
    assert not np.array_equal(found(1).draws, found(2).draws)
