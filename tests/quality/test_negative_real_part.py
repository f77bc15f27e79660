"""Negative real parts: what turns all points is refused, what a lag or a filter does is named and kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faulty_recordings import Complex, warnings
from lagged_recordings import LOADS, Chain, delayed, filtered_motion, recorded

from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.quality.curve_anomalies import suspect_units
from bayes_impedance.quality.negative_real_part import explain
from bayes_impedance.recordings.files import read_recordings, write_recordings
from bayes_impedance.recordings.phase_relation import excess_phase

SEEDS = (1, 2)


def _said(load: str, chain: Chain, seed: int, folder: Path) -> str:
    """All messages about a dataset that is written and read again."""
    data = read_recordings(write_recordings(recorded(load, chain, seed), folder))
    return " ".join(finding.message for finding in warnings(data))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("chain", [lambda s, z: -z, lambda s, z: -z * np.exp(s * 2e-5)], ids=["sign", "sign and lag"])
def test_a_wrong_sign_is_refused(load: str, chain: Chain, seed: int, tmp_path: Path) -> None:
    with pytest.raises(InputError, match='write sign = "passive negative"'):
        read_recordings(write_recordings(recorded(load, chain, seed), tmp_path))


@pytest.mark.parametrize("angle_deg", [-5, 5])
@pytest.mark.parametrize("load", ["finger", "oscillator", "skin", "two inertias"])
def test_a_wrong_sign_beside_a_small_angle_is_refused(load: str, angle_deg: int, tmp_path: Path) -> None:
    """Not of a load without damping: Re z is then positive, if the angle turns it so."""
    turned = recorded(load, lambda _, z: -z * np.exp(1j * np.deg2rad(angle_deg)))
    with pytest.raises(InputError, match='write sign = "passive negative"'):
        read_recordings(write_recordings(turned, tmp_path))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("load", LOADS)
def test_a_lag_is_named_with_its_size(load: str, seed: int, tmp_path: Path) -> None:
    data = read_recordings(write_recordings(recorded(load, delayed(1e-4), seed), tmp_path))
    for subject in data.subjects:
        found = excess_phase(subject.frequency_hz, subject.mean)
        assert found is not None
        assert found.cause == "lag"
        assert found.size == pytest.approx(1e-4, rel=0.15)
    text = " ".join(finding.message for finding in warnings(data))
    assert "grows with frequency" in text
    assert "the motion is about" in text
    assert "bayes-impedance diagnose" in text
    assert "sign" not in text


@pytest.mark.parametrize("corner", [20.0, 300.0])
@pytest.mark.parametrize("load", ["oscillator", "two inertias", "mass"])
def test_a_filter_is_not_taken_for_a_wrong_sign(load: str, corner: float, tmp_path: Path) -> None:
    """At up to all frequencies Re z is negative."""
    text = _said(load, filtered_motion(corner), 1, tmp_path)
    assert "phase and magnitude belong together, so that the sign is right" in text
    assert "filter" in text or "low-pass" in text
    assert "bayes-impedance diagnose" in text


@pytest.mark.parametrize("load", ["finger", "spring"])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s, z: s / z, "divided by jw, as accelerance"),
        (lambda s, z: z / s, "multiplied by jw, as apparent mass"),
    ],
)
def test_another_quantity_is_pointed_at(load: str, change: Chain, said: str, tmp_path: Path) -> None:
    assert said in _said(load, change, 1, tmp_path)


@pytest.mark.parametrize(("change", "said"), [(2, "divided by the square"), (-2, "multiplied by the square")])
def test_exchanged_channels_are_named(change: int, said: str, tmp_path: Path) -> None:
    """Of acceleration and of displacement; behind a filter and a lag the same load is not called exchanged."""
    text = _said("oscillator", lambda s, z: s**change / z, 1, tmp_path)
    assert said in text
    assert "force and " + ("acceleration" if change > 0 else "displacement") + " are exchanged" in text


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("corner", [1.0, 20.0, 300.0, 20_000.0])
@pytest.mark.parametrize("late", [0.0, 1e-5])
def test_a_filter_is_not_called_an_exchange(load: str, corner: float, late: float) -> None:
    for chain in (filtered_motion(corner), lambda s, z: z * s / (s + 2 * np.pi * corner)):
        one = recorded(load, lambda s, z, chain=chain: delayed(late)(s, chain(s, z)), subjects=1).subjects[0]  # type: ignore[misc]
        assert explain(one.frequency_hz, one.mean).cause != "exchange"


@pytest.mark.parametrize("load", LOADS)
def test_conjugates_are_refused_unless_their_convention_is_declared(
    load: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recordings(recorded(load, lambda s, z: z.conj(), 1), tmp_path)
    assert main(["check", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "complex conjugates" in said
    assert 'convention = "exp(-jwt)"' in said
    metadata = tmp_path / "dataset.toml"
    described = metadata.read_text(encoding="utf-8")
    metadata.write_text(described + 'convention = "exp(-jwt)"\n', encoding="utf-8")
    turned = read_recordings(tmp_path)
    assert "conjugates of z were taken" in " ".join(turned.warnings)
    true = recorded(load, lambda s, z: z, 1)
    np.testing.assert_allclose(np.abs(np.angle(turned.subjects[0].z / true.subjects[0].z)), 0.0, atol=0.2)
    again = read_recordings(write_recordings(turned, tmp_path / "again"))
    np.testing.assert_array_equal(again.subjects[0].z, turned.subjects[0].z)
    metadata.write_text(described + 'convention = "exp(+jwt)"\n', encoding="utf-8")
    np.testing.assert_array_equal(read_recordings(tmp_path).subjects[0].z, turned.subjects[0].z.conj())


def test_one_conjugated_person_of_many_is_not_refused(tmp_path: Path) -> None:
    data = recorded("finger", lambda s, z: z, 1)
    one = replace(data.subjects[0], z=data.subjects[0].z.conj())
    write_recordings(replace(data, subjects=(one, *data.subjects[1:])), tmp_path)
    assert len(read_recordings(tmp_path)) == len(data) > 2


def test_an_unknown_convention_is_refused(tmp_path: Path) -> None:
    write_recordings(recorded("finger", lambda s, z: z, 1), tmp_path)
    metadata = tmp_path / "dataset.toml"
    metadata.write_text(metadata.read_text(encoding="utf-8") + 'convention = "engineers"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r'convention "engineers" is unknown'):
        read_recordings(tmp_path)


@pytest.mark.parametrize("load", ["oscillator", "two inertias", "mass"])
def test_an_error_of_the_phase_is_named(load: str, tmp_path: Path) -> None:
    text = _said(load, lambda s, z: z * np.exp(1j * np.pi / 6), 1, tmp_path)
    assert "30 degrees at every frequency" in text or "31 degrees" in text or "29 degrees" in text


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("chain", [lambda s, z: z, lambda s, z: 1.3 * z, lambda s, z: 1 / z])
def test_what_is_passive_gives_no_finding(load: str, chain: Chain, seed: int, tmp_path: Path) -> None:
    """Also an error of the gain; and noise around zero on a mass is no negative real part."""
    assert _said(load, chain, seed, tmp_path) == ""


def test_one_turned_recording_among_others(tmp_path: Path) -> None:
    def turned(s: Complex, z: Complex) -> Complex:
        return -z

    data = recorded("finger", turned, subjects=1, repetitions=1)
    subject = data.subjects[0]
    assert explain(subject.frequency_hz, subject.z[0]).cause == "sign"


def test_few_points_are_refused_only_if_nearly_all_are_negative(tmp_path: Path) -> None:
    head = "subject,repetition,frequency_hz,z_re,z_im\n"
    for negative, refused in ((5, True), (4, False)):
        rows = "".join(f"A,1,{10 + i},{-1 if i < negative else 1},3\n" for i in range(5))
        (tmp_path / "recordings.csv").write_text(head + rows)
        if refused:
            with pytest.raises(InputError, match="negative real part"):
                read_recordings(tmp_path)
        else:
            assert (read_recordings(tmp_path).subjects[0].z.real < 0).sum() == negative


def test_a_narrow_band_says_nothing() -> None:
    f = np.linspace(10.0, 39.0, 50)
    assert excess_phase(f, 2j * np.pi * f) is None


@pytest.mark.parametrize("load", LOADS)
def test_channels_that_were_exchanged_are_no_conjugates(load: str) -> None:
    """Acceleration over the integral of force, s^2/z: the phase is beyond 180 degrees, and is written as negative."""
    exchanged = recorded(load, lambda s, z: s**2 / z)
    assert "phase_conjugated" not in suspect_units(exchanged.subjects, polar=False)
    conjugated = recorded(load, lambda s, z: (s**2 / z).conj())
    assert suspect_units(conjugated.subjects, polar=False) == ("phase_conjugated",)
