"""Affine maps by which draws follow what is the same for everybody: coefficients, regression, and what they gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shared_worlds
from scipy.special import logsumexp
from shared_worlds import ONE, World, directions, fitted, moved_world, populations, world

from bayes_impedance.person.likelihood import log_likelihood
from bayes_impedance.person.small_matrices import inverses, log_determinant, log_determinants
from bayes_impedance.population import shared_draws
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.sharded_likelihood import Part, _resampled
from bayes_impedance.population.shears import fitted_shears, maps, sheared_coefficients, sheared_moments

SIZE = 3


def test_log_determinants_are_those_of_the_library() -> None:
    rng = np.random.default_rng(1)
    for a in (rng.normal(size=(5, 5)), np.array([[0.0, 2.0], [-3.0, 0.0]]), np.array([[-0.5]])):
        assert log_determinant(a.copy()) == pytest.approx(np.linalg.slogdet(a)[1], abs=1e-12)
    assert log_determinant(np.ones((2, 2))) == -np.inf


def test_coefficients_are_those_of_the_moved_coordinates() -> None:
    """The quadratic form in Mu - v is the same polynomial in u, whatever u is."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, SIZE, SIZE))
    precision = root @ root.swapaxes(1, 2)
    v, t, shears = rng.normal(size=(4, 2, SIZE)), rng.normal(size=(4, 2)), 0.2 * rng.normal(size=(2, 2, SIZE, SIZE))
    pairs = np.tril_indices(SIZE)
    squares, linear, volume = sheared_coefficients(precision, v @ precision, t, shears, *pairs)
    m = maps(t, shears)
    np.testing.assert_allclose(volume, np.linalg.slogdet(m)[1], atol=1e-12)
    for u in rng.normal(size=(5, SIZE)):
        away = m @ u - v
        exact = np.einsum("wnp,wpq,wnq->wn", away, precision, away)
        products = u[pairs[0]] * u[pairs[1]] * np.where(pairs[0] == pairs[1], 1, 2)
        ours = (squares @ products).T - 2 * linear @ u + np.einsum("wnp,wpq,wnq->wn", v, precision, v)
        np.testing.assert_allclose(ours, exact, rtol=1e-10)


def test_moments_are_those_of_moved_draws_and_the_slope_is_that_of_the_density() -> None:
    """Of four persons' weighted draws, two of whom count in part, under three populations."""
    rng = np.random.default_rng(6)
    n_sets, n, k, step = 3, 4, 50, 1e-6
    root = rng.normal(size=(n_sets, SIZE, SIZE))
    precision = root @ root.swapaxes(1, 2)
    v, t, shears = rng.normal(size=(n_sets, n, SIZE)), rng.normal(size=(n_sets, 2)), rng.normal(size=(n, 2, SIZE, SIZE))
    shears *= 0.2
    counted, u = np.tile([1.0, 1.0, 0.3, 0.6], (n_sets, 1)), rng.normal(size=(n, k, SIZE))
    weight = rng.dirichlet(np.ones(k), size=(n_sets, n)) * counted[..., None]
    rows, columns = pairs = np.tril_indices(SIZE)
    first = np.einsum("wnk,nkp->wnp", weight, u)
    squares = np.einsum("wnk,nkm->wnm", weight, u[..., rows] * u[..., columns])
    there, after, slope = sheared_moments(precision, v, counted, t, shears, first, squares, *pairs)
    moved = np.einsum("wnpq,nkq->wnkp", maps(t, shears), u)
    np.testing.assert_allclose(there, np.einsum("wnk,wnkp->wnp", weight, moved), atol=1e-12)
    products = moved[..., rows] * moved[..., columns]
    np.testing.assert_allclose(after, np.einsum("wnk,wnkm->wnm", weight, products), atol=1e-12)

    def log_density(at: np.ndarray) -> np.ndarray:
        m = maps(at, shears)
        away = np.einsum("wnpq,nkq->wnkp", m, u) - v[:, :, None]
        own = np.linalg.slogdet(m)[1][..., None] - 0.5 * np.einsum("wnkp,wpq,wnkq->wnk", away, precision, away)
        return np.asarray(np.sum(weight * own, axis=(1, 2)))

    for s in range(2):
        ahead, behind = (log_density(t + sign * step * np.eye(2)[s]) for sign in (1, -1))
        np.testing.assert_allclose(slope[:, s], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-5)


