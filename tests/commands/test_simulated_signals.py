"""``simulate --signals``: volts from which ``import`` finds the persons and the rig again."""

import csv
import json
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
from simulated_signals import share_within

from bayes_impedance.commands.cli import main
from bayes_impedance.commands.simulate_signals import simulate_signals, without_noise
from bayes_impedance.intake.simulated_rig import SimulatedRig
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.recordings import Recordings, read_recordings

FREQUENCY = np.geomspace(50.0, 5000.0, 16)
SMALL = ["--subjects", "2", "--repetitions", "2", "--points", "16", "--band", "50", "5000"]


def imported(words: list[str], out: Path) -> Recordings:
    assert main(["import", *words, "-o", str(out)]) == 0
    return read_recordings(out).in_memory()


def truth(n_subjects: int, n_repetitions: int, seed: int) -> np.ndarray:
    """Impedances, shape (N, J, F)."""
    simulation = without_noise(FINGERTIP, n_subjects, n_repetitions, FREQUENCY, seed)
    return np.array([one.z for one in simulation.recordings.subjects])


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_the_command_that_is_told_imports_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--signals", "-o", str(tmp_path / "raw"), "--seed", "4", *SMALL]) == 0
    command = capsys.readouterr().out.splitlines()[-1].partition("to import them: ")[2]
    words = shlex.split(command)
    assert words[:2] == ["bayes-impedance", "import"]
    out = tmp_path / "dataset"
    recordings = imported(words[2 : words.index("-o")], out)
    z = truth(2, 2, 4)
    assert [one.z.shape for one in recordings.subjects] == [(2, 16)] * 2
    errors = np.abs(np.array([one.z for one in recordings.subjects]) / z - 1)
    assert np.median(errors) < 0.02
    assert errors.max() < 0.1
    rig = tomllib.loads((out / "rig.toml").read_text(encoding="utf-8"))
    true = json.loads((tmp_path / "raw" / "rig_truth.json").read_text(encoding="utf-8"))
    names = ("gain", "delay_s", "mass_kg", "damper", "stiffness", "mount")
    for parameter, name in zip(rig["parameters"], names, strict=True):
        assert abs(parameter["mean"] - true[name]) < 5 * parameter["sd"]
    with (out / "repetitions.csv").open(encoding="utf-8", newline="") as stream:
        assert {row["periods_averaged"] for row in csv.DictReader(stream)} == {"5.0"}  # as in the paper


def test_without_noise_the_chain_is_exact_to_single_precision(tmp_path: Path) -> None:
    words = simulate_signals(tmp_path / "raw", FINGERTIP, 2, 1, FREQUENCY, 3, rig=SimulatedRig(noise_v=0.0))
    recordings = imported(words, tmp_path / "dataset")
    # Besides the samples' 6e-8, what has not settled after five periods, of which `simulated_rig` leaves 4e-6.
    found = np.array([one.z for one in recordings.subjects])
    assert np.abs(found / truth(2, 1, 3) - 1).max() < 1e-4


def test_intervals_of_calibrated_signals_hold_the_truth(tmp_path: Path) -> None:
    """Noise of the recording and error of the calibration together; five periods of each step: eight degrees."""
    share = []
    for seed in range(6):
        words = simulate_signals(tmp_path / f"raw{seed}", FINGERTIP, 3, 1, FREQUENCY, seed)
        out = tmp_path / f"dataset{seed}"
        recordings = imported(words, out)
        with (out / "calibration_sd.csv").open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        common = np.array([[float(row["calibration_sd_re"]), float(row["calibration_sd_im"])] for row in rows])
        for one, z, of_rig in zip(recordings.subjects, truth(3, 1, seed), common.reshape(3, -1, 2), strict=True):
            assert one.noise_sd is not None
            sd = np.hypot(one.noise_sd[0], np.mean(of_rig, axis=1))
            share.append(share_within(one.z[0], z[0], sd, 8.0))
    # 576 parts: the standard deviation of the share is 0.9 %.
    assert 0.92 < np.mean(share) < 0.98


def test_subtraction_leaves_gain_and_mount(tmp_path: Path) -> None:
    words = simulate_signals(tmp_path / "raw", FINGERTIP, 2, 1, FREQUENCY, 3)
    first, last = words.index("--known-load"), words.index("--force")
    unloaded = words[first + 1].removeprefix("open:")
    recordings = imported([*words[:first], "--unloaded", unloaded, *words[last:]], tmp_path / "dataset")
    ratio = np.array([one.z[0] for one in recordings.subjects]) / truth(2, 1, 3)[:, 0]
    low = FREQUENCY < 500
    np.testing.assert_allclose(np.abs(ratio[:, low]), SimulatedRig().gain, rtol=0.02)


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name, seed in (("a", "7"), ("b", "7"), ("c", "8")):
        assert main(["simulate", "--signals", "-o", str(tmp_path / name), "--seed", seed, *SMALL]) == 0
    a, b, c = (files_of(tmp_path / name) for name in "abc")
    assert a == b
    assert a.keys() == c.keys()
    assert all(a[name] != c[name] for name in a)
    assert sum(name.endswith(".npz") for name in a) == 4 + 3


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--noise", "0.01"], "--noise is that of spectra"),
        (["--band", "5", "20000"], "end it at a quarter"),
        (["--subjects", "71", "--points", "401"], "simulate fewer"),
        (["--band", "0.001", "10"], "simulate fewer"),
    ],
)
def test_what_cannot_be_simulated_is_refused(
    options: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "--signals", "-o", str(tmp_path / "raw"), *options]) == 2
    message = capsys.readouterr().err
    assert sentence in message
    assert len(message.splitlines()) == 1
    assert not (tmp_path / "raw").exists()


def test_other_recordings_are_not_mixed_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = tmp_path / "raw"
    assert main(["simulate", "--signals", "-o", str(raw), *SMALL]) == 0
    before = files_of(raw)
    assert main(["simulate", "--signals", "-o", str(raw), *SMALL, "--subjects", "1"]) == 2
    assert "is not of this simulation" in capsys.readouterr().err
    assert files_of(raw) == before
    assert main(["simulate", "--signals", "-o", str(raw), *SMALL, "--seed", "2"]) == 0  # its own files are replaced
    assert files_of(raw).keys() == before.keys()
