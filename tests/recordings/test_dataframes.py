"""Recordings as tables of pandas: the numbers of the CSV files, with units."""

import io
from pathlib import Path

import numpy as np
import pandas as pd

from bayes_impedance.recordings import Recordings, Subject, write_recordings


def _recordings(noise: bool = True) -> Recordings:
    rng = np.random.default_rng(1)
    z = rng.normal(size=(2, 4)) + 1j * rng.normal(size=(2, 4))
    return Recordings(
        title="two people",
        unit="ohm",
        network=None,
        source="",
        licence="",
        subjects=(
            Subject(
                name="A",
                frequency_hz=np.array([1.0, 2.0, 5.0, 9.0]),
                z=z,
                repetitions=("1", "x"),
                noise_sd=np.abs(z) if noise else None,
                covariates={"age_y": 31.0},
            ),
            Subject(
                name='"B", jr',
                frequency_hz=np.array([1.5, 2.5]),
                z=z[:1, :2],
                repetitions=("1",),
                covariates={"force_n": 1e-7},
            ),
        ),
    )


def test_a_row_for_each_subject_repetition_and_frequency() -> None:
    recordings = _recordings()
    table = recordings.to_dataframe()
    assert table.shape == (2 * 4 + 2, 6)
    units = {"frequency_hz": "Hz", "z_re": "ohm", "z_im": "ohm", "noise_sd": "ohm"}
    assert table.attrs["units"] == units
    for subject in recordings.subjects:
        for repetition, z in zip(subject.repetitions, subject.z, strict=True):
            rows = table[(table.subject == subject.name) & (table.repetition == repetition)]
            np.testing.assert_array_equal(rows.frequency_hz, subject.frequency_hz)
            np.testing.assert_array_equal(rows.z_re + 1j * rows.z_im, z)
    assert table.noise_sd.isna().tolist() == [False] * 8 + [True] * 2


def test_without_noise_there_is_no_column_of_it() -> None:
    table = _recordings(noise=False).to_dataframe()
    assert list(table.columns) == ["subject", "repetition", "frequency_hz", "z_re", "z_im"]
    assert "noise_sd" not in table.attrs["units"]


def test_the_table_is_the_file(tmp_path: Path) -> None:
    recordings = _recordings()
    folder = write_recordings(recordings, tmp_path)
    written = pd.read_csv(folder / "recordings.csv", dtype={"repetition": str})
    pd.testing.assert_frame_equal(written, recordings.to_dataframe(), check_dtype=False, rtol=1e-12)
    assert (folder / "subjects.csv").read_text() == 'subject,age_y,force_n\nA,31.0,\n"""B"", jr",,1e-07\n'


def test_everybody_has_a_row_of_covariates() -> None:
    table = _recordings().subjects_table()
    assert table.shape == (2, 2)
    assert table.index.tolist() == ["A", '"B", jr']
    assert table.loc["A", "age_y"] == 31.0
    assert np.isnan(table.loc["A", "force_n"])
    again = pd.read_csv(io.StringIO(table.to_csv()), index_col="subject")
    pd.testing.assert_frame_equal(again, table, check_index_type=False, rtol=1e-12)
