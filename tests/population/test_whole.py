"""From the parameters that are sampled to all parameters of a network, in its order and in their own units."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.whole import Whole

NETWORK, SCALE = "delay[d1*](m1|r1)", 1e-3
"""One signed parameter, which is the same for all and sampled in units of a millisecond, and two that differ."""
SETS = 5


@pytest.fixture
def pooling() -> Pooling:
    return Pooling.of(Kernel(parse(NETWORK), scales={"d1": SCALE}))


@pytest.fixture
def sampled() -> PopulationParameters:
    rng = np.random.default_rng(1)
    cholesky = np.tile(np.eye(2), (SETS, 1, 1))
    cholesky[:, 1] = 0.6, 0.8
    return PopulationParameters(
        mu=rng.normal(size=(SETS, 2)),
        between_persons=rng.uniform(0.1, 0.5, (SETS, 2)),
        correlation_cholesky=cholesky,
        between_repetitions=rng.uniform(0.1, 0.5, (SETS, 2)),
        slopes=rng.normal(size=(SETS, 2, 1)),
        shared=rng.normal(size=(SETS, 1)),
    )


def test_shared_parameters_have_a_column_without_dispersion(pooling: Pooling, sampled: PopulationParameters) -> None:
    whole = Whole(pooling).parameters(sampled)
    d = pooling.kernel.elements.index("d1")
    others = [k for k in range(3) if k != d]
    assert sampled.shared is not None
    np.testing.assert_allclose(whole.mu[:, d], SCALE * sampled.shared[:, 0])
    for name in ("between_persons", "between_repetitions"):
        np.testing.assert_array_equal(getattr(whole, name)[:, d], 0.0)
        np.testing.assert_array_equal(getattr(whole, name)[:, others], getattr(sampled, name))
    np.testing.assert_array_equal(whole.mu[:, others], sampled.mu)
    np.testing.assert_array_equal(whole.slopes[:, d], 0.0)
    np.testing.assert_array_equal(whole.slopes[:, others], sampled.slopes)
    np.testing.assert_allclose(whole.correlation[:, others][:, :, others], sampled.correlation)
    np.testing.assert_array_equal(whole.correlation[:, d, others], 0.0)


def test_everybody_has_the_same_value_of_what_is_shared(pooling: Pooling, sampled: PopulationParameters) -> None:
    theta = np.random.default_rng(2).normal(size=(SETS, 4, 2))
    persons = Whole(pooling).persons(theta, sampled.shared)
    d = pooling.kernel.elements.index("d1")
    assert sampled.shared is not None
    np.testing.assert_allclose(persons[:, :, d], SCALE * np.tile(sampled.shared, (1, 4)))
    np.testing.assert_array_equal(np.delete(persons, d, axis=2), theta)
    np.testing.assert_array_equal(Whole(pooling).without(theta)[..., d], 0.0)


def test_the_curves_are_those_of_the_kernel_that_was_fitted(pooling: Pooling, sampled: PopulationParameters) -> None:
    """In the units of the parameters' own scales the kernel without scales gives the same impedance."""
    whole, frequency = Whole(pooling), np.geomspace(5, 500, 7)
    theta = pooling.whole(sampled.mu, sampled.shared)
    np.testing.assert_allclose(
        whole.kernel.impedance(whole.parameters(sampled).mu, frequency), pooling.kernel.impedance(theta, frequency)
    )
    prior = whole.prior(Prior(centre=np.ones(3), centre_sd=2.0))
    expected = np.where(np.array(pooling.kernel.elements) == "d1", SCALE, 1.0)
    np.testing.assert_allclose(prior.centre, expected)
    np.testing.assert_allclose(prior.centre_sds, 2 * expected)


def test_without_signed_or_shared_parameters_nothing_changes() -> None:
    pooling = Pooling.of(Kernel(parse("m1|r1")))
    whole, prior = Whole(pooling), Prior(centre=np.zeros(2))
    assert whole.kernel is pooling.kernel
    assert whole.prior(prior) is prior
    theta = np.random.default_rng(3).normal(size=(SETS, 4, 2))
    np.testing.assert_array_equal(whole.persons(theta, None), theta)
