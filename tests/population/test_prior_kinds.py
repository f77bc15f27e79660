"""Student t priors of what is the same for all, and of what has an order: against direct computations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import SHORT, THREE_ELEMENTS
from scipy import stats

from bayes_impedance.population import prior_tails
from bayes_impedance.population.fit import FitSettings, fit_population
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior
from bayes_impedance.population.order import Order
from bayes_impedance.population.ordered_centres import Centres
from bayes_impedance.population.parameters import Coordinates
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.prior_draws import draw_prior
from bayes_impedance.population.sample_prior import sample_prior
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings

T = stats.t(prior_tails.DEGREES)
MIXED = Prior(
    centre=np.array([0.3, -1.0, 0.1, 2.0]),
    centre_sd=np.array([1.0, 3.0, 0.5, 2.0]),
    heavy=np.array([True, True, True, False]),
    order=Order(chains=((2, 0, 3),), names=(("c", "a", "d"),)),
)
"""Of an order, and of one beside it, with and without tails."""


def of_kind(kind: str, name: str, centre: float, scale: float, *order: tuple[str, ...]) -> FitSettings:
    own = ElementPrior(centre=float(np.exp(centre)), scale=scale, kind=kind)
    return replace(SHORT, prior=GivenPrior(elements={name: own}, order=order))


def known_shared() -> Coordinates:
    """Three shared parameters: two known and correlated, as of a calibration, and one with tails; the first is held."""
    prior = Prior(
        centre=np.array([0.0, 0.5, -0.2, 1.0]),
        centre_sd=np.array([1.0, 0.1, 0.2, 0.3]),
        correlation=np.array([[1, 0, 0, 0], [0, 1, 0.8, 0], [0, 0.8, 1, 0], [0, 0, 0, 1.0]]),
        heavy=np.array([False, False, False, True]),
    )
    one = np.ones(1)
    return Coordinates(
        prior=Prior(centre=one),
        correlated=False,
        repetitions=False,
        n_covariates=0,
        free=(0,),
        held_mu=one,
        held_dispersion=one,
        shared_prior=prior,
        shared_free=(1, 2, 3),
        held_shared=prior.centre,
    )


def test_the_density_of_shared_parameters_is_that_of_their_coordinates_with_the_jacobian() -> None:
    c = known_shared()
    u = np.random.default_rng(1).normal(0, 2, (30, c.n_dimensions))
    p = c.unpack(u)
    assert p.shared is not None
    packed = np.array([c.pack(p.mu[w], p.covariance[w], p.mu[w], p.slopes[w], p.shared[w]) for w in range(30)])
    np.testing.assert_allclose(packed[:, -3:], u[:, -3:], atol=1e-9)
    slopes = c.shared_slope(u[:, -3:])
    of_phi = c.log_prior(u) - np.linalg.slogdet(slopes)[1]
    normal = stats.multivariate_normal([0.5, -0.2], [[0.01, 0.016], [0.016, 0.04]])
    expected = normal.logpdf(p.shared[:, 1:3]) + T.logpdf((p.shared[:, 3] - 1) / 0.3) - 0.5 * np.sum(u[:, :2] ** 2, 1)
    np.testing.assert_allclose(of_phi - of_phi[0], expected - expected[0], rtol=1e-7, atol=1e-9)
    for k, step in enumerate(1e-6 * np.eye(c.n_dimensions)[-3:]):
        difference = (c.unpack(u + step).shared[:, 1:] - c.unpack(u - step).shared[:, 1:]) / 2e-6  # type: ignore[index]
        np.testing.assert_allclose(slopes[:, :, k], difference, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(c.shared_moments(u[0, -3:], np.eye(3))[1], slopes[0] @ slopes[0].T)
    # Standard deviations of the coordinates, of the covariance that these would give the parameters.
    covariance = slopes[0] @ np.diag([1.0, 4.0, 9.0]) @ slopes[0].T
    np.testing.assert_allclose(c.shared_scale(p.shared[0], covariance), [1, 2, 3], rtol=1e-6)


def test_the_local_precision_draws_as_the_prior_does() -> None:
    prior = known_shared().shared_prior
    assert prior is not None
    there = prior.centre + np.array([0.4, 0.1, -0.3, 3.0])
    force = prior.local_precision(there) @ (there - prior.centre)
    for k, own in enumerate(1e-5 * np.eye(4)):
        assert force[k] == pytest.approx((prior.misfit(there + own) - prior.misfit(there - own)) / 2e-5, rel=1e-5)


def test_the_posterior_of_a_shared_parameter_is_the_product_of_densities() -> None:
    """The recordings determine a damper that is the same for all: a narrow normal density, times the prior's."""
    network = replace(
        THREE_ELEMENTS,
        network="m1|r1*|n1",
        between_persons={"m1": 0.2, "n1": 0.2},
        between_repetitions={},
        correlation={},
        force_exponent={},
    )
    recordings = simulate_recordings(network, 8, 1, np.geomspace(5, 5000, 12), seed=3).recordings
    usual = fit_population(recordings, settings=SHORT, seed=1).parameters.shared
    assert usual is not None
    mean, sd = usual.mean(), usual.std()
    grid = mean + sd * np.linspace(-6, 12, 4001)
    fit = fit_population(recordings, settings=of_kind("student_t", "r1", mean + 6 * sd, sd), seed=1)
    assert not fit.diagnostics.problems
    moved = fit.parameters.shared
    assert moved is not None
    weights = stats.norm(mean, sd).pdf(grid) * T.pdf((grid - mean - 6 * sd) / sd)
    expected = np.average(grid, weights=weights)
    spread = np.sqrt(np.average((grid - expected) ** 2, weights=weights))
    assert moved.mean() == pytest.approx(expected, abs=0.25 * sd)  # 0.86 of them; a normal prior moves it by 3
    assert moved.std() == pytest.approx(spread, rel=0.2)


