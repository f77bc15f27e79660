"""Student t noise: its density against quadrature, its information against simulation, points far off."""

from __future__ import annotations

import numpy as np
import pytest
from noise_with_tails import CENTRE, NETWORK, people_with_noise
from scipy.integrate import quad
from scipy.stats import invgamma, multivariate_t

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.absolute_density import deviations_of, log_constant
from bayes_impedance.person.heavy_noise import (
    TAILS,
    log_density,
    log_likelihoods_of_tails,
    own_fits,
    reweighted,
    squared_scale,
    squares_at,
    weights_of,
)
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, information_share
from bayes_impedance.person.marginal_likelihood import find_ridge, marginal_log_likelihood
from bayes_impedance.person.mode import find_mode

KERNEL = Kernel(parse(NETWORK))


def residuals(degrees: float, n: int, seed: int) -> np.ndarray:
    """Squares over the scale of n complex values."""
    rng = np.random.default_rng(seed)
    stretch = degrees / rng.chisquare(degrees, n) if np.isfinite(degrees) else np.ones(n)
    return np.sum(rng.normal(size=(2, n)) ** 2, axis=0) * stretch


def person(degrees: float, seed: int, repetitions: int = 1, points: int = 60) -> tuple[Likelihood, np.ndarray]:
    """Likelihood of normal noise of one person, and the elements."""
    recordings, elements = people_with_noise(1, degrees, seed, repetitions=repetitions, points=points, known=True)
    one = recordings.subjects[0]
    assert one.noise_sd is not None
    nothing = np.zeros((repetitions, CENTRE.size))
    return Likelihood.make(one.frequency_hz, one.z, one.noise_sd, nothing), elements[0]


@pytest.mark.parametrize("degrees", [2.5, 3.0, 30.0])
def test_density_is_the_integral_over_the_scale(degrees: float) -> None:
    sigma, values = np.array([0.5, 2.0, 1.0]), np.array([0.3 + 0.4j, 3 - 2j, 9j])

    def at(variance: float) -> float:
        each = [
            multivariate_t(shape=variance * s**2 * np.eye(2), df=degrees).pdf([v.real, v.imag])
            for v, s in zip(values, sigma, strict=True)
        ]
        return float(np.prod(each) * invgamma(SCALE_SHAPE, scale=SCALE_SHAPE).pdf(variance))

    exact = np.log(quad(at, 0, np.inf, epsabs=0, epsrel=1e-10, limit=400)[0])
    square = (np.abs(values) / sigma)[None] ** 2
    assert log_density(square, float(-2 * np.log(sigma).sum()), degrees) == pytest.approx(exact, abs=1e-6)


def test_information_is_fishers() -> None:
    """The variance of the score of one part, and the mean weighted square, whose solution is the scale."""
    for degrees in (3.0, 8.0):
        u = residuals(degrees, 400_000, 1)
        w = weights_of(u, degrees)
        assert np.mean(w**2 * u) / 2 == pytest.approx(information_share(degrees), rel=0.01)
        assert np.mean(w * u) / 2 == pytest.approx(1, rel=0.01)
        assert squared_scale(4 * u, degrees) == pytest.approx(4, rel=0.01)
    assert information_share(np.inf) == 1


@pytest.mark.parametrize("degrees", [2.5, 5.0, np.inf])
def test_degrees_of_freedom_are_found(degrees: float) -> None:
    log_likelihood_of = log_likelihoods_of_tails(0.3 * residuals(degrees, 6000, 2), 0.0)
    inside = TAILS[log_likelihood_of >= log_likelihood_of.max() - 3.3]  # 99 %
    assert inside[0] - 0.005 <= 1 / degrees <= inside[-1] + 0.005
    assert inside[-1] - inside[0] < 0.12


def test_the_density_is_that_of_the_t_distribution_at_the_mode_and_near_it() -> None:
    """Along each element, against the density with the scale integrated out: equal at the mode, similar curvature."""
    degrees, ratios = 3.0, []
    for seed in range(30):
        plain, truth = person(degrees, seed)
        theta = truth.copy()
        for _ in range(6):
            square = squares_at(KERNEL, plain, theta)
            heavy = reweighted(plain, weights_of(square / squared_scale(square, degrees), degrees), degrees)
            mode = find_mode(KERNEL, heavy, theta[None], truth, 1e-6 * np.eye(3))
            theta = mode.theta
        ridge = find_ridge(KERNEL, heavy, theta, mode.scale, np.full(3, 0.03))
        constant = log_constant(heavy, ridge, deviations_of(KERNEL, heavy, theta))

        def exact(at: np.ndarray, plain: Likelihood = plain) -> float:
            return log_density(squares_at(KERNEL, plain, at), float(np.log(plain.weight).sum()), degrees)

        assert marginal_log_likelihood(KERNEL, heavy, ridge, theta[None])[0] + constant == pytest.approx(
            exact(theta), abs=1e-6
        )
        step = np.diag(np.diag(ridge.precision) ** -0.5)
        ours = [marginal_log_likelihood(KERNEL, heavy, ridge, theta + k * step) for k in (-1, 0, 1)]
        theirs = [np.array([exact(theta + k * row) for row in step]) for k in (-1, 0, 1)]
        bend = [np.subtract(a[0] + a[2], 2 * a[1]) for a in (ours, theirs)]
        ratios.append(bend[0] / bend[1])
    middle = np.mean(ratios)
    assert 0.93 < middle < 1.07, middle  # with the weights alone it would be 1.4


def test_points_far_off_do_not_move_the_fit() -> None:
    plain, truth = person(np.inf, 3, repetitions=2)
    far = plain.z.copy()
    far[0, :, [5, 20, 33]] *= 1.8
    z, frequency = far[:, 0] + 1j * far[:, 1], plain.omega / (2 * np.pi)
    spoiled = Likelihood.make(frequency, z, plain.weight**-0.5, np.zeros((2, 3)))
    square, weights = own_fits(KERNEL, spoiled, truth, 4.0)
    assert np.all(weights[0, [5, 20, 33]] < 0.05)
    kept = np.delete(weights[0], [5, 20, 33])
    assert np.median(kept) > 0.8
    assert np.median(np.delete(square[0], [5, 20, 33])) < 4
    heavy = reweighted(spoiled, weights, 4.0)
    errors = [np.abs(find_mode(KERNEL, d, truth[None], truth, np.eye(3)).theta - truth).max() for d in (spoiled, heavy)]
    assert errors[1] < 0.02
    assert errors[0] > 2 * errors[1]


def test_parts_of_a_likelihood_keep_their_noise() -> None:
    plain, _ = person(np.inf, 4, repetitions=2)
    heavy = reweighted(plain, np.full((2, 60), 0.5), 4.0)
    share = information_share(4.0)
    assert heavy.values == pytest.approx(share * 120)
    half = heavy.at(np.arange(0, 60, 2))
    assert half.values == pytest.approx(share * 60)
    assert half.plain is not None
    assert half.plain.shape == half.weight.shape == (2, 30)
    one = heavy.recording(1, 3)
    assert one.values == pytest.approx(share * 60)
    assert one.plain is not None
    np.testing.assert_array_equal(one.plain[0], plain.weight[1])
