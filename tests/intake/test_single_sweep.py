"""A force that sweeps once through the band is told from noise, hits and periodic signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.intake.single_sweep import is_single_sweep

RATE_HZ, N = 2048.0, 20_480
TIME = np.arange(N) / RATE_HZ


def sweep(low: float, high: float, log: bool) -> np.ndarray:
    duration = N / RATE_HZ
    if log:
        rate = np.log(high / low)
        return np.sin(2 * np.pi * low * duration / rate * np.expm1(TIME / duration * rate))
    return np.sin(2 * np.pi * (low * TIME + (high - low) * TIME**2 / (2 * duration)))


@pytest.mark.parametrize("log", [True, False])
@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize(("low", "high"), [(5.0, 800.0), (20.0, 200.0)])
@pytest.mark.parametrize("silence", [0, 2000])
def test_a_sweep_is_one(log: bool, down: bool, low: float, high: float, silence: int) -> None:
    force = sweep(low, high, log)[:: -1 if down else 1] + 0.01 * np.random.default_rng(1).normal(size=N)
    assert is_single_sweep(np.concatenate([np.zeros(silence), force, np.zeros(silence)]))


def test_other_forces_are_none() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        white = rng.normal(size=N)
        assert not is_single_sweep(white)
        assert not is_single_sweep(np.cumsum(white))
        assert not is_single_sweep(white * (np.sin(2 * np.pi * TIME) > 0))  # bursts
        assert not is_single_sweep(np.where(rng.random(N) < 5e-4, white, 0.0))  # hits
        lines = rng.integers(5, 800, 60)
        assert not is_single_sweep(np.sin(2 * np.pi * np.outer(TIME, lines) + rng.uniform(0, 6.28, 60)).sum(axis=1))
    assert not is_single_sweep(np.sin(2 * np.pi * 50 * TIME))
    assert not is_single_sweep(np.tile(sweep(5.0, 800.0, True)[::20], 20))  # repeated
    assert not is_single_sweep(np.zeros(N))
    assert not is_single_sweep(sweep(5.0, 800.0, True)[:500])


@pytest.mark.parametrize(("estimator", "told"), [("H1", True), ("local polynomial", False)])
def test_the_import_says_so(estimator: str, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    force = sweep(5.0, 800.0, True)
    spectrum = 2j * np.pi * np.fft.rfftfreq(2 * N, 1 / RATE_HZ)
    mobility = spectrum / (2e-3 * spectrum**2 + 2 * spectrum + 2e3)
    velocity = np.fft.irfft(np.fft.rfft(force, 2 * N) * mobility, 2 * N)[:N]
    np.savez(tmp_path / "a.npz", force=force, velocity=velocity, fs=RATE_HZ)
    channels = ["--force", "force[N]", "--motion", "velocity[m/s]", "--band", "10", "700", "--estimator", estimator]
    assert main(["import", str(tmp_path / "a.npz"), *channels, "-o", str(tmp_path / "out")]) == 0
    assert ("sweeps once through the band" in capsys.readouterr().out) is told
