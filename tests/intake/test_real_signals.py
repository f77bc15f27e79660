"""Real recordings: a motor bench under multisines, a hammered beam, an analyser's export with coherence."""

from pathlib import Path

import numpy as np
import pytest
from known_impedance import spectra_written

from bayes_impedance.commands.cli import main

LOW_PASS_HZ = 20.39
"""Corner of the bench's velocity channel, found beside these tests from the ratio of its two channels."""


def motor(real_data: Path, kind: str, motion: str, out: Path) -> tuple[np.ndarray, np.ndarray, dict[str, str]]:
    """Frequencies, impedance (of current in place of torque), and what is noted."""
    file = real_data / "motor_bench" / f"Multisine{kind}.mat"
    assert main(["import", str(file), "-o", str(out), "--force", "iq_adx[N m]", "--motion", motion, "--overwrite"]) == 0
    return spectra_written(out)


@pytest.mark.parametrize(("kind", "lines", "band"), [("TypeA", 240, (11, 250)), ("TypeB", 60, (13, 249))])
def test_both_channels_of_the_motor_bench_are_one_load(
    real_data: Path, kind: str, lines: int, band: tuple[int, int], tmp_path: Path
) -> None:
    frequency, by_angle, _ = motor(real_data, kind, "theta_mx[rad]", tmp_path / "out")
    other, by_velocity, _ = motor(real_data, kind, "omega_max[rad/s]", tmp_path / "out")
    np.testing.assert_allclose(frequency, other)
    assert frequency.size == lines
    assert (frequency[0], frequency[-1]) == pytest.approx(band)
    ratio = by_angle / by_velocity  # of the velocity channel to the angle's derivative
    low_pass = 1 / (1 + 1j * frequency / LOW_PASS_HZ)
    assert np.median(np.abs(ratio / low_pass - 1)) < 0.002
    assert np.mean(np.abs(ratio / low_pass)) == pytest.approx(1.0, abs=0.002)


def test_distortion_of_the_motor_bench(real_data: Path, tmp_path: Path) -> None:
    _, _, noted = motor(real_data, "TypeB", "theta_mx[rad]", tmp_path / "out")
    # Measured independently: 19 and 5.5.
    assert float(noted["odd_distortion_of_motion"]) == pytest.approx(19, rel=0.1)
    assert float(noted["even_distortion_of_motion"]) == pytest.approx(5.5, rel=0.1)
    assert float(noted["periods"]) == 19  # the first one had not settled


def test_the_hammered_beam_is_nearly_a_driving_point(real_data: Path, tmp_path: Path) -> None:
    file = real_data / "hammer_beam" / "acceleration.lvm"
    assert main(["import", str(file), "-o", str(tmp_path / "out"), "--band", "20", "2000"]) == 0
    frequency, z, noted = spectra_written(tmp_path / "out")
    assert np.mean((1 / z).real < 0) == pytest.approx(0.02, abs=0.005)
    assert frequency[0] == pytest.approx(20.99, abs=0.01)
    assert noted["hits"] == "1.0"


def test_the_coherence_of_an_analyser_is_kept(real_data: Path, tmp_path: Path) -> None:
    import scipy.io

    file = real_data / "coherence_case" / "case1.mat"
    columns = ["frequency=Freq_domain", "complex=Hf_chan_2", "coherence=Hf_coh_chan_2"]
    options = ["--columns", *columns, "--form", "accelerance", "--averages", "10"]
    assert main(["import", str(file), "-o", str(tmp_path / "out"), *options]) == 0
    content = scipy.io.loadmat(file, variable_names=["Freq_domain", "Hf_chan_2", "Hf_coh_chan_2"])
    f, h, coherence = (content[name].ravel()[1:] for name in ("Freq_domain", "Hf_chan_2", "Hf_coh_chan_2"))
    frequency, z, _ = spectra_written(tmp_path / "out")
    np.testing.assert_allclose(frequency, f, rtol=1e-7)
    np.testing.assert_allclose(z, 2j * np.pi * f / h, rtol=1e-6)
    kept = np.loadtxt(tmp_path / "out" / "coherence.csv", delimiter=",", skiprows=1, usecols=3)
    np.testing.assert_allclose(kept, coherence, rtol=1e-6)
