"""Over many virtual populations: 90 % intervals contain the truth in about 90 % of cases."""

import runpy

import pytest
from conftest import DATA

SCRIPT = DATA.parent / "analyses" / "coverage" / "calibration.py"
ASKED = ("central", "dispersion_between_persons")


def _coverage(n_populations: int, first_seed: int) -> float:
    module = runpy.run_path(str(SCRIPT))
    rows = [
        row
        for seed in range(first_seed, first_seed + n_populations)
        for row in module["one_population"](seed, 40, 101, module["QUICK_SETTINGS"])
    ]
    return float(module["coverage"](rows, ASKED))


@pytest.mark.slow
@pytest.mark.ci
def test_coverage_over_six_populations() -> None:
    # 96 intervals in six correlated groups: a standard error of 4 %, and four of them to either side.
    assert 0.74 < _coverage(6, 1) <= 1.0


@pytest.mark.slow
def test_coverage_over_twenty_populations() -> None:
    assert 0.80 <= _coverage(20, 1) <= 0.97
