"""Recordings as Parquet are the recordings of the CSV file."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayes_impedance.errors import InputError
from bayes_impedance.recordings import read_recordings, write_recordings
from bayes_impedance.simulate import FINGERTIP, simulate_recordings

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra: parquet)")


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    people = simulate_recordings(FINGERTIP, 3, 2, np.geomspace(5, 5000, 21), 1).recordings
    write_recordings(people, tmp_path / "csv")
    return tmp_path / "csv"


def _moved(dataset: Path, partitioned: bool) -> Path:
    """The same dataset with its table as Parquet."""
    table = pd.read_csv(dataset / "recordings.csv", dtype={"subject": str, "repetition": str})
    target = dataset.parent / "parquet"
    target.mkdir()
    for file in dataset.iterdir():
        if file.name != "recordings.csv":
            (target / file.name).write_bytes(file.read_bytes())
    table.to_parquet(target / "recordings.parquet", index=False, partition_cols=["subject"] if partitioned else None)
    return target


@pytest.mark.parametrize("partitioned", [False, True])
@pytest.mark.parametrize("named", ["folder", "table"])
def test_parquet_gives_the_same_recordings(dataset: Path, partitioned: bool, named: str) -> None:
    folder = _moved(dataset, partitioned)
    expected = read_recordings(dataset)
    found = read_recordings(folder if named == "folder" else folder / "recordings.parquet")
    assert (found.unit, found.network, found.names) == (expected.unit, expected.network, expected.names)
    for one, other in zip(found.subjects, expected.subjects, strict=True):
        np.testing.assert_array_equal(one.z, other.z)
        np.testing.assert_array_equal(one.frequency_hz, other.frequency_hz)
        assert one.repetitions == other.repetitions


def test_a_broken_table_is_one_sentence(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=False)
    (folder / "recordings.parquet").write_bytes(b"not parquet at all")
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_recordings(folder)


def test_faults_of_the_table_name_the_row(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=False)
    table = pd.read_parquet(folder / "recordings.parquet")
    table.loc[4, "frequency_hz"] = -1.0
    table.to_parquet(folder / "recordings.parquet", index=False)
    with pytest.raises(InputError, match=r"recordings\.parquet, row 6: frequency_hz is -1"):
        read_recordings(folder)


def test_two_tables_are_one_too_many(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=True)
    (folder / "recordings.csv").write_bytes((dataset / "recordings.csv").read_bytes())
    with pytest.raises(InputError, match=r"has both recordings\.csv and recordings\.parquet; delete"):
        read_recordings(folder)
