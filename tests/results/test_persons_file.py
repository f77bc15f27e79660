"""Many people's elements as Parquet: the numbers of `persons_table`, with units, in groups of rows."""

from pathlib import Path

import numpy as np
import pytest
from results_by_hand import make_result

from bayes_impedance.results import persons_file
from bayes_impedance.results.persons_file import PERSONS_FILE, write_persons

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra: parquet)")


def test_the_file_has_the_numbers_of_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pyarrow.parquet as pq

    monkeypatch.setattr(persons_file, "MANY", 5)
    monkeypatch.setattr(persons_file, "_AT_ONCE", 4)
    result = make_result(subjects=6, unidentified=("n1",))
    file = write_persons(result, tmp_path)
    assert file == tmp_path / PERSONS_FILE
    written, expected = pq.ParquetFile(file), result.persons_table(intervals=True)
    assert written.num_row_groups == 2
    table = written.read()
    assert table.column_names == ["subject", *expected.columns]
    assert table["subject"].to_pylist() == list(expected.index)
    for name in expected:
        np.testing.assert_array_equal(table[name].to_numpy(), expected[name].to_numpy())
    assert np.isnan(table["n1"].to_numpy()).all()
    assert table.schema.field("r3_q05").metadata[b"unit"] == b"N s/m"
    before = file.read_bytes()
    write_persons(result, tmp_path)
    assert file.read_bytes() == before


def test_of_few_people_there_is_no_file_and_none_of_another_fit(tmp_path: Path) -> None:
    (tmp_path / PERSONS_FILE).write_bytes(b"of a thousand people")
    assert write_persons(make_result(subjects=6), tmp_path) is None
    assert not list(tmp_path.iterdir())
