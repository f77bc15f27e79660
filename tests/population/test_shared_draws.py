"""Parameters that are the same for everybody: equations and moved draws against exact or independent computations.

The persons are made by hand, with a known noise, so that nothing but `shared.py` and `shared_draws.py` and what they
are fed is involved; `test_shared_fits.py` looks at whole fits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import root
from shared_worlds import (
    FREQUENCY,
    ONE,
    TWO,
    World,
    directions,
    drawn,
    equations,
    fitted,
    moved_world,
    populations,
    world,
)

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, log_likelihood
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.shared_draws import Sharing

# --- the equations of the shared parameters ---------------------------------------------------------------------------


def residuals(w: World, phi: np.ndarray, likelihood: Likelihood, theta: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Of every repetition, shape (J, F)."""
    exact = w.pooling.kernel.impedance(w.pooling.whole(theta + own, phi), FREQUENCY)
    return np.asarray(exact - (likelihood.z[:, 0] + 1j * likelihood.z[:, 1]))


def deviations_from(contrast: np.ndarray, repetitions: int) -> np.ndarray:
    """Deviations (J, V) of one or two repetitions."""
    return np.array([contrast, -contrast]) if repetitions == 2 else np.zeros((1, contrast.size))


def negative_log_posterior(w: World, x: np.ndarray, phi: np.ndarray, mean: np.ndarray, likelihood: Likelihood) -> float:
    """Of theta and, with two repetitions, half their difference: both are in x."""
    v, j = w.mean.size, len(likelihood.z)
    theta, own = x[:v], deviations_from(x[v:], j) if j == 2 else np.zeros((1, v))
    chi = np.sum(likelihood.weight * np.abs(residuals(w, phi, likelihood, theta, own)) ** 2)
    value = (SCALE_SHAPE + likelihood.count) * np.log(SCALE_SHAPE + 0.5 * chi)
    value += 0.5 * (theta - mean) @ np.linalg.solve(w.covariance, theta - mean)
    return float(value + (0.5 * np.sum((own / w.rho) ** 2) if j == 2 else 0.0))


def profile(
    w: World, phi: np.ndarray, mean: np.ndarray, likelihood: Likelihood, start: np.ndarray
) -> tuple[float, np.ndarray]:
    """Least negative log posterior at shared parameters and a population's mean, and where it is."""
    v, j = w.mean.size, len(likelihood.z)

    def gradient(x: np.ndarray) -> np.ndarray:
        theta, own = x[:v], deviations_from(x[v:], j) if j == 2 else np.zeros((1, v))
        rest = residuals(w, phi, likelihood, theta, own)
        tangent = w.pooling.kernel.derivative(w.pooling.whole(theta + own, phi), FREQUENCY)[1][:, w.pooling.varying]
        chi = np.sum(likelihood.weight * np.abs(rest) ** 2)
        scale = (SCALE_SHAPE + likelihood.count) / (SCALE_SHAPE + 0.5 * chi)
        each = scale * np.einsum("jf,jpf->jp", likelihood.weight * rest, tangent.conj()).real
        upward = each.sum(axis=0) + np.linalg.solve(w.covariance, theta - mean)
        return np.concatenate([upward, each[0] - each[1] + 2 * x[v:] / w.rho**2]) if j == 2 else upward

    found = root(gradient, start, tol=1e-13)
    assert np.abs(found.x - root(gradient, start + 1e-3, tol=1e-13).x).max() < 1e-9
    return negative_log_posterior(w, found.x, phi, mean, likelihood), found.x


