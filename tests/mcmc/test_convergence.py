"""R-hat and Pareto k are those of ArviZ, whichever of its versions is installed."""

import warnings
from importlib.metadata import version
from typing import Any

import numpy as np
import pytest

from bayes_impedance.mcmc.convergence import pareto_k, rhat

MODERN = int(version("arviz").split(".")[0]) >= 1


def statistics() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if MODERN:
            from arviz_stats.base import array_stats

            return array_stats
        import arviz

        return arviz


def arviz_rhat(chains: np.ndarray) -> np.ndarray:
    if MODERN:
        return np.asarray(statistics().rhat(chains, chain_axis=0, draw_axis=1))
    return np.array([statistics().rhat(chains[:, :, d]) for d in range(chains.shape[2])])


def arviz_pareto_k(log_weights: np.ndarray) -> float:
    # 1.x takes log likelihoods and changes their sign; 0.x takes log weights.
    smoothed = statistics().psislw(-log_weights, axis=-1) if MODERN else statistics().psislw(log_weights)
    return float(smoothed[1])


@pytest.mark.parametrize(("chains", "draws"), [(2, 4), (2, 501), (4, 100), (7, 33)])
def test_rhat_is_that_of_arviz(chains: int, draws: int) -> None:
    rng = np.random.default_rng(draws)
    values = rng.standard_t(2, (chains, draws, 5))
    values[0, :, 1] += 0.5
    values[0, :, 2] *= 3.0
    values[:, :, 3] = np.round(values[:, :, 3])  # equal values share their ranks
    values[:, :, 4] = np.cumsum(values[:, :, 4], axis=1)
    assert rhat(values) == pytest.approx(arviz_rhat(values), rel=1e-12)


@pytest.mark.smoke
def test_rhat_sees_a_chain_that_is_elsewhere_and_one_that_stands_still() -> None:
    chains = np.random.default_rng(0).normal(size=(4, 500, 4))
    chains[0, :, 1] += 1
    chains[:, :, 2] = 0
    chains[2, 7, 3] = np.nan
    good, apart, still, unknown = rhat(chains)
    assert good < 1.01
    assert apart > 1.05
    assert still == unknown == np.inf


@pytest.mark.parametrize("shape", [(1, 100, 2), (4, 3, 2)])
def test_rhat_of_one_chain_or_of_three_draws_is_undefined(shape: tuple[int, int, int]) -> None:
    assert np.all(rhat(np.random.default_rng(0).normal(size=shape)) == np.inf)


@pytest.mark.parametrize("draws", [30, 100, 256, 4000])
@pytest.mark.parametrize("shape", [0.1, 0.5, 0.9, 2.0])
def test_pareto_k_is_that_of_arviz(draws: int, shape: float) -> None:
    weights = shape * np.random.default_rng(draws).exponential(size=draws)
    assert pareto_k(weights) == pytest.approx(arviz_pareto_k(weights.copy()), rel=1e-9)


@pytest.mark.smoke
def test_pareto_k_is_that_of_the_weights() -> None:
    shapes = np.array([0.2, 0.5, 0.9])
    # Weights exp(k e) with exponential e have a Pareto tail of shape k.
    k = pareto_k(shapes[:, None] * np.random.default_rng(0).exponential(size=(3, 4000)))
    assert k == pytest.approx(shapes, abs=0.12)


def test_equal_weights_have_no_tail() -> None:
    assert pareto_k(np.zeros((2, 50))).tolist() == [np.inf, np.inf]