def test_the_density_of_ordered_centres_is_that_of_the_centres() -> None:
    centres = Centres(MIXED)
    u = np.random.default_rng(2).normal(0, 1.5, (40, 4))
    values = centres.values(u)
    assert np.all((values[:, 2] < values[:, 0]) & (values[:, 0] < values[:, 3]))
    back = centres.coordinates(values)
    np.testing.assert_allclose(np.where(centres.even, np.abs(u), u), back, rtol=1e-7, atol=1e-9)
    # Only the second has no order, and a Jacobian that is not constant.
    found = centres.log_prior(u) - np.log(prior_tails.slope(u[:, 1]))
    expected = MIXED.log_density(values)
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-7, atol=1e-9)


def test_the_gradient_of_ordered_centres_is_the_derivative() -> None:
    centres, u = Centres(MIXED), np.array([[0.3, -2.5, 1.2, 0.7]])
    target = np.array([0.2, 3.0, -1.0, 4.0])

    def log_posterior(u: np.ndarray) -> float:
        return float(centres.log_prior(u)[0] - 0.5 * np.sum((centres.values(u) - target) ** 2))

    slope = centres.slope(u, target - centres.values(u))[0]
    for k, step in enumerate(1e-5 * np.eye(4)):
        assert slope[k] == pytest.approx((log_posterior(u + step) - log_posterior(u - step)) / 2e-5, rel=1e-6)


def test_draws_of_ordered_centres_are_order_statistics_of_a_student_t() -> None:
    order = Order(chains=((1, 0),), names=(("b", "a"),))
    prior = Prior(centre=np.full(2, 1.0), centre_sd=2.0, heavy=np.array([True, True]), order=order)
    drawn = (draw_prior(prior, 4000, 1).mu - 1) / 2
    assert stats.kstest(drawn[:, 1], lambda x: 1 - T.sf(x) ** 2).pvalue > 1e-3
    assert stats.kstest(drawn[:, 0], lambda x: T.cdf(x) ** 2).pvalue > 1e-3


@pytest.mark.long
def test_recordings_overrule_an_ordered_centre_with_tails() -> None:
    """A centre given eleven scales from where the recordings are: farther than coordinates of one scale would reach."""
    branches = VirtualPopulation(
        network="(n1-r1)|(n2-r2)",
        central={"n1": 1e-4, "r1": 2.0, "n2": 1e-3, "r2": 20.0},
        between_persons={"n1": 0.2, "r1": 0.2, "n2": 0.2, "r2": 0.2},
    )
    # Of fewer people the centre's own likelihood has tails, and the posterior a second mode at the prior's centre.
    recordings = simulate_recordings(branches, 16, 1, np.geomspace(5, 5000, 16), seed=4).recordings
    order = ("n1", "n2")
    settings = of_kind("student_t", "n1", np.log(1e-4) - 1.1, 0.1, order)
    fit = fit_population(recordings, settings=settings, seed=1)
    k = fit.kernel.elements.index("n1")
    usual = fit_population(recordings, settings=replace(SHORT, prior=GivenPrior(order=[order])), seed=1).parameters.mu
    weights = prior_tails.density((usual[:, k] - np.log(1e-4) + 1.1) / 0.1)
    expected, sd = np.average(usual[:, k], weights=weights), usual[:, k].std()
    assert fit.parameters.mu[:, k].mean() == pytest.approx(expected, abs=0.5 * sd)
    assert abs(expected - np.log(1e-4)) < 4 * sd
    table = sample_prior(recordings, settings=settings, n=2000, seed=2).to_dataframe()
    assert (table["n1"] < table["n2"]).all()