@pytest.mark.parametrize("repetitions", [1, 2])
@pytest.mark.parametrize("network", [ONE, TWO])
def test_equations_are_derivatives_of_the_profile(network: str, repetitions: int) -> None:
    """Without noise the Gauss-Newton curvature is exact, and so are the responses: modes are searched anew nearby."""
    w = world(network, repetitions, 1, noise=0.0)
    likelihood = w.likelihoods[0]
    own = equations(w, w.phi, likelihood, fitted(w, w.phi, likelihood))
    s, v, h = w.phi.size, w.mean.size, 3e-4
    at = np.concatenate([w.phi, w.mean])
    start = np.concatenate([w.mean, np.zeros(v * (repetitions - 1))])

    def there(change: np.ndarray) -> tuple[float, np.ndarray]:
        return profile(w, at[:s] + change[:s], at[s:] + change[s:], likelihood, start)

    steps = h * np.eye(s + v)
    middle = there(np.zeros(s + v))[0]
    curvature = np.empty((s + v, s + v))
    for p in range(s + v):
        ahead, behind = there(steps[p]), there(-steps[p])
        slope = (ahead[1] - behind[1]) / (2 * h)
        np.testing.assert_allclose(own.response[:, p], slope[:v], rtol=0, atol=2e-4)
        if repetitions == 2:
            np.testing.assert_allclose(own.drift[0, :, p], slope[v:], rtol=0, atol=2e-4)
            np.testing.assert_allclose(own.drift[1], -own.drift[0], rtol=0, atol=1e-12)
        for q in range(p + 1):
            both, opposite = there(steps[p] + steps[q])[0], there(steps[p] - steps[q])[0]
            back, other = there(-steps[p] - steps[q])[0], there(steps[q] - steps[p])[0]
            mixed = (both + back - opposite - other) / (4 * h**2)
            if p == q:
                mixed = (ahead[0] + behind[0] - 2 * middle) / h**2
            curvature[p, q] = curvature[q, p] = mixed
    scale = np.sqrt(np.diag(curvature))
    np.testing.assert_allclose(own.curvature / np.outer(scale, scale), curvature / np.outer(scale, scale), atol=2e-3)
    # Parameters of the person absorb much of a shared one's effect, and more repetitions matter: nothing is trivial.
    assert np.abs(own.response[:, :s]).max() > 0.01


@pytest.mark.parametrize("repetitions", [1, 2])
@pytest.mark.parametrize("network", [ONE, TWO])
def test_gradient_is_that_of_the_profile_with_noise_too(network: str, repetitions: int) -> None:
    """At the mode only the shared parameters' own derivative is left."""
    w = world(network, repetitions, 3, noise=0.05, seed=3)
    h = 1e-4
    for likelihood in w.likelihoods:
        fit = fitted(w, w.phi, likelihood)
        own = equations(w, w.phi, likelihood, fit)
        start = np.concatenate([fit.theta, fit.deviations[0] if repetitions == 2 else []])
        sd = 1 / np.sqrt(np.diag(own.curvature))
        for p in range(w.phi.size):
            step = h * np.eye(w.phi.size)[p]
            values = [profile(w, w.phi + sign * step, w.mean, likelihood, start)[0] for sign in (1, -1)]
            slope = (values[0] - values[1]) / (2 * h)
            assert -own.gradient[p] * sd[p] == pytest.approx(slope * sd[p], abs=2e-3)


# --- moved draws ------------------------------------------------------------------------------------------------------


