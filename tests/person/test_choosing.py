"""Draws that are chosen for given populations count for more under these, and estimate the same."""

import numpy as np
import pytest

from bayes_impedance.person import choosing
from bayes_impedance.person.choosing import Nearby, inclusion


def test_no_probabilities_have_less_variance_under_the_populations() -> None:
    """The mean of the variances is least: any other probabilities have more, and so have those for the reference."""
    rng = np.random.default_rng(1)
    theta = rng.normal(size=(400, 2))
    log_ratio = rng.normal(scale=0.3, size=400)
    near = Nearby(np.array([[0.5, 0.0], [-0.5, 0.3]]), np.array([0.5 * np.eye(2), np.diag([2.0, 0.3])]))
    mean = np.array([0.1, -0.1])

    def weights(shift: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        away = theta - mean - shift
        w = np.exp(log_ratio - 0.5 * np.einsum("kp,pq,kq->k", away, np.linalg.inv(covariance), away))
        return w / w.sum()

    squares = sum(weights(s, c) ** 2 for s, c in zip(near.shift, near.covariance, strict=True))
    assert near.effective(theta, log_ratio, mean) == pytest.approx(2 / squares.sum())
    log_root = near.log_roots(theta, log_ratio, mean)
    np.testing.assert_allclose(log_root, 0.5 * np.log(squares), atol=1e-10)
    best = inclusion(log_root, 40)
    assert best.max() < 1
    reference = np.exp(log_ratio - 0.5 * np.sum((theta - mean) ** 2, axis=1))
    for other in (inclusion(0.5 * np.log(reference), 40), np.full(400, 0.1)):
        assert np.sum(squares / best) < np.sum(squares / other)


def test_many_draws_are_computed_in_parts_like_few(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    theta, log_ratio = rng.normal(size=(50, 3)), rng.normal(size=50)
    near = Nearby(rng.normal(scale=0.2, size=(7, 3)), np.array([s * np.eye(3) for s in rng.uniform(0.5, 2, 7)]))
    whole = near.log_roots(theta, log_ratio, np.zeros(3)), near.effective(theta, log_ratio, np.zeros(3))
    monkeypatch.setattr(choosing, "_CHUNK", 2 * theta.size)
    np.testing.assert_allclose(near.log_roots(theta, log_ratio, np.zeros(3)), whole[0], rtol=1e-12)
    assert near.effective(theta, log_ratio, np.zeros(3)) == pytest.approx(whole[1], rel=1e-12)
