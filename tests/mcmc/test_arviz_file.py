"""What is asked of ArviZ gives the same answer whatever its version."""

from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.mcmc.arviz_file import load_groups, pareto_k, rhat, save


@pytest.mark.smoke
def test_pareto_k_is_that_of_the_weights() -> None:
    rng = np.random.default_rng(0)
    shapes = np.array([0.2, 0.5, 0.9])
    # Weights exp(k e) with exponential e have a Pareto tail of shape k.
    k = pareto_k(shapes[:, None] * rng.exponential(size=(3, 4000)))
    assert k == pytest.approx(shapes, abs=0.12)


@pytest.mark.smoke
def test_rhat_sees_a_chain_that_is_elsewhere_and_one_that_stands_still() -> None:
    chains = np.random.default_rng(0).normal(size=(4, 500, 3))
    chains[0, :, 1] += 1
    chains[:, :, 2] = 0
    good, apart, still = rhat(chains)
    assert good < 1.01
    assert apart > 1.05
    assert still == np.inf


@pytest.mark.smoke
def test_what_is_saved_comes_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    groups = {
        "posterior": {"mu": rng.normal(size=(2, 5, 3))},
        "sample_stats": {"lp": rng.normal(size=(2, 5))},
        "constant_data": {"curve": rng.normal(size=4)},
    }
    dims = {"mu": ["element"], "curve": ["frequency_hz"]}
    coords = {"element": ["m1", "n1", "r1"], "frequency_hz": np.array([1.0, 2.0, 3.0, 4.0])}
    for name in ("one.nc", "two.nc"):
        save(tmp_path / name, groups, dims, coords, {"seed": 3, "network": "m1|n1|r1"})
    assert (tmp_path / "one.nc").read_bytes() == (tmp_path / "two.nc").read_bytes()
    found, labels, attributes = load_groups(tmp_path / "one.nc")
    for group, variables in groups.items():
        for variable, values in variables.items():
            assert np.array_equal(found[group][variable], values)
    assert labels["element"] == ["m1", "n1", "r1"]
    assert np.array_equal(labels["frequency_hz"], coords["frequency_hz"])
    assert attributes["seed"] == 3
    assert attributes["network"] == "m1|n1|r1"
    assert not list(tmp_path.glob("*.tmp"))
