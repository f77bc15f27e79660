"""Frequencies in rad/s that are read as Hz are refused, those in kHz remarked on, unless Hz are declared."""

from pathlib import Path

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance, imported, table

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import Recordings, Subject, read_recordings, write_recordings
from bayes_impedance.recordings.frequency_scale import Band, band_of, seems

RADIANS = 2 * np.pi * FREQUENCY


def dataset(folder: Path, frequency_hz: np.ndarray, unit: str = "N s/m", **said: str) -> Path:
    one = Subject(name="A", frequency_hz=frequency_hz, z=impedance()[None], repetitions=("1",))
    whole = {"title": "t", "network": None, "source": "", "licence": "", **said}
    return write_recordings(Recordings(unit=unit, subjects=(one,), **whole), folder)  # type: ignore[arg-type]


@pytest.mark.parametrize("frequency", [RADIANS, np.round(RADIANS, 2)])
def test_radians_are_named(frequency: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, unit = dataset(tmp_path / "in", frequency), "rad/s"
    assert main(["check", str(folder)]) == 2
    assert f"--frequency-unit {unit}" in capsys.readouterr().err
    file, out = str(folder / "recordings.csv"), str(tmp_path / "out")
    assert main(["import", file, "-o", out]) == 2
    assert f"these seem to be in {unit}; give --frequency-unit {unit}" in capsys.readouterr().err
    assert not Path(out).exists()
    np.testing.assert_allclose(imported(tmp_path, file, "--frequency-unit", unit).frequency_hz, FREQUENCY, rtol=2e-4)


def test_slow_recordings_are_remarked_on_and_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Specimens are measured from 0.005 Hz on purpose."""
    folder = dataset(tmp_path / "in", FREQUENCY / 1e3)
    assert main(["check", str(folder)]) == 0
    assert "may be in kHz; import the file with --frequency-unit kHz" in " ".join(capsys.readouterr().out.split())
    file = str(folder / "recordings.csv")
    one = imported(tmp_path, file)
    assert "may be in kHz; give --frequency-unit kHz" in " ".join(capsys.readouterr().out.split())
    np.testing.assert_allclose(one.frequency_hz, FREQUENCY / 1e3)
    assert "kHz" not in " ".join(
        read_recordings(dataset(tmp_path / "said", FREQUENCY / 1e3, frequency_unit="Hz")).warnings
    )


def test_who_declares_hertz_is_believed(tmp_path: Path) -> None:
    assert main(["check", str(dataset(tmp_path / "in", RADIANS, frequency_unit="Hz"))]) == 0
    one = imported(tmp_path, tmp_path / "in" / "recordings.csv", "--frequency-unit", "Hz")
    np.testing.assert_allclose(one.frequency_hz, RADIANS)


def test_batteries_are_slow(tmp_path: Path) -> None:
    assert main(["check", str(dataset(tmp_path, FREQUENCY / 1e3, "ohm"))]) == 0


def test_bands_that_nobody_chose_are_rarely_rounded() -> None:
    rng = np.random.default_rng(1)
    ends = np.exp(rng.uniform(0, 10, size=(20_000, 2)))
    assert sum(seems(Band(100, *sorted(pair)), "N s/m") == "rad/s" for pair in ends.tolist()) < 20


@pytest.mark.parametrize("step", [1.0, 0.25, 1.953125])
def test_lines_of_a_spectrum_are_hertz(step: float) -> None:
    assert seems(band_of(step * np.arange(5, 205)), "N s/m") is None


def written(frequency_hz: np.ndarray, digits: int) -> np.ndarray:
    """Read from a file that holds so many digits."""
    return np.array([float(f"{f:.{digits}g}") for f in frequency_hz])


def grids(rng: np.random.Generator, kind: str) -> np.ndarray:
    """A grid as people and instruments choose it, in Hz."""
    n = int(rng.integers(20, 400))
    if kind == "three digits":
        low = float(f"{10 ** rng.uniform(-1, 2):.3g}")
        return np.geomspace(low, float(f"{low * 10 ** rng.uniform(0.7, 3):.3g}"), n)
    if kind == "octaves":
        return 1000 * 2.0 ** (np.arange(-int(rng.integers(10, 25)), int(rng.integers(4, 12))) / 3)
    rate = rng.choice([1000.0, 2048, 2500, 8000, 10_000, 44_100, 48_000, 51_200, 65_536, 102_400])
    samples = 2 ** int(rng.integers(9, 17)) if kind == "spectrum" else int(rng.integers(100, 20_000))
    first = int(rng.integers(1, 20))
    return rate / samples * np.arange(first, first + n)


@pytest.mark.parametrize("kind", ["three digits", "octaves", "spectrum", "any number of samples"])
def test_grids_in_hertz_are_not_doubted(kind: str) -> None:
    rng = np.random.default_rng(2)
    told = [seems(band_of(written(grids(rng, kind), int(rng.integers(4, 17)))), "ohm") for _ in range(2000)]
    assert told.count("rad/s") <= 1


@pytest.mark.parametrize(("kind", "digits", "least"), [("three digits", 7, 0.95), ("spectrum", 12, 0.99)])
def test_radians_of_bands_that_are_not_round_are_named(kind: str, digits: int, least: float) -> None:
    rng = np.random.default_rng(3)
    told = [seems(band_of(written(2 * np.pi * grids(rng, kind), digits)), "ohm") for _ in range(300)]
    assert told.count("rad/s") >= least * len(told)


@pytest.mark.parametrize("frequency", [np.geomspace(3.25, 1250, 60), 51_200 / 4096 * np.arange(3, 200)])
def test_radians_of_any_grid_are_refused_by_commands(
    frequency: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    s = 2j * np.pi * frequency
    z = 0.02 * s + 2 + 1000 / s
    one = Subject(name="A", frequency_hz=2 * np.pi * frequency, z=z[None], repetitions=("1",))
    folder = write_recordings(
        Recordings(unit="N s/m", subjects=(one,), title="t", network=None, source="", licence=""), tmp_path / "in"
    )
    assert main(["check", str(folder)]) == 2
    assert "these seem to be in rad/s" in capsys.readouterr().err


def test_the_unit_in_a_name_is_used(tmp_path: Path) -> None:
    columns = {"omega [rad/s]": RADIANS, "Re [N s/m]": impedance().real, "Im [N s/m]": impedance().imag}
    (tmp_path / "a.csv").write_text(table(columns), encoding="utf-8")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.csv").frequency_hz, FREQUENCY)
