"""Amplitudes of a structure in each person, against their definition, and who is named for having it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from bayes_impedance.diagnosis.residuals.amplitudes import (
    Amplitudes,
    carriers,
    energy_amplitudes,
    pattern_amplitudes,
)
from bayes_impedance.diagnosis.residuals.nodes import Pooled

NODES = 30


def pooled(size: np.ndarray, template: np.ndarray, seed: int = 1, absorbed: np.ndarray | None = None) -> Pooled:
    """Unit noise and a structure of given size in each person's only recording; `absorbed` is projected out."""
    n, noise = len(size), np.random.default_rng(seed).normal(size=(len(size), template.size))
    basis = np.zeros((n, template.size, 1))
    scores = noise + size[:, None] * template
    if absorbed is not None:
        basis[:] = absorbed[:, None]
        scores -= (scores @ absorbed)[:, None] * absorbed
    return Pooled(np.geomspace(5, 5000, NODES), np.arange(n), scores, np.ones(scores.shape), basis)


def unit(seed: int) -> np.ndarray:
    vector = np.random.default_rng(seed).normal(size=2 * NODES)
    return vector / np.linalg.norm(vector)


@pytest.mark.parametrize("scale", [1.0, -1e6, 1e-6])
def test_one_template_gives_the_normalised_score(scale: float) -> None:
    """Amplitudes do not depend on the template's scale; their common sign is that of most of them."""
    template = unit(2)
    data = pooled(np.r_[np.full(5, 9.0), np.zeros(5)], template)
    expected = data.scores @ template
    found = pattern_amplitudes(data, scale * template[:, None])
    np.testing.assert_allclose(found.z, expected, rtol=1e-6)
    np.testing.assert_allclose(found.p_value, chi2.sf(expected**2, 1), rtol=1e-4)


def test_what_the_elements_absorb_does_not_count() -> None:
    """Of a template, only what is orthogonal to the elements' tangent space remains, with unit variance."""
    template, absorbed = unit(3), unit(4)
    mixed = template + absorbed
    data = pooled(np.zeros(400), template, absorbed=absorbed)
    rest = mixed - (mixed @ absorbed) * absorbed
    found = pattern_amplitudes(data, mixed[:, None])
    np.testing.assert_allclose(np.abs(found.z), np.abs(data.scores @ rest) / np.linalg.norm(rest), rtol=1e-6)
    assert kstest(found.z, "norm").pvalue > 0.01


def test_who_does_not_cover_a_structure_has_no_amplitude() -> None:
    template = np.zeros(2 * NODES)
    template[:5] = 1.0
    data = pooled(np.full(8, 3.0), template)
    data.count[2, :10] = 0.0
    data.scores[2, :10] = 0.0
    for found in (
        pattern_amplitudes(data, template[:, None]),
        energy_amplitudes(data, (template > 0).astype(float), noise=1.0),
    ):
        assert np.flatnonzero(np.isnan(found.z)).tolist() == [2]
        assert found.p_value[2] == 1.0
        assert (found.p_value[[0, 1, 3, 4, 5, 6, 7]] < 0.05).mean() > 0.5


def test_energy_of_noise_is_a_standard_normal_score() -> None:
    data = pooled(np.zeros(2000), np.zeros(2 * NODES))
    inside = (np.arange(2 * NODES) < 20).astype(float)
    assert kstest(energy_amplitudes(data, inside, noise=1.0).z, "norm").pvalue > 0.01
    assert energy_amplitudes(data, inside, noise=4.0).z.mean() < -2.0  # half the energy that such noise has


def named(z: list[float] | np.ndarray) -> list[int]:
    z = np.asarray(z, dtype=float)
    p_value = np.where(np.isfinite(z), chi2.sf(np.nan_to_num(z) ** 2, 1), 1.0)
    return carriers(Amplitudes(z, p_value), 0.01)[0].tolist()


def test_only_a_clear_minority_is_named() -> None:
    noise = np.random.default_rng(5).normal(size=20)
    few = noise + np.where(np.isin(np.arange(20), [3, 11, 12]), 9.0, 0.0)
    assert named(few) == [3, 11, 12]
    assert named(-few) == [3, 11, 12]
    assert named(noise) == []
    assert named(noise + 9.0) == []  # everybody has it
    assert named(noise + np.where(np.arange(20) < 15, 9.0, 0.0)) == []  # most have it
    assert named(9.0 * np.exp(0.5 * noise)) == []  # everybody, to different degrees
    assert named(few[:5]) == []  # too few people for a minority


def test_the_p_value_is_the_largest_corrected_one_and_missing_people_are_left_out() -> None:
    z = np.r_[np.random.default_rng(7).normal(size=17), np.nan, 8.0, 9.0, 10.0]
    p = np.where(np.isfinite(z), chi2.sf(np.nan_to_num(z) ** 2, 1), 1.0)
    who, p_value = carriers(Amplitudes(z, p), 0.01)
    assert who.tolist() == [18, 19, 20]
    assert p_value == pytest.approx(19 * p[18])  # Holm: the third smallest of 21
    assert carriers(Amplitudes(z[:17], p[:17]), 0.01)[1] == 1.0
