"""Tables of a result: one row for each element or person, units beside them, no number where there is none."""

import numpy as np
import pandas as pd
import pytest
from results_by_hand import make_result


def test_elements_are_those_of_the_summary() -> None:
    result = make_result(subjects=6, unidentified=("n1",))
    table = result.elements_table()
    assert table.shape == (5, 12)
    assert table.index.name == "element"
    assert list(table.index) == result.elements
    told = result.summary["elements"]["r3"]
    assert table.loc["r3", "unit"] == "N s/m"
    assert table.loc["r3", ["central", "central_q05", "central_q95"]].tolist() == [
        told["central"][key] for key in ("median", "q05", "q95")
    ]
    assert table.loc["r3", "between_repetitions"] == told["dispersion_between_repetitions"]["median"]
    assert not table.loc["n1", "identified"]
    assert table.drop(columns=["unit", "identified", "marked"]).loc["n1"].isna().all()
    assert table.attrs["units"]["between_persons_q95"] == "ln"
    assert table.attrs["units"].keys() == set(table.columns) - {"unit", "identified", "marked"}


def test_persons_have_their_own_medians() -> None:
    result = make_result(subjects=6, unidentified=("n1",))
    table = result.persons_table()
    assert table.index.name == "subject"
    assert list(table.index) == list(result.coords["subject"])
    draws = np.exp(result.groups["posterior"]["person_log_elements"])
    own = np.median(draws[:, :, 2, 1])
    assert table.iloc[2]["r3"] == pytest.approx(own, rel=1e-3)  # an even number of draws: the median is between two
    assert table["n1"].isna().all()
    np.testing.assert_array_equal(table["pareto_k"], result.groups["constant_data"]["pareto_k"])
    assert table.attrs["units"].keys() == set(table.columns)
    assert table.attrs["units"]["n3"] == "m/N"


def test_a_fit_that_must_not_be_used_has_no_elements() -> None:
    table = make_result(subjects=6, problems=("too short",)).persons_table()
    assert table[["n3", "r3"]].isna().all(axis=None)
    assert table["noise_scale"].notna().all()


def test_one_person_has_no_dispersion() -> None:
    result = make_result(subjects=1)
    assert result.elements_table()["between_persons"].isna().all()
    assert isinstance(result.persons_table(), pd.DataFrame)
    assert len(result.persons_table()) == 1


def test_intervals_of_persons_stand_beside_their_medians() -> None:
    table = make_result(subjects=6, unidentified=("n1",)).persons_table(intervals=True)
    assert list(table)[3:6] == ["r3", "r3_q05", "r3_q95"]
    assert (table["r3_q05"] < table["r3"]).all()
    assert (table["r3"] < table["r3_q95"]).all()
    assert table["n1_q95"].isna().all()
    assert table.attrs["units"]["r3_q05"] == "N s/m"
