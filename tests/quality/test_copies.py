"""Copies of recordings are an error; recordings that are merely alike are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faulty_recordings import Complex, change, gaussian, simulate

from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.quality.copies import copies, require_distinct
from bayes_impedance.recordings.files import Recordings, Subject, write_recordings


def significant(z: Complex, digits: int) -> Complex:
    return np.vectorize(lambda one: complex(float(f"{one.real:.{digits}g}"), float(f"{one.imag:.{digits}g}")))(z)


def polar(z: Complex) -> Complex:
    return np.round(np.abs(z), 4) * np.exp(1j * np.deg2rad(np.round(np.rad2deg(np.angle(z)), 3)))


COPYING = {
    "exact": lambda z: z,
    "seven digits": lambda z: significant(z, 7),
    "four digits": lambda z: significant(z, 4),
    "decimals": lambda z: np.round(z, 5),
    "magnitude and phase": polar,
}


@pytest.mark.parametrize("copying", COPYING.values(), ids=COPYING.keys())
def test_a_copy_under_another_name_is_refused(copying) -> None:
    data = simulate(1)

    def edit(z: Complex) -> None:
        z[2] = copying(data.subjects[3].z[0])

    with pytest.raises(InputError, match="2 recordings are copies of one another") as caught:
        require_distinct(change(data, 7, edit))
    assert 'subjects "S03", "S07"' in str(caught.value)
    assert "keep one of them" in str(caught.value)


def test_copied_repetitions_are_named() -> None:
    def edit(z: Complex) -> None:
        z[2] = z[0]

    with pytest.raises(InputError, match='subject "S05", repetitions "1", "3"'):
        require_distinct(change(simulate(1), 5, edit))


@pytest.mark.long
def test_one_person_71_times_is_refused_by_every_command(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (one,) = simulate(1, subjects=1).subjects
    data = replace(simulate(1), subjects=tuple(replace(one, name=f"P{i:02d}") for i in range(71)))
    write_recordings(data, tmp_path / "data")
    with_output = (
        "run data",
        "fit data",
        "diagnose data",
        "compare data",
        "covariates data",
        "import data/recordings.csv",
    )
    several = "compare data --networks m1|r1 n1|r1"
    for command in ("check data", *(f"{words} -o out" for words in (*with_output, several))):
        words = command.split()
        assert main([str(tmp_path / word) if "data" in word or word == "out" else word for word in words]) == 2
        said = capsys.readouterr().err
        assert "71 recordings are copies of one another" in said
        assert "those of 2 more groups" in said
        assert '"P00", "P01"' in said
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("noise", [1e-3, 0.05])
def test_people_and_repetitions_are_no_copies(noise: float) -> None:
    data = simulate(2, noise=noise)
    coarse = tuple(replace(one, z=significant(one.z, 3)) for one in data.subjects)
    assert copies(data.subjects) == copies(coarse) == []


def test_numbers_of_few_digits_or_points_are_equal_by_chance() -> None:
    def subject(name: str, z: Complex, f: np.ndarray) -> Subject:
        return Subject(name=name, frequency_hz=f, z=z, repetitions=tuple(map(str, range(len(z)))))

    rng, f = np.random.default_rng(3), np.geomspace(5, 500, 20)
    quiet = (2 + 1j * f / 100) * (1 + 1e-6 * gaussian(rng, 4, 20))
    assert copies([subject("A", np.round(quiet, 1), f)]) == []
    assert copies([subject("A", np.tile(quiet[0, :5], (2, 1)), f[:5])]) == []
    assert copies([subject("A", np.full((2, 20), 9999.0 + 0j), f)]) == []
    assert len(copies([subject("A", np.tile(quiet[0], (2, 1)), f)])) == 1


def test_nobody_is_no_copy() -> None:
    empty = Recordings(title="T", unit="ohm", network=None, source="", licence="", subjects=())
    require_distinct(empty)
