r"""The likelihood with deviations integrated out, far from the mode: against importance sampling and an optimiser.

Two recordings of ``n1|r1|m1`` in a band of one per cent determine :math:`\omega m - 1/(\omega n)` and hardly anything
else. Along that valley deviations at the mode say little of those elsewhere.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, normal_equations
from bayes_impedance.person.marginal_likelihood import Ridge, find_ridge, marginal_log_likelihood, settled
from bayes_impedance.person.mode import find_mode
from bayes_impedance.person.noise import contrasts
from bayes_impedance.person.valley import follow

TRUTH = np.log([1e-3, 1.5, 1e-3])  # n1, r1, m1
FREQUENCY = np.geomspace(100, 101, 20)
SD, RHO = 0.02, np.array([0.2, 0.15, 0.25])
MEAN, PRECISION = TRUTH, np.diag(1 / np.array([0.4, 0.4, 0.5]) ** 2)
KERNEL = Kernel(parse("n1|r1|m1"))


def person(seed: int) -> tuple[Likelihood, Ridge, NDArray]:
    """Two recordings, the ridge at the mode, and places along the valley."""
    rng = np.random.default_rng(seed)
    half = RHO / np.sqrt(2) * rng.normal(size=3)
    z = KERNEL.impedance(TRUTH + np.array([half, -half]), FREQUENCY)
    z = z + SD * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    whole = Likelihood.make(FREQUENCY, z, np.full(z.shape, SD), np.zeros((2, 3)))
    theta, deviations = TRUTH, np.zeros((2, 3))
    for _ in range(20):  # the mean under the population, and deviations there
        theta = find_mode(KERNEL, whole.moved(deviations), theta[None], MEAN, PRECISION).theta
        deviations = optimum(whole, theta, deviations)[0]
    likelihood = whole.moved(deviations)
    ridge = find_ridge(KERNEL, likelihood, theta, 1.0, RHO)
    valley = follow(KERNEL, likelihood, theta, MEAN, PRECISION)
    return likelihood, ridge, valley.centre


def joint(likelihood: Likelihood, theta: NDArray, contrast: NDArray) -> NDArray:
    """Log density of recordings and deviations, those of contrasts (M, 3): shape (M,)."""
    rows = contrasts(2)
    recorded = likelihood.z[:, 0] + 1j * likelihood.z[:, 1]
    chi, square = np.zeros(len(contrast)), np.sum((contrast / RHO) ** 2, axis=1)
    for j in range(2):
        z = KERNEL.impedance(theta + rows[0, j] * contrast, FREQUENCY)
        chi += np.sum(likelihood.weight[j] * np.abs(z - recorded[j]) ** 2, axis=1)
    exponent = SCALE_SHAPE + likelihood.values
    return -exponent * np.log(likelihood.beta + 0.5 * chi) - 0.5 * square


def optimum(likelihood: Likelihood, theta: NDArray, start: NDArray) -> tuple[NDArray, float]:
    """Most probable deviations (2, 3), and the log density there."""
    rows = contrasts(2)
    found = minimize(lambda c: -joint(likelihood, theta, c[None])[0], rows[0] @ start, method="Nelder-Mead", tol=1e-9)
    return rows[0][:, None] * found.x, -found.fun


def integral(likelihood: Likelihood, theta: NDArray, seed: int) -> float:
    """Logarithm of the integral over the contrasts, by importance sampling around the most probable ones."""
    best, rows = optimum(likelihood, theta, likelihood.deviations)[0], contrasts(2)
    program, own = KERNEL.program, likelihood
    equations = [normal_equations(program, theta + d, own.omega, own.z[j], own.weight[j]) for j, d in enumerate(best)]
    w = (SCALE_SHAPE + own.values) / (own.beta + 0.5 * sum(chi for chi, _, _ in equations))
    curvature = np.diag(RHO**-2.0) + w * sum(rows[0, j] ** 2 * h for j, (_, _, h) in enumerate(equations))
    q = multivariate_t(rows[0] @ best, 1.5 * np.linalg.inv(curvature), df=5)
    points = q.rvs(40_000, random_state=np.random.default_rng(seed))
    log_weight = joint(likelihood, theta, points) - q.logpdf(points)
    assert np.exp(2 * logsumexp(log_weight) - logsumexp(2 * log_weight)) > 2000  # a standard error of 0.02
    return float(logsumexp(log_weight) - np.log(len(points)) - 1.5 * np.log(2 * np.pi))


@pytest.mark.parametrize("seed", [2, 7])
def test_the_likelihood_along_a_valley_is_the_integral(seed: int) -> None:
    likelihood, ridge, places = person(seed)
    places = places[:: len(places) // 6]
    found = marginal_log_likelihood(KERNEL, likelihood, ridge, places)
    exact = np.array([integral(likelihood, t, seed) for t in places])
    # Laplace's method itself errs by a few tenths; a single step from the ridge's tangent was 2700 off at the far end.
    assert np.abs(found - exact).max() < 0.5
    assert np.ptp(found - exact) < 0.35
    assert np.linalg.norm(places - ridge.theta, axis=1).max() > 0.5


@pytest.mark.parametrize("away", [0.0, 0.1, 1.0])
def test_deviations_settle_at_their_mode_and_sum_to_zero(away: float) -> None:
    likelihood, ridge, places = person(2)
    theta, d = places[0], likelihood
    best, highest = optimum(likelihood, theta, likelihood.deviations)
    moved = best + away * np.array([[1.0, -1.0, 0.5], [-1.0, 1.0, -0.5]])
    exponent, work = SCALE_SHAPE + d.values, (np.empty((2, 3, 3)), np.empty((2, 3)))
    found = settled(KERNEL.program, theta, moved, ridge.rho, d.omega, d.z, d.weight, exponent, d.beta, *work)
    assert np.isfinite(found)
    assert np.abs(moved.sum(axis=0)).max() < 1e-12
    assert joint(likelihood, theta, (contrasts(2)[0] @ moved)[None])[0] > highest - 0.02
