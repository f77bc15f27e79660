"""Whitened residuals of a person, and orthonormal bases of what the elements can absorb."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import TOY, toy

from bayes_impedance.diagnosis.fit.person_residuals import orthonormal, person_residuals


def test_orthonormal_bases_span_the_columns() -> None:
    rng = np.random.default_rng(1)
    columns_ = rng.normal(size=(3, 10, 4)) * [1.0, 1e8, 1e-8, 1.0]
    columns_[1, :, 3] = columns_[1, :, 0] - 2e-8 * columns_[1, :, 1]  # depends on the others
    columns_[2, :, 2] = 0.0  # not seen
    basis = orthonormal(columns_)
    assert basis.shape == columns_.shape
    for q, a, rank in zip(basis, columns_, (4, 3, 3), strict=True):
        projector = q @ q.T
        np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)
        assert np.trace(projector) == pytest.approx(rank)
        unit = a / np.maximum(np.linalg.norm(a, axis=0), 1e-300)
        np.testing.assert_allclose(projector @ unit, unit, atol=1e-7)


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
