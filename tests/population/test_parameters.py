"""Population parameters and the vector that is sampled: round trips, and priors against Monte-Carlo and Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import beta, halfnorm, kstest, norm
from strategies import repeatable

from bayes_impedance.population.parameters import Coordinates
from bayes_impedance.population.prior import Prior

DRAWS = 4000


def coordinates(n=4, correlated=True, repetitions=True, covariates=2, held=(), **prior):
    return Coordinates(
        prior=Prior(centre=np.linspace(-3.0, 2.0, n), **prior),
        correlated=correlated,
        repetitions=repetitions,
        n_covariates=covariates,
        free=tuple(p for p in range(n) if p not in held),
        held_mu=np.linspace(10.0, 20.0, n),
        held_dispersion=np.linspace(0.2, 0.3, n),
    )


def correlation_coordinates(n, concentration):
    """Coordinates whose last block is all that is looked at, and the position where it begins."""
    c = coordinates(n, repetitions=False, covariates=0, concentration=concentration)
    return c, 2 * n


def drawn_from(log_density, n, rng):
    """Draws of one coordinate by inverting its distribution function on a grid."""
    grid = np.linspace(-12, 12, 20001)
    log_p = log_density(grid)
    cumulative = np.cumsum(np.exp(log_p - log_p.max()))
    return np.interp(rng.random(n), cumulative / cumulative[-1], grid)


def drawn_from_prior(c, n, seed):
    """Draws of all coordinates, each from the prior density along its own axis (they are independent)."""
    rng = np.random.default_rng(seed)
    columns = []
    for axis in np.eye(c.n_dimensions):
        columns.append(drawn_from(lambda x, axis=axis: c.log_prior(x[:, None] * axis), n, rng))
    return np.array(columns).T


settings_of = st.fixed_dictionaries(
    {
        "n": st.integers(2, 5),
        "correlated": st.booleans(),
        "repetitions": st.booleans(),
        "covariates": st.integers(0, 3),
        "held": st.sampled_from([(), (0,), (1,)]),
        "centre_sd": st.sampled_from([3.0, 0.5]),
        "dispersion_sd": st.sampled_from([1.0, 0.2]),
        "slope_sd": st.sampled_from([1.0, 4.0]),
    }
)


@repeatable
@given(settings_of, st.integers(0, 1000))
def test_pack_and_unpack_round_trip(setting, seed):
    c = coordinates(**setting)
    vector = np.random.default_rng(seed).normal(0, 0.7, (3, c.n_dimensions))
    p = c.unpack(vector)
    vector[:, c.even] = np.abs(vector[:, c.even])  # the sign of a dispersion's coordinate has no meaning
    for w in range(3):
        packed = c.pack(p.mu[w], p.covariance[w], p.between_repetitions[w], p.slopes[w])
        np.testing.assert_allclose(packed, vector[w], rtol=1e-8, atol=1e-8)


@repeatable
@given(settings_of, st.integers(0, 1000))
def test_parameters_have_their_shapes_and_ranges(setting, seed):
    c = coordinates(**setting)
    n, free = setting["n"], len(c.free)
    expected = 2 * free + setting["repetitions"] * free + setting["covariates"] * free
    assert c.n_dimensions == expected + setting["correlated"] * free * (free - 1) // 2
    p = c.unpack(np.random.default_rng(seed).normal(0, 1.5, (3, c.n_dimensions)))
    assert p.mu.shape == p.between_persons.shape == p.between_repetitions.shape == (3, n)
    assert p.slopes.shape == (3, n, setting["covariates"])
    assert np.all(p.between_persons > 0)
    assert np.all((p.between_repetitions > 0) == setting["repetitions"])
    np.testing.assert_allclose(np.diagonal(p.correlation, axis1=1, axis2=2), 1, rtol=1e-12)
    assert np.all(np.linalg.eigvalsh(p.correlation) > 0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(p.covariance, axis1=1, axis2=2)), p.between_persons, rtol=1e-12)
    assert np.all(np.triu(p.covariance_cholesky, 1) == 0)
    if not setting["correlated"]:
        np.testing.assert_array_equal(p.correlation, np.tile(np.eye(n), (3, 1, 1)))


def test_blocks_are_in_the_stated_order():
    """Centres, dispersions between persons, between repetitions, slopes, correlations: one thing changes at a time."""
    c = coordinates(3, covariates=2)
    zero = c.unpack(np.zeros((1, c.n_dimensions)))
    np.testing.assert_allclose(zero.mu[0], c.prior.centre)
    assert zero.between_persons.max() < 1e-8
    names = np.repeat(["mu", "tau", "rho", "b", "c"], c.sizes[:5])
    np.testing.assert_array_equal(c.even, np.isin(names, ["tau", "rho"]))
    moved = c.unpack(np.eye(c.n_dimensions))
    for row in range(c.n_dimensions):
        changed = {
            "mu": moved.mu[row] != zero.mu[0],
            "tau": moved.between_persons[row] != zero.between_persons[0],
            "rho": moved.between_repetitions[row] != zero.between_repetitions[0],
            "b": (moved.slopes[row] != 0).ravel(),
            "c": np.array([moved.correlation[row, i, j] != 0 for i, j in ((1, 0), (2, 0), (2, 1))]),
        }
        stacked = np.concatenate(list(changed.values()))
        np.testing.assert_array_equal(np.flatnonzero(stacked), [row])
    np.testing.assert_allclose(moved.mu[:3] - zero.mu, 3 * np.eye(3), atol=1e-12)


def test_held_elements_keep_what_they_are_given():
    c = coordinates(4, held=(1, 3))
    p = c.unpack(np.random.default_rng(1).normal(size=(5, c.n_dimensions)))
    for held in (1, 3):
        np.testing.assert_array_equal(p.mu[:, held], c.held_mu[held])
        np.testing.assert_array_equal(p.between_persons[:, held], c.held_dispersion[held])
        np.testing.assert_array_equal(p.between_repetitions[:, held], c.held_dispersion[held])
        np.testing.assert_array_equal(p.slopes[:, held], 0)
        np.testing.assert_array_equal(p.correlation[:, held], np.tile(np.eye(4)[held], (5, 1)))
    assert np.ptp(p.correlation[:, 0, 2]) > 0.1


def test_rows_can_be_taken():
    c = coordinates()
    vectors = np.random.default_rng(1).normal(size=(5, c.n_dimensions))
    some, expected = c.unpack(vectors)[1:3], c.unpack(vectors[1:3])
    for name in ("mu", "between_persons", "correlation_cholesky", "between_repetitions", "slopes"):
        np.testing.assert_array_equal(getattr(some, name), getattr(expected, name))


# Priors against Monte-Carlo


@pytest.mark.parametrize("dispersion_sd", [1.0, 0.3])
def test_marginals_of_the_prior(dispersion_sd):
    c = coordinates(3, dispersion_sd=dispersion_sd, slope_sd=0.7)
    p = c.unpack(drawn_from_prior(c, DRAWS, seed=11))
    p_values = []
    for e in range(3):
        p_values += [
            kstest(p.mu[:, e], norm(c.prior.centre[e], 3.0).cdf).pvalue,
            kstest(p.between_persons[:, e], halfnorm(scale=dispersion_sd).cdf).pvalue,
            kstest(p.between_repetitions[:, e], halfnorm(scale=dispersion_sd).cdf).pvalue,
            *(kstest(p.slopes[:, e, q], norm(0, 0.7).cdf).pvalue for q in range(2)),
        ]
    assert min(p_values) > 0.01 / len(p_values)


@pytest.mark.parametrize("concentration", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("n", [2, 3, 5])
def test_correlations_are_lkj(n, concentration):
    """Every correlation of an LKJ matrix is Beta(eta - 1 + n/2) on (-1, 1), whatever its place in the vine."""
    c, _ = correlation_coordinates(n, concentration)
    correlation = c.unpack(drawn_from_prior(c, DRAWS, seed=12)).correlation
    shape = concentration - 1 + n / 2
    p_values = [kstest((correlation[:, i, j] + 1) / 2, beta(shape, shape).cdf).pvalue for i, j in pairs(n)]
    assert min(p_values) > 0.01 / len(p_values)


def test_partial_correlations_of_the_vine_give_lkj():
    """Beta partial correlations of the textbook (level k: eta + (n - 1 - k)/2) through `unpack`, without log_prior."""
    n, concentration = 4, 2.0
    c, first = correlation_coordinates(n, concentration)
    rng = np.random.default_rng(5)
    vectors = np.zeros((DRAWS, c.n_dimensions))
    for k, (_, j) in enumerate(pairs(n)):
        b = concentration + (n - 1 - (j + 1)) / 2
        vectors[:, first + k] = np.arctanh(2 * rng.beta(b, b, DRAWS) - 1)
    correlation = c.unpack(vectors).correlation
    shape = concentration - 1 + n / 2
    p_values = [kstest((correlation[:, i, j] + 1) / 2, beta(shape, shape).cdf).pvalue for i, j in pairs(n)]
    assert min(p_values) > 0.01 / len(p_values)


def pairs(n):
    return [(i, j) for i in range(n) for j in range(i)]


# Densities


@pytest.mark.parametrize("concentration", [1.0, 2.0, 3.5])
@pytest.mark.parametrize("n", [2, 3, 4])
def test_log_prior_is_the_lkj_density_times_the_jacobian(n, concentration):
    """ln p(u) = (eta - 1) ln det C + ln |dC/du| up to a constant, with the Jacobian by differences."""
    c, first = correlation_coordinates(n, concentration)
    size = n * (n - 1) // 2

    def entries(u):
        correlation = c.unpack(np.concatenate([np.zeros(first), u])[None]).correlation[0]
        return np.array([correlation[i, j] for i, j in pairs(n)]), np.linalg.slogdet(correlation)[1]

    differences = []
    for u in np.random.default_rng(n).normal(0, 0.6, (12, size)):
        jacobian = np.array([entries(u + h)[0] - entries(u - h)[0] for h in 1e-5 * np.eye(size)]) / 2e-5
        expected = (concentration - 1) * entries(u)[1] + np.linalg.slogdet(jacobian)[1]
        differences.append(c.log_prior(np.concatenate([np.zeros(first), u])[None])[0] - expected)
    np.testing.assert_allclose(differences, differences[0], atol=1e-7)


@pytest.mark.parametrize("dispersion_sd", [1.0, 0.2])
def test_log_prior_is_the_half_normal_density_whatever_the_sign(dispersion_sd):
    c = coordinates(1, correlated=False, repetitions=False, covariates=0, dispersion_sd=dispersion_sd)
    u = np.linspace(-4, 4, 33)
    vectors = np.column_stack([np.zeros_like(u), u])
    dispersion = c.unpack(vectors).between_persons[:, 0]
    np.testing.assert_allclose(dispersion, dispersion_sd * np.abs(u), atol=1e-8)
    difference = c.log_prior(vectors) - halfnorm(scale=dispersion_sd).logpdf(dispersion)
    np.testing.assert_allclose(difference, difference[0], atol=1e-6)


@pytest.mark.parametrize("concentration", [1.0, 2.0, 5.0])
def test_density_of_a_transformed_partial_correlation_integrates_to_one(concentration):
    """With two elements C has one entry, Beta(eta, eta) on (-1, 1); its constant is known, so is the integral's."""
    c, first = correlation_coordinates(2, concentration)
    constant = beta(concentration, concentration).logpdf(0.5) - np.log(2)  # density of r at r = 0, where du = dr

    def density(u):
        vector = np.zeros((2, c.n_dimensions))
        vector[0, first] = u
        at_u, at_zero = c.log_prior(vector)
        return np.exp(at_u - at_zero + constant)

    assert quad(density, -np.inf, np.inf)[0] == pytest.approx(1, rel=1e-8)


def test_log_prior_is_standard_normal_in_the_other_coordinates():
    c = coordinates(3, correlated=False)
    vectors = np.random.default_rng(2).normal(size=(6, c.n_dimensions))
    expected = norm.logpdf(vectors).sum(axis=1)
    difference = c.log_prior(vectors) - expected
    np.testing.assert_allclose(difference, difference[0], atol=1e-12)


def test_far_out_coordinates_stay_finite():
    c = coordinates(3)
    for u in (-8.0, 8.0):
        p = c.unpack(np.full((1, c.n_dimensions), u))
        assert np.all(p.between_persons > 0)
        assert np.all(np.isfinite(p.covariance))
        assert np.isfinite(c.log_prior(np.full((1, c.n_dimensions), 50 * u)))[0]
    large = c.unpack(np.full((1, c.n_dimensions), 7.0)).between_persons[0, 0]
    assert large == 7.0
