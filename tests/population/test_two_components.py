"""Populations of two groups: moments, density, quadrature, limits, gradients, draws, labels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from persons_with_draws import (
    REFERENCE_COVARIANCE,
    N,
    P,
    contrasts_of,
    gaussian_draws,
    parameters,
    people,
    require_gradient,
)
from scipy.stats import chi2, kstest, multivariate_normal, norm

from bayes_impedance.mcmc.mirrored import labelled
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.parameters import Coordinates, PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.prior_draws import draw_prior
from bayes_impedance.population.shapes import normal_parts
from bayes_impedance.population.two_components import (
    LEAST_SHARE,
    SEPARATION,
    Groups,
    drawn_people,
    estimated_groups,
    groups_of,
    share_coordinate,
    share_of,
)

STEP = 2e-3
"""Of differences in coordinates. Where few draws carry the weight of a person in either group the slope changes fast;
at this step rounding in single precision still leaves four digits."""


def with_groups(sets: PopulationParameters, seed: int = 3, scale: float = 1.0) -> PopulationParameters:
    rng = np.random.default_rng(seed)
    w = len(sets.mu)
    return replace(sets, groups=Groups(rng.uniform(0.15, 0.8, w), scale * rng.normal(size=(w, P))))


def likelihood_of_people(n_draws: int = 4096, n_covariates: int = 0) -> tuple[ImportanceLikelihood, np.ndarray]:
    centres, covariances, repetitions = people()
    covariates = np.random.default_rng(1).normal(size=(N, n_covariates))
    draws, constants = gaussian_draws(centres, covariances, np.zeros((N, P)), n_draws, 2)
    contrasts = [contrasts_of(c, n=3, seed=c) for c in (1, 2)]
    means = np.zeros((N, P))
    return ImportanceLikelihood(draws, means, REFERENCE_COVARIANCE, repetitions, covariates, contrasts), constants


def coordinates_with_groups(**more: object) -> Coordinates:
    settings = {
        "prior": Prior(centre=np.zeros(P)),
        "correlated": True,
        "repetitions": True,
        "n_covariates": 0,
        "free": (0, 1, 2),
        "held_mu": np.full(P, 0.1),
        "held_dispersion": np.full(P, 0.4),
        "groups": True,
    }
    return Coordinates(**{**settings, **more})  # type: ignore[arg-type]


def test_mean_and_covariance_are_those_of_the_parameters():
    """Of the two normal parts by the law of total covariance."""
    sets = with_groups(parameters(6))
    parts, log_weight = normal_parts(sets)
    weight = np.exp(log_weight)[..., None]
    np.testing.assert_allclose(weight.sum(axis=1), 1)
    means = parts.mu.reshape(6, 2, P)
    np.testing.assert_allclose(np.sum(weight * means, axis=1), sets.mu, atol=1e-12)
    away = means - sets.mu[:, None]
    between = np.einsum("wkp,wkq->wpq", weight * away, away)
    within = parts.covariance.reshape(6, 2, P, P)
    np.testing.assert_allclose(within[:, 0], within[:, 1])
    np.testing.assert_allclose(within[:, 0] + between, sets.covariance, atol=1e-12)
    difference = sets.groups.difference(sets.covariance_cholesky)
    np.testing.assert_allclose(means[:, 1] - means[:, 0], difference, atol=1e-12)
    distance = np.sqrt(np.einsum("wp,wp->w", difference, np.linalg.solve(within[:, 0], difference[..., None])[..., 0]))
    np.testing.assert_allclose(sets.groups.distance, distance)


def test_likelihood_of_persons_is_that_of_two_normal_densities():
    """Persons with normal likelihoods: in either group their density is normal, in closed form."""
    centres, covariances, repetitions = people()
    marginal, constants = likelihood_of_people()
    sets = with_groups(parameters(3), scale=0.7)
    terms, effective = marginal.terms(sets)[0], marginal.terms(sets, effective=True)[1]
    expected = np.empty((3, N))
    for w in range(3):
        share, difference = sets.groups.share[w], sets.groups.difference(sets.covariance_cholesky)[w]
        within = sets.covariance[w] - share * (1 - share) * np.outer(difference, difference)
        for i, (m, c, j) in enumerate(zip(centres, covariances, repetitions, strict=True)):
            own = within + np.diag(sets.between_repetitions[w] ** 2) / j + c
            first = multivariate_normal(sets.mu[w] - share * difference, own).pdf(m)
            second = multivariate_normal(sets.mu[w] + (1 - share) * difference, own).pdf(m)
            expected[w, i] = np.log((1 - share) * first + share * second)
    error = np.sqrt(1 / effective - 1 / 4096)
    assert np.all(np.abs(terms + constants - expected) < 5 * error + 1e-4)
    assert error.max() < 0.05


def test_without_separation_it_is_the_normal_population():
    marginal, _ = likelihood_of_people(512)
    normal = parameters(5)
    limit = with_groups(normal, scale=0.0)
    np.testing.assert_allclose(marginal.terms(limit)[0], marginal.terms(normal)[0], atol=1e-5)
    np.testing.assert_allclose(marginal(limit), marginal(normal), atol=1e-4)
    near = with_groups(normal, scale=0.02)  # to second order nothing changes
    np.testing.assert_allclose(marginal(near), marginal(normal), atol=2e-3)
    finite = marginal.terms(with_groups(normal, scale=1.5))[0] - marginal.terms(normal)[0]
    assert np.abs(finite).max() > 0.3  # the limit is one


def test_exchanged_groups_are_the_same_population():
    marginal, _ = likelihood_of_people(512, n_covariates=1)
    sets = with_groups(parameters(4, covariates=1))
    other = replace(sets, groups=Groups(1 - sets.groups.share, -sets.groups.separation))
    np.testing.assert_allclose(marginal(sets), marginal(other), rtol=1e-6)


def test_both_ways_to_sum_over_groups_agree(monkeypatch):
    """Terms sum over draws first, weights of single draws over groups first; in chunks of populations or at once."""
    marginal, _ = likelihood_of_people(512, n_covariates=2)
    sets = with_groups(parameters(7, covariates=2))
    terms = marginal.terms(sets)[0]
    weights = marginal.log_weights(sets).astype(float)
    np.testing.assert_allclose(np.log(np.mean(np.exp(weights), axis=2)), terms, atol=1e-4)
    monkeypatch.setattr("bayes_impedance.population.importance_likelihood._CHUNK", 3 * 2 * 4 * 512)
    # Some processors sum products of single precision in another order where there are more of them.
    np.testing.assert_allclose(marginal.terms(sets)[0], terms, atol=1e-6)
    np.testing.assert_allclose(marginal.log_weights(sets), weights, atol=1e-5)


@pytest.mark.parametrize("free", [(0, 1, 2), (0, 2)])
def test_gradient(free):
    marginal, _ = likelihood_of_people(256, n_covariates=1)
    coordinates = coordinates_with_groups(
        n_covariates=1, free=free, bend_persons=np.full(P, 0.15), bend_repetitions=np.full(P, 0.05)
    )
    u = 0.4 * np.random.default_rng(5).normal(size=(5, coordinates.n_dimensions)) + 1.2 * coordinates.even
    u[:, : len(free)] *= 0.1  # of the prior's three
    u[:, coordinates.mirrored] *= 2

    assert np.linalg.norm(coordinates.unpack(u).groups.separation, axis=1).max() > 1
    require_gradient(marginal, coordinates, u, STEP, 5e-4)


def test_parameters_survive_packing():
    coordinates = coordinates_with_groups(free=(0, 2))
    groups = Groups(np.array([0.3]), np.array([[0.5, 0.0, -1.2]]))
    covariance = np.diag(np.diag(REFERENCE_COVARIANCE))
    vector = coordinates.pack(np.ones(P), covariance, np.full(P, 0.1), np.zeros((P, 0)), None, None, groups)
    found = coordinates.unpack(vector[None]).groups
    assert found.share == pytest.approx(0.3)
    np.testing.assert_allclose(found.separation, groups.separation)
    assert found[np.array([0, 0])].separation.shape == (2, P)


def test_prior_of_share_is_uniform_and_of_the_separation_the_same_in_all_directions():
    drawn = draw_prior(Prior(centre=np.zeros(P)), 4000, 1, groups=True).groups
    assert kstest((drawn.share - LEAST_SHARE) / (1 - 2 * LEAST_SHARE), "uniform").pvalue > 0.01
    assert kstest(P * np.sum(drawn.separation**2, axis=1) / SEPARATION**2, chi2(P).cdf).pvalue > 0.01
    np.testing.assert_allclose(share_of(share_coordinate(np.array([0.2, 0.5, 0.85]))), [0.2, 0.5, 0.85])


def test_difference_gives_the_groups_back_and_with_them_those_of_fewer_elements():
    sets = with_groups(parameters(4))
    factor = sets.covariance_cholesky
    difference = sets.groups.difference(factor)
    found = groups_of(difference, sets.groups.share, factor)
    np.testing.assert_allclose(found.separation, sets.groups.separation)
    # The marginal density of some elements is that of two groups with these elements' difference and covariance.
    some = np.array([0, 2])
    smaller = np.linalg.cholesky(sets.covariance[:, some[:, None], some])
    part = groups_of(difference[:, some], sets.groups.share, smaller)
    normal, log_weight = normal_parts(sets)
    point = np.array([0.1, -0.3])
    inside = normal.covariance[0][np.ix_(some, some)]
    expected = [np.exp(log_weight[0, k]) * multivariate_normal(normal.mu[k, some], inside).pdf(point) for k in range(2)]
    white = np.linalg.solve(smaller[0], point - sets.mu[0, some])
    own = np.logaddexp.reduce(part[np.array([0])].of_people(white[None, None]), axis=-1)[0, 0]
    volume = np.log(np.linalg.det(smaller[0])) + np.log(2 * np.pi)
    assert own - volume == pytest.approx(np.log(np.sum(expected)))
    shared = factor.copy()
    shared[:, 2] = 0  # an element that is the same for everybody
    assert np.all(groups_of(difference * [1, 1, 0], sets.groups.share, shared).separation[:, 2] == 0)
    with pytest.raises(ValueError, match="farther apart"):
        groups_of(5 * difference, sets.groups.share, factor)


def test_drawn_people_follow_the_mixture():
    """Moments, and probabilities by the density: the transform along the separation is uniform."""
    groups = Groups(np.array([0.25]), np.array([[1.5, 0.0, 1.0]]))
    rng = np.random.default_rng(1)
    people_drawn = drawn_people(groups, rng.normal(size=(1, 20_000, P)), rng)[0]
    np.testing.assert_allclose(people_drawn.mean(axis=0), 0, atol=0.03)
    np.testing.assert_allclose(np.cov(people_drawn.T), np.eye(P), atol=0.04)
    direction = groups.separation[0] / np.linalg.norm(groups.separation)
    centres, sd = groups.offsets[0] @ direction, np.sqrt(direction @ groups.within[0] @ direction)
    along = people_drawn @ direction
    both = [norm(centre, sd) for centre in centres]
    assert kstest(along, lambda x: 0.75 * both[0].cdf(x) + 0.25 * both[1].cdf(x)).pvalue > 0.01
    across = people_drawn @ np.array([0.0, 1.0, 0.0])
    assert kstest(across, "norm").pvalue > 0.01
    assert kstest(along, "norm").pvalue < 1e-6
    each = drawn_people(Groups(np.array([0.3, 0.5]), np.ones((2, P))), np.zeros((2, P)), np.random.default_rng(2))
    assert each.shape == (2, P)


def test_probabilities_of_the_groups_add_up_to_the_density():
    sets = with_groups(parameters(2))
    parts, log_weight = normal_parts(sets)
    theta = np.random.default_rng(4).normal(size=(5, P))
    white = np.linalg.solve(sets.covariance_cholesky[:, None], (theta - sets.mu[:, None])[..., None])[..., 0]
    own = sets.groups.of_people(white)
    for w in range(2):
        for k in range(2):
            normal = multivariate_normal(parts.mu[2 * w + k], parts.covariance[2 * w + k]).logpdf(theta)
            constant = 0.5 * P * np.log(2 * np.pi) + np.sum(np.log(np.diag(sets.covariance_cholesky[w])))
            np.testing.assert_allclose(own[w, :, k], log_weight[w, k] + normal + constant)


@pytest.mark.parametrize(("share", "distance"), [(0.3, 5.0), (0.5, 4.0)])
def test_groups_of_many_people_are_estimated(share, distance):
    direction = np.array([0.6, 0.0, -0.8])
    length = distance * np.sqrt(share * (1 - share))
    truth = Groups(np.array([share]), (length * direction)[None])
    rng = np.random.default_rng(4)
    found = estimated_groups(drawn_people(truth, rng.normal(size=(1, 1000, P)), rng)[0])
    sign = np.sign(found.separation[0] @ direction)
    np.testing.assert_allclose(sign * found.separation[0], truth.separation[0], atol=0.25)
    assert (found.share[0] if sign > 0 else 1 - found.share[0]) == pytest.approx(share, abs=0.04)


def test_groups_in_one_element_are_estimated():
    truth = Groups(np.array([0.4]), np.array([[2.0]]))
    rng = np.random.default_rng(2)
    found = estimated_groups(drawn_people(truth, rng.normal(size=(1, 1000, 1)), rng)[0])
    assert abs(found.separation[0, 0]) == pytest.approx(2.0, abs=0.25)
    assert min(found.share[0], 1 - found.share[0]) == pytest.approx(0.4, abs=0.04)


def test_labels_are_chosen_after_sampling():
    """Two chains of one population with labels either way: one peak, the smaller group second; others unchanged."""
    rng = np.random.default_rng(3)
    mirrored = np.array([False, True, True, False])
    chains = []
    for sign in (1, -1):
        chain = rng.normal(size=(50, 8, 4)) * 0.2 + np.array([5.0, 2.0, -1.0, 0.0])
        flips = rng.choice([1, -1], size=(50, 8, 1), p=(0.7, 0.3)) * sign
        chain[..., 1:3] *= flips
        chains.append(chain)
    found = labelled(chains, mirrored)
    for before, after in zip(chains, found, strict=True):
        assert np.all(np.abs(after) == np.abs(before))
        assert np.array_equal(after[..., [0, 3]], before[..., [0, 3]])
        assert np.all(after[..., 1] > 0)
        assert np.all(after[..., 2] < 0)
    again = labelled([-chain for chain in found], np.ones(4, dtype=bool))
    assert np.mean(np.concatenate(again)[..., -1]) <= 0
    assert labelled(chains, np.zeros(4, dtype=bool))[0] is chains[0]
