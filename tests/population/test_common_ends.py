"""Solutions that everybody has in common, from ends of searches in two valleys."""

from __future__ import annotations

import numpy as np

from bayes_impedance.population.common_ends import REGRET, common_solutions_of


def test_a_valley_that_leaves_an_element_anywhere_does_not_lead() -> None:
    """It is nearly as good for everybody, and each of its ends is another."""
    rng, n = np.random.default_rng(2), 30
    own = rng.normal([0.0, 1.0, 2.0], 0.2, (n, 3))
    lost = np.column_stack([rng.normal(3.0, 0.2, n), rng.normal(0.0, 0.2, n), rng.normal(8.0, 3.0, n)])
    # Each search has brought some people to one valley, and the others to the other.
    there = rng.random((n, 6)) < 0.5
    there[:, 0], there[:, 1] = True, False
    ends = np.where(there[:, :, None], own[:, None], lost[:, None])
    regret = np.where(there, rng.exponential(1.0, (n, 1)), 0.0)
    solutions = common_solutions_of(ends, regret, np.array([[0.1, 1.1, 2.1], [3.0, 0.0, 9.0]] * 3))
    np.testing.assert_array_equal(ends[np.arange(n), solutions[0]], own)
    assert len(solutions) == 2


def test_nobody_is_far_behind_for_being_near_the_others() -> None:
    n = 12
    ends = np.zeros((n, 2, 1))
    ends[:, 1] = 5.0
    regret = np.zeros((n, 2))
    regret[3, 0] = REGRET
    for chosen in common_solutions_of(ends, regret, np.array([[0.0], [5.0]])):
        assert chosen[3] == 1
    chosen = common_solutions_of(ends[:, ::-1], regret[:, ::-1], np.array([[0.0]]))[0]
    assert chosen[3] == 0
    assert np.all(np.delete(chosen, 3) == 1)


def test_one_person_has_the_best_end() -> None:
    solutions = common_solutions_of(np.array([[[0.0], [2.0]]]), np.array([[4.0, 0.0]]), np.array([[2.0], [0.0]]))
    assert any(chosen[0] == 1 for chosen in solutions)
