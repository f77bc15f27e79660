"""Signals of every excitation to impedance by the command, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from known_impedance import imported
from simulated_signals import Multisine, mobility_at, random_response

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import read_recordings
from bayes_impedance.recordings.circumstances import OF_THE_ESTIMATE

SINES = Multisine()
Signals = dict[str, np.ndarray]


def write(file: Path, signals: Signals, separator: str = ",") -> Path:
    """Columns of text with all digits."""
    rows = zip(*(np.asarray(s, dtype=float).ravel().tolist() for s in signals.values()), strict=True)
    lines = [separator.join(signals), *(separator.join(map(repr, row)) for row in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


@pytest.fixture
def periodic(tmp_path: Path) -> Path:
    """Six periods of force and displacement at 2 kHz."""
    force, x = SINES.periods(6, 1, noise=1e-3)
    t = np.arange(force.size) / SINES.rate_hz
    return write(tmp_path / "P3.csv", {"time (s)": t, "F [N]": force, "x [mm]": 1e3 * x})


def test_a_file_with_one_force_and_one_motion_needs_no_option(
    periodic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    subject = imported(tmp_path, periodic)
    np.testing.assert_allclose(subject.frequency_hz, np.array(SINES.lines) * 2.0, rtol=1e-9)
    np.testing.assert_allclose(subject.z[0], SINES.impedance(), rtol=0.02)
    assert subject.noise_sd is not None
    said = capsys.readouterr().out
    for words in ("taken for periodic", "period of 1000 samples (0.5 s)", "48 lines are excited", "force is"):
        assert words in said
    noted = (tmp_path / "imported" / "repetitions.csv").read_text(encoding="utf-8").splitlines()
    assert noted[0].startswith("subject,repetition,periods,realisations")
    assert noted[1].startswith("P3,1,6.0,1.0")
    assert set(noted[0].split(",")) - {"subject", "repetition"} <= OF_THE_ESTIMATE
    assert subject.circumstances == {}


def test_sensitivities_signs_and_rates(tmp_path: Path) -> None:
    force, x = SINES.periods(4, 1)
    acceleration = np.real(np.fft.ifft(np.fft.fft(x[0]) * (2j * np.pi * np.fft.fftfreq(1000, 1 / 2000)) ** 2))
    volts = {"a": force.ravel() * 22.4e-3, "b": -np.tile(acceleration, 4) / 9.80665 * 10.2e-3}
    file = write(tmp_path / "v.csv", volts, ";")
    channels = ("--force", "a@22.4 mV/N", "--motion", "-b@10.2 mV/g", "--sampling-rate", 2000)
    np.testing.assert_allclose(imported(tmp_path, file, *channels).z[0], SINES.impedance(), rtol=1e-7)
    other = ("--force", "a@44.642857142857146 N/V", "--motion", "b@10.2 mV/g", "--negated", "--sampling-rate", 2000)
    np.testing.assert_allclose(imported(tmp_path, file, *other).z[0], SINES.impedance(), rtol=1e-7)


def test_torque_and_angle(tmp_path: Path) -> None:
    force, x = SINES.periods(4, 1)
    file = write(
        tmp_path / "r.csv", {"t": np.arange(force.size) / 2000, "T [N m]": force, "angle [deg]": np.rad2deg(x)}
    )
    assert main(["import", str(file), "-o", str(tmp_path / "out")]) == 0
    recordings = read_recordings(tmp_path / "out")
    assert recordings.unit == "N m s/rad"
    np.testing.assert_allclose(recordings.subjects[0].z[0], SINES.impedance(), rtol=1e-7)


def test_realisations_are_put_together(tmp_path: Path) -> None:
    for k in range(4):
        force, x = SINES.periods(3, k, noise=1e-3, cubic=1e10)
        write(tmp_path / f"A_1_r{k}.csv", {"F [N]": force, "x [m]": x})
    pattern = r"(?P<subject>\w)_(?P<repetition>\d)_r(?P<realisation>\d)"
    files = sorted(tmp_path.glob("A*.csv"))
    subject = imported(
        tmp_path, *files, "--subject-from-name", pattern, "--sampling-rate", 2000, "--period", 0.5, "--drop-periods", 0
    )
    assert subject.z.shape == (1, 48)
    noted = (tmp_path / "imported" / "repetitions.csv").read_text(encoding="utf-8").splitlines()
    facts = dict(zip(noted[0].split(","), noted[1].split(","), strict=True))
    assert facts["realisations"] == "4.0"
    assert 6 <= float(facts["noise_degrees_of_freedom"]) < 54  # its own, and what neighbours add
    assert float(facts["scatter_of_realisations_over_noise"]) > 3


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv", "local polynomial"])
def test_noise(estimator: str, tmp_path: Path) -> None:
    force, velocity = random_response(40_000, 8000.0, 0.01, seed=1)
    np.savez(tmp_path / "n.npz", force=force, velocity=velocity, fs=8000.0)
    subject = imported(
        tmp_path, tmp_path / "n.npz", "--force", "force[N]", "--motion", "velocity[m/s]", "--estimator", estimator,
        "--band", 100, 1000,
    )  # fmt: skip
    assert subject.noise_sd is not None
    truth = 1 / mobility_at(subject.frequency_hz, 8000.0)
    error = np.abs(subject.z[0] - truth) / subject.noise_sd[0]
    # |error|^2/sd^2 has mean 2 for a normal error; with the t of eight averages or more it is below 3.
    assert 1.0 < np.mean(error**2) < 3.5
    assert subject.frequency_hz[0] >= 100
    assert subject.frequency_hz[-1] <= 1000


def test_hits_in_one_record_and_a_double_one_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng, rate = np.random.default_rng(1), 8000.0
    t = np.arange(40_000)
    force = sum(
        s * np.exp(-(((t - p) / 3.0) ** 2)) for p, s in ((3000, 1), (11000, 2), (19000, 1.5), (19100, 1), (27000, 1))
    )
    force = force + 1e-5 * rng.normal(size=t.size)
    from scipy.signal import lfilter
    from simulated_signals import sampled_mobility

    velocity = lfilter(*sampled_mobility(rate), force) + 1e-6 * rng.normal(size=t.size)
    np.savez(tmp_path / "h.npz", force=force, velocity=velocity, fs=rate)
    channels = ("--force", "force[N]", "--motion", "velocity[m/s]", "--segment", 0.5, "--band", 20, 800)
    subject = imported(tmp_path, tmp_path / "h.npz", *channels)
    np.testing.assert_allclose(subject.z[0], 1 / mobility_at(subject.frequency_hz, rate), rtol=0.01)
    assert "3 hits of 0.5 s are used; left out: 1 hit twice" in capsys.readouterr().out
    assert (tmp_path / "imported" / "coherence.csv").exists()
    whole = [str(part) for part in channels if part not in ("--segment", 0.5)]
    assert main(["import", str(tmp_path / "h.npz"), *whole, "-o", str(tmp_path / "out")]) == 2
    assert "if it holds several, give the length of each in seconds by --segment" in capsys.readouterr().err


FORCE, X = SINES.periods(4, 1)
GOOD: Signals = {"F [N]": FORCE, "x [m]": X}
TIME = np.arange(FORCE.size) / 2000.0
UNEVEN = np.where(TIME > 1.0, TIME * 1.5, TIME)
REFUSED = {
    "no rate": (GOOD, (), "sampling rate is not known"),
    "uneven times": ({"t": UNEVEN, **GOOD}, (), "not even steps"),
    "no unit": ({"a": FORCE, "b": X}, ("--force", "a", "--motion", "b[m]"), "has no unit"),
    "wrong unit": (GOOD, ("--force", "F [N][kg]", "--motion", "x [m]"), "neither of a force nor of a motion"),
    "two forces": (GOOD, ("--force", "F [N]", "--motion", "F [N]"), "but force and motion"),
    "mixed": ({"F [N]": FORCE, "a [rad]": X}, ("--sampling-rate", "2000"), "torque and angle, are needed"),
    "one channel only": ({"a": FORCE, "b": X}, ("--force", "a[N]"), "force and motion are not clear"),
    "no such channel": (GOOD, ("--force", "G[N]", "--motion", "x [m]"), "there is no such column"),
    "sensitivity": (GOOD, ("--force", "F [N]@3 apples", "--motion", "x [m]"), "does not lead to a force"),
    "constant": ({"t": TIME, "F [N]": FORCE * 0, "x [m]": X}, (), "never changes"),
    "gap": ({"t": TIME, "F [N]": np.where(TIME == 0.5, np.nan, FORCE.ravel()), "x [m]": X}, (), "row 1002"),
    "period": ({"t": TIME, **GOOD}, ("--period", "0.00051"), "must be a whole number"),
    "long period": ({"t": TIME, **GOOD}, ("--period", "1.5"), "1 whole periods"),
    "all dropped": ({"t": TIME, **GOOD}, ("--period", "0.5", "--drop-periods", "3"), "must remain"),
    "not periodic": (
        {"t": TIME, "F [N]": np.random.default_rng(1).normal(size=4000), "x [m]": X},
        ("--excitation", "periodic"),
        "no period was found",
    ),
    "short for segments": ({"t": TIME, **GOOD}, ("--excitation", "noise", "--segment", "9"), "too few for segments"),
    "empty band": ({"t": TIME, **GOOD}, ("--band", "900", "950"), "0 usable frequencies"),
    "clipped": (
        {"t": TIME, "F [N]": np.clip(FORCE, None, 0.5 * FORCE.max()), "x [m]": X},
        ("--excitation", "noise"),
        "is overloaded",
    ),
    "no hit": ({"t": TIME, **GOOD}, ("--excitation", "hammer", "--segment", "1.9"), "no hit can be used"),
    "rate": ({"t": TIME, **GOOD}, ("--sampling-rate", "-1"), "not a number above zero"),
    "overlap": ({"t": TIME, **GOOD}, ("--overlap", "1"), "not a number from 0"),
    "drop": ({"t": TIME, **GOOD}, ("--drop-periods", "few"), "not a whole number"),
    "turned band": ({"t": TIME, **GOOD}, ("--band", "50", "20"), "below its upper end"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_signals_that_cannot_be_used_are_refused(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    signals, options, sentence = REFUSED[fault]
    file = write(tmp_path / "s.csv", signals)
    assert main(["import", str(file), "-o", str(tmp_path / "out"), *options]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_the_same_from_python(periodic: Path, tmp_path: Path) -> None:
    from bayes_impedance import ImportSettings, import_recordings

    subject = imported(tmp_path, periodic)
    found = import_recordings([periodic], ImportSettings(title="mine"))
    assert found.recordings.title == "mine"
    np.testing.assert_array_equal(found.recordings.subjects[0].z, subject.z)
    degrees = found.spectra[0].degrees_of_freedom
    assert degrees is not None
    assert 10 < degrees < 90  # its own, and what eight neighbours add
    assert np.shares_memory(found.spectra[0].z, found.recordings.subjects[0].z)  # each recording is kept once
