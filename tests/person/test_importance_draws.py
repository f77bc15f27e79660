"""Draws from one person's posterior: simulation-based calibration, and the marginal likelihood against integration."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person import importance_draws
from bayes_impedance.person.bent_proposal import log_t
from bayes_impedance.person.choosing import inclusion
from bayes_impedance.person.importance_draws import Reference, draw
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, log_likelihood
from bayes_impedance.person.marginal_likelihood import Ridge, find_ridge
from bayes_impedance.person.mode import Mode, find_mode

GRID = np.geomspace(5, 5000, 25)


def _ridge(kernel: Kernel, likelihood: Likelihood, mode: Mode, rho: float = 1e-3) -> Ridge:
    """Repetitions that hardly differ."""
    return find_ridge(kernel, likelihood, mode.theta, mode.scale, np.full(mode.theta.size, rho))


def _record(
    kernel: Kernel, theta: np.ndarray, noise: float, rng: np.random.Generator, repetitions: int = 2
) -> Likelihood:
    """Equal repetitions whose noise scale comes from the prior of the model."""
    clean = np.tile(kernel.impedance(theta, GRID), (repetitions, 1))
    sd = noise * np.abs(clean)
    scale = rng.gamma(SCALE_SHAPE, 1 / SCALE_SHAPE) ** -0.5
    z = clean + scale * sd * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
    # No deviations are estimated here, so all numbers count.
    likelihood = Likelihood.make(GRID, z, sd, np.zeros((repetitions, theta.size)))
    return replace(likelihood, count=float(z.size))


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_ranks_of_the_truth_are_uniform(noise: float) -> None:
    """Simulation-based calibration: theta from the prior, data from theta, and theta's rank in its posterior.

    With 30 % noise the posterior is far from normal and nearly as wide as the prior in some directions.
    """
    kernel = Kernel(parse("(n3|r3)-(m2|r1|n1)"))
    rng = np.random.default_rng(1)
    mean = np.log([8e-6, 60, 8e-4, 3, 1e-3])
    factor = np.diag([0.6, 0.4, 0.3, 0.6, 0.4]) @ np.linalg.cholesky(0.7 * np.eye(5) + 0.3)
    reference = Reference(mean, factor @ factor.T)
    precision = np.linalg.inv(reference.covariance)
    ranks = []
    for seed in np.random.SeedSequence(7).spawn(300):
        theta = mean + factor @ rng.normal(size=5)
        likelihood = _record(kernel, theta, noise, rng)
        mode = find_mode(kernel, likelihood, np.vstack([mean, theta]), mean, precision)
        draws = draw(kernel, likelihood, mode, _ridge(kernel, likelihood, mode), reference, 256, seed)
        ranks.append(np.exp(draws.log_weight) @ (draws.theta < theta))
    for p in range(5):
        assert stats.kstest(np.array(ranks)[:, p], "uniform").pvalue > 0.002  # five elements, two noises


def test_mean_weight_is_the_marginal_likelihood() -> None:
    """One element: the integral over theta by quadrature."""
    kernel = Kernel(parse("r1"))
    rng = np.random.default_rng(2)
    likelihood = _record(kernel, np.array([1.0]), 0.5, rng, repetitions=1)
    reference = Reference(np.array([0.8]), np.array([[0.25]]))
    mode = find_mode(kernel, likelihood, np.array([[0.8]]), reference.mean, np.linalg.inv(reference.covariance))
    grid = np.linspace(-4, 5, 20001)[:, None]
    for mu, tau in ((0.8, 0.5), (1.2, 0.3), (0.5, 0.2)):
        population = Reference(np.array([mu]), np.array([[tau**2]]))
        exponent = log_likelihood(kernel, likelihood, grid) + population.log_density(grid)
        exact = np.logaddexp.reduce(exponent) + np.log(grid[1, 0] - grid[0, 0])
        estimates = []
        for seed in np.random.SeedSequence(3).spawn(20):
            draws = draw(kernel, likelihood, mode, _ridge(kernel, likelihood, mode), reference, 512, seed)
            estimates.append(np.logaddexp.reduce(draws.log_ratio + population.log_density(draws.theta)) - np.log(512))
        error = np.std(estimates, ddof=1) / np.sqrt(20)
        assert error < 0.005
        # The reference's density lacks its factor of 1/sqrt(2 pi) on both sides; q's is complete.
        assert abs(np.mean(estimates) - exact) < 4 * error + 1e-6


def test_effective_draws_stay_high_where_the_data_say_little() -> None:
    """An element that a person hardly determines keeps the reference's spread, and the draws cover it."""
    kernel = Kernel(parse("m1|r1|n1"))
    rng = np.random.default_rng(4)
    theta = np.log([1e-6, 5.0, 1e-3])
    likelihood = _record(kernel, theta, 0.02, rng)
    reference = Reference(theta, np.diag([1.0, 0.3, 0.3]) ** 2)
    mode = find_mode(kernel, likelihood, theta[None], theta, np.linalg.inv(reference.covariance))
    draws = draw(kernel, likelihood, mode, _ridge(kernel, likelihood, mode), reference, 512, np.random.SeedSequence(5))
    assert draws.effective > 250
    weight = np.exp(draws.log_weight)
    spread = np.sqrt(weight @ (draws.theta[:, 0] - weight @ draws.theta[:, 0]) ** 2)
    assert spread > 0.6


