"""One person's part of expectation-maximisation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from bayes_impedance.population.e_step import _realigned


def test_repetitions_are_realigned_where_one_point_beside_a_pole_outweighs_all_others() -> None:
    """The information of a lossless network of five elements there: of rank one to rounding, and singular with rho."""
    slopes = np.array([3.31e10, 3.712e11, 3.381e11, 1.43e10, 1.43e10])
    information = np.stack([share * np.outer(slopes, slopes) for share in (1.0, 0.7, 0.53)])
    pull, share = np.array([5.6, -1.05, -4.54]), np.array([1.0, 0.7, 0.53])
    likelihood: Any = SimpleNamespace(z=np.zeros((3, 2, 4)), deviations=np.zeros((3, 5)))
    mode: Any = SimpleNamespace(scale=2.6)
    found = _realigned(likelihood, mode, np.outer(pull, slopes), information, np.full(5, 0.1))
    # Along the slopes alone anything is known: the least of sum(share x^2 / 2 + pull x) among x whose sum is zero.
    least = -(pull - np.sum(pull / share) / np.sum(1 / share)) / share
    np.testing.assert_allclose(found @ slopes, least, atol=1e-3 * np.abs(least).max())
    np.testing.assert_allclose(found.sum(axis=0), 0, atol=1e-12)
