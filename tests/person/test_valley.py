r"""Draws along a curved valley, against quadrature.

In a band of one per cent a recording of ``n1|r1|m1`` tells :math:`\omega m - 1/(\omega n)` and hardly anything else. At
a given n the impedance is linear in r and m, so that a person's marginal likelihood is a one-dimensional integral.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.bent_proposal import DEGREES_OF_FREEDOM, BentT
from bayes_impedance.person.first_proposal import along_conditional_modes
from bayes_impedance.person.importance_draws import Draws, Reference, draw
from bayes_impedance.person.likelihood import Likelihood, log_likelihood
from bayes_impedance.person.marginal_likelihood import find_ridge
from bayes_impedance.person.mode import find_mode
from bayes_impedance.person.valley import _factor, follow

TRUTH = np.log([1e-3, 1.5, 1e-3])  # n1, r1, m1
FREQUENCY = np.geomspace(100, 101, 40)
SD = 0.02
WIDE = np.diag([0.4, 0.4, 0.5]) ** 2

KERNEL = Kernel(parse("n1|r1|m1"))


def person(seed: int) -> Likelihood:
    rng = np.random.default_rng(seed)
    z = KERNEL.impedance(TRUTH[None], FREQUENCY)
    noise = rng.normal(scale=SD, size=(2, *z.shape))
    return Likelihood.make(FREQUENCY, z + noise[0] + 1j * noise[1], np.full(z.shape, SD), np.zeros((1, 3)))


def along_n(likelihood: Likelihood, mean: np.ndarray, covariance: np.ndarray) -> tuple[NDArray, NDArray, NDArray]:
    """A grid of ln n, the log of the integrand there, and ln m; r and m are integrated out around their best values."""
    grid = np.linspace(TRUTH[0] - 3, TRUTH[0] + 3, 4001)
    w = likelihood.omega
    recorded = likelihood.z[0, 0] + 1j * likelihood.z[0, 1]
    rest = recorded - 1 / (1j * w * np.exp(grid)[:, None])
    m, r = (rest.imag @ w) / (w @ w), rest.real.mean(axis=1)
    chi = np.sum(np.abs(rest - r[:, None] - 1j * w * m[:, None]) ** 2, axis=1) / SD**2
    there = (m > 0) & (r > 0)
    log_m, log_r = np.log(np.where(there, m, 1)), np.log(np.where(there, r, 1))
    exponent = 1.0 + likelihood.count
    value = -exponent * np.log(1.0 + 0.5 * chi) - log_m - log_r
    theta = np.stack([grid, log_r, log_m], axis=1)
    value = value + Reference(mean, covariance).log_density(theta)
    return grid, np.where(there, value, -np.inf), log_m


def drawn(likelihood: Likelihood, mean: np.ndarray, covariance: np.ndarray, along_valley: bool) -> Draws:
    mode = find_mode(KERNEL, likelihood, mean[None], mean, np.linalg.inv(covariance))
    ridge = find_ridge(KERNEL, likelihood, mode.theta, mode.scale, np.full(3, 0.1))
    seed = np.random.SeedSequence(3)
    return draw(KERNEL, likelihood, mode, ridge, Reference(mean, covariance), 4096, seed, along_valley)


def under(draws: Draws, mean: np.ndarray, covariance: np.ndarray) -> tuple[NDArray, float]:
    """Normalised weights under another population, and the log of their sum."""
    log_weight = draws.log_ratio + Reference(mean, covariance).log_density(draws.theta)
    total = float(logsumexp(log_weight))
    return np.exp(log_weight - total), total


POPULATIONS = [
    (TRUTH, WIDE),
    (TRUTH + np.array([0.2, 0, -0.6]), WIDE / 4),
    (TRUTH + np.array([-0.2, 0, 0.3]), WIDE / 9),
]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_likelihoods_of_populations_are_those_of_quadrature(seed: int) -> None:
    likelihood = person(seed)
    draws = drawn(likelihood, TRUTH, WIDE, along_valley=True)
    exact = [float(logsumexp(along_n(likelihood, *p)[1])) for p in POPULATIONS]
    ours = [under(draws, *p)[1] for p in POPULATIONS]
    np.testing.assert_allclose(np.diff(ours), np.diff(exact), atol=0.15)
    for population in POPULATIONS:
        grid, value, log_m = along_n(likelihood, *population)
        weight = np.exp(value - logsumexp(value))
        own, _ = under(draws, *population)
        for column, x in ((0, grid), (2, log_m)):
            mean, sd = weight @ x, np.sqrt(weight @ (x - weight @ x) ** 2)
            mine = own @ draws.theta[:, column]
            assert abs(mine - mean) < 0.15 * sd
            assert np.sqrt(own @ (draws.theta[:, column] - mine) ** 2) == pytest.approx(sd, rel=0.15)
        assert 1 / np.sum(own**2) > 50


def test_the_surface_of_conditional_modes_covers_what_one_t_misses() -> None:
    """The weights of a t around the mode look well because its draws never leave their stretch of the valley."""
    likelihood = person(1)
    _, value, log_m = along_n(likelihood, TRUTH, WIDE)
    weight = np.exp(value - logsumexp(value))
    sd = np.sqrt(weight @ (log_m - weight @ log_m) ** 2)

    def spread(proposal: BentT) -> float:
        rng = np.random.default_rng(1)
        stretch = np.sqrt(DEGREES_OF_FREEDOM / rng.chisquare(DEGREES_OF_FREEDOM, 4096))
        theta = proposal.points(stretch[:, None] * rng.normal(size=(4096, TRUTH.size)))
        log_weight = log_likelihood(KERNEL, likelihood, theta) + Reference(TRUTH, WIDE).log_density(theta)
        own = np.exp(log_weight - proposal.log_density(theta))
        own /= own.sum()
        return float(np.sqrt(own @ (theta[:, 2] - own @ theta[:, 2]) ** 2))

    mode = find_mode(KERNEL, likelihood, TRUTH[None], TRUTH, np.linalg.inv(WIDE))
    laplace = np.linalg.inv(mode.precision)
    straight = BentT.straight(mode.theta, laplace)
    bent = along_conditional_modes(KERNEL, likelihood, mode.theta, TRUTH, WIDE, laplace)
    assert spread(straight) < 0.8 * sd
    assert spread(bent) == pytest.approx(sd, rel=0.1)


def test_the_valley_stays_on_its_ground_and_reaches_its_ends() -> None:
    likelihood = person(2)
    valley = follow(KERNEL, likelihood, TRUTH, TRUTH, np.linalg.inv(WIDE))
    n, r, m = np.exp(valley.centre).T
    w = 2 * np.pi * 100.5
    assert np.ptp(w * m - 1 / (w * n)) < 0.1  # of 0.96, while both terms change by factors
    assert np.ptp(np.log(m)) > 1.0
    assert np.ptp(np.log(r)) < 0.05
    assert valley.weight.sum() == pytest.approx(1)
    assert np.all(np.diagonal(valley.factor, axis1=1, axis2=2) > 0)


def test_where_everything_is_determined_the_valley_is_a_point_with_its_surroundings() -> None:
    frequency = np.geomspace(5, 1000, 60)
    z = KERNEL.impedance(TRUTH[None], frequency)
    likelihood = Likelihood.make(frequency, z, np.full(z.shape, SD), np.zeros((1, 3)))
    valley = follow(KERNEL, likelihood, TRUTH, TRUTH, np.linalg.inv(WIDE))
    assert np.ptp(valley.centre, axis=0).max() < 0.2


def test_the_valley_is_followed_beside_an_element_that_the_population_holds() -> None:
    """Its precision is ten orders of magnitude larger there, and nothing bends along it."""
    reference = WIDE.copy()
    reference[1, :] = reference[:, 1] = 0.0
    reference[1, 1] = 1e-10
    likelihood = person(2)
    valley = follow(KERNEL, likelihood, TRUTH, TRUTH, np.linalg.inv(reference))
    assert np.ptp(valley.centre[:, 2]) > 1.0
    assert np.ptp(valley.centre[:, 1]) < 1e-4
    covariance = valley.factor @ np.swapaxes(valley.factor, 1, 2)
    np.testing.assert_allclose(covariance[:, 1, 1], 1e-10, rtol=1e-3)
    assert drawn(likelihood, TRUTH, reference, along_valley=True).effective > 100


def test_covariances_of_the_valley_are_inverses_where_these_can_be_computed() -> None:
    likelihood = person(2)
    precision = np.linalg.inv(WIDE)
    information = find_mode(KERNEL, likelihood, TRUTH[None], TRUTH, precision).information
    direction = np.array([3.0, 0.5, -2.0])
    factor = _factor(np.linalg.cholesky(precision), information, direction)
    along = precision @ direction
    expected = np.linalg.inv(information + precision + np.outer(along, along))
    np.testing.assert_allclose(factor @ factor.T, expected, rtol=1e-8, atol=1e-12)
    np.testing.assert_array_equal(factor, np.triu(factor))


def test_information_beside_a_pole_leaves_a_factor() -> None:
    """One combination is determined ten billion times better than the others: the sums are singular to rounding."""
    strong = np.array([1.0, -0.3, 2.0])
    information = 1e18 * np.outer(strong, strong)
    factor = _factor(np.linalg.cholesky(np.linalg.inv(WIDE)), information, np.array([1.0, 0.0, 0.0]))
    assert np.all(np.isfinite(factor))
    assert np.all(np.diagonal(factor) > 0)
