"""Recordings that are summed up at a few frequencies give the log likelihood of all of them."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.condensed import NODES_PER_DECADE, condensed, holds
from bayes_impedance.person.likelihood import Likelihood, repetition_equations
from bayes_impedance.person.marginal_likelihood import find_ridge, marginal_log_likelihood
from bayes_impedance.person.mode import find_mode, mode_at

NETWORK = "(n3|r3)-(m2|r1|n1|(m1-(n2|r2)))"
THETA = np.log([7e-7, 60.0, 8e-4, 1.5, 1.2e-3, 0.055, 4.7e-3, 4.0])
RHO = np.full(8, 0.05)


def person(frequency, repetitions=3, noise=0.01, network=NETWORK, theta=THETA):
    """A person, the mode with the deviations there, and the ridge."""
    kernel, rng = Kernel(parse(network)), np.random.default_rng(3)
    deviations = 0.05 * rng.standard_normal((repetitions, theta.size)) * (repetitions > 1)
    deviations -= deviations.mean(axis=0)
    clean = kernel.impedance(theta + deviations, frequency)
    sd = noise * np.abs(clean)
    z = clean + sd * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    likelihood = Likelihood.make(frequency, z, sd, deviations)
    mode = find_mode(kernel, likelihood, theta[None], theta, np.eye(theta.size))
    return kernel, likelihood, mode, find_ridge(kernel, likelihood, mode.theta, mode.scale, RHO[: theta.size])


def near(mode, n=200, wide=1.0, seed=1):
    """Points of the normal approximation."""
    root = np.linalg.cholesky(np.linalg.inv(mode.precision))
    return mode.theta + wide * np.random.default_rng(seed).standard_normal((n, len(root))) @ root.T


@pytest.mark.parametrize("repetitions", [1, 3])
@pytest.mark.parametrize("frequency", [np.geomspace(5, 5000, 401), np.linspace(5, 2000, 1500)], ids=["log", "linear"])
def test_log_likelihood_is_that_of_all_recordings(frequency, repetitions):
    kernel, whole, mode, ridge = person(frequency, repetitions)
    small = condensed(kernel, whole, mode.theta, NODES_PER_DECADE[0])
    theta = near(mode)
    exact = marginal_log_likelihood(kernel, whole, ridge, theta)
    off = marginal_log_likelihood(kernel, small, ridge, theta) - exact
    assert small.omega.size < frequency.size / 5
    assert np.ptp(exact) > 10
    # With the constant: what summing up leaves out is kept beside it.
    np.testing.assert_allclose(off, 0.0, atol=0.03)
    finer = condensed(kernel, whole, mode.theta, NODES_PER_DECADE[1])
    off_finer = marginal_log_likelihood(kernel, finer, ridge, theta) - exact
    assert np.std(off_finer) < 0.3 * np.std(off)


def test_it_is_exact_at_the_mode_but_for_the_residuals():
    kernel, whole, mode, _ = person(np.geomspace(5, 5000, 401))
    small = condensed(kernel, whole, mode.theta, NODES_PER_DECADE[0])
    (g, h), (own_g, own_h) = (repetition_equations(kernel, d, mode.theta) for d in (whole, small))
    sd = 1 / np.sqrt(np.diagonal(h.sum(axis=0)))
    np.testing.assert_allclose(own_h, h, atol=1e-4 * np.abs(h).max())
    np.testing.assert_allclose(sd * own_g, sd * g, atol=0.02 * mode.scale)
    at = [mode_at(kernel, d, mode.theta, THETA, np.eye(8), 0.0) for d in (whole, small)]
    assert at[1].scale == pytest.approx(at[0].scale, rel=1e-9)  # chi-square there is the same


def test_few_frequencies_and_impedances_that_are_not_finite_are_left_alone():
    kernel, whole, mode, _ = person(np.geomspace(5, 5000, 101))
    assert condensed(kernel, whole, mode.theta, NODES_PER_DECADE[0]) is None
    kernel, whole, mode, _ = person(np.geomspace(5, 5000, 401))
    assert condensed(kernel, whole, np.full(8, np.inf), NODES_PER_DECADE[0]) is None
    repeated = Likelihood.make(
        np.repeat(np.geomspace(5, 5000, 101), 4), np.ones((1, 404)) + 0j, np.ones((1, 404)), 0 * THETA[None]
    )
    assert condensed(kernel, repeated, mode.theta, NODES_PER_DECADE[0]) is None


def test_a_sharp_resonance_is_found_to_need_all_frequencies():
    """Its width is a hundredth of the distance between nodes: interpolating over it gives another likelihood."""
    network, theta = "m2|r1|n1|(m1-(n2|r2))", np.log([8e-4, 1.5, 1.2e-3, 0.02, 5e-4, 2e-3])
    frequency = np.geomspace(5, 500, 801)
    for damped, expected in ((0.0, False), (np.log(1e4), True)):
        kernel, whole, mode, ridge = person(
            frequency, 1, network=network, theta=theta + np.array([0, 0, 0, 0, 0, damped])
        )
        small = condensed(kernel, whole, mode.theta, NODES_PER_DECADE[0])
        points = near(mode)
        log_weight = np.full(len(points), -np.log(len(points)))
        assert holds(kernel, whole, small, ridge, points, log_weight) == expected
        assert not holds(kernel, whole, small, ridge, np.full_like(points, np.inf), log_weight)
