"""Gradients of the population likelihood and of the posterior, against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_posteriors import posterior_of
from persons_with_draws import (
    REFERENCE_COVARIANCE,
    N,
    P,
    contrasts_of,
    gaussian_draws,
    parameters,
    people,
    require_gradient,
    slopes_of,
)

from bayes_impedance import FINGERTIP, simulate_recordings
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.exponentials import normalise_rows
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.likelihood_gradient import likelihood_gradient
from bayes_impedance.population.parameters import Coordinates
from bayes_impedance.population.prior import Prior
from bayes_impedance.recordings.files import Recordings, Subject

STEP = 1e-2
"""Of differences in coordinates: likelihoods are in single precision."""


def test_a_draw_that_the_recordings_exclude_has_no_part_in_the_gradient():
    """Beside a pole its log likelihood is minus infinity; a weight of zero times that is no number."""
    centres, covariances, repetitions = people()
    draws, _ = gaussian_draws(centres, covariances, np.zeros((N, P)), 256, 3)
    gradients = []
    for worth in (-np.inf, -1e4):
        ratio = draws[0].log_ratio.copy()
        ratio[7] = worth
        one = (replace(draws[0], log_ratio=ratio), *draws[1:])
        marginal = ImportanceLikelihood(one, np.zeros((N, P)), REFERENCE_COVARIANCE, repetitions, np.zeros((N, 0)), [])
        gradients.append(likelihood_gradient(marginal, parameters(3)))
    assert np.isfinite(gradients[0].mu).all()
    np.testing.assert_array_equal(gradients[0].mu, gradients[1].mu)
    np.testing.assert_array_equal(gradients[0].covariance, gradients[1].covariance)


@pytest.mark.parametrize("n_covariates", [0, 2])
@pytest.mark.parametrize("correlated", [True, False])
def test_gradient_of_likelihood_and_prior(n_covariates, correlated):
    """Persons with 1, 2, 3 and 5 repetitions, several blocks, contrasts, a held element, bent dispersions."""
    rng = np.random.default_rng(5)
    centres, covariances, repetitions = people()
    covariates = rng.normal(size=(N, n_covariates))
    means = np.zeros((N, P))
    draws, _ = gaussian_draws(centres, covariances, means, 256, 3)
    contrasts = [contrasts_of(c, n=3, seed=c) for c in (1, 2)]
    marginal = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, covariates, contrasts)
    coordinates = Coordinates(
        prior=Prior(centre=np.zeros(P)),
        correlated=correlated,
        repetitions=True,
        n_covariates=n_covariates,
        free=(0, 2),
        held_mu=np.full(P, 0.1),
        held_dispersion=np.full(P, 0.4),
        bend_persons=np.full(P, 0.15),
        bend_repetitions=np.full(P, 0.05),
    )
    u = 0.3 * rng.normal(size=(7, coordinates.n_dimensions)) + 1.2 * coordinates.even
    u[:, :2] *= 0.1  # of the prior's three

    require_gradient(marginal, coordinates, u, STEP, 1e-3)


def test_gradient_is_finite_where_a_dispersion_between_repetitions_is_zero():
    contrasts = contrasts_of(2)
    rho = np.array([[0.0, 0.2, 0.1], [1e-9, 0.2, 0.1]])[:, :P]
    slope = contrasts.slope(rho)
    assert np.all(np.isfinite(slope))
    assert np.abs(slope[0, 0] - slope[1, 0]) < 1e-5 * np.abs(slope).max()


def test_gradient_from_all_draws_and_from_fewer():
    centres, covariances, repetitions = people()
    means = np.zeros((N, P))
    draws, _ = gaussian_draws(centres, covariances, means, 4096, 3)
    marginal = ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, np.zeros((N, 0)), [])
    some = parameters(5)
    assert marginal.thinned(4096) is marginal
    rough = marginal.thinned(512)
    assert rough.n_draws == 512
    assert rough.thinned(512) is rough
    whole, part = likelihood_gradient(marginal, some), likelihood_gradient(rough, some)
    assert np.abs(part.mu - whole.mu).max() < 0.1 * np.abs(whole.mu).max()
    assert not np.array_equal(part.mu, whole.mu)


def test_weights_are_normalised_and_negligible_ones_are_zero():
    """Subnormal numbers would make products a hundred times slower."""
    values = np.array([[[0.0, -1.0, -30.0, -60.0, -2000.0]]], dtype=np.float32)
    exact = np.exp(values.astype(float))
    normalise_rows(values)
    assert np.abs(values - exact / exact.sum()).max() < 1e-6
    assert np.array_equal(values[0, 0] == 0, [False, False, False, True, True])


def with_a_delay():
    """Twelve persons whose network has a delay that is the same for all."""
    kernel = Kernel(parse("delay[d1*](r1|n1)"))
    rng, frequency = np.random.default_rng(2), np.geomspace(5, 500, 30)
    values = {"r1": np.log(2.0), "n1": np.log(1e-3), "d1": 2e-4}
    centre = np.array([values[p.name] for p in kernel.parameters])
    varies = np.array([not p.shared for p in kernel.parameters])
    subjects = []
    for i in range(12):
        own = centre + varies * (0.3 * rng.normal(size=3) + 0.03 * rng.normal(size=(2, 3)))
        z = kernel.impedance(own, frequency)
        z = z * (1 + 0.03 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))
        subjects.append(Subject(name=f"s{i:02d}", repetitions=("1", "2"), frequency_hz=frequency, z=z, noise_sd=None))
    return Recordings(
        subjects=tuple(subjects), title=None, unit="N s/m", network=str(kernel.network), source=None, licence=None
    )


@pytest.mark.parametrize(
    "kind", [pytest.param("fingertip", marks=pytest.mark.slow), "with a shared delay", "with tails"]
)
def test_gradient_of_a_fits_posterior(kind, monkeypatch):
    """In standard deviations: an error of one changes trajectories by as much as the posterior's own curvature."""
    recordings = (
        simulate_recordings(FINGERTIP, 14, 2, np.geomspace(5, 2000, 40), 4).recordings
        if kind == "fingertip"
        else with_a_delay()
    )
    posterior = posterior_of(recordings, monkeypatch, distribution="student_t" if kind == "with tails" else "normal")
    assert posterior.coordinates.tails == (kind == "with tails")
    rng = np.random.default_rng(6)
    factor = np.linalg.cholesky(posterior.normal_covariance)
    white = 0.7 * rng.normal(size=(4, posterior.mode.size))  # each takes four densities for every coordinate
    posterior.rough_draws = posterior.drawn
    own = posterior.gradient(posterior.mode + white @ factor.T) @ factor
    expected = slopes_of(lambda x: posterior.log_probability(posterior.mode + x @ factor.T), white, STEP)
    assert np.abs(own - expected).max() < 0.05
    assert np.abs(expected).max() > 1


def test_gradient_is_zero_where_the_density_is(monkeypatch):
    posterior = posterior_of(with_a_delay(), monkeypatch)
    far = np.tile(posterior.mode, (2, 1))
    far[0, 0] = 9.0
    assert not posterior.gradient(far)[0].any()
    assert posterior.gradient(far)[1].any()
