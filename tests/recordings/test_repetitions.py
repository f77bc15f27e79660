"""From the table of recordings to subjects: unit, sign and convention, and the frequencies that repetitions share."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import CovariateTable
from bayes_impedance.recordings.long_table import RecordingTable, parse_recordings
from bayes_impedance.recordings.metadata import CONVENTIONS, SIGNS, Metadata
from bayes_impedance.recordings.repetitions import subjects_of

HEADER = "subject,repetition,frequency_hz,z_re,z_im"


def table(*rows: str, header: str = HEADER) -> RecordingTable:
    return parse_recordings("\n".join([header, *rows, ""]).encode(), "f.csv")


def recording(subject: str, repetition: int, frequencies: tuple[int, ...], more: str = "") -> list[str]:
    return [f"{subject},{repetition},{f},{f + repetition},2{more}" for f in frequencies]


NOBODY = CovariateTable({}, (), ())


def test_values_get_the_sign_the_convention_and_the_unit_of_the_description() -> None:
    rows = recording("A", 1, (10, 20, 30), ",0.5")
    given = table(*rows, header=HEADER + ",noise_sd")
    z = np.array([11, 21, 31]) + 2j
    for metadata, expected in (
        (Metadata(title="t"), z),
        (Metadata(title="t", factor=1e-3), 1e-3 * z),
        (Metadata(title="t", sign=SIGNS[1]), -z),
        (Metadata(title="t", convention=CONVENTIONS[1]), z.conj()),
        (Metadata(title="t", convention=CONVENTIONS[0]), z),
        (Metadata(title="t", factor=2.0, sign=SIGNS[1], convention=CONVENTIONS[1]), -2 * z.conj()),
    ):
        ((subject, _, warning),) = subjects_of(given, metadata, NOBODY)
        np.testing.assert_array_equal(subject.z, expected[None])
        np.testing.assert_array_equal(subject.noise_sd, np.full((1, 3), 0.5 * metadata.factor))  # without a sign
        assert warning is None


def test_subjects_have_their_rows_repetitions_and_covariates() -> None:
    given = table(*recording("B", 2, (10, 20, 30)), *recording("A", 1, (10, 20, 40)), *recording("B", 1, (10, 20, 30)))
    covariates = CovariateTable({"A": {"age_y": 30.0}}, ("age_y",), ())
    found = list(subjects_of(given, Metadata(title="t"), covariates))
    assert [subject.name for subject, _, _ in found] == ["B", "A"]
    assert [subject.repetitions for subject, _, _ in found] == [("2", "1"), ("1",)]
    assert [subject.covariates for subject, _, _ in found] == [{}, {"age_y": 30.0}]
    for subject, rows, _ in found:
        np.testing.assert_array_equal(subject.z, given.z[rows])
        np.testing.assert_array_equal(given.frequency_hz[rows], np.tile(subject.frequency_hz, (len(rows), 1)))
        assert subject.noise_sd is None


def test_repetitions_are_reduced_to_the_frequencies_that_all_have() -> None:
    given = table(*recording("A", 1, (10, 20, 30, 40)), *recording("A", 2, (20, 30, 40, 50)))
    ((subject, rows, warning),) = subjects_of(given, Metadata(title="t"), NOBODY)
    assert subject.frequency_hz.tolist() == [20, 30, 40]
    assert given.row[rows].tolist() == [[3, 4, 5], [6, 7, 8]]
    assert subject.z.real.tolist() == [[21, 31, 41], [22, 32, 42]]
    assert warning is not None
    assert "was reduced to the 3 that are common to all (of up to 4)" in warning


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        ((10, 20, 30, 40, 50, 60, 70), (10, 20, 30), "of up to 7 frequencies, of which only 3 are common to all"),
        ((10, 20, 30, 40), (10, 20, 50, 60), "2 usable frequencies, but at least 3 are needed"),
        ((10, 20), (10, 20), "2 usable frequencies, but at least 3 are needed"),
    ],
)
def test_too_few_frequencies_are_refused(first: tuple[int, ...], second: tuple[int, ...], said: str) -> None:
    """Half of the longest repetition suffices, if it is three points."""
    given = table(*recording("B", 1, (10, 20, 30)), *recording("A", 1, first), *recording("A", 2, second))
    with pytest.raises(InputError, match=rf'^f\.csv, row 5: subject "A" has .*{said}'):
        list(subjects_of(given, Metadata(title="t"), NOBODY))
