"""Anomalies of whole curves: copies, odd subjects, wrong units, spread of repetitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faulty_recordings import Complex, change, fingertip, gaussian, only, simulate, warnings

from bayes_impedance.quality import curve_anomalies
from bayes_impedance.quality.curve_anomalies import COPY_CONTRAST, bode_phase, duplicates
from bayes_impedance.recordings.files import Recordings, Subject


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
    assert "delete the faulty one" in finding.message


def test_phase_in_radians() -> None:
    data = replace(simulate(1), polar=True)
    subjects = [replace(s, z=np.abs(s.z) * np.exp(1j * np.deg2rad(np.angle(s.z)))) for s in data.subjects]
    finding = only(replace(data, subjects=tuple(subjects)), "phase_in_radians")
    assert "multiply it by 180/pi" in finding.message
    # From real and imaginary part it cannot be that, but these do not belong together.
    only(replace(data, subjects=tuple(subjects), polar=False), "kramers_kronig")


@pytest.mark.parametrize("polar", [True, False])
def test_conjugated_phase(polar: bool) -> None:
    data = replace(simulate(1), polar=polar)
    turned = replace(data, subjects=tuple(replace(s, z=s.z.conj()) for s in data.subjects))
    assert "change the sign" in only(turned, "phase_conjugated").message
    assert warnings(data) == []


@pytest.mark.parametrize(
    ("turned", "words"), [((0, 1, 2), 'subject "S05": '), ((1,), 'subject "S05", repetition "2": ')]
)
def test_one_conjugated_person_among_others(turned: tuple[int, ...], words: str) -> None:
    """The median person does not show it, and the mean phase of such a curve need not be unusual."""

    def edit(z: Complex) -> None:
        z[list(turned)] = z[list(turned)].conj()

    found = [f for f in warnings(change(simulate(1), 5, edit)) if f.id == "phase_conjugated"]
    assert [f.subject for f in found] == ["S05"]
    assert found[0].message.startswith(words)
    assert "change the sign of its imaginary part" in found[0].message


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


@pytest.mark.parametrize(("scatter", "asked"), [(0.05, 400), (0.05, 7), (3.0, 400)])
def test_copies_among_many_are_those_of_a_comparison_of_all_pairs(
    scatter: float, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if the nearest neighbours of a few are looked for, and where nobody resembles anybody."""
    monkeypatch.setattr(curve_anomalies, "_NEIGHBOURS_OF", asked)
    rng = np.random.default_rng(2)
    frequency, n = np.geomspace(10, 1000, 40), 60
    z = np.exp(scatter * (rng.normal(size=(n, 40)) + 1j * rng.normal(size=(n, 40))))
    for copy, of, error in ((7, 3, 0.0), (50, 3, 1e-4), (20, 41, 3e-4), (21, 42, 0.3)):
        z[copy] = z[of] * (1 + error * rng.normal(size=40))
    z[8] = z[9]
    z[8, 30] *= 1 + 2e-3  # they differ in one point alone
    people = [Subject(name=str(i), frequency_hz=frequency, z=own[None], repetitions=("1",)) for i, own in enumerate(z)]
    apart = np.sqrt(np.mean(np.abs(z[None] / z[:, None] - 1) ** 2, axis=-1)) + np.diag(np.full(n, np.inf))
    limit = COPY_CONTRAST * np.median(apart.min(axis=1))
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n) if apart[i, j] <= limit]
    assert {(3, 7), (3, 50), (20, 41), (8, 9)} <= set(pairs)
    seen: set[int] = set()
    firsts = [(i, j) for i, j in pairs if not (j in seen or seen.add(j))]
    found = duplicates(people)
    assert [(int(c.subject), int(c.other_subject)) for c in found] == firsts
    np.testing.assert_allclose([c.distance for c in found], [apart[i, j] for i, j in firsts], atol=1e-12)
