"""One person's likelihood and mode against direct formulas, quadrature, finite differences and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.special import gammaln
from strategies import network_impedance

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.person.likelihood import (
    SCALE_SHAPE,
    Likelihood,
    log_likelihood,
    normal_equations,
    repetition_equations,
)
from bayes_impedance.person.mode import (
    DECREMENT_LIMIT,
    ROUNDING,
    _gradient,
    _hessian,
    all_modes,
    find_mode,
    mode_at,
)

FREQUENCY = np.geomspace(5.0, 2000.0, 40)
PAPER_THETA = np.log([8e-4, 1.5, 3e-4, 1.2, 6e-4, 0.02, 2e-3, 2.5])  # n3 r3 m2 r1 n1 m1 n2 r2
SMALL_THETA = np.log([3e-4, 1.4, 2e-3])


def person(notation, theta, repetitions=3, noise=0.02, spread=0.1, seed=0, misfit=0.0):
    """Kernel, likelihood and what it was made of: recordings with known noise and known deviations."""
    rng = np.random.default_rng(seed)
    kernel = Kernel(parse(notation))
    deviations = rng.normal(0, spread, (repetitions, theta.size)) * (repetitions > 1)
    deviations -= deviations.mean(axis=0)
    clean = kernel.impedance(theta + deviations, FREQUENCY) * (1 + misfit * np.sin(2 * np.log(FREQUENCY)))
    sd = noise * np.abs(clean) * np.geomspace(2, 0.5, FREQUENCY.size)
    z = clean + sd * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    return kernel, Likelihood.make(FREQUENCY, z, sd, deviations), (z, sd, deviations)


def chi_square(kernel, theta, z, sd, deviations):
    """Sum of squares by plain recursion, for one theta."""
    s = 2j * np.pi * FREQUENCY
    total = 0.0
    for j in range(z.shape[0]):
        values = dict(zip(kernel.elements, np.exp(theta + deviations[j]), strict=True))
        total += np.sum(np.abs(z[j] - network_impedance(kernel.network, s, values)) ** 2 / sd[j] ** 2)
    return total


def objective_of(kernel, likelihood, mean, precision):
    def objective(theta):
        offset = theta - mean
        return -log_likelihood(kernel, likelihood, theta[None])[0] + 0.5 * offset @ precision @ offset

    return objective


def numerical_gradient(function, theta, step=1e-5):
    """Fourth-order central differences."""
    rows = []
    for h in step * np.eye(theta.size):
        near, far = function(theta + h) - function(theta - h), function(theta + 2 * h) - function(theta - 2 * h)
        rows.append(8 * near - far)
    return np.array(rows) / (12 * step)


# Likelihood


@pytest.mark.parametrize("repetitions", [1, 2, 5])
def test_log_likelihood_is_the_formula(repetitions):
    kernel, likelihood, data = person(PAPER_NETWORK, PAPER_THETA, repetitions)
    n = repetitions * FREQUENCY.size - 0.5 * (repetitions - 1) * 8
    assert likelihood.count == n
    sets = PAPER_THETA + np.random.default_rng(1).normal(0, 0.2, (6, 8))
    expected = [-(2 + n) * np.log(2 + 0.5 * chi_square(kernel, theta, *data)) for theta in sets]
    np.testing.assert_allclose(log_likelihood(kernel, likelihood, sets), expected, rtol=1e-12)


def test_deviations_matter_and_can_be_moved():
    kernel, likelihood, (z, sd, deviations) = person(PAPER_NETWORK, PAPER_THETA)
    other = deviations[::-1].copy()
    moved = likelihood.moved(other)
    assert moved.count == likelihood.count
    values = [log_likelihood(kernel, one, PAPER_THETA[None])[0] for one in (likelihood, moved)]
    squares = np.array([chi_square(kernel, PAPER_THETA, z, sd, d) for d in (deviations, other)])
    expected = -(2 + likelihood.count) * np.log(2 + 0.5 * squares)
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    assert values[0] - values[1] > 10


def test_noise_scale_is_integrated_out():
    """Against quadrature over s, with s^2 inverse gamma(2, 2) and two real Gaussians for each complex number."""
    kernel, likelihood, data = person("n1|r1|m1", SMALL_THETA, repetitions=1)
    n = FREQUENCY.size

    def log_integral(theta):
        chi = chi_square(kernel, theta, *data)

        def log_integrand(s):
            log_prior = 2 * np.log(2) - gammaln(2) - 3 * np.log(s**2) - 2 / s**2 + np.log(2 * s)  # d(s^2) = 2 s ds
            return log_prior - 2 * n * np.log(s) - 0.5 * chi / s**2

        peak = np.sqrt((2 + 0.5 * chi) / (2 + n))
        top = log_integrand(peak)
        value, _ = quad(lambda s: np.exp(log_integrand(s) - top), peak / 20, 20 * peak, points=[peak], epsrel=1e-11)
        return np.log(value) + top

    sets = SMALL_THETA + np.random.default_rng(2).normal(0, 0.1, (5, 3))
    expected = np.array([log_integral(theta) for theta in sets])
    values = log_likelihood(kernel, likelihood, sets)
    np.testing.assert_allclose(values - values[0], expected - expected[0], rtol=1e-9, atol=1e-9)
    assert np.ptp(values) > 5


def test_what_is_not_finite_has_no_likelihood():
    kernel, likelihood, _ = person("n1|r1|m1", SMALL_THETA)
    sets = np.array([SMALL_THETA, SMALL_THETA + np.array([0, 0, 900.0]), SMALL_THETA + np.array([0, np.nan, 0])])
    with np.errstate(all="ignore"):
        values = log_likelihood(kernel, likelihood, sets)
    assert np.isfinite(values[0])
    assert np.all(values[1:] == -np.inf)


def test_count_stays_positive():
    sd = np.ones((5, 1))
    assert Likelihood.make(FREQUENCY[:1], np.ones((5, 1), dtype=complex), sd, np.zeros((5, 8))).count == 1.0


# Derivatives


def derivative_arguments(likelihood, mean, precision):
    d = likelihood
    return d.deviations, d.omega, d.z, d.weight, SCALE_SHAPE + d.count, d.beta, mean, precision


def test_gradient_and_hessian_equal_differences():
    kernel, likelihood, _ = person(PAPER_NETWORK, PAPER_THETA, misfit=0.2)
    precision = np.diag(np.linspace(0.5, 3.0, 8)) + 0.1
    mean = PAPER_THETA + 0.3
    arguments = derivative_arguments(likelihood, mean, precision)
    for shift in (0.0, 0.15):
        theta = PAPER_THETA + shift * np.cos(np.arange(8))
        gradient = numerical_gradient(objective_of(kernel, likelihood, mean, precision), theta, 1e-4)
        exact = _gradient(kernel.program, theta, *arguments)
        np.testing.assert_allclose(exact, gradient, rtol=1e-6, atol=1e-6 * np.abs(exact).max())
        hessian = _hessian(kernel.program, theta, *arguments)
        expected = numerical_gradient(lambda x: _gradient(kernel.program, x, *arguments), theta, 1e-3)
        np.testing.assert_allclose(hessian, expected, rtol=1e-5, atol=1e-6 * np.abs(hessian).max())
        np.testing.assert_array_equal(hessian, hessian.T)


def test_repetition_equations_equal_differences():
    kernel, likelihood, (z, sd, deviations) = person(PAPER_NETWORK, PAPER_THETA)
    theta = PAPER_THETA + 0.1
    gradient, information = repetition_equations(kernel, likelihood, theta)
    assert gradient.shape == (3, 8)
    assert information.shape == (3, 8, 8)
    for j in range(3):

        def half_chi(x, j=j):
            return 0.5 * chi_square(kernel, x, z[[j]], sd[[j]], deviations[[j]])

        expected = numerical_gradient(half_chi, theta, 1e-3)
        np.testing.assert_allclose(gradient[j], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
        jacobian = kernel.derivative(theta + deviations[j], FREQUENCY)[1] / sd[j]
        expected = (jacobian @ jacobian.conj().T).real
        np.testing.assert_allclose(information[j], expected, rtol=1e-10, atol=1e-14 * expected.max())


def test_decrement_is_the_squared_distance_to_the_mode():
    """g A^-1 g with the gradient by differences and the curvature w J'J/sigma^2 + prior."""
    kernel, likelihood, data = person(PAPER_NETWORK, PAPER_THETA)
    mean, precision = PAPER_THETA + 0.2, 2 * np.eye(8)
    start = PAPER_THETA + 0.05
    _, _, decrements = all_modes(kernel, likelihood, start[None], mean, precision, max_iterations=1)
    gradient = numerical_gradient(objective_of(kernel, likelihood, mean, precision), start, 1e-4)
    w = (2 + likelihood.count) / (2 + 0.5 * chi_square(kernel, start, *data))
    curvature = w * repetition_equations(kernel, likelihood, start)[1].sum(axis=0) + precision
    assert decrements[0] == pytest.approx(gradient @ np.linalg.solve(curvature, gradient), rel=1e-6)


