"""The checked table of recordings: order, polar values, dropped rows, and the row that each refusal names."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import repeatable

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import parse_csv
from bayes_impedance.recordings.long_table import (
    KNOWN,
    ONLY_REPETITION,
    RecordingTable,
    check_cells,
    parse_recordings,
    values,
)

HEADER = "subject,repetition,frequency_hz,z_re,z_im"


def table(*rows: str, header: str = HEADER) -> RecordingTable:
    return parse_recordings("\n".join([header, *rows, ""]).encode(), "f.csv")


@repeatable
@given(order=st.permutations(range(12)))
def test_rows_are_in_the_order_of_subject_repetition_frequency(order: list[int]) -> None:
    """Whatever recording is written first, as long as each one's frequencies ascend."""
    rows = [(f"S{i % 2}", f"r{i // 2 % 2}", 10 * (1 + i // 4)) for i in range(12)]
    written = sorted(order, key=lambda i: rows[i][2])  # ascending within each recording, the recordings mixed
    found = table(*(f"{rows[i][0]},{rows[i][1]},{rows[i][2]},{i},0.5" for i in written))
    key = list(zip(found.subject, found.repetition, found.frequency_hz, strict=True))
    assert key == sorted(key)
    for name, repetition, f, z, row in zip(
        (found.subject_names[k] for k in found.subject),
        (found.repetition_names[k] for k in found.repetition),
        found.frequency_hz,
        found.z,
        found.row,
        strict=True,
    ):
        assert rows[int(z.real)] == (name, repetition, f)
        assert written[row - 2] == int(z.real)


def test_names_are_in_the_order_of_the_file() -> None:
    found = table("B,2,10,1,0", "A,1,10,1,0", "B,1,10,1,0")
    assert found.subject_names == ("B", "A")
    assert found.repetition_names == ("2", "1")
    assert found.label(0) == 'subject "B", repetition "2"'
    assert found.label(2) == 'subject "A", repetition "1"'


def test_magnitude_and_phase_are_the_same_impedance() -> None:
    z = np.array([3 + 4j, -1 + 1j, -2j])
    rows = [f"A,1,{10 + k},{abs(v)!r},{float(np.angle(v, deg=True))!r}" for k, v in enumerate(z.tolist())]
    found = table(*rows, header="subject,repetition,frequency_hz,magnitude,phase_deg")
    assert found.polar
    np.testing.assert_allclose(found.z, z, rtol=1e-12)


def test_values_of_both_kinds_are_the_cartesian_ones_with_a_warning() -> None:
    found = table("A,1,10,1,2,99,99", header=HEADER + ",magnitude,phase_deg")
    assert not found.polar
    assert found.z.tolist() == [1 + 2j]
    assert len(found.warnings) == 2
    assert all("values are taken from z_re and z_im" in warning for warning in found.warnings)


def test_without_repetitions_everybody_was_measured_once() -> None:
    found = table("A,10,1,0", "B,10,1,0", header="subject,frequency_hz,z_re,z_im")
    assert found.repetition_names == (ONLY_REPETITION,)
    assert found.repetition.tolist() == [0, 0]


def test_rows_without_a_value_are_dropped_and_counted() -> None:
    found = table("A,1,10,1,0", "A,1,20,,0", "B,1,10,nan,0", "A,1,30,inf,0", "A,2,10,1,1")
    assert found.row.tolist() == [2, 6]
    assert found.warnings == (
        "f.csv: 3 of 5 rows have no finite value and were dropped, the first is row 3",
        'f.csv: subject "B", repetition "1" has no usable row and was left out',
    )


def test_noise_is_needed_only_of_those_who_have_it() -> None:
    header = HEADER + ",noise_sd"
    found = table("A,1,10,1,0,0.1", "A,1,20,1,0,", "B,1,10,1,0,", "B,1,20,1,0,", header=header)
    assert found.row.tolist() == [2, 4, 5]
    np.testing.assert_array_equal(found.noise_sd, [0.1, np.nan, np.nan])


def test_a_table_without_a_usable_row_is_refused_or_empty() -> None:
    cells = parse_csv(f"{HEADER}\nA,1,10,,\n".encode(), "f.csv", KNOWN)
    with pytest.raises(InputError, match=r"no row has a finite number in every column \(row 2 is the first\)"):
        check_cells(cells)
    assert check_cells(cells, may_be_empty=True).z.size == 0


def test_values_are_read_without_any_check() -> None:
    z, noise_sd = values(parse_csv(f"{HEADER}\nA,1,10,-1,2\nA,1,5,3,\n".encode(), "f.csv", KNOWN), polar=False)
    np.testing.assert_array_equal(z, [-1 + 2j, complex(3, np.nan)])
    assert np.isnan(noise_sd).all()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (("A,1,10,1,0", "A,1,0,1,0"), "row 3: frequency_hz is 0, but must be above zero"),
        (("A,1,10,1,0", "A,1,-5,1,0"), "row 3: frequency_hz is -5, but must be above zero"),
        (("A,1,10,0,0", "A,1,20,1,0", "A,1,30,0,0"), "row 2: z is exactly 0, .*and so are 1 more rows"),
        (("A,1,10,1e26,0",), r"row 2: \|z\| is 1e\+26, which cannot be a measured value; leave"),
        (("A,1,10,1e-26,0",), r"row 2: \|z\| is 1e-26"),
        (("A,1,1e16,1,0",), r"row 2: frequency_hz is 1e\+16"),
        (("A,1,10,1,0", "B,1,10,1,0", "A,1,10,2,0"), 'row 4: 10 Hz was already given in row 2 for subject "A", rep'),
        (("A,1,20,1,0", "B,1,10,1,0", "A,1,10,2,0"), 'row 4: frequency_hz falls from 20 to 10 within subject "A"'),
    ],
)
def test_the_row_that_is_wrong_is_named(rows: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError, match=rf"^f\.csv, {said}"):
        table(*rows)


def test_the_first_of_several_wrong_rows_of_the_file_is_named() -> None:
    """Also where its subject comes later in the table's own order."""
    rows = ("B,1,10,1,0", "A,1,10,1,0", "A,1,10,2,0", "B,1,10,2,0")
    with pytest.raises(InputError, match="row 4: 10 Hz was already given in row 3"):
        table(*rows)
    falling = ("B,1,10,1,0", "A,1,20,1,0", "A,1,10,2,0", "B,1,5,2,0")
    with pytest.raises(InputError, match="row 4: frequency_hz falls from 20 to 10"):
        table(*falling)


@pytest.mark.parametrize(
    ("row", "header", "said"),
    [
        ("A,1,10,-1,0", "subject,repetition,frequency_hz,magnitude,phase_deg", "magnitude is -1, .*if it is in dB"),
        ("A,1,10,1,0,0", HEADER + ",noise_sd", "noise_sd is 0, but must be above zero"),
        ("A,1,10,1,0,1e-30", HEADER + ",noise_sd", "noise_sd is 1e-30, which cannot be a measured value"),
    ],
)
def test_a_wrong_cell_of_an_optional_column_is_named(row: str, header: str, said: str) -> None:
    with pytest.raises(InputError, match=rf"^f\.csv, row 2: {said}"):
        table(row, header=header)
