"""The Kramers-Kronig check: silent about whatever is causal or not known, and not about what has been changed."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import DATA
from faulty_recordings import Complex, change, gaussian, only, simulate, warnings

from bayes_impedance import FINGERTIP, simulate_recordings
from bayes_impedance.quality.causal_model import misfits
from bayes_impedance.quality.kramers_kronig import LEAST_BAND, LEAST_POINTS, _rounding, disagreement, violations

sys.path.insert(0, str(DATA.parent / "analyses" / "kramers_kronig"))
worlds = importlib.import_module("worlds")

F = np.geomspace(5.0, 5000.0, 201)
S = 2j * np.pi * F


def resonances() -> Complex:
    """A mass on a lossy spring behind a soft layer, and a sharp resonance on it."""
    sharp = 1 / (1 / (S * 2e-3) + 1 / (0.02 + 4e3 / S))
    z: Complex = 1 / (1 / (2.0 + 8e3 / S) + 1 / (S * 2e-3 + 1.0 + 1e3 / S + sharp))
    return z


def noisy(z: Complex, noise: float, seed: int = 0) -> Complex:
    return z + noise * np.abs(z) * gaussian(np.random.default_rng(seed), z.size)


def test_a_rational_curve_is_described_and_its_conjugate_only_by_the_reflected_poles() -> None:
    z, s = resonances(), 1j * F / np.sqrt(F[0] * F[-1])
    right, turned = (misfits(s, curve, 1e6 / np.abs(z), 8) for curve in (z, z.conj()))
    assert right.causal < 1e-6
    assert turned.causal > 1e6
    assert turned.either < 1e-3 * turned.causal


def test_misfits_do_not_depend_on_the_unit() -> None:
    z, s = noisy(resonances(), 0.01), 1j * F / np.sqrt(F[0] * F[-1])
    one, other = (misfits(s, k * z, 100 / np.abs(k * z), 8) for k in (1.0, 1e-6))
    assert one.causal == pytest.approx(other.causal, rel=1e-6)
    assert one.either == pytest.approx(other.either, rel=1e-6)


def test_noise_is_one() -> None:
    """Squares for a degree of freedom, with noise that is known."""
    s = 1j * F / np.sqrt(F[0] * F[-1])
    found = [misfits(s, noisy(resonances(), 0.01, seed), 100 / np.abs(resonances()), 8) for seed in range(20)]
    assert np.mean([one.causal for one in found]) == pytest.approx(1, abs=0.05)
    assert np.mean([one.either for one in found]) == pytest.approx(1, abs=0.05)


# Silence


@pytest.mark.parametrize("kind", worlds.KINDS)
@pytest.mark.parametrize("behind", worlds.BEHIND)
def test_no_finding_of_causal_curves(kind: str, behind: str) -> None:
    for seed in range(12):
        rng = np.random.default_rng([9, seed])
        f = worlds.draw_band(rng)
        z = worlds.draw_curve(rng, f, kind, behind)(0 * f)
        noise = worlds.NOISES[seed % len(worlds.NOISES)]
        y = worlds.with_noise(rng, f, z, worlds.draw_noise_level(rng), noise)
        assert disagreement(f, y) is None, (seed, noise)


@pytest.mark.parametrize(
    ("low", "high", "points", "repetitions"), [(5, 5000, 401, 1), (20, 400, 80, 3), (50, 320, 60, 1)]
)
def test_no_finding_of_fingertips(low: float, high: float, points: int, repetitions: int) -> None:
    frequency = np.geomspace(low, high, points)
    made = simulate_recordings(FINGERTIP, 20, repetitions, frequency, seed=2).recordings
    assert violations(made.subjects) == ([], 20)


def test_late_motion_is_causal_in_the_mobility_only() -> None:
    z, s = noisy(resonances() * np.exp(S * 2 / S[-1].imag), 1e-3), 1j * F / np.sqrt(F[0] * F[-1])
    assert misfits(s, z, 1e3 / np.abs(z), 32).causal > 3
    assert disagreement(F, z) is None


def test_motion_at_another_place_is_causal_in_the_mobility_only() -> None:
    """Two modes of opposite sign: the transfer mobility has zeros in the right half plane, which are poles of z."""
    w = 2 * np.pi * np.array([60.0, 700.0])
    one, two = (S / (S**2 + 0.05 * k * S + k**2) for k in w)
    z = noisy(1 / (one - 0.3 * two), 1e-3)
    assert disagreement(F, z) is None


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.05])
def test_no_finding_without_a_fault(noise: float) -> None:
    assert violations(simulate(3, noise=noise).subjects) == ([], 12)


def test_few_points_a_narrow_band_or_much_noise_are_not_judged() -> None:
    bad: Complex = 2 * resonances().real + 1j * resonances().imag
    assert disagreement(F, noisy(bad, 0.003)) is not None
    few = np.linspace(0, F.size - 1, LEAST_POINTS - 1).astype(int)
    assert disagreement(F[few], noisy(bad, 0.003)[few]) is None
    assert disagreement(F, noisy(bad, 0.3)) is None
    assert disagreement(F, noisy(bad, 0.003), 0.5 * np.abs(bad)) is None
    narrow = np.geomspace(50, 50 * 0.99 * LEAST_BAND, F.size)
    assert disagreement(narrow, noisy(bad, 0.003)) is None


def test_smoothed_noise_is_not_known() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        e = np.convolve(gaussian(rng, 1, F.size)[0], np.hanning(9) / np.linalg.norm(np.hanning(9)), "same")
        assert disagreement(F, resonances() + 0.02 * np.abs(resonances()) * e) is None


# Faults

PROGRESS = np.linspace(0, 1, F.size)
FAULTS = {
    "real part scaled": lambda z: 1.2 * z.real + 1j * z.imag,
    "imaginary part scaled": lambda z: z.real + 1.2j * z.imag,
    "real part shifted": lambda z: np.append(z.real[2:], z.real[-2:]) + 1j * z.imag,
    "phase multiplied": lambda z: np.abs(z) * np.exp(1.1j * np.angle(z)),
    "drift": lambda z: z * (1 + 0.3 * PROGRESS),
}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("given", [False, True])
def test_a_fault_is_found(name: str, given: bool) -> None:
    for seed in range(5):
        z = noisy(FAULTS[name](resonances()), 0.003, seed)
        found = disagreement(F, z, 0.003 * np.abs(z) if given else None)
        assert found is not None
        misfit, noise = found
        # Beside a resonance the curve is rough without noise.
        assert misfit > noise == pytest.approx(0.003 * np.sqrt(2), rel=0.01 if given else 0.4)


def test_the_check_names_the_subject() -> None:
    data = simulate(1, noise=0.002)

    def edit(z: Complex) -> None:
        z.real *= 1.15

    finding = only(change(data, 4, edit), "kramers_kronig")
    assert finding.subject == "S04"
    assert "drift during the sweep" in finding.message


def test_what_all_have_is_the_rigs_and_said_once() -> None:
    data = simulate(1, noise=0.002)
    turned = tuple(replace(one, z=one.z.real + 1.15j * one.z.imag) for one in data.subjects)
    finding = only(replace(data, subjects=turned), "kramers_kronig")
    assert finding.subject is None
    assert "12 of 12 subjects" in finding.message


def test_a_fault_that_has_another_name_is_said_once() -> None:
    data = simulate(1, noise=0.002)

    def edit(z: Complex) -> None:
        z[:, 100:] *= 1.4

    assert {one.id for one in warnings(change(data, 4, edit))} == {"jump"}


# Rounding


@pytest.mark.parametrize(
    ("values", "repetitions", "step"),
    [
        (np.round(np.linspace(0.0123, 4.56, 90), 2), 1, 0.01),
        (np.linspace(120.0, 4500.0, 90).round(-1), 1, 10.0),
        (np.full(90, 0.25), 1, 0.01),
        (np.round(np.linspace(0.0123, 4.56, 90), 2) / 3, 3, 0.01 / 3),  # the mean of three
        (np.sqrt(np.arange(1.0, 91.0)), 1, 0.0),
        (np.pi * np.arange(1.0, 91.0), 1, 0.0),  # even steps of an ideal mass, and nothing rounded
        (np.zeros(90), 1, 0.0),
    ],
)
def test_only_rounded_values_have_a_step(values: np.ndarray, repetitions: int, step: float) -> None:
    assert _rounding(values + 0j, repetitions) == pytest.approx(step)
    assert _rounding(1j * values, repetitions) == pytest.approx(step)


def test_a_steep_curve_on_an_even_grid_is_not_taken_for_rounded() -> None:
    """The smallest difference between values of the reactance is many times the noise there, and hid the fault."""
    f = np.linspace(5.0, 500.0, 100)
    s = 2j * np.pi * f
    z = s * 5e-3 + 2 + 1 / (1 / 4 + s / 5e3)
    fault = np.abs(z) * np.exp(0.8j * np.angle(z))
    for seed in range(5):
        noise = 1 + 1e-3 * gaussian(np.random.default_rng(seed), 100)
        assert disagreement(f, z * noise) is None
        assert disagreement(f, fault * noise) is not None
