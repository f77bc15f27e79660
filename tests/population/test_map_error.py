"""The error of a calibration at each frequency, in a fit: against refitting with perturbed calibration runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from scipy.optimize import least_squares

from bayes_impedance.intake.simulated_rig import SimulatedRig
from bayes_impedance.intake.two_port import TwoPort, two_port
from bayes_impedance.network import Kernel, parse
from bayes_impedance.population.fit import QUICK_SETTINGS, fit_population
from bayes_impedance.population.map_error import moved, response, with_map_noise, without_map_noise
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings

NETWORK = "(n3|r3)-(m2|r1|n1)"
ELEMENTS = {"n3": 2e-4, "r3": 3.0, "m2": 2e-3, "r1": 2.0, "n1": 1e-3}
FREQUENCY_HZ = np.geomspace(10, 1000, 30)
S = 2j * np.pi * FREQUENCY_HZ
LOADS = S * np.array([[0.0], [0.01], [0.05]])
RIG = SimulatedRig()
NOISE = 0.002
"""Of the calibration runs, over their size: small, as the response is that to small errors."""


def runs(noise: float, rng: np.random.Generator | None = None) -> TwoPort:
    exact = np.array([RIG.measured(FREQUENCY_HZ, load) for load in LOADS])
    sd = noise * np.abs(exact)
    off = 0.0 if rng is None else sd * (rng.normal(size=sd.shape) + 1j * rng.normal(size=sd.shape))
    return two_port(FREQUENCY_HZ, LOADS, exact + off, sd, len(LOADS))


def people(theta: np.ndarray, repetitions: int = 1, noise: float = 0.01) -> Recordings:
    """Recordings of persons (N, P) without noise, corrected with runs that have an error."""
    kernel, exact = Kernel(parse(NETWORK)), runs(NOISE)
    simulated = simulate_recordings(THREE_ELEMENTS, len(theta), repetitions, FREQUENCY_HZ, 1).recordings
    z = kernel.impedance(theta, FREQUENCY_HZ)
    subjects = tuple(
        replace(one, z=np.tile(own, (repetitions, 1)), noise_sd=np.tile(noise * np.abs(own), (repetitions, 1)))
        for one, own in zip(simulated.subjects, z, strict=True)
    )
    return replace(simulated, subjects=subjects, network=NETWORK, calibration_map=exact.recorded)


def parameters(p: int, between: float) -> PopulationParameters:
    return PopulationParameters(
        mu=np.zeros((2, p)),
        between_persons=np.full((2, p), between),
        correlation_cholesky=np.tile(np.eye(p), (2, 1, 1)),
        between_repetitions=np.zeros((2, p)),
        slopes=np.zeros((2, p, 0)),
    )


def test_the_response_is_the_covariance_of_fits_to_perturbed_runs() -> None:
    kernel, rng = Kernel(parse(NETWORK)), np.random.default_rng(0)
    theta = np.log([ELEMENTS[name] for name in kernel.elements])
    recordings = people(theta[None], repetitions=2)
    one = recordings.subjects[0]
    assert one.noise_sd is not None
    prior = Prior(centre=theta, centre_sd=1e3)
    follows = response(recordings, kernel, theta[None], [one.noise_sd], parameters(5, np.nan), prior)
    measured, found = RIG.measured(FREQUENCY_HZ, one.z[0]), []
    for _ in range(400):
        z = runs(NOISE, rng).load(measured)

        def misfit(u: np.ndarray, z: np.ndarray = z) -> np.ndarray:
            off = (kernel.impedance(u, FREQUENCY_HZ) - z) / np.abs(one.z[0])
            return np.concatenate([off.real, off.imag])

        found.append(least_squares(misfit, theta, method="lm").x)
    # With two recordings of a person half of the variance is in the noise already.
    expected = 2 * follows.centre @ follows.centre.T
    whitened = np.linalg.solve(np.linalg.cholesky(expected), (np.array(found) - theta).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(5), atol=0.3)  # 0.05 to 0.07 are the errors of 400 draws
    np.testing.assert_allclose(follows.persons[0], follows.centre)


@pytest.mark.parametrize("between", [1e-4, 10.0])
def test_the_centre_follows_what_all_people_have_in_common(between: float) -> None:
    """People who are alike are one recording, repeated; of people who differ much the centre is the mean."""
    kernel, rng = Kernel(parse(NETWORK)), np.random.default_rng(0)
    theta = np.log([ELEMENTS[name] for name in kernel.elements]) + 0.3 * rng.normal(size=(4, 5))
    recordings = people(theta, repetitions=3)
    noise = [one.noise_sd for one in recordings.subjects if one.noise_sd is not None]
    prior = Prior(centre=theta[0], centre_sd=1e3)
    follows = response(recordings, kernel, theta, noise, parameters(5, between), prior)
    alone = [
        response(replace(recordings, subjects=(one,)), kernel, own[None], [sd], parameters(5, np.nan), prior)
        for one, own, sd in zip(recordings.subjects, theta, noise, strict=True)
    ]
    if between > 1:
        expected = np.mean([own.centre for own in alone], axis=0) * np.sqrt((1 - 1 / 12) / (1 - 1 / 3))
        np.testing.assert_allclose(follows.centre, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())
        for own, of in zip(follows.persons, alone, strict=True):
            np.testing.assert_allclose(own, of.centre, rtol=1e-2, atol=1e-3 * np.abs(own).max())
    else:
        for own in follows.persons:
            np.testing.assert_allclose(own, follows.centre, rtol=1e-2, atol=1e-2 * np.abs(own).max())


def test_noise_holds_the_error_once() -> None:
    recordings = people(np.log([[2e-4, 3.0, 2e-3, 2.0, 1e-3]]))
    plain, error = recordings.subjects[0], recordings.calibration_map
    noisier = with_map_noise(recordings)
    sd = noisier.subjects[0].noise_sd
    assert error is not None
    assert sd is not None
    assert plain.noise_sd is not None
    np.testing.assert_allclose(sd**2 - plain.noise_sd**2, error.variance(FREQUENCY_HZ, plain.z), rtol=1e-9)
    assert with_map_noise(noisier) is noisier
    again = without_map_noise(noisier).subjects[0].noise_sd
    assert again is not None
    np.testing.assert_allclose(again, plain.noise_sd, rtol=1e-9)
    exact = replace(recordings, calibration_map=None)
    assert with_map_noise(exact) is exact


@pytest.mark.long
def test_a_fit_has_the_error_in_its_centre_and_not_in_its_dispersions() -> None:
    alike = dict.fromkeys(("m1", "r1", "n1"), 0.05)
    population = replace(THREE_ELEMENTS, between_persons=alike, between_repetitions=alike, noise=0.01)
    recordings = simulate_recordings(population, 12, 2, FREQUENCY_HZ, 1).recordings
    error = replace(runs(0.05).recorded, in_noise=True)  # the same noise with and without it
    exact, carried = (
        fit_population(replace(recordings, calibration_map=own), settings=QUICK_SETTINGS, seed=1, workers=1)
        for own in (None, error)
    )
    elements = exact.person_draws.mean(axis=(0, 1))
    follows = response(carried.recordings, carried.kernel, elements, exact.noise, exact.parameters, exact.prior)
    expected = np.hypot(exact.parameters.mu.std(axis=0), np.linalg.norm(follows.centre, axis=1))
    assert np.all(expected > 1.2 * exact.parameters.mu.std(axis=0))
    np.testing.assert_allclose(carried.parameters.mu.std(axis=0), expected, rtol=0.05)
    np.testing.assert_array_equal(carried.parameters.between_persons, exact.parameters.between_persons)
    np.testing.assert_array_equal(carried.log_probability, exact.log_probability)
    # All move together: by the same draw of the error.
    common, _ = moved(follows, exact.parameters, elements[None], np.random.SeedSequence(1))
    again, _ = moved(follows, exact.parameters, elements[None], np.random.SeedSequence(1))
    np.testing.assert_array_equal(common.mu, again.mu)
