"""Whitened residuals of a person, and bases of what the elements can absorb."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import TOY, toy

from bayes_impedance.diagnosis.fit.person_residuals import directions, person_residuals


def test_what_elements_absorb_is_the_span_of_their_derivatives() -> None:
    rng = np.random.default_rng(1)
    columns_ = rng.normal(size=(3, 10, 4)) * [1.0, 1e4, 1e-4, 1.0]
    columns_[1, :, 3] = columns_[1, :, 0] - 2e-8 * columns_[1, :, 1]  # depends on the others
    columns_[2, :, 2] = 0.0  # not seen
    basis, _ = directions(np.swapaxes(columns_, 1, 2), 0.0)
    assert basis.shape == columns_.shape
    for q, a, rank in zip(basis, columns_, (4, 3, 3), strict=True):
        projector = q @ q.T
        np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)
        assert np.trace(projector) == pytest.approx(rank)
        unit = a / np.maximum(np.linalg.norm(a, axis=0), 1e-300)
        np.testing.assert_allclose(projector @ unit, unit, atol=1e-7)


def test_what_a_factor_e_hardly_moves_absorbs_nothing() -> None:
    derivative = np.diag([100.0, 1.0, 1e-3])[:, [0, 1, 2, 0]]
    derivative[:, 3] = 0.0
    basis, moved = directions(derivative, 0.01)
    np.testing.assert_allclose(moved, [100.0, 1.0, 1e-3])
    np.testing.assert_allclose(basis @ basis.T, np.diag([1.0, 1.0, 0.0, 0.0]), atol=1e-12)


def test_an_element_driven_to_nothing_does_not_hide_a_misfit_in_its_direction() -> None:
    # The resistance of the recordings is negative; the damper can only vanish.
    experiment = toy("m1|r1|n1", {"m1": 0.002, "r1": 1.0, "n1": 5e-4}, seed=4, n=8)
    below = [replace(d, z=d.z - np.array([2.0, 0.0])[:, None]) for d in experiment.data]
    fit = replace(experiment, data=tuple(below)).fit()
    assert fit.population.mu[1] < -4
    for person in person_residuals(fit, list("abcdefgh")):
        outside = person.outside(person.white[..., None])[..., 0]
        assert np.sum(outside**2) > 0.9 * np.sum(person.white**2)


def test_residuals_are_whitened_by_the_persons_own_noise() -> None:
    experiment = toy(*TOY, seed=4, n=3)
    fit = experiment.fit()
    for i, person in enumerate(person_residuals(fit, ["a", "b", "c"])):
        d = fit.data[i]
        assert person.name == "abc"[i]
        np.testing.assert_allclose(person.frequency_hz, d.omega / (2 * np.pi))
        scale = person.sd * np.sqrt(d.weight)  # one number for a person
        np.testing.assert_allclose(scale, scale[0, 0])
        assert scale[0, 0] == pytest.approx(1, abs=4 / np.sqrt(2 * person.white.size))
        residual = d.z[:, 0] + 1j * d.z[:, 1] - person.model
        np.testing.assert_allclose(person.white[:, :41], residual.real / person.sd)
        np.testing.assert_allclose(person.white[:, 41:], residual.imag / person.sd)
        assert person.basis.shape == (2, 82, 2)
