"""Periodic excitation: exact lines, true intervals, distortion where it is and nowhere else."""

from pathlib import Path

import numpy as np
import pytest
from simulated_signals import Multisine, share_within

from bayes_impedance.commands.cli import main
from bayes_impedance.intake.periodic import (
    best_linear_approximation,
    distortion,
    excited_lines,
    find_period,
    period_spectra,
    repeats,
    transient_periods,
)

SINES = Multisine()
ODD_WITH_DETECTION = Multisine(lines=tuple(k for k in range(5, 101, 2) if k % 10 != 5))
LINES = np.array(SINES.lines)


def spectra_of(sines: Multisine, count: int, seeds: list[int], **what: float):
    """Spectra of realisations."""
    made = [sines.periods(count, seed, **what) for seed in seeds]
    return period_spectra(np.array([f for f, _ in made]), np.array([x for _, x in made]), sines.rate_hz)


def test_without_noise_the_impedance_is_exact() -> None:
    ratio = best_linear_approximation(spectra_of(SINES, 3, [1]), LINES)
    z = ratio.value / (2j * np.pi * ratio.frequency_hz)
    np.testing.assert_allclose(z, SINES.impedance(), rtol=1e-9)
    np.testing.assert_allclose(ratio.frequency_hz, LINES * 2.0)


@pytest.mark.parametrize(("count", "realisations"), [(2, 1), (5, 1), (12, 1), (3, 4)])
def test_intervals_hold_the_truth(count: int, realisations: int) -> None:
    share = []
    for seed in range(60):
        seeds = list(range(100 * seed, 100 * seed + realisations))
        ratio = best_linear_approximation(spectra_of(SINES, count, seeds, noise=0.02), LINES)
        assert ratio.noise_sd is not None
        assert ratio.degrees_of_freedom is not None
        s = 2j * np.pi * ratio.frequency_hz
        value, sd = ratio.value / s, ratio.noise_sd / np.abs(s)
        share.append(share_within(value, SINES.impedance(), sd, ratio.degrees_of_freedom))
    # 60 times 96 parts: the standard deviation of the share is 0.3 %.
    assert np.mean(share) == pytest.approx(0.95, abs=0.01)


def test_distortion_of_a_linear_load_is_none() -> None:
    found = distortion(spectra_of(ODD_WITH_DETECTION, 20, [1], noise=1e-3), np.array(ODD_WITH_DETECTION.lines))
    assert set(found) == {f"{k}_distortion_of_{c}" for k in ("odd", "even") for c in ("motion", "force")}
    for level in found.values():
        assert level == pytest.approx(1.0, abs=0.35)  # ten odd lines: the mean of ten has a deviation of 16 %


def test_a_cubic_spring_shows_at_odd_lines_of_the_force_only() -> None:
    lines = np.array(ODD_WITH_DETECTION.lines)
    found = distortion(spectra_of(ODD_WITH_DETECTION, 20, [1], noise=1e-4, cubic=1e10), lines)
    assert found["odd_distortion_of_force"] > 20
    for name in ("even_distortion_of_force", "odd_distortion_of_motion", "even_distortion_of_motion"):
        assert found[name] == pytest.approx(1.0, abs=0.35)


def test_a_quadratic_spring_shows_at_even_lines_of_the_force_only() -> None:
    lines = np.array(ODD_WITH_DETECTION.lines)
    found = distortion(spectra_of(ODD_WITH_DETECTION, 20, [1], noise=1e-4, square=2e6), lines)
    assert found["even_distortion_of_force"] > 20
    assert found["odd_distortion_of_force"] == pytest.approx(1.0, abs=0.35)


def test_realisations_scatter_by_distortion_and_not_without() -> None:
    name = "scatter_of_realisations_over_noise"
    seeds = list(range(8))
    linear = best_linear_approximation(spectra_of(SINES, 6, seeds, noise=1e-3), LINES)
    cubic = best_linear_approximation(spectra_of(SINES, 6, seeds, noise=1e-3, cubic=1e10), LINES)
    assert linear.facts[name] == pytest.approx(1.0, abs=0.2)
    assert cubic.facts[name] > 3
    assert (linear.degrees_of_freedom, cubic.degrees_of_freedom) == (14.0, 14.0)