# Mode


@pytest.mark.parametrize("misfit", [0.0, 0.3])
@pytest.mark.parametrize(("notation", "truth"), [("n1|r1|m1", SMALL_THETA), (PAPER_NETWORK, PAPER_THETA)])
def test_mode_equals_scipys(notation, truth, misfit):
    kernel, likelihood, _ = person(notation, truth, misfit=misfit)
    mean, precision = truth + 0.2, np.eye(truth.size)
    starts = truth + np.vstack([np.zeros(truth.size), np.random.default_rng(3).normal(0, 1, (12, truth.size))])
    mode = find_mode(kernel, likelihood, starts, mean, precision)
    assert mode.converged
    objective = objective_of(kernel, likelihood, mean, precision)
    arguments = derivative_arguments(likelihood, mean, precision)
    found = [
        minimize(objective, start, jac=lambda x: _gradient(kernel.program, x, *arguments), method="BFGS")
        for start in starts
    ]
    best = min(found, key=lambda result: result.fun)
    assert mode.objective == pytest.approx(objective(mode.theta), rel=1e-13)
    assert mode.objective == pytest.approx(best.fun, abs=1e-5)
    distance = (mode.theta - best.x) @ mode.precision @ (mode.theta - best.x)
    assert distance < 1e-4  # squared posterior standard deviations


