"""Findings: planted faults are found where they were planted, and clean data give none."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from bayes_impedance.quality import point_anomalies
from bayes_impedance.quality.checks import Finding, check_recordings, describe
from bayes_impedance.quality.curve_anomalies import bode_phase
from bayes_impedance.recordings.files import Recordings, Subject, read_recordings

Complex = npt.NDArray[np.complex128]
Float = npt.NDArray[np.float64]


def fingertip(f: Float, scale: Float) -> Complex:
    """Two-mass chain behind a skin layer; `scale` multiplies the eight elements."""
    m1, m2, n1, n2, n3, r1, r2, r3 = np.array([0.1, 2e-3, 1e-3, 2e-3, 1e-4, 1.0, 2.0, 1.5]) * scale
    s = 2j * np.pi * f
    limb = 1 / (1 / (s * m1) + 1 / (1 / (s * n2) + r2))
    z: Complex = 1 / (1 / (1 / (s * n3) + r3) + 1 / (s * m2 + r1 + 1 / (s * n1) + limb))
    return z


def gaussian(rng: np.random.Generator, *shape: int) -> Complex:
    """Complex noise with unit standard deviation of each part."""
    return np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape), dtype=np.complex128)


def simulate(
    seed: int = 0, *, subjects: int = 12, repetitions: int = 3, points: int = 201, noise: float = 0.01
) -> Recordings:
    """Smooth curves, 30 % variation between subjects, noise four times as large at 5 Hz as above 10 Hz."""
    rng = np.random.default_rng(seed)
    f = np.geomspace(5.0, 5000.0, points)
    made = []
    for i in range(subjects):
        z = fingertip(f, np.exp(0.3 * rng.normal(size=8)))
        sd = noise * np.abs(z) * (1 + 3 * np.clip(np.log2(10 / f), 0, 1))
        made.append(
            Subject(
                name=f"S{i:02d}",
                frequency_hz=f,
                z=z + sd * gaussian(rng, repetitions, points),
                repetitions=tuple(str(j + 1) for j in range(repetitions)),
            )
        )
    return Recordings(title="simulated", unit="N s/m", network=None, source="", licence="", subjects=tuple(made))


def change(data: Recordings, index: int, edit: Callable[[Complex], None]) -> Recordings:
    """Return recordings in which the z of one subject was edited in place."""
    subjects = list(data.subjects)
    z = subjects[index].z.copy()
    edit(z)
    subjects[index] = replace(subjects[index], z=z)
    return replace(data, subjects=tuple(subjects))


def warnings(data: Recordings) -> list[Finding]:
    return [finding for finding in check_recordings(data) if finding.severity == "warning"]


def only(data: Recordings, kind: str) -> Finding:
    (finding,) = warnings(data)
    assert finding.id == kind
    assert "\n" not in finding.message
    return finding


# Clean data


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("subjects", "repetitions", "points"),
    [(71, 3, 401), (12, 3, 60), (6, 2, 30), (5, 1, 100), (1, 3, 201), (1, 1, 401)],
)
def test_clean_data_give_no_warning(seed: int, subjects: int, repetitions: int, points: int) -> None:
    data = simulate(seed, subjects=subjects, repetitions=repetitions, points=points)
    assert warnings(replace(data, polar=True)) == []


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.05])
@pytest.mark.parametrize("points", [60, 401])
def test_amount_of_noise_does_not_matter(noise: float, points: int) -> None:
    assert warnings(simulate(4, noise=noise, repetitions=1, points=points)) == []


def test_many_gaussian_points_have_no_outlier() -> None:
    rng = np.random.default_rng(5)
    f = np.geomspace(5, 5000, 401)
    z = 1 + 0.01 * gaussian(rng, 850, 401)
    assert not point_anomalies.outliers(f, z).any()
    assert not point_anomalies.jumps(f, z)[0].any()


def test_deviation_has_the_size_of_the_noise() -> None:
    rng = np.random.default_rng(6)
    f = np.cumsum(rng.uniform(0.5, 1.5, size=2000))
    z = 10 + 0.1 * gaussian(rng, 1, 2000)
    d = point_anomalies.deviation(f, z)
    assert d.real.std() == pytest.approx(0.01, rel=0.05)
    assert np.median(point_anomalies.noise_scale(d)) == pytest.approx(0.01, rel=0.05)


def test_deviation_of_a_straight_line_is_zero() -> None:
    f = np.array([1.0, 2.0, 5.0, 7.0, 20.0, 21.0])
    np.testing.assert_allclose(point_anomalies.deviation(f, (3 + 2j) * np.log(f) + 10), 0, atol=1e-14)


def test_mass_with_noise_is_passive() -> None:
    """The real part of a mass is noise around zero: half of the points are negative, but no stretch is."""
    rng = np.random.default_rng(7)
    f = np.geomspace(5, 5000, 401)
    z: Complex = 2j * np.pi * f * 0.01 * (1 + 0.01 * gaussian(rng, 100, 401))
    assert (z.real < 0).any(axis=1).all()
    assert point_anomalies.not_passive(f, z) == [[] for _ in range(100)]


# Planted faults


def test_outlier() -> None:
    data = simulate(1)

    def edit(z: Complex) -> None:
        z[1, 120] *= 1.6

    finding = only(change(data, 4, edit), "outlier")
    f = float(data.subjects[0].frequency_hz[120])
    assert (finding.subject, finding.repetition, finding.frequency_hz) == ("S04", "2", (f, f))
    assert f"1 point is far off the neighbours at {f:.4g} Hz" in finding.message
    assert "delete the rows" in finding.message


@pytest.mark.parametrize("index", [0, 1, 2, 199, 200])
def test_outlier_at_the_ends(index: int) -> None:
    f = np.geomspace(5, 5000, 201)
    rng = np.random.default_rng(index)
    z = (3 + np.log(f) * (1 + 0.5j))[None] * (1 + 0.01 * rng.normal(size=(1, 201)))
    z[0, index] *= -1
    np.testing.assert_array_equal(np.flatnonzero(point_anomalies.outliers(f, z)[0]), [index])


def test_many_outliers_of_a_recording_are_one_finding() -> None:
    data = simulate(1)

    def edit(z: Complex) -> None:
        z[0, [40, 90, 91, 150]] *= 2

    finding = only(change(data, 0, edit), "outlier")
    f = data.subjects[0].frequency_hz
    assert "4 points are" in finding.message
    assert finding.frequency_hz == (f[40], f[150])


def test_zero_is_an_outlier() -> None:
    def edit(z: Complex) -> None:
        z[2, 77] = 0

    assert only(change(simulate(1), 0, edit), "outlier").repetition == "3"


def test_hum_in_all_recordings_is_one_finding() -> None:
    data = simulate(2)

    def edit(z: Complex) -> None:
        z[:, 67] *= 2

    for i in range(len(data)):
        data = change(data, i, edit)
    finding = only(data, "outlier")
    assert finding.subject is None
    assert "36 of 36 recordings" in finding.message
    assert "point to the rig" in finding.message


@pytest.mark.parametrize("factor", [2.0, 0.5, 1.2, -1.0, 1j])
def test_jump(factor: complex) -> None:
    data = simulate(3, noise=0.002)

    def edit(z: Complex) -> None:
        z[2, :101] /= factor

    # A turned curve is not passive either.
    (finding,) = [finding for finding in warnings(change(data, 7, edit)) if finding.id != "not_passive"]
    f = data.subjects[0].frequency_hz
    assert finding.id == "jump"
    assert (finding.subject, finding.repetition, finding.frequency_hz) == ("S07", "3", (f[100], f[101]))
    assert "check gain range" in finding.message
    told = re.search(r"by a factor of (\S+) and (\S+) deg", finding.message)
    assert told is not None
    assert float(told[1]) == pytest.approx(abs(factor), rel=0.05)
    assert np.cos(np.deg2rad(float(told[2])) - np.angle(factor)) == pytest.approx(1, abs=0.01)


def test_gain_switch_of_all_recordings_is_one_finding() -> None:
    data = simulate(3)

    def edit(z: Complex) -> None:
        z[:, 130:] *= 1.5

    for i in range(len(data)):
        data = change(data, i, edit)
    finding = only(data, "jump")
    assert finding.subject is None
    assert "of 36 recordings" in finding.message


@pytest.mark.parametrize("quality", [1, 3, 10])
@pytest.mark.parametrize("points", [60, 201, 1001])
def test_sharp_resonance_is_neither_jump_nor_outlier(quality: float, points: int) -> None:
    f = np.geomspace(5, 5000, points)
    x = 1j * f / 300
    series = x + 1 / quality + 1 / x
    for z in (series, 1 / series, 0.3 + 1 / series):
        curve: Complex = np.asarray(z)[None]
        assert not point_anomalies.outliers(f, curve).any()
        assert not point_anomalies.jumps(f, curve)[0].any()


def test_not_passive() -> None:
    data = simulate(1)
    f = data.subjects[0].frequency_hz

    def edit(z: Complex) -> None:
        z[1] -= 1.3 * np.abs(z[1].real) * np.exp(-((np.log(f / 400) / 0.4) ** 2))

    finding = only(change(data, 2, edit), "not_passive")
    assert (finding.subject, finding.repetition) == ("S02", "2")
    assert finding.frequency_hz is not None
    assert 200 < finding.frequency_hz[0] < 400 < finding.frequency_hz[1] < 800
    assert "Re z is negative between" in finding.message
    assert "delay between the channels" in finding.message


def test_delay_of_the_rig_is_one_finding() -> None:
    data = simulate(1)
    f = data.subjects[0].frequency_hz
    late = [replace(subject, z=subject.z * np.exp(2j * np.pi * f * 8e-5)) for subject in data.subjects]
    finding = only(replace(data, subjects=tuple(late)), "not_passive")
    assert finding.subject is None
    assert "point to the rig" in finding.message


def test_identical_subjects() -> None:
    data = simulate(1, subjects=3)
    copy = replace(data.subjects[0], name="X")
    first, second, third = warnings(replace(data, subjects=(*data.subjects, copy)))
    assert {first.id, second.id, third.id} == {"duplicate_subject"}
    assert first.subject == "X"
    assert '"S00" (repetition "1") and "X" (repetition "1") are identical' in first.message
    assert "delete one" in first.message


def test_nearly_identical_repetitions() -> None:
    def edit(z: Complex) -> None:
        z[2] = z[0] * (1 + 1e-8)

    finding = only(change(simulate(1), 5, edit), "duplicate_subject")
    assert (finding.subject, finding.repetition) == ("S05", "3")
    assert 'repetitions "1" and "3" are the same within 1e-08' in finding.message


def test_rounded_copy_among_others() -> None:
    data = simulate(1, repetitions=1)

    def edit(z: Complex) -> None:
        z[:] = data.subjects[0].z * (1 + 1e-4)

    assert only(change(data, 5, edit), "duplicate_subject").subject == "S05"


@pytest.mark.parametrize(("factor", "words"), [(1000.0, "times the median magnitude"), (0.02, "times"), (1j, "deg")])
def test_odd_subject(factor: complex, words: str) -> None:
    def edit(z: Complex) -> None:
        z *= factor

    (finding,) = [f for f in warnings(change(simulate(1, subjects=15), 9, edit)) if f.id != "not_passive"]
    assert finding.id == "odd_subject"
    assert (finding.subject, finding.repetition) == ("S09", None)
    assert words in finding.message
    assert "check unit, sign and calibration" in finding.message


def test_odd_subject_of_another_grid() -> None:
    data = simulate(1)
    f = np.geomspace(20, 1000, 50)
    odd = Subject(name="X", frequency_hz=f, z=100 * fingertip(f, np.ones(8))[None], repetitions=("1",))
    assert only(replace(data, subjects=(*data.subjects, odd)), "odd_subject").subject == "X"


def test_bands_that_do_not_overlap_are_not_compared() -> None:
    data = simulate(1)
    f = np.geomspace(6e3, 1e4, 50)
    other = Subject(name="X", frequency_hz=f, z=100 * fingertip(f, np.ones(8))[None], repetitions=("1",))
    assert warnings(replace(data, subjects=(*data.subjects, other))) == []


def test_repetition_spread() -> None:
    def edit(z: Complex) -> None:
        z *= np.array([[0.8], [1.0], [1.3]])

    finding = only(change(simulate(1), 3, edit), "repetition_spread")
    assert finding.subject == "S03"
    assert "0.24 of |z| where 0.013 is usual" in finding.message
    assert "delete the one that went wrong" in finding.message


def test_phase_in_radians() -> None:
    data = replace(simulate(1), polar=True)
    subjects = [replace(s, z=np.abs(s.z) * np.exp(1j * np.deg2rad(np.angle(s.z)))) for s in data.subjects]
    finding = only(replace(data, subjects=tuple(subjects)), "phase_in_radians")
    assert "multiply it by 180/pi" in finding.message
    # From real and imaginary part it cannot be that.
    assert warnings(replace(data, subjects=tuple(subjects), polar=False)) == []


def test_damper_is_not_in_radians() -> None:
    f = np.geomspace(5, 5000, 101)
    rng = np.random.default_rng(1)
    z = 2 + 0.01 * gaussian(rng, 3, 101)
    data = Recordings(
        title="damper",
        unit="N s/m",
        network=None,
        source="",
        licence="",
        subjects=(Subject(name="A", frequency_hz=f, z=z, repetitions=("1", "2", "3")),),
        polar=True,
    )
    assert warnings(data) == []


def test_magnitude_in_db() -> None:
    data = replace(simulate(1), polar=True)
    subjects = [replace(s, z=20 * np.log10(1e3 * np.abs(s.z)) * s.z / np.abs(s.z)) for s in data.subjects]
    finding = only(replace(data, subjects=tuple(subjects)), "magnitude_in_db")
    assert "10^(dB/20)" in finding.message


def test_both_units_wrong() -> None:
    data = replace(simulate(1), polar=True)
    least = min(float(np.abs(s.z).min()) for s in data.subjects)
    subjects = [
        replace(s, z=20 * np.log10(1.5 * np.abs(s.z) / least) * np.exp(1j * np.deg2rad(np.angle(s.z))))
        for s in data.subjects
    ]
    found = warnings(replace(data, subjects=tuple(subjects)))
    assert {finding.id for finding in found} == {"phase_in_radians", "magnitude_in_db"}


@pytest.mark.parametrize(("exponent", "phase"), [(-1.0, -90.0), (0.0, 0.0), (0.5, 45.0)])
def test_bode_phase_of_a_power_law(exponent: float, phase: float) -> None:
    np.testing.assert_allclose(np.rad2deg(bode_phase(np.linspace(0.0, 5.9 * exponent, 60), 0.1)), phase, atol=1e-9)


def test_bode_phase_of_a_resonance() -> None:
    x = np.arange(-4, 4, 0.02)
    z = 1j * np.exp(x) + 0.5 + 1 / (1j * np.exp(x))
    np.testing.assert_allclose(bode_phase(np.log(np.abs(z)), 0.02), np.angle(z), atol=0.03)


# Notes, and small data


def test_notes_on_what_cannot_be_estimated() -> None:
    one_each = check_recordings(simulate(1, repetitions=1))
    assert [(finding.id, finding.severity) for finding in one_each] == [("one_repetition", "note")]
    assert "repeat the measurement" in one_each[0].message
    one = check_recordings(simulate(1, subjects=1))
    assert [(finding.id, finding.severity, finding.subject) for finding in one] == [("one_subject", "note", "S00")]
    assert "add subjects" in one[0].message
    assert check_recordings(simulate(1)) == ()


def test_warnings_come_first() -> None:
    def edit(z: Complex) -> None:
        z[0, 50] *= 3

    found = check_recordings(change(simulate(1, subjects=1, repetitions=1), 0, edit))
    assert [finding.id for finding in found] == ["outlier", "one_subject", "one_repetition"]


@pytest.mark.parametrize("points", range(1, 14))
def test_few_points(points: int) -> None:
    assert warnings(simulate(1, points=points)) == []


def test_no_subjects() -> None:
    empty = Recordings(title="", unit="N s/m", network=None, source="", licence="", subjects=())
    assert check_recordings(empty) == ()
    assert describe(empty)["frequency_hz"] is None


def test_describe() -> None:
    f = np.array([1.0, 2.0, 4.0])
    a = Subject(
        name="A",
        frequency_hz=f,
        z=np.array([[3 + 4j, 1, 2]]),
        repetitions=("1",),
        noise_sd=None,
        covariates={"age_y": 3.0},
    )
    b = Subject(name="B", frequency_hz=f[:2], z=np.array([[1j, 2], [0.5, 2]]), repetitions=("1", "2"))
    assert describe(
        Recordings(title="T", unit="ohm", network="r1", source="", licence="", subjects=(a, b), sha256="abc")
    ) == {
        "title": "T",
        "unit": "ohm",
        "network": "r1",
        "subjects": 2,
        "repetitions": [1, 2],
        "points": [2, 3],
        "frequency_hz": [1.0, 4.0],
        "magnitude": [0.5, 5.0],
        "covariates": ["age_y"],
        "sha256": "abc",
    }


@pytest.mark.skipif(not os.environ.get("BAYES_IMPEDANCE_REAL_DATA"), reason="BAYES_IMPEDANCE_REAL_DATA is not set")
@pytest.mark.parametrize(
    ("name", "notes"), [("battery_130", ["one_repetition"]), ("fuel_cell_1", ["one_subject", "one_repetition"])]
)
def test_real_data(name: str, notes: list[str]) -> None:
    found = check_recordings(read_recordings(Path(os.environ["BAYES_IMPEDANCE_REAL_DATA"]) / name))
    assert [finding.id for finding in found] == notes
