"""Folds of people: everybody once, of equal sizes, by the seed."""

import numpy as np
import pytest

from bayes_impedance.diagnosis.folds import FOLDS, person_folds


@pytest.mark.parametrize("n", [10, 13, 71])
def test_folds_are_of_equal_size_and_random(n: int) -> None:
    fold = person_folds(n, 3)
    sizes = np.bincount(fold)
    assert sizes.size == FOLDS
    assert np.ptp(sizes) <= 1
    np.testing.assert_array_equal(fold, person_folds(n, 3))
    assert np.any(fold != person_folds(n, 4))


def test_fewer_people_than_folds_are_held_out_one_by_one() -> None:
    assert sorted(person_folds(3, 1)) == [0, 1, 2]
