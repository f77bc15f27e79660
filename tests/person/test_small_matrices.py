"""Inverse and log determinant of small matrices against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.person.small_matrices import inverse, inverted, solved


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


@pytest.mark.parametrize("size", [1, 2, 8, 24])
def test_solution_is_that_of_lapack_also_where_pivots_must_be_exchanged(size: int) -> None:
    rng = np.random.default_rng(size)
    a, b = rng.normal(size=(size, size)), rng.normal(size=size)
    a[0, 0] = 0.0 if size > 1 else 1.0
    before = a.copy(), b.copy()
    assert solved(a, b) == pytest.approx(np.linalg.solve(a, b), rel=1e-9)
    assert np.array_equal(a, before[0])
    assert np.array_equal(b, before[1])


def test_singular_matrix_has_no_solution() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="singular"):
        solved(np.zeros((2, 2)), np.ones(2))


def test_where_one_point_outweighs_all_others_there_is_an_inverse() -> None:
    a = np.array([np.diag([4.0, 2.0]), np.ones((2, 2))])  # two rows whose difference is lost in rounding
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.inv(a)
    found = inverse(a)
    np.testing.assert_allclose(found[0], np.diag([0.25, 0.5]), rtol=1e-11)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(inverse(a[:1]), np.linalg.inv(a[:1]))
