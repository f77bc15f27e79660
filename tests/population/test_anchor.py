"""The reference population: the mean of some populations, and draws chosen for these."""

import numpy as np
import pytest

from bayes_impedance.population.anchor import Anchor, of_limited_growth
from bayes_impedance.population.parameters import PopulationParameters


def populations() -> PopulationParameters:
    rng = np.random.default_rng(1)
    return PopulationParameters(
        mu=rng.normal(size=(50, 2)),
        between_persons=rng.uniform(0.2, 0.4, size=(50, 2)),
        correlation_cholesky=np.tile(np.eye(2), (50, 1, 1)),
        between_repetitions=np.full((50, 2), 0.1),
        slopes=np.zeros((50, 2, 0)),
    )


def test_the_mean_of_populations_has_their_repetitions_too() -> None:
    there = populations()
    anchor = Anchor.of(there, np.array([2, 2, 4, 4]), 1.5, True)
    np.testing.assert_allclose(anchor.covariance, np.diag(np.mean(there.between_persons**2, axis=0) + 0.01 / 3))
    np.testing.assert_allclose(anchor.wide, 2.25 * anchor.covariance)
    assert anchor.along_valley
    assert anchor.near is None
    between = anchor.and_between(there).covariance - anchor.covariance
    np.testing.assert_allclose(between, np.cov(there.mu.T))


def test_draws_are_chosen_for_some_of_the_populations() -> None:
    there = populations()
    anchor = Anchor.among(there, np.array([1, 1]))
    assert anchor.near is not None
    assert len(anchor.near.shift) == len(anchor.near.covariance) == 32
    np.testing.assert_allclose(anchor.mu + anchor.near.shift[0], there.mu[0])
    np.testing.assert_allclose(anchor.near.covariance[-1], there.covariance[-1] + 0.01 * np.eye(2))


def test_a_covariance_grows_by_no_more_than_is_allowed() -> None:
    before = np.diag([1.0, 2.0])
    grown = of_limited_growth(before, np.diag([100.0, 8.0]), 4.0)
    np.testing.assert_allclose(grown, np.diag([4.0, 8.0]))
    assert of_limited_growth(before, np.diag([0.01, 4.0]), 4.0)[0, 0] == pytest.approx(0.25)
