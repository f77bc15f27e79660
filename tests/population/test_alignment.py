"""Recordings whose sharp resonances repositioning moves are brought to their own elements."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.bounded_search import GROSS
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population.alignment import aligned
from bayes_impedance.population.e_step import begin, expect

FREQUENCY = np.geomspace(5, 500, 120)
KERNEL = Kernel(parse("r1-(m1|n1)"))
THETA = np.log([10.0, 0.05, 5e-4])
PRECISION, RHO = np.eye(3) / 0.3**2, np.full(3, 0.1)
NO_STARTS = np.empty((0, 3))
NOISE = 0.005


def likelihood_of(moves: list[float]) -> Likelihood:
    """Recordings whose compliance differs by these factors, that is, their resonance by the roots of these."""
    rng = np.random.default_rng(1)
    theta = THETA + np.outer(np.log(moves), [0.0, 0.0, 1.0])
    z = KERNEL.impedance(theta, FREQUENCY)
    sd = NOISE * np.abs(z)
    z = z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    return Likelihood.make(FREQUENCY, z, sd, np.zeros(theta.shape))


def test_linear_steps_do_not_arrive_where_the_search_of_each_recording_does() -> None:
    moves = [0.85, 1.0, 1.2]
    likelihood = likelihood_of(moves)
    fit = expect(KERNEL, PRECISION, RHO, likelihood, begin(likelihood, THETA), THETA, NO_STARTS)
    for _ in range(10):
        fit = expect(KERNEL, PRECISION, RHO, likelihood, fit, THETA, NO_STARTS)
    assert fit.mode.scale > 3  # ten linear steps have not arrived
    place = aligned(KERNEL, PRECISION, RHO, likelihood, fit, THETA)
    assert place is not fit
    # What a step of shared parameters, and a checkpoint, take from a fit between two iterations.
    assert place.mode.scale < fit.mode.scale
    np.testing.assert_array_equal(place.expanded, place.deviations)
    np.testing.assert_allclose(place.deviations.sum(axis=0), 0, atol=1e-12)
    there = expect(KERNEL, PRECISION, RHO, likelihood, place, THETA, NO_STARTS)
    assert 0.9 < there.mode.scale < 1.1
    np.testing.assert_allclose(there.deviations[:, 2], np.log(moves) - np.mean(np.log(moves)), atol=0.01)


def test_who_has_left_the_valley_is_searched_from_where_the_search_began() -> None:
    """From other elements no recording comes back, and from the beginning each is found."""
    likelihood = likelihood_of([0.85, 1.2])
    elsewhere = THETA + np.array([0.0, 6.0, 6.0])
    fit = expect(KERNEL, np.eye(3) / 5.0**2, RHO, likelihood, begin(likelihood, elsewhere), elsewhere, NO_STARTS)
    wide = KERNEL, np.eye(3) / 5.0**2, RHO, likelihood, fit, THETA
    assert fit.mode.scale > 3
    assert aligned(*wide).mode.scale > 3
    assert aligned(*wide, THETA).mode.scale < 1.2
    described = likelihood_of([1.0, 1.001])
    there = expect(KERNEL, PRECISION, RHO, described, begin(described, THETA), THETA, NO_STARTS)
    assert aligned(KERNEL, PRECISION, RHO, described, there, THETA, THETA) is there


def test_who_is_described_stays_as_he_is() -> None:
    likelihood = likelihood_of([1.0, 1.001])
    fit = expect(KERNEL, PRECISION, RHO, likelihood, begin(likelihood, THETA), THETA, NO_STARTS)
    assert fit.mode.scale < GROSS
    assert aligned(KERNEL, PRECISION, RHO, likelihood, fit, THETA) is fit


def test_one_recording_has_no_deviations() -> None:
    likelihood = likelihood_of([1.5])
    fit = expect(KERNEL, PRECISION, RHO, likelihood, begin(likelihood, THETA + 1.0), THETA + 1.0, NO_STARTS)
    assert aligned(KERNEL, PRECISION, RHO, likelihood, fit, THETA + 1.0) is fit


def test_a_network_that_describes_nothing_keeps_its_fit_unless_another_place_is_better() -> None:
    other = Kernel(parse("r1-m1-n1"))
    likelihood = likelihood_of([0.9, 1.1])
    fit = expect(other, PRECISION, RHO, likelihood, begin(likelihood, THETA), THETA, NO_STARTS)
    assert fit.mode.scale > GROSS
    place = aligned(other, PRECISION, RHO, likelihood, fit, THETA)
    there = expect(other, PRECISION, RHO, likelihood, place, THETA, NO_STARTS)
    assert there.mode.scale <= fit.mode.scale


def test_who_is_described_badly_is_searched_as_far_as_the_population_reaches() -> None:
    """Both recordings have a resonance that the fit has hidden between two frequencies, far from where it is."""
    kernel = Kernel(parse("n1-((n2-m1)|(m2-r1)|n3)-m3"))
    true = np.array([-6.3, -2.32, -12.6, -10.46, -0.37, -7.7, -8.18])
    own = true + np.outer([1, -1], [0.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    rng, frequency_hz = np.random.default_rng(1), np.geomspace(8, 2000, 255)
    z = kernel.impedance(own, frequency_hz)
    sd = NOISE * np.abs(z)
    z = z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    likelihood = Likelihood.make(frequency_hz, z, sd, np.zeros(own.shape))
    precision, rho, none = np.eye(7) / 0.5**2, np.full(7, 0.03), np.empty((0, 7))
    begun = true + np.array([0, 0.695, -0.62, 0, 0, 0, 0])
    fit = expect(kernel, precision, rho, likelihood, begin(likelihood, begun), true, none)
    assert fit.mode.scale > GROSS
    assert np.abs(fit.theta - true).max() > 0.5
    place = aligned(kernel, precision, rho, likelihood, fit, true)
    np.testing.assert_allclose(place.theta, true, atol=0.15)
    assert place.theta[1:3].sum() == pytest.approx(true[1:3].sum(), abs=0.005)  # the resonance's frequency
    assert place.mode.scale < 1.2
