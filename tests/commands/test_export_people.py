"""Values of everybody who was recorded, as a table from the command line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from results_by_hand import make_result

from bayes_impedance.commands.cli import main
from bayes_impedance.results.result import save_result


@pytest.mark.parametrize("subjects", [1, 6])
def test_people_are_exported(subjects: int, tmp_path: Path) -> None:
    result = make_result(subjects=subjects, unidentified=("n1",))
    save_result(result, tmp_path / "fit")
    assert main(["export", str(tmp_path / "fit"), "-o", str(tmp_path / "out"), "--what", "people"]) == 0
    table = pd.read_csv(tmp_path / "out" / "people.csv", index_col="subject", comment="#")
    assert list(table.index) == list(result.coords["subject"])
    np.testing.assert_allclose(table["r3"], result.persons_table()["r3"], rtol=1e-12)
    assert table["n1"].isna().all()
    assert {"r3_q05", "r3_q95", "noise_scale"} <= set(table)


def test_people_of_a_fit_that_must_not_be_used_have_no_values(tmp_path: Path) -> None:
    save_result(make_result(problems=("the ensembles disagree",)), tmp_path / "fit")
    assert main(["export", str(tmp_path / "fit"), "-o", str(tmp_path / "out"), "--what", "people"]) == 0
    text = (tmp_path / "out" / "people.csv").read_text(encoding="utf-8")
    assert text.startswith("# WARNING: the ensembles disagree")
    assert pd.read_csv(tmp_path / "out" / "people.csv", comment="#")["r3"].isna().all()
