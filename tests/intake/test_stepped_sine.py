"""Stepped sines in one record: steps are found, impedances exact without noise, intervals true with it."""

from pathlib import Path

import numpy as np
from simulated_signals import DAMPING, MASS, STIFFNESS, share_within

from bayes_impedance.commands.cli import main
from bayes_impedance.intake.stepped_sine import FREQUENCY_TOLERANCE, stepped_ratio, steps_of
from bayes_impedance.recordings import read_recordings

RATE = 20_000.0
STEPS = np.geomspace(20, 2000, 40)


def record(noise: float = 0.0, seed: int = 1, settle: int = 5, average: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Force, with a phase that continues from step to step, and displacement; the first periods have not settled."""
    rng, force, motion, phase = np.random.default_rng(seed), [], [], 0.0
    for f in STEPS:
        w, count = 2 * np.pi * f / RATE, round((settle + average + 1.6) * RATE / f)
        angle = phase + w * np.arange(count)
        phase = angle[-1] + w
        s = 2j * np.pi * f
        stiffness = MASS * s**2 + DAMPING * s + STIFFNESS
        settled = 1 - np.exp(-4 * np.arange(count) * f / RATE)
        force.append(np.sin(angle))
        motion.append(settled * np.imag(np.exp(1j * angle) / stiffness))
        motion[-1] += noise * np.abs(1 / stiffness) * rng.normal(size=count)
        force[-1] += noise * rng.normal(size=count)
    return np.concatenate(force), np.concatenate(motion)


def impedance(frequency_hz: np.ndarray) -> np.ndarray:
    s = 2j * np.pi * frequency_hz
    return MASS * s + DAMPING + STIFFNESS / s


def test_steps_are_found() -> None:
    assert len(steps_of(record(noise=0.02)[0])) == STEPS.size
    ratio = stepped_ratio(*record(noise=0.02), RATE)
    assert ratio is not None
    np.testing.assert_allclose(ratio.frequency_hz, STEPS, rtol=FREQUENCY_TOLERANCE)


def test_without_noise_the_impedance_is_exact() -> None:
    ratio = stepped_ratio(*record(), RATE)
    assert ratio is not None
    np.testing.assert_allclose(ratio.frequency_hz, STEPS, rtol=1e-6)
    z = ratio.value / (2j * np.pi * ratio.frequency_hz)
    np.testing.assert_allclose(z, impedance(STEPS), rtol=1e-6)


def test_intervals_hold_the_truth() -> None:
    share = []
    for seed in range(25):
        ratio = stepped_ratio(*record(0.02, seed), RATE)
        assert ratio is not None
        assert ratio.noise_sd is not None
        assert ratio.degrees_of_freedom is not None
        s = 2j * np.pi * ratio.frequency_hz
        sd = ratio.noise_sd / np.abs(s)
        share.append(share_within(ratio.value / s, impedance(STEPS), sd, ratio.degrees_of_freedom))
    # 25 times 80 parts: the standard deviation of the share is 0.5 %. The degrees of freedom are those of the step with
    # the fewest periods, so that the intervals of others are a little too wide.
    assert 0.935 < np.mean(share) < 0.985


def test_periods_that_have_not_settled_are_left_out() -> None:
    early = stepped_ratio(*record(), RATE, settle=0)
    assert early is not None
    error = np.abs(early.value / (2j * np.pi * early.frequency_hz) / impedance(STEPS) - 1)
    assert np.median(error) > 1e-3


def test_repetitions_have_the_same_steps(tmp_path: Path) -> None:
    for k in (1, 2):
        force, motion = record(0.01, k)
        np.savez(tmp_path / f"A_{k}.npz", force=force, x=motion, fs=RATE)
    files = sorted(map(str, tmp_path.glob("*.npz")))
    options = ["--force", "force[N]", "--motion", "x[m]", "--excitation", "stepped sine"]
    pattern = ["--subject-from-name", r"(?P<subject>\w)_(?P<repetition>\d)"]
    assert main(["import", *files, "-o", str(tmp_path / "out"), *options, *pattern]) == 0
    (subject,) = read_recordings(tmp_path / "out").subjects
    assert subject.z.shape == (2, 40)
    np.testing.assert_allclose(subject.z, np.tile(impedance(STEPS), (2, 1)), rtol=0.05)
