"""What a fit needs of its chains, its file and its corner plots is had without ArviZ, xarray and pandas."""

import subprocess
import sys

import pytest

CHAINS_AND_FILE = """
import sys
from pathlib import Path
import numpy as np
from bayes_impedance.mcmc.arviz_file import load_groups, save
from bayes_impedance.mcmc.convergence import pareto_k, rhat

draws = np.random.default_rng(0).normal(size=(2, 50, 3))
rhat(draws), pareto_k(draws[:, :, 0])
save(Path(sys.argv[1]) / "one.nc", {"posterior": {"mu": draws}}, {"mu": ["element"]}, {"element": list("abc")}, {})
assert np.array_equal(load_groups(Path(sys.argv[1]) / "one.nc")[0]["posterior"]["mu"], draws)
print(sorted({"arviz", "xarray", "pandas"} & set(sys.modules)))
"""

CORNER = """
import sys
from bayes_impedance.plots.joint import _corner_package

assert callable(_corner_package().corner)
print(sorted({"arviz", "xarray", "pandas"} & set(sys.modules)))
import arviz  # which is still there for others
"""


@pytest.mark.parametrize("script", [CHAINS_AND_FILE, CORNER])
def test_large_packages_are_not_imported(script: str, tmp_path: object) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.returncode) == ("[]\n", 0), done.stderr
