"""The missing one-port: the least squares with all elements free, recovery of a loss, and nothing where nothing is."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import TOY, Experiment, toy

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals, real_and_imaginary
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals import missing_impedance as module
from bayes_impedance.diagnosis.residuals.missing_impedance import missing_one_ports

LOSS = 0.08


def lossy_spring(s: np.ndarray, z: np.ndarray, _rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Everybody's spring 1/(s n) times 1 + j LOSS: no spring and no damper behaves like that."""
    compliance = 1 / np.mean((z * s - s * z.real).real, axis=(1, 2))
    return z + 1j * LOSS / (s * compliance[:, None, None]), np.full(len(z), LOSS)


def fitted(experiment: Experiment) -> tuple[Refit, list[PersonResiduals]]:
    fit = experiment.fit()
    return fit, person_residuals(fit, [f"P{i}" for i in range(len(experiment.data))])


def test_ratio_is_the_ridge_least_squares_with_every_recordings_elements_free() -> None:
    fit, residuals = fitted(toy(*TOY, seed=1, n=2, repetitions=2, hidden=lossy_spring))
    frequency = residuals[0].frequency_hz
    bumps = module._bumps(frequency, frequency[0], frequency[-1])
    dz = fit.model.kernel.derivative(fit.u, frequency)[1]
    spring = 1 / (2j * np.pi * frequency * np.exp(fit.u[:, :1]))
    rows, right = [], []
    for r in range(4):
        person, j = residuals[fit.owner[r]], r % 2
        columns = np.concatenate([bumps, 1j * bumps]) * spring[r] / person.sd[j]
        own = np.zeros((2 * frequency.size, 8))
        own[:, 2 * r : 2 * r + 2] = real_and_imaginary(dz[r, :2] / person.sd[j]).T
        rows.append(np.hstack([real_and_imaginary(columns).T, own]))
        right.append(person.white[j])
    size = len(bumps) * 2
    prior = np.hstack([np.eye(size), np.zeros((size, 8))])
    solution = np.linalg.lstsq(np.vstack([*rows, prior]), np.concatenate([*right, np.zeros(size)]), rcond=None)[0]
    shown = module._bumps(np.geomspace(frequency[0], frequency[-1], 60), frequency[0], frequency[-1])
    expected = solution[: len(bumps)] @ shown + 1j * (solution[len(bumps) : size] @ shown)
    port = next(p for p in missing_one_ports(fit, residuals) if p.place == "n1")
    np.testing.assert_allclose(port.ratio, expected, atol=1e-7)


def test_a_loss_of_the_spring_is_recovered_where_the_spring_dominates() -> None:
    ports = missing_one_ports(*fitted(toy(*TOY, seed=2, n=12, hidden=lossy_spring)))
    assert [p.share for p in ports] == sorted((p.share for p in ports), reverse=True)
    spring = next(p for p in ports if p.place == "n1")
    assert spring.share > 0.9
    # Elements take constants at will, so what is left of a constant loss is its shape below 40 Hz.
    low = spring.frequency_hz < 40
    turned = spring.ratio.imag[low]
    assert np.ptp(turned) < 0.5 * LOSS
    assert turned.mean() == pytest.approx(LOSS, abs=0.5 * LOSS)


def test_where_nothing_is_missing_nothing_is_significant() -> None:
    for seed in range(6):
        for port in missing_one_ports(*fitted(toy(*TOY, seed=30 + seed, n=8))):
            # The error contains what the elements absorb, of which the recordings say nothing.
            assert np.all(np.abs(port.ratio.real) < 4 * port.sd)
            assert np.all(np.abs(port.ratio.imag) < 4 * port.sd)


def test_bumps_sum_to_one_everywhere() -> None:
    grid = np.geomspace(3, 700, 50)
    np.testing.assert_allclose(module._bumps(grid, 3, 700).sum(axis=0), 1.0)