def test_matrices_side_by_side_are_as_those_alone_even_where_rows_must_be_exchanged() -> None:
    rng = np.random.default_rng(7)
    a = np.moveaxis(rng.normal(size=(9, 4, 4)), 0, -1).copy()
    a[0, 0, 3] = 0.0
    a[:, :, 5] = np.eye(4)[::-1]
    found, volume = np.empty(a.shape), np.empty(9)
    inverses(a, found)
    log_determinants(a, volume)
    alone = np.moveaxis(a, -1, 0)
    np.testing.assert_allclose(np.moveaxis(found, -1, 0) @ alone, np.tile(np.eye(4), (9, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(volume, np.linalg.slogdet(alone)[1], atol=1e-10)


@pytest.mark.parametrize("size", [0.02, 10.0])
def test_shears_are_the_slopes_of_the_responses_and_invertible(size: float) -> None:
    rng = np.random.default_rng(3)
    covariance = np.diag([0.01, 1.0, 4.0])
    theta = rng.normal(size=(500, SIZE)) * np.sqrt(np.diag(covariance)) + 5.0
    drawn = size * rng.normal(size=(2, SIZE, SIZE)) * np.sqrt(np.diag(covariance))[:, None]
    slopes = drawn / np.sqrt(np.diag(covariance))
    responses = 1.0 + np.einsum("spq,nq->nps", slopes, theta)
    found = fitted_shears(theta, responses, covariance, 3.0)
    factor = found[0, 0, 0] / slopes[0, 0, 0]
    np.testing.assert_allclose(found, factor * slopes, atol=0.01 * np.abs(slopes).max())
    if size < 1:
        assert factor == pytest.approx(1.0, abs=0.01)
    far = rng.normal(size=(200, 2))
    far *= 3.0 / np.linalg.norm(far, axis=1, keepdims=True)
    assert np.linalg.det(maps(far, found)).min() > 0


def at(w: World, t: float) -> PopulationParameters:
    """The population of the world, with the shared parameters elsewhere."""
    kept = moved_world(w, 64).sharing
    return replace(populations(w, kept, np.array([[t]])), mu=w.mean[None], between_persons=w.tau[None])


def test_persons_are_drawn_where_the_shared_parameters_are() -> None:
    """Mean and spread of a person's elements far from where the draws were made, against a grid."""
    w = world(ONE, 1, 2, noise=0.3, seed=4)
    kept = moved_world(w, 4096)
    there = at(w, 2.0)
    part = Part.of(kept.marginal, kept.draws_of_persons, np.ones(2))
    many = there[np.zeros(4000, dtype=int)]
    found, _ = _resampled(part, many, np.random.SeedSequence(1))
    assert there.shared is not None
    kernel = w.pooling.at(there.shared[0])
    for i, likelihood in enumerate(w.likelihoods):
        fit = fitted(w, there.shared[0], likelihood)
        factor = np.linalg.cholesky(np.linalg.inv(fit.mode.precision))
        x = np.linspace(-9, 9, 181)
        grid = fit.theta + np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2) @ factor.T
        value = log_likelihood(kernel, likelihood, grid) - 0.5 * np.sum(((grid - w.mean) / w.tau) ** 2, axis=1)
        weight = np.exp(value - logsumexp(value))
        mean = weight @ grid
        sd = np.sqrt(weight @ (grid - mean) ** 2)
        np.testing.assert_allclose(found[:, i].mean(axis=0), mean, atol=0.08 * sd.min())
        np.testing.assert_allclose(found[:, i].std(axis=0), sd, rtol=0.06)


FINGER = "highpass[f1*]((n3|r3)-(m2|r1|n1|(m1-(n2|r2))))"
HAND = {"m1": 17e-3, "m2": 0.9e-3, "n1": 1.2e-3, "n2": 5e-3, "n3": 9e-5, "r1": 1.5, "r2": 3.2, "r3": 30.0, "f1": 0.25}


def test_sheared_draws_stay_with_the_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Responses differ over some people's posteriors, and draws that move alike leave them; others are as good."""
    monkeypatch.setattr(shared_worlds, "VALUES", HAND)
    monkeypatch.setattr(shared_worlds, "FREQUENCY", np.geomspace(5, 5000, 60))
    w = world(FINGER, 1, 8, noise=0.05, seed=1)
    sheared = moved_world(w, 1024)
    size = w.mean.size
    monkeypatch.setattr(shared_draws, "_shears", lambda *_: np.zeros((w.phi.size, size, size)))
    alike = moved_world(w, 1024)
    some = populations(w, sheared.sharing, directions(w.phi.size))
    ours = sheared.marginal.terms(some, effective=True)[1].min(axis=0)
    without = alike.marginal.terms(some, effective=True)[1].min(axis=0)
    assert np.all(ours > 0.95 * without)
    assert np.max(ours / without) > 1.3
