"""Each person's log density is that of a brute-force integral over everything of the person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import SHORT
from densities_by_grid import log_density, mass_and_damper, one_damper, recordings_of
from scipy.integrate import quad
from scipy.stats import invgamma, multivariate_normal, norm

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.absolute_density import deviations_of, log_constant
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import find_ridge, marginal_log_likelihood
from bayes_impedance.population.fit import PopulationFit, fit_population

TOLERANCE = 0.1
"""Nats. The largest error of 144 persons and populations was 0.072, and the same with eight times as many draws: it is
Laplace's approximation, of somebody whose repetitions differ by several of the population's dispersions."""

TYPICAL = 0.02
"""Nats: the median error, three times what the draws of one person leave."""

CASES = {
    "r1": (one_damper, np.array([0.7]), [1, 2, 3, 2, 1, 3, 2, 1], 12, 81),
    "m1|r1": (mass_and_damper, np.array([-5.0, 0.7]), [1, 2, 2, 1, 1, 2, 2, 1], 12, 49),
}
"""Impedance, centre, repetitions, frequencies, and points of the grid in each dimension."""


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[str, PopulationFit]:
    impedance, mu, repetitions, points, _ = CASES[request.param]
    recordings = recordings_of(impedance, request.param, mu, repetitions, points, seed=4)
    return request.param, fit_population(recordings, settings=replace(SHORT, draws=512), seed=1)


def brute(network: str, fit: PopulationFit, person: int, row: int) -> float:
    impedance, *_, n = CASES[network]
    subject, p = fit.recordings.subjects[person], fit.parameters
    sigma = fit.noise[person] / fit.noise_scale[person]
    order = [fit.kernel.elements.index(e) for e in (["r1"] if network == "r1" else ["m1", "r1"])]
    mu, rho = p.mu[row, order], p.between_repetitions[row, order]
    covariance = p.covariance[row][np.ix_(order, order)]
    return log_density(impedance, subject.frequency_hz, subject.z, sigma, mu, covariance, rho, n)


def test_densities_equal_a_brute_force_integral(case: tuple[str, PopulationFit]) -> None:
    network, fit = case
    found = fit.person_log_likelihood.reshape(-1, len(fit.recordings.subjects))
    p = fit.parameters
    smallest = np.minimum(p.between_persons, p.between_repetitions).min(axis=1)
    resolved = np.flatnonzero(smallest > 0.03)  # the grid resolves dispersions of this size
    rows = resolved[np.argsort(p.mu[resolved, 0])[[0, resolved.size // 2, -1]]]  # far apart
    expected = np.array([[brute(network, fit, i, row) for i in range(found.shape[1])] for row in rows])
    error = np.abs(found[rows] - expected)
    assert error.max() < TOLERANCE
    assert np.median(error) < TYPICAL
    assert np.ptp(expected, axis=0).max() > 10 * TOLERANCE  # the populations do differ


def test_the_density_of_one_person_is_that_under_the_persons_elements() -> None:
    impedance, mu, *_ = CASES["m1|r1"]
    recordings = recordings_of(impedance, "m1|r1", mu, [1], 12, seed=3)
    fit = fit_population(recordings, settings=SHORT, seed=1)
    subject, order = recordings.subjects[0], [fit.kernel.elements.index(e) for e in ("m1", "r1")]
    sigma = fit.noise[0] / fit.noise_scale[0]
    for theta, found in list(zip(fit.parameters.mu, fit.person_log_likelihood.ravel(), strict=True))[::200]:
        residual = subject.z - impedance(theta[order], 2 * np.pi * subject.frequency_hz)
        parts = np.concatenate([residual.real, residual.imag], axis=1)

        def integrand(scale: float, parts: np.ndarray = parts) -> float:
            noise = np.sqrt(scale) * np.tile(sigma, 2)
            return float(np.exp(norm.logpdf(parts, scale=noise).sum() + invgamma.logpdf(scale, 2, scale=2)))

        assert found == pytest.approx(np.log(quad(integrand, 0, 30, points=[0.5, 1, 2])[0]), abs=1e-5)


def test_deviations_and_the_scale_are_integrated_together() -> None:
    """Six repetitions of three values: given the scale all is normal, and Laplace's method alone would be 0.09 off."""
    repetitions, points, rho, sd = 6, 3, 0.01, 0.02
    rng, damper = np.random.default_rng(2), 2.0
    deviations = rho * rng.normal(size=(repetitions, 1))
    z = damper * (1 + deviations + sd * (rng.normal(size=(6, points)) + 1j * rng.normal(size=(6, points))))
    kernel, frequency, theta = Kernel(parse("r1")), np.geomspace(5, 50, points), np.array([np.log(damper)])
    own = (np.log(z.real.mean(axis=1)) - theta)[:, None]
    shrunk = rho**2 / (rho**2 + sd**2 / points) * (own - own.mean())
    likelihood = Likelihood.make(frequency, z, np.full(z.shape, damper * sd), shrunk)
    ridge = find_ridge(kernel, likelihood, theta, 1.0, np.array([rho]))
    constant = log_constant(likelihood, ridge, deviations_of(kernel, likelihood, theta))
    found = marginal_log_likelihood(kernel, likelihood, ridge, theta[None])[0] + constant

    moving = np.kron(np.eye(repetitions) - 1 / repetitions, np.ones((points, points))) * (damper * rho) ** 2
    still = (damper * sd) ** 2 * np.eye(z.size)

    def integrand(scale: float) -> float:
        real = multivariate_normal(None, scale * still + moving).logpdf((z.real - damper).ravel())
        imaginary = multivariate_normal(None, scale * still).logpdf(z.imag.ravel())
        return float(np.exp(real + imaginary + invgamma.logpdf(scale, 2, scale=2)))

    assert found == pytest.approx(np.log(quad(integrand, 0.05, 20, points=[0.5, 1, 2])[0]), abs=0.02)