def test_held_parameters_stay_at_the_origin() -> None:
    kernel = Kernel(parse(TWO), scales={"d1": 1e-3})
    pooling, rng = Pooling.of(kernel), np.random.default_rng(6)
    origin, covariance = np.array([0.2, -6.9]), np.array([[0.04]])
    for free in ((0,), (1,)):
        held = 1 - free[0]
        sharing = Sharing.around(pooling, origin, covariance, free)
        phi = origin + rng.normal(size=(40, 2))
        away = (phi[:, free] - origin[list(free)]) / 0.2
        np.testing.assert_allclose(sharing.standardised(phi), np.clip(away, -sharing.reach, sharing.reach))
        np.testing.assert_allclose(sharing.beyond(phi), np.maximum(np.abs(away[:, 0]) - sharing.reach, 0), atol=1e-12)
        slope = sharing.beyond_slope(phi, 2.0)
        assert not slope[:, held].any()
        step = 1e-6 * np.eye(2)[free[0]]
        difference = (2 * sharing.beyond(phi + step) ** 2 - 2 * sharing.beyond(phi - step) ** 2) / 2e-6
        np.testing.assert_allclose(slope[:, free[0]], difference, rtol=1e-5, atol=1e-5)
        assert sharing.spread(origin[list(free)] + 0.3, np.array([[0.16]])) == pytest.approx(np.sqrt(0.16 + 0.09) / 0.2)
        name = pooling.names[held]
        for own, t in zip(sharing.kernels, sharing.points, strict=True):
            moved_to = origin + np.eye(2)[free[0]] * 0.2 * t[0]
            theta = np.zeros((1, len(own.elements)))
            expected = pooling.at(moved_to).impedance(theta, FREQUENCY)
            np.testing.assert_array_equal(own.impedance(theta, FREQUENCY), expected, err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize("repetitions", [1, 2])
@pytest.mark.parametrize("network", [ONE, TWO])
def test_moved_draws_equal_fresh_draws(network: str, repetitions: int) -> None:
    """Everybody's log likelihood wherever the shared parameters are, from draws that were made there."""
    w = world(network, repetitions, 8, seed=1)
    kept = moved_world(w, 1024)
    some = populations(w, kept.sharing, directions(w.phi.size))
    terms, effective = kept.marginal.terms(some, effective=True)
    terms = terms + kept.constants
    fresh, error = np.empty_like(terms), 1 / effective - 1 / kept.draws
    for row, phi in enumerate(some.shared):
        for i, likelihood in enumerate(w.likelihoods):
            draws, *_ = drawn(w, phi, likelihood, fitted(w, phi, likelihood), 4096, 100 + i)
            own = ImportanceLikelihood(
                [draws], w.mean[None], 1.3 * w.covariance, np.array([repetitions]), np.zeros((1, 0)), ()
            )
            value, count = own.terms(replace(some[slice(row, row + 1)], shared=None), effective=True)
            fresh[row, i] = value[0, 0] + draws.log_ratio.max()
            error[row, i] += 1 / count[0, 0] - 1 / 4096
    rounding = 1e-3  # of single precision, and of Laplace's method expanded elsewhere
    assert np.abs(terms - fresh).max() < 5 * np.sqrt(error.max()) + rounding
    assert np.all(np.abs((terms - fresh).sum(axis=1)) < 4 * np.sqrt(error.sum(axis=1)) + rounding * len(w.likelihoods))
    # The errors are far below the differences that matter, of persons and of all of them together.
    assert np.sqrt(error.max()) < 0.1 * np.ptp(fresh, axis=0).max()
    assert np.sqrt(error.sum(axis=1).max()) < 0.2 < 0.1 * np.ptp(fresh.sum(axis=1))


def test_moved_draws_equal_the_integral() -> None:
    """With two parameters that vary and one repetition the integral is done on a grid: no Monte-Carlo on that side."""
    w = world(ONE, 1, 3, seed=2)
    kept = moved_world(w, 8192)
    some = populations(w, kept.sharing, directions(1))
    terms, effective = kept.marginal.terms(some, effective=True)
    for row, phi in enumerate(some.shared):
        kernel = w.pooling.at(phi)
        for i, likelihood in enumerate(w.likelihoods):
            fit = fitted(w, phi, likelihood)
            factor = np.linalg.cholesky(np.linalg.inv(fit.mode.precision))
            x = np.linspace(-9, 9, 181)
            u = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
            theta = fit.theta + u @ factor.T
            values = log_likelihood(kernel, likelihood, theta)
            offset = (theta - some.mu[row]) / some.between_persons[row]
            values = values - 0.5 * np.sum(offset**2, axis=1) - np.sum(np.log(some.between_persons[row]))
            cell = np.log(x[1] - x[0]) * 2 + np.log(np.diag(factor)).sum()
            exact = np.logaddexp.reduce(values) + cell
            error = np.sqrt(1 / effective[row, i] - 1 / kept.draws)
            assert terms[row, i] + kept.constants[i] == pytest.approx(exact, abs=4 * error + 1e-3)
            assert error < 0.02