def test_curvature_and_scale_at_the_mode():
    kernel, likelihood, data = person(PAPER_NETWORK, PAPER_THETA)
    precision = np.diag(np.linspace(1, 2, 8))
    mode = find_mode(kernel, likelihood, PAPER_THETA[None], PAPER_THETA, precision)
    chi = chi_square(kernel, mode.theta, *data)
    assert mode.scale == pytest.approx(np.sqrt((2 + 0.5 * chi) / (2 + likelihood.count)), rel=1e-10)
    fisher = repetition_equations(kernel, likelihood, mode.theta)[1].sum(axis=0)
    np.testing.assert_allclose(mode.information, fisher / mode.scale**2, rtol=1e-10)
    ridge = ROUNDING * np.diag(np.diag(mode.precision))
    np.testing.assert_allclose(mode.precision - ridge, mode.information + precision, rtol=1e-13)


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_scale_says_by_how_much_the_noise_was_underestimated(factor):
    kernel, _, (z, sd, deviations) = person(PAPER_NETWORK, PAPER_THETA, repetitions=10, seed=5)
    likelihood = Likelihood.make(FREQUENCY, z, sd / factor, deviations)
    mode = find_mode(kernel, likelihood, PAPER_THETA[None], PAPER_THETA, np.eye(8))
    assert mode.scale == pytest.approx(factor, rel=5 / np.sqrt(4 * z.size))  # five standard errors


def test_mode_is_within_its_own_standard_deviations_of_the_truth():
    """Over 60 persons the squared distance averages to the number of elements."""
    distances = []
    for seed in range(60):
        kernel, likelihood, _ = person("n1|r1|m1", SMALL_THETA, repetitions=1, seed=seed)
        mode = find_mode(kernel, likelihood, SMALL_THETA[None], SMALL_THETA, 1e-6 * np.eye(3))
        distances.append((mode.theta - SMALL_THETA) @ mode.precision @ (mode.theta - SMALL_THETA))
    assert np.mean(distances) == pytest.approx(3.0, abs=5 * np.sqrt(6 / 60))


def test_too_few_iterations_are_not_called_converged():
    kernel, likelihood, _ = person(PAPER_NETWORK, PAPER_THETA)
    mean, precision, start = PAPER_THETA, np.eye(8), PAPER_THETA + 1.0
    for iterations, converged in ((1, False), (2, False), (100, True)):
        ends, objectives, decrements = all_modes(kernel, likelihood, start[None], mean, precision, iterations)
        mode = mode_at(kernel, likelihood, ends[0], mean, precision, float(decrements[0]))
        assert mode.converged is converged
        assert mode.converged is bool(decrements[0] < DECREMENT_LIMIT)
        assert mode.objective == pytest.approx(objectives[0], rel=1e-12)


def test_objective_never_rises():
    kernel, likelihood, _ = person(PAPER_NETWORK, PAPER_THETA, misfit=0.3)
    start = PAPER_THETA[None] + np.random.default_rng(0).normal(0, 1.5, (4, 8))
    runs = [all_modes(kernel, likelihood, start, PAPER_THETA, np.eye(8), n)[1] for n in range(1, 30)]
    assert np.all(np.diff(runs, axis=0) <= 0)


