"""Noise of single recordings from the noise model of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.noise import NoiseModel
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.recording_noise import initial_likelihoods, noise_of, scaled_noise
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.runtime.executors import executor_of

FREQUENCY = np.geomspace(5, 500, 80)


def test_noise_follows_a_recording_whose_resonance_has_moved_and_is_smooth_elsewhere() -> None:
    kernel = Kernel(parse("m1|n1|r1"))
    theta = np.log([[0.05, 1e-3, 0.05], [0.05, 1.1e-3, 0.05]])
    clean = kernel.impedance(theta, FREQUENCY)
    rng = np.random.default_rng(1)
    noise = 0.02 * np.abs(clean) * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
    subject = replace(simulate_recordings(FINGERTIP, 1, 2, FREQUENCY, 1).recordings.subjects[0], z=clean + noise)
    model = NoiseModel(FREQUENCY, np.full(80, 0.02), True, 1e-4)
    sd = noise_of(subject, model)
    ratio = sd / (0.02 * np.abs(clean))
    # Differences of 0.5 keep half of it, 0.25; the mean of both is off by a factor e beside the resonance.
    assert np.all(np.abs(np.log(ratio)) < 0.3)
    mean = np.exp(np.mean(np.log(np.abs(clean)), axis=0))
    assert np.abs(np.log(0.02 * mean / (0.02 * np.abs(clean)))).max() > 1.0
    same = np.abs(np.log(np.abs(clean[0] / clean[1]))) < 0.005
    own = np.log(np.abs(subject.z) / np.abs(clean))
    assert np.std(np.log(ratio[:, same])) < 0.95 * np.std(own[:, same])


def test_weights_do_not_go_with_a_points_own_noise_where_repetitions_differ_smoothly() -> None:
    """Where the weight depends on how much they differ, elements cannot absorb what it shifts the residuals by."""
    n, level = 200_000, 0.01
    clean = np.repeat([[1.04], [0.96]], n, axis=1)
    rng = np.random.default_rng(1)
    noise = level * np.abs(clean) * rng.normal(size=clean.shape)
    subject = simulate_recordings(FINGERTIP, 1, 2, FREQUENCY, 1).recordings.subjects[0]
    subject = replace(subject, frequency_hz=np.linspace(5, 500, n), z=clean + noise + 0j)
    model = NoiseModel(FREQUENCY, np.full(80, level), True, 1e-6)
    sd = noise_of(subject, model)
    weighted = np.sum(noise / sd**2, axis=1) / np.sum(1 / sd, axis=1)
    shift = weighted - np.mean(noise / (level * np.abs(clean)), axis=1)
    # The mean over two repetitions would give one level, the recording's own magnitude two.
    assert np.all(np.abs(shift) < 0.3 * level)


@pytest.mark.parametrize("spacing", [np.geomspace, np.linspace])
def test_noise_of_one_recording_does_not_draw_it_down(spacing: Callable[..., np.ndarray]) -> None:
    n, level = 40_000, 0.07
    frequency = spacing(5, 500, n)
    clean = Kernel(parse("(m1-(n1|r1))|r2")).impedance(np.log([0.05, 1e-3, 2.0, 1.0]), frequency)
    rng = np.random.default_rng(1)
    noise = level * np.abs(clean) * (rng.normal(size=n) + 1j * rng.normal(size=n))
    subject = simulate_recordings(FINGERTIP, 1, 1, FREQUENCY, 1).recordings.subjects[0]
    subject = replace(subject, frequency_hz=frequency, z=(clean + noise)[None])
    sd = noise_of(subject, NoiseModel(FREQUENCY, np.full(80, level), True, 1e-6))[0]
    assert np.median(sd / (level * np.abs(clean))) == pytest.approx(1.0, abs=0.01)
    gain = np.sum(np.real(np.conj(clean) * noise) / sd**2) / np.sum(np.abs(clean / sd) ** 2)
    assert abs(gain) < 4 * level / np.sqrt(n)  # four standard errors; its own magnitude gives -2 level^2 = -0.0098
    own = np.sum(np.real(np.conj(clean) * noise) / np.abs(clean + noise) ** 2) / n
    assert own < -0.008


def test_a_resonance_that_the_grid_barely_resolves_keeps_its_own_magnitude() -> None:
    frequency = np.geomspace(5, 500, 200)
    clean = Kernel(parse("m1|n1|r1")).impedance(np.log([0.05, 1e-3, 0.05]), frequency)
    subject = simulate_recordings(FINGERTIP, 1, 1, FREQUENCY, 1).recordings.subjects[0]
    subject = replace(subject, frequency_hz=frequency, z=clean[None])
    sd = noise_of(subject, NoiseModel(FREQUENCY, np.full(80, 0.01), True, 1e-6))[0]
    assert np.abs(np.log(sd / (0.01 * np.abs(clean)))).max() < 0.06


def test_a_few_points_keep_the_magnitude_of_the_recordings() -> None:
    few = FREQUENCY[:5]
    subject = simulate_recordings(FINGERTIP, 1, 1, FREQUENCY, 1).recordings.subjects[0]
    subject = replace(subject, frequency_hz=few, z=subject.z[:, :5])
    sd = noise_of(subject, NoiseModel(FREQUENCY, np.full(80, 0.01), True, 1e-6))
    np.testing.assert_allclose(sd, 0.01 * np.abs(subject.z))


def test_noise_that_does_not_grow_with_the_magnitude_is_the_same_in_all_recordings() -> None:
    recordings = simulate_recordings(FINGERTIP, 1, 3, FREQUENCY, 1).recordings
    model = NoiseModel(np.array([5.0, 500.0]), np.array([1e-3, 1e-2]), False, 0.0)
    expected = np.exp(np.interp(np.log(FREQUENCY), np.log([5, 500]), np.log([1e-3, 1e-2])))
    np.testing.assert_allclose(noise_of(recordings.subjects[0], model), np.tile(expected, (3, 1)))


def test_noise_of_the_recordings_is_taken_as_it_is_and_the_likelihood_has_it() -> None:
    recordings = simulate_recordings(FINGERTIP, 2, 2, FREQUENCY, 1).recordings
    first, other = recordings.subjects
    own = np.linspace(1, 2, 160).reshape(2, 80)
    model = NoiseModel(FREQUENCY, np.full(80, 0.02), True, 1e-4)
    mixed = replace(recordings, subjects=(replace(first, noise_sd=own), other))
    np.testing.assert_array_equal(noise_of(mixed.subjects[0], None), own)
    np.testing.assert_array_equal(scaled_noise(model, mixed.subjects[0], 3.0), 3 * own)
    with executor_of(1) as executor:
        likelihoods = list(initial_likelihoods(mixed, model, 8, executor).gathered())
    np.testing.assert_allclose(likelihoods[0].weight, own**-2)
    np.testing.assert_allclose(likelihoods[1].weight, noise_of(other, model) ** -2)
