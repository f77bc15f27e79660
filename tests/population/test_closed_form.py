r"""One damper, where the population's posterior has a closed form up to three integrals.

The recordings are real numbers r plus noise, and noise is small enough that ln r is normal: with J repetitions of F
frequencies, of noise s sigma relative to r, the mean y_ij of one recording's ln r is sufficient for the element,

.. math:: y_{i\cdot} \sim N(\mu, \tau^2 + (\rho^2 + s_i^2 e^2)/J), \qquad
          c_{ij} \sim N(0, \rho^2 + s_i^2 e^2), \qquad e^2 = \sigma^2/F,

c being the contrasts, and the rest of the residuals tells s_i, with 2 F J - J degrees of freedom. A grid in mu, tau and
rho, and quadrature over every s_i, give the posterior without any of the approximations of the package.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population.fit import FitSettings, fit_population
from bayes_impedance.recordings.files import Recordings, Subject

PERSONS, REPETITIONS, FREQUENCIES = 12, 3, 20
NOISE = 0.012
"""Relative; one recording's ln r is then known to 0.0027, and the normal approximation errs by that much of itself."""

Float = NDArray[np.float64]


def recordings_of_dampers(seed: int) -> Recordings:
    """Dampers that vary between persons by 1 % and between repetitions by 0.4 %."""
    rng = np.random.default_rng(seed)
    frequency = np.geomspace(5, 5000, FREQUENCIES)
    person = np.log(2.0) + 0.01 * rng.normal(size=(PERSONS, 1))
    r = np.exp(person + 0.004 * rng.normal(size=(PERSONS, REPETITIONS)))[..., None]
    parts = rng.normal(size=(2, PERSONS, REPETITIONS, FREQUENCIES))
    scale = np.exp(0.15 * rng.normal(size=(PERSONS, 1, 1)))
    z = r + 2.0 * NOISE * scale * (parts[0] + 1j * parts[1])
    noise_sd = np.full((REPETITIONS, FREQUENCIES), 2.0 * NOISE)
    names = tuple(str(j + 1) for j in range(REPETITIONS))
    subjects = tuple(
        Subject(name=f"D{i + 1:02d}", frequency_hz=frequency, z=z[i], repetitions=names, noise_sd=noise_sd)
        for i in range(PERSONS)
    )
    return Recordings(
        title="dampers",
        unit="N s/m",
        network="r1",
        source="simulated",
        licence="MIT",
        subjects=subjects,
        sha256="",
        warnings=(),
    )


def moments_on_grid(recordings: Recordings, centre: float) -> dict[str, tuple[float, float]]:
    """Posterior mean and standard deviation of mu, tau and rho."""
    z = np.array([s.z for s in recordings.subjects])
    mean = z.real.mean(axis=2)
    y = np.log(mean)
    e2 = NOISE**2 / FREQUENCIES * (2.0 / mean.mean(axis=1)) ** 2  # (N,)
    rest = np.sum((z.real - mean[..., None]) ** 2 + z.imag**2, axis=(1, 2)) / (2.0 * NOISE) ** 2  # (N,)
    freedom = REPETITIONS * (2 * FREQUENCIES - 1)
    between = y.mean(axis=1)
    within = np.sum((y - between[:, None]) ** 2, axis=1)

    log_s2 = np.linspace(-1.2, 1.2, 49)[None]  # InvGamma(2, 2) in s^2, with the Jacobian of the logarithm
    s2 = np.exp(log_s2)
    weight = -2 * log_s2 - 2 / s2 - 0.5 * freedom * log_s2 - 0.5 * rest[:, None] / s2  # (N, Q)
    mu = between.mean() + np.linspace(-0.02, 0.02, 61)
    tau = np.linspace(0, 0.035, 71)[1:]
    rho = np.linspace(0, 0.012, 61)[1:]
    log_posterior = np.empty((mu.size, tau.size, rho.size))
    for k, one in enumerate(rho):
        variance = one**2 + s2 * e2[:, None]  # (N, Q)
        common = weight - 0.5 * (REPETITIONS - 1) * np.log(variance) - 0.5 * within[:, None] / variance
        total = tau[:, None, None] ** 2 + variance / REPETITIONS  # (T, N, Q)
        offset = (between[None] - mu[:, None]) ** 2  # (M, N)
        exponent = common - 0.5 * np.log(total) - 0.5 * offset[:, None, :, None] / total
        log_posterior[:, :, k] = logsumexp(exponent, axis=3).sum(axis=2)
    log_posterior += -0.5 * ((mu - centre) / 3.0)[:, None, None] ** 2 - 0.5 * tau[:, None] ** 2 - 0.5 * rho**2
    density = np.exp(log_posterior - log_posterior.max())
    density /= density.sum()
    moments = {}
    for axis, (name, grid) in enumerate((("mu", mu), ("tau", tau), ("rho", rho))):
        marginal = density.sum(axis=tuple({0, 1, 2} - {axis}))
        assert marginal[[0, -1]].max() < 0.02 * marginal.max() or name == "rho", "the grid cuts the posterior"
        first = float(marginal @ grid)
        moments[name] = (first, float(np.sqrt(marginal @ (grid - first) ** 2)))
    return moments


@pytest.mark.long
def test_population_of_dampers_agrees_with_quadrature() -> None:
    """Means within 0.05 and spreads within 5 % of a standard deviation, plus three Monte-Carlo errors."""
    recordings = recordings_of_dampers(seed=5)
    settings = FitSettings(sampler=SamplerSettings(ensembles=8, effective=6000, workers=1))
    fit = fit_population(recordings, settings=settings, seed=2, workers=1)
    assert not fit.diagnostics.problems
    some = fit.parameters
    ours = {"mu": some.mu, "tau": some.between_persons, "rho": some.between_repetitions}
    n = some.mu.shape[0]  # kept draws are an autocorrelation time apart
    for name, (mean, sd) in moments_on_grid(recordings, float(fit.prior.centre[0])).items():
        values: Float = ours[name][:, 0]
        standard = (values - values.mean()) / values.std()
        kurtosis = float(np.mean(standard**4))
        shift = (values.mean() - mean) / sd
        ratio = values.std() / sd
        assert abs(shift) < 0.05 + 3 / np.sqrt(n), f"{name}: mean off by {shift:.3f} sd"
        assert abs(ratio - 1) < 0.05 + 3 * np.sqrt((kurtosis - 1) / (4 * n)), f"{name}: spread ratio {ratio:.3f}"
