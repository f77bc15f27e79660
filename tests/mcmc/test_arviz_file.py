"""Files of results are ArviZ's and give the same answer whatever its version."""

from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.mcmc.arviz_file import load_groups, save


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
