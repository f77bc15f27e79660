"""Element-wise fits: recovery, elements that phases do not determine, and averages with diverged elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import SMALL

from bayes_impedance.classical.elementwise import RUNAWAY, Curve, fit_elements, with_magnitude_of
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings

NETWORK = parse(SMALL.network)
KERNEL = Kernel(NETWORK)
FREQUENCY_HZ = np.geomspace(5, 5000, 60)


@pytest.fixture(scope="module")
def clean() -> tuple[Recordings, np.ndarray]:
    """Eight people without noise, and their log elements."""
    exact = replace(SMALL, noise=0.0, between_repetitions=dict.fromkeys(SMALL.between_repetitions, 0.0))
    simulation = simulate_recordings(exact, 8, 1, FREQUENCY_HZ, seed=1)
    return simulation.recordings, simulation.log_elements


@pytest.mark.parametrize("part", ["magnitude", "complex"])
@pytest.mark.parametrize("weighting", ["none", "relative"])
def test_recovers_everybodys_elements_from_clean_curves(clean, part, weighting):
    recordings, truth = clean
    fit = fit_elements(recordings, NETWORK, part, weighting=weighting)
    assert fit.converged.all()
    assert not fit.stopped.any()
    np.testing.assert_allclose(fit.log_elements, truth, atol=1e-4)
    assert fit.median()["r3"] == pytest.approx(np.exp(np.median(truth[:, KERNEL.elements.index("r3")])), rel=1e-3)
    assert fit.mean()["r3"] == pytest.approx(np.exp(truth[:, KERNEL.elements.index("r3")]).mean(), rel=1e-3)


def test_phases_leave_one_scale_open_and_magnitudes_close_it(clean):
    recordings, truth = clean
    fit = fit_elements(recordings, NETWORK, "phase")
    # All that is wrong is one number for each person, the same for masses and dampers, its inverse for compliances.
    wrong = (fit.log_elements - truth) * np.array([-1.0 if e[0] == "n" else 1.0 for e in KERNEL.elements])
    np.testing.assert_allclose(wrong - wrong.mean(axis=1, keepdims=True), 0, atol=1e-4)
    assert np.abs(wrong).max() > 0.1
    scaled = with_magnitude_of(fit, recordings, NETWORK)
    np.testing.assert_allclose(scaled.log_elements, truth, atol=1e-4)


@pytest.mark.parametrize("part", ["magnitude", "phase", "complex"])
def test_jacobian_is_the_derivative(clean, part):
    recordings, truth = clean
    subject = recordings.subjects[0]
    weight = 1 / np.abs(subject.mean)
    curve = Curve(KERNEL, FREQUENCY_HZ, subject.mean, part, weight, truth[0])
    theta = truth[0] + np.linspace(-0.3, 0.4, truth.shape[1])
    numeric = np.array(
        [(curve.residual(theta + d) - curve.residual(theta - d)) / 2e-6 for d in 1e-6 * np.eye(theta.size)]
    ).T
    np.testing.assert_allclose(curve.jacobian(theta), numeric, atol=1e-7)


def test_an_element_that_the_curve_does_not_show_is_stopped_and_counted(clean):
    recordings, truth = clean
    larger = parse(f"({SMALL.network})|m9")  # there is no such mass
    fit = fit_elements(recordings, larger, "complex", weighting="relative")
    mass = fit.elements.index("m9")
    assert fit.stopped[:, mass].sum() >= 4
    assert not fit.stopped[:, [i for i in range(len(fit.elements)) if fit.elements[i] not in ("m9", "m2")]].any()
    assert np.all(np.isfinite(list(fit.mean().values())))
    assert np.ptp(fit.log_elements[fit.stopped[:, mass], mass]) <= 2 * RUNAWAY
    skin = fit.elements.index("r3")
    np.testing.assert_allclose(fit.log_elements[:, skin], truth[:, KERNEL.elements.index("r3")], atol=0.05)


def test_same_seed_same_elements(clean):
    first, second = (fit_elements(clean[0], NETWORK, "magnitude", seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.log_elements, second.log_elements)


def test_refuses_what_it_cannot_do(clean):
    recordings, _ = clean
    with pytest.raises(InputError, match="choose magnitude, phase, complex"):
        fit_elements(recordings, NETWORK, "modulus")
    few = replace(
        recordings,
        subjects=tuple(replace(s, frequency_hz=s.frequency_hz[:4], z=s.z[:, :4]) for s in recordings.subjects),
    )
    with pytest.raises(InputError, match="4 frequencies, too few for 5 elements"):
        fit_elements(few, NETWORK, "magnitude")
