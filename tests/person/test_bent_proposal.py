"""A t along a surface of degree two: its density, its bend, and what it is good for."""

import numpy as np
import pytest

from bayes_impedance.person.bent_proposal import BentT, log_t


def banana(n: int, seed: int) -> np.ndarray:
    """Points (n, 3): one direction is long, and a thin one follows its square."""
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v * (1.0, 0.3, 0.01) + np.outer(v[:, 0] ** 2, (0.0, 0.0, 0.1))


def fitted(bent: bool) -> BentT:
    theta = banana(4000, 1)
    return BentT.fitted(theta, np.full(len(theta), -np.log(len(theta))), np.eye(3), 1e-8 * np.eye(3), bent)


def test_density_integrates_to_one() -> None:
    """The mean of the ratio to another density over draws of that one, with the Jacobian of the map."""
    own, rng = fitted(True), np.random.default_rng(2)
    t = rng.normal(size=(200_000, 3)) * np.sqrt(10 / rng.chisquare(10, size=(200_000, 1)))
    theta = own.points(t)
    # In the coordinates of the draws a wider t is known; the map's Jacobian takes it there.
    log_jacobian = np.log(np.abs(np.linalg.det(own.axes @ own.factor)))
    np.testing.assert_allclose(own.log_density(theta), log_t(t, np.zeros(3), np.eye(3)) - log_jacobian, atol=1e-6)
    step = 1e-6
    numeric = [
        np.linalg.det((own.points(x + step * np.eye(3)) - own.points(x - step * np.eye(3))) / (2 * step)) for x in t[:5]
    ]
    np.testing.assert_allclose(np.log(np.abs(numeric)), log_jacobian, rtol=1e-5)


@pytest.mark.parametrize(("bent", "least", "most"), [(True, 0.6, 1.0), (False, 0.0, 0.25)])
def test_a_curved_target_is_covered_by_the_bent_one(bent: bool, least: float, most: float) -> None:
    own, rng, n = fitted(bent), np.random.default_rng(3), 20_000
    theta = own.points(rng.normal(size=(n, 3)) * np.sqrt(10 / rng.chisquare(10, size=(n, 1))))
    rest = np.column_stack([theta[:, 0], theta[:, 1] / 0.3, (theta[:, 2] - 0.1 * theta[:, 0] ** 2) / 0.01])
    weight = np.exp(-0.5 * np.sum(rest**2, axis=1) - own.log_density(theta))
    share = weight.sum() ** 2 / np.sum(weight**2) / n
    assert least < share < most


def test_a_straight_one_is_the_t_itself() -> None:
    covariance, theta = np.array([[2.0, 0.5], [0.5, 1.0]]), np.random.default_rng(4).normal(size=(7, 2))
    own = BentT.straight(np.ones(2), covariance)
    np.testing.assert_array_equal(own.log_density(theta), log_t(theta, np.ones(2), np.linalg.cholesky(covariance)))