def test_excited_lines_are_found_with_and_without_distortion() -> None:
    for what in ({}, {"noise": 1e-3}, {"noise": 1e-4, "cubic": 1e9}):
        np.testing.assert_array_equal(excited_lines(spectra_of(SINES, 8, [1], **what)), LINES)
    few = Multisine(lines=(3, 7, 16, 37, 86))
    np.testing.assert_array_equal(excited_lines(spectra_of(few, 8, [1], noise=1e-3)), few.lines)


def test_transient_periods_are_left_out_and_settled_ones_are_not() -> None:
    dropped = []
    for seed in range(40):
        force, x = SINES.periods(10, seed, noise=0.01)
        settled = period_spectra(force[None], x[None], SINES.rate_hz)
        both = np.concatenate([settled.force, settled.motion])[:, :, LINES]
        dropped.append(transient_periods(both))
        decay = np.exp(-np.arange(3 * SINES.samples) / SINES.samples * 4).reshape(3, -1)
        force[:3] += force.std() * decay
        moving = period_spectra(force[None], x[None], SINES.rate_hz)
        assert transient_periods(np.concatenate([moving.force, moving.motion])[:, :, LINES]) in (1, 2, 3)
    assert sum(dropped) <= 1  # one in a thousand


@pytest.mark.parametrize("sines", [SINES, Multisine(lines=(4,)), Multisine(lines=(3, 50, 51)), ODD_WITH_DETECTION])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_period_is_found(sines: Multisine, noise: float) -> None:
    force = sines.periods(6, 1, noise=noise)[0].ravel()
    found = find_period(force, force.size // 2)
    # The period of the signal, which is a fraction of the record's if its lines have a common divisor.
    assert found == sines.samples // int(np.gcd.reduce(sines.lines))
    for count in (3, 6):  # of two periods and three lines it may be chance
        assert repeats(force[: count * sines.samples], found)


def test_noise_has_no_period() -> None:
    assert find_period(np.random.default_rng(1).normal(size=20_000), 10_000) is None


def finger_under_random_acceleration(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Force of 800 N/m, 3 N s/m and 1 g, and acceleration; at 5 kHz, nothing below 2 Hz."""
    rng = np.random.default_rng(seed)
    size = 2 * int(rng.choice([8000, 20_000]))
    s = 2j * np.pi * np.maximum(np.fft.rfftfreq(size, 1 / 5000), 1e-3)
    acceleration = np.fft.rfft(rng.normal(size=size)) * (np.abs(s) > 2 * np.pi * 2)
    force = np.fft.irfft(acceleration / s * (800 / s + 3 + 1e-3 * s))[: size // 2]
    return force + 1e-3 * force.std() * rng.normal(size=force.size), np.fft.irfft(acceleration)[: size // 2]


def test_a_resemblance_by_chance_is_no_period() -> None:
    """The force of a spring under noise is nearly all in its lowest lines, which often resemble themselves."""
    resembling = 0
    for seed in range(40):
        force, _ = finger_under_random_acceleration(seed)
        found = find_period(force, force.size // 2)
        if found is not None:
            resembling += 1
            assert not repeats(force, found)
    assert resembling >= 10


def test_what_resembles_itself_by_chance_is_imported_as_noise(tmp_path: Path, capsys) -> None:
    made = (finger_under_random_acceleration(seed) for seed in range(40))
    force, motion = next(pair for pair in made if find_period(pair[0], pair[0].size // 2) is not None)
    np.savez(tmp_path / "a.npz", fs=5000.0, force=force, motion=motion)
    arguments = ["import", str(tmp_path / "a.npz"), "--force", "force[N]", "--motion", "motion[m/s^2]"]
    assert main([*arguments, "-o", str(tmp_path / "out")]) == 0
    assert "taken for noise" in capsys.readouterr().out