def test_start_without_likelihood_is_passed_over():
    kernel, likelihood, _ = person("n1|r1|m1", SMALL_THETA)
    bad = SMALL_THETA + np.array([0, 0, 800.0])
    with np.errstate(all="ignore"):
        mode = find_mode(kernel, likelihood, np.array([bad, SMALL_THETA]), SMALL_THETA, np.eye(3))
        assert mode.converged
        assert not find_mode(kernel, likelihood, bad[None], SMALL_THETA, np.eye(3)).converged


def test_first_start_is_preferred_among_equals():
    """Two branches that could change places keep the names of the first start."""
    theta = np.log([2e-3, 3.0, 0.2, 0.8])
    kernel, likelihood, _ = person("(m1-r1)|(m2-r2)", theta, repetitions=1)
    swapped = theta[[2, 3, 0, 1]]
    mean = 0.5 * (theta + swapped)
    rng = np.random.default_rng(4)
    for first, second in [(theta, swapped), (swapped, theta)] * 5:
        starts = np.array([first, second]) + rng.normal(0, 0.2, (2, 4))  # so that the ends differ in rounding
        mode = find_mode(kernel, likelihood, starts, mean, 1e-4 * np.eye(4))
        assert mode.converged
        assert np.abs(mode.theta - first).max() < 0.5
        assert mode.apart == 0


def test_a_mode_tells_how_far_it_is_from_where_the_first_start_ended():
    """The prior prefers one of two branches' orders by many nats; from the other's valley the search does not leave."""
    theta = np.log([2e-3, 3.0, 0.2, 0.8])
    kernel, likelihood, _ = person("(m1-r1)|(m2-r2)", theta, repetitions=1)
    swapped = theta[[2, 3, 0, 1]]
    alone = find_mode(kernel, likelihood, swapped[None], theta, np.eye(4))
    both = find_mode(kernel, likelihood, np.array([swapped, theta]), theta, np.eye(4))
    assert alone.apart == 0
    assert both.objective < alone.objective - 1
    assert both.apart == np.abs(both.theta - alone.theta).max() > 1


@pytest.mark.parametrize("n", [1, 2, 103, 104, 105, 401])
def test_normal_equations_are_sums_over_frequencies_however_they_are_divided(n):
    kernel = Kernel(parse("skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))"))
    rng = np.random.default_rng(n)
    theta, frequency = rng.normal(0, 1, len(kernel.elements)), np.geomspace(3, 900, n)
    model, derivative = kernel.derivative(theta, frequency)
    z = model * np.exp(rng.normal(0, 0.1, n) + 1j * rng.normal(0, 0.1, n))
    weight = rng.uniform(0.5, 2, n) / np.abs(z) ** 2
    parts = np.array([z.real, z.imag])
    chi, gradient, information = normal_equations(kernel.program, theta, 2 * np.pi * frequency, parts, weight)
    np.testing.assert_allclose(chi, np.sum(weight * np.abs(model - z) ** 2), rtol=1e-11)
    expected = np.real(derivative.conj() @ (weight * (model - z)))
    np.testing.assert_allclose(gradient, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())
    expected = np.real((derivative.conj() * weight) @ derivative.T)
    np.testing.assert_allclose(information, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def test_curvature_beside_a_resonance_that_nothing_damps_can_be_inverted():
    """One frequency weighs 1e18 times as much as the prior there, and what the others say is lost in rounding."""
    kernel = Kernel(parse("m1|r1|(n1-m2)"))
    mass = 2e-3
    resonant = np.log([2e-3, 1.5, 1 / (mass * (2 * np.pi * FREQUENCY[20]) ** 2), mass])
    z = kernel.impedance(resonant + np.array([0, 0, 0.3, 0]), FREQUENCY)[None]
    likelihood = Likelihood.make(FREQUENCY, z, 1e-2 * np.abs(z), np.zeros((1, 4)))
    lost = 0
    for distance in np.geomspace(1e-10, 1e-7, 20):
        theta = resonant + np.array([0, 0, distance, 0])
        mode = mode_at(kernel, likelihood, theta, resonant, np.eye(4), 0.0)
        try:
            np.linalg.cholesky(mode.information + np.eye(4))
        except np.linalg.LinAlgError:
            lost += 1
        np.linalg.cholesky(mode.precision)
    assert lost > 0
