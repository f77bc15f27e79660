"""Files of results are ArviZ's and give the same answer whatever its version."""

from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.mcmc import arviz_file
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


def test_what_is_true_or_false_is_read_as_such(tmp_path: Path) -> None:
    """netCDF has no such type."""
    xarray = pytest.importorskip("xarray")
    known = np.array([True, False, True])
    save(tmp_path / "a.nc", {"posterior": {"mu": np.zeros((1, 2, 3))}, "constant_data": {"known": known}},
         {"mu": ["element"], "known": ["element"]}, {"element": ["m1", "n1", "r1"]}, {})  # fmt: skip
    groups, _, _ = load_groups(tmp_path / "a.nc")
    np.testing.assert_array_equal(groups["constant_data"]["known"], known)
    with xarray.open_dataset(tmp_path / "a.nc", group="constant_data", engine="h5netcdf") as data:
        assert data["known"].dtype == bool


def test_a_large_file_has_the_digest_of_its_numbers_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Taken of a few numbers at a time, whatever their order in memory and their precision."""
    values = np.swapaxes(np.arange(120.0).reshape(2, 3, 5, 4), -1, -2)
    dims = {"mu": ["element", "subject"]}
    save(tmp_path / "at_once.nc", {"posterior": {"mu": values}}, dims, {}, {})
    monkeypatch.setattr(arviz_file, "_AT_ONCE", 7)
    save(tmp_path / "in_pieces.nc", {"posterior": {"mu": values}}, dims, {}, {})
    assert (tmp_path / "at_once.nc").read_bytes() == (tmp_path / "in_pieces.nc").read_bytes()
    save(tmp_path / "single.nc", {"posterior": {"mu": values.astype(np.float32)}}, dims, {}, {})
    found, _, _ = load_groups(tmp_path / "single.nc")
    assert found["posterior"]["mu"].dtype == np.float32
    np.testing.assert_array_equal(found["posterior"]["mu"], values)
