"""Evenly spread points are uniform, another set for each seed, and their means err less than those of random points."""

import numpy as np
import pytest

from bayes_impedance.person.shifted_sobol import uniform_points


def seeds(n: int) -> list[np.random.SeedSequence]:
    return np.random.SeedSequence(5).spawn(n)


def test_a_power_of_two_of_points_puts_one_into_each_interval_of_every_coordinate() -> None:
    for seed in seeds(3):
        points = uniform_points(128, 9, seed)
        assert np.all((points > 0) & (points < 1))
        np.testing.assert_array_equal(np.sort((128 * points).astype(int), axis=0), np.arange(128)[:, None].repeat(9, 1))


def test_the_first_points_are_those_of_more() -> None:
    few, more = (uniform_points(n, 4, seeds(1)[0]) for n in (100, 128))
    np.testing.assert_array_equal(few, more[:100])


def test_means_over_seeds_are_right_and_spread_less_than_those_of_random_points() -> None:
    """Of a smooth function of eight coordinates whose mean is known, for 400 seeds."""
    n = 256

    def function(u: np.ndarray) -> np.ndarray:
        return np.asarray(np.prod(1 + 0.5 * (u - 0.5), axis=1))

    means = np.array([function(uniform_points(n, 8, seed)).mean() for seed in seeds(400)])
    of_random_points = np.sqrt(((1 + 0.25 / 12) ** 8 - 1) / n)
    assert abs(means.mean() - 1) < 4 * means.std() / np.sqrt(400)
    assert means.std() < 0.3 * of_random_points


def test_sets_of_different_seeds_are_independent() -> None:
    """Errors of two sets are uncorrelated: of 400 pairs, within four standard errors of zero."""
    pairs = np.array(
        [[np.exp(uniform_points(64, 3, s).sum(axis=1)).mean() for s in seed.spawn(2)] for seed in seeds(400)]
    )
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / np.sqrt(400)


@pytest.mark.parametrize("n", [0, 1])
def test_few_points(n: int) -> None:
    assert uniform_points(n, 3, seeds(1)[0]).shape == (n, 3)
