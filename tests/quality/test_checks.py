"""Checks of recordings: clean data give no warning, and faults at single points are found where they were planted."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faulty_recordings import Complex, change, gaussian, only, simulate, warnings

from bayes_impedance.quality import point_anomalies
from bayes_impedance.quality.checks import check_recordings, describe
from bayes_impedance.recordings.files import Recordings, Subject, read_recordings

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
    assert f"1 point is far from its neighbours at {f:.4g} Hz" in finding.message
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


def test_zero_is_a_mark() -> None:
    def edit(z: Complex) -> None:
        z[2, 77] = 0

    assert only(change(simulate(1), 0, edit), "mark").repetition == "3"


def test_hum_in_all_recordings_is_one_finding() -> None:
    data = simulate(2)

    def edit(z: Complex) -> None:
        z[:, 67] *= 2

    for i in range(len(data)):
        data = change(data, i, edit)
    finding = only(data, "outlier")
    assert finding.subject is None
    assert "36 of 36 recordings" in finding.message
    assert "indicate a fault of the rig" in finding.message


def test_names_that_differ_in_case_only() -> None:
    data = simulate(1, subjects=5)
    renamed = replace(data.subjects[3], name="s_01")
    finding = only(replace(data, subjects=(*data.subjects[:3], renamed, data.subjects[4])), "subject_names")
    assert finding.message.startswith('subjects "S01" and "s_01" have names that differ only in case')


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
    assert "indicate a fault of the rig" in finding.message


def test_small_delay_of_the_rig_is_found_by_the_phase() -> None:
    data = simulate(1)
    tau = 2.5e-5
    late = [
        replace(subject, z=subject.z * np.exp(-2j * np.pi * subject.frequency_hz * tau)) for subject in data.subjects
    ]
    finding = only(replace(data, subjects=tuple(late)), "lag")
    assert finding.subject is None
    assert "the force were recorded" in finding.message
    (alone,) = (finding for finding in check_recordings(replace(data, subjects=(late[2],))) if finding.id == "lag")
    assert alone.message.startswith(f'subject "{late[2].name}": the phase differs')


# Notes, and small data


def test_notes_on_what_cannot_be_estimated() -> None:
    one_each = check_recordings(simulate(1, repetitions=1))
    assert [(finding.id, finding.severity) for finding in one_each] == [("one_repetition", "note")]
    assert "the noise is estimated from the roughness of the curves only; repeat" in one_each[0].message
    data = simulate(1, repetitions=1)
    known = [replace(subject, noise_sd=0.01 * np.abs(subject.z)) for subject in data.subjects]
    (note,) = check_recordings(replace(data, subjects=tuple(known)))
    assert "roughness" not in note.message
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