def test_rounds_together_have_the_marginal_likelihood(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two elements by quadrature; more rounds are made than are needed, and few of their draws are kept."""
    monkeypatch.setattr(importance_draws, "_ENOUGH", 2.0)  # never: six rounds are made
    monkeypatch.setattr(importance_draws, "_POOR", 2.0)  # always: all of them count
    kernel = Kernel(parse("r1|n1"))
    theta = np.log([5.0, 1e-3])
    likelihood = _record(kernel, theta, 0.5, np.random.default_rng(8), repetitions=1)
    reference = Reference(theta + 0.2, np.diag([0.25, 1.0]))
    mode = find_mode(kernel, likelihood, theta[None], reference.mean, np.linalg.inv(reference.covariance))
    axes = [np.linspace(c - 5, c + 5, 401) for c in theta]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    cell = np.log(axes[0][1] - axes[0][0]) + np.log(axes[1][1] - axes[1][0])
    on_grid = log_likelihood(kernel, likelihood, grid)
    made = [
        draw(kernel, likelihood, mode, _ridge(kernel, likelihood, mode), reference, 128, seed)
        for seed in np.random.SeedSequence(9).spawn(40)
    ]
    for away, width in ((0.2, 1.0), (0.0, 0.8), (0.4, 0.5)):
        population = Reference(theta + away, width**2 * reference.covariance)
        exact = np.logaddexp.reduce(on_grid + population.log_density(grid)) + cell
        estimates = [np.mean(np.exp(d.log_ratio + population.log_density(d.theta) - exact)) for d in made]
        error = np.std(estimates, ddof=1) / np.sqrt(len(made))
        assert error < 0.02
        assert abs(np.mean(estimates) - 1) < 4 * error
    assert all(len(np.unique(d.theta, axis=0)) == 128 for d in made)  # none is kept twice


def test_draws_are_chosen_with_probabilities_that_go_with_the_root_of_their_weights() -> None:
    rng = np.random.default_rng(10)
    log_weight = rng.normal(scale=2, size=500)
    log_weight[:3] = -np.inf
    chance = inclusion(0.5 * log_weight, 64)
    assert chance.sum() == pytest.approx(64)
    assert np.all((chance > 0) & (chance <= 1))
    certain = chance == 1
    assert 0 < certain.sum() < 64
    rest = ~certain & np.isfinite(log_weight)
    np.testing.assert_allclose(np.diff(np.log(chance[rest])), 0.5 * np.diff(log_weight[rest]), atol=1e-9)
    assert log_weight[certain].min() > log_weight[rest].max()
    # Also where fewer draws count than are to be chosen.
    few = np.where(np.arange(500) < 10, 0.0, -np.inf)
    np.testing.assert_allclose(inclusion(0.5 * few, 64), np.where(np.arange(500) < 10, 1.0, 54 / 490))


def test_density_of_the_t_is_that_of_scipy() -> None:
    """Constant included: in the mixtures it stands beside the density of the reference population."""
    rng = np.random.default_rng(6)
    root = rng.normal(size=(4, 4))
    centre, covariance, theta = rng.normal(size=4), root @ root.T, rng.normal(scale=5, size=(50, 4))
    expected = stats.multivariate_t(centre, covariance, df=10).logpdf(theta)
    np.testing.assert_allclose(log_t(theta, centre, np.linalg.cholesky(covariance)), expected, rtol=1e-10)


def test_same_seed_same_draws() -> None:
    kernel = Kernel(parse("r1|n1"))
    likelihood = _record(kernel, np.log([5.0, 1e-3]), 0.1, np.random.default_rng(0))
    reference = Reference(np.log([5.0, 1e-3]), 0.1 * np.eye(2))
    mode = find_mode(kernel, likelihood, reference.mean[None], reference.mean, 10 * np.eye(2))
    one, two, other = (
        draw(kernel, likelihood, mode, _ridge(kernel, likelihood, mode), reference, 64, np.random.SeedSequence(seed))
        for seed in (1, 1, 2)
    )
    assert np.array_equal(one.theta, two.theta)
    assert not np.array_equal(one.theta, other.theta)


def test_few_draws_of_many_elements_come_to_an_end() -> None:
    """Weights of fewer draws than a covariance needs were made more equal without end."""
    kernel = Kernel(parse("(n3|r3)-(m2|r1|n1)"))
    mean = np.log([8e-6, 60, 8e-4, 3, 1e-3])
    reference = Reference(mean, 0.1 * np.eye(5))
    likelihood = _record(kernel, mean, 0.02, np.random.default_rng(1))
    mode = find_mode(kernel, likelihood, mean[None], mean, np.linalg.inv(reference.covariance))
    ridge, seed = _ridge(kernel, likelihood, mode), np.random.SeedSequence(1)
    draws = draw(kernel, likelihood, mode, ridge, reference, 16, seed)
    assert draws.theta.shape == (16, 5)
    assert np.all(np.isfinite(draws.log_weight))
