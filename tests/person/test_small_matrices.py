"""Inverse and log determinant of small matrices against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.person.small_matrices import inverted


@pytest.mark.parametrize("n", [1, 2, 8, 19])
@pytest.mark.parametrize("condition", [1e0, 1e6, 1e10])
def test_inverse_and_determinant(n, condition):
    rng = np.random.default_rng(n)
    vectors = np.linalg.qr(rng.standard_normal((n, n)))[0]
    a = (vectors * np.geomspace(1, condition, n)) @ vectors.T
    a = 0.5 * (a + a.T)
    own = a.copy()
    own[np.triu_indices(n, 1)] = np.nan  # not read
    log_determinant = inverted(own)
    np.testing.assert_allclose(own, np.linalg.inv(a), rtol=0, atol=1e-15 * condition * np.abs(own).max() * n)
    assert log_determinant == pytest.approx(np.linalg.slogdet(a)[1], rel=1e-6, abs=1e-9)
    np.testing.assert_array_equal(own, own.T)


def test_what_is_not_positive_definite_gives_nan():
    assert np.isnan(inverted(np.array([[1.0, 2.0], [2.0, 1.0]])))
    assert np.isnan(inverted(np.array([[np.nan]])))
