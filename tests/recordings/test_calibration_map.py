"""The error of a calibration at each frequency: its table, and what it does to corrected loads."""

from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.errors import InputError
from bayes_impedance.recordings import read_recordings
from bayes_impedance.recordings.calibration_map import CalibrationMap, parse_map

FREQUENCY = np.array([10.0, 20.0, 50.0, 100.0])
RNG = np.random.default_rng(1)


def any_map() -> CalibrationMap:
    a, b, c = (RNG.normal(size=(3, 4)) + 1j * RNG.normal(size=(3, 4))) * np.array([[0.1], [0.3], [0.01]])
    root = RNG.normal(size=(4, 3, 3)) + 1j * RNG.normal(size=(4, 3, 3))
    covariance = np.einsum("fij,fkj->fik", root, root.conj()) * 1e-6
    return CalibrationMap(frequency_hz=FREQUENCY, a=1 + a, b=b, c=c, covariance=covariance)


def test_the_table_comes_back_exactly() -> None:
    error = any_map()
    again = parse_map(error.csv(), "calibration.csv")
    for name in ("frequency_hz", "a", "b", "c", "covariance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(error, name))


def test_changes_are_the_derivatives_of_a_corrected_load() -> None:
    error, step = any_map(), 1e-6
    at = np.array([2, 0, 3])
    z = RNG.normal(size=(2, 3)) + 1j * RNG.normal(size=(2, 3))
    index, gradient = error.changes(FREQUENCY[at] * 1.001, z)
    np.testing.assert_array_equal(index, at)
    a, b, c = error.a[at], error.b[at], error.c[at]
    h = (a * z + b) / (c * z + 1)
    for k in range(3):
        da, db, dc = step * np.eye(3)[k]
        changed = (h - b - db) / (a + da - (c + dc) * h)
        np.testing.assert_allclose((changed - z) / step, gradient[..., k], rtol=1e-4)


def test_the_variance_is_that_of_drawn_maps() -> None:
    error = any_map()
    assert error.covariance is not None
    z = np.array([2.0 + 1j, 1 - 1j, 0.5j, 3.0])
    values, vectors = np.linalg.eigh(error.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))[:, None, :]
    normal = RNG.normal(size=(20_000, 4, 3, 2)) @ np.array([1, 1j])
    a, b, c = (
        np.moveaxis(np.einsum("fij,wfj->wfi", root, normal), -1, 0) + np.array([error.a, error.b, error.c])[:, None]
    )
    h = (error.a * z + error.b) / (error.c * z + 1)
    off = (h - b) / (a - c * h) - z
    expected = error.variance(FREQUENCY, z)
    np.testing.assert_allclose(off.real.var(axis=0), expected, rtol=0.05)  # 0.01 is the error of the draws
    np.testing.assert_allclose(off.imag.var(axis=0), expected, rtol=0.05)


def test_a_frequency_that_the_map_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="no frequency near 70 Hz"):
        any_map().changes(np.array([10.0, 70.0]), np.ones(2, dtype=complex))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"var_c", b"var_d", 'column "var_c" is missing'),
        (b"\n20.0,", b"\n5.0,", "must be above zero and ascend"),
        (b"\n20.0,", b"\n,", "row 3: frequency_hz is empty"),
        (b"\n20.0,", b"\nx,", "which is not a number"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(old: bytes, new: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_map(any_map().csv().replace(old, new), "calibration.csv")


def test_a_negative_variance_is_refused() -> None:
    error = any_map()
    assert error.covariance is not None
    error.covariance[1, 1, 1] *= -1
    with pytest.raises(InputError, match="row 3: variances and covariances are no positive semidefinite matrix"):
        parse_map(error.csv(), "calibration.csv")


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ('map = "calibration.csv"', "there is no calibration.csv beside it"),
        ('map = "../calibration.csv"', "must be the name of a file in the dataset's folder"),
        ("map = 3", "map is 3, but must be text"),
        ('map = "calibration.csv"\nsd = [1]', "is not used"),
    ],
)
def test_a_table_of_the_dataset_that_cannot_be_used_is_refused(written: str, said: str, tmp_path: Path) -> None:
    rows = "".join(f"A,1,{f},{1 + f},{f}\n" for f in range(1, 9))
    (tmp_path / "recordings.csv").write_text("subject,repetition,frequency_hz,z_re,z_im\n" + rows)
    (tmp_path / "dataset.toml").write_text(f"[calibration]\n{written}\n")
    with pytest.raises(InputError, match=said):
        read_recordings(tmp_path)


def test_values_in_another_unit_are_refused(tmp_path: Path) -> None:
    rows = "".join(f"A,1,{f},{1 + f},{f}\n" for f in range(1, 9))
    (tmp_path / "recordings.csv").write_text("subject,repetition,frequency_hz,z_re,z_im\n" + rows)
    (tmp_path / "dataset.toml").write_text('unit = "N s/mm"\n[calibration]\nmap = "calibration.csv"\n')
    (tmp_path / "calibration.csv").write_bytes(any_map().csv())
    with pytest.raises(InputError, match=r"in N s/m, but recordings in another unit"):
        read_recordings(tmp_path)
