"""What is written in another layout comes back as it was."""

from pathlib import Path

import numpy as np
import pytest
from results_by_hand import VARIANTS, make_result

from bayes_impedance.mcmc.arviz_file import load_groups
from bayes_impedance.results.result import load_result, save_result


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_result_comes_back(variant: str, tmp_path: Path) -> None:
    made = make_result(**VARIANTS[variant])
    save_result(made, tmp_path)
    read = load_result(tmp_path)
    for group, variables in made.groups.items():
        assert set(read.groups[group]) == set(variables)
        for name, values in variables.items():
            np.testing.assert_allclose(read.groups[group][name], values, rtol=1e-12, err_msg=f"{group}/{name}")
    assert read.coords["element"] == made.coords["element"]
    assert not [axis for axis in read.coords if "/" in axis or axis in ("pair", "varying_element")]


def test_what_is_the_same_for_everybody_has_no_dispersion_in_the_file(tmp_path: Path) -> None:
    made = make_result(unidentified=("r1",))
    posterior = made.groups["posterior"]
    posterior["dispersion_between_persons"][..., 0] = 0.0  # of n3
    posterior["dispersion_between_repetitions"][..., 0] = 0.0
    posterior["correlation"][..., 0, 1:] = posterior["correlation"][..., 1:, 0] = 0.0
    posterior["correlation"][..., 3, :] = posterior["correlation"][..., :, 3] = np.nan
    save_result(made, tmp_path)
    groups, coords, _ = load_groups(tmp_path / "result.nc")
    assert coords["posterior/element"] == ["n3", "r3", "m2", "n1"]
    assert coords["varying_element"] == ["r3", "m2", "n1"]
    assert coords["pair"] == ["r3, m2", "r3, n1", "m2, n1"]
    assert groups["posterior"]["dispersion_between_persons"].shape == (2, 60, 3)
    assert all(np.all(np.isfinite(values)) for values in groups["posterior"].values())
    read = load_result(tmp_path)
    for name, values in posterior.items():
        np.testing.assert_allclose(read.groups["posterior"][name], values, rtol=1e-12, err_msg=name)
