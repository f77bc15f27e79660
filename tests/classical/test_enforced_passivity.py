"""The nearest passive model: what is removed, what stays, and that nothing nearer is passive."""

from __future__ import annotations

import numpy as np
import pytest
from rational_models import (
    BAND,
    S,
    above_the_band,
    below_the_band,
    finger,
    only,
    random_model,
    with_terms,
)
from scipy.optimize import minimize

from bayes_impedance.classical import passivity
from bayes_impedance.classical.passivity import check_passivity, enforce_passivity
from bayes_impedance.classical.pole_residue import PoleResidue
from bayes_impedance.errors import InputError


def distance(model, target, sd):
    return np.sum(np.abs((model(S) - target) / sd) ** 2)


def test_what_is_passive_stays_the_very_same():
    model = finger()
    assert enforce_passivity(model, BAND) is model
    assert enforce_passivity(model, BAND, 2 * model(S)) is model


@pytest.mark.parametrize("seed", range(25))
def test_repaired_models_are_positive_real_and_the_nearest(seed):
    """In a convex cone the nearest point z* to z has <z - z*, z*> = 0, and <z - z*, q> <= 0 for all others q."""
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    repaired = enforce_passivity(model, BAND)
    assert check_passivity(repaired).positive_real
    np.testing.assert_array_equal(repaired.poles, model.poles)
    if model.constant == 0:
        assert repaired.constant == 0
        assert -np.sum(repaired.residues * repaired.poles).real >= 0  # omega^2 Re z at infinity
    assert repaired.linear >= 0
    z, nearest = model(S), repaired(S)

    def product(a, b):
        return np.sum((a.conj() * b).real / np.abs(z) ** 2)

    size = np.sqrt(product(z, z))
    assert abs(product(z - nearest, nearest)) <= 1e-4 * size**2
    for _ in range(3):
        factors = np.where(model.poles.imag == 0, rng.normal(size=model.poles.size), 1.0)
        other = PoleResidue(model.poles, model.residues * factors, model.constant, model.linear)
        other = enforce_passivity(other, BAND)(S)
        assert product(z - nearest, other) <= 1e-4 * size * np.sqrt(product(other, other))


def test_the_distance_is_that_of_a_general_optimiser():
    poles = np.array([-40.0, -900 + 3000j, -900 - 3000j, 0.0])
    model = PoleResidue(poles, np.array([-60.0, 500 + 1500j, 500 - 1500j, 400.0]), 0.6, 1e-4)
    assert only(check_passivity(model).violations).relative < -0.9
    z, sd = model(S), np.abs(model(S))
    omega = 2 * np.pi * np.geomspace(1e-3, 1e6, 1500)

    def member(x):
        c1, re, im, c0, d, e = x
        return PoleResidue(poles, [c1, re + 1j * im, re - 1j * im, c0], d, e)

    basis = np.array([member(row)(S) / sd for row in np.eye(6)]).T
    real = np.array([member(row)(1j * omega).real for row in np.eye(6)]).T
    scale = 1 / np.linalg.norm(basis, axis=0)
    basis, real = basis * scale, real * scale
    real = real / np.linalg.norm(real, axis=1, keepdims=True)
    found = minimize(
        lambda x: np.sum(np.abs(basis @ x - z / sd) ** 2),
        np.array([0.1, 1, 0.1, 1, 1, 1]),
        jac=lambda x: 2 * (basis.conj().T @ (basis @ x - z / sd)).real,
        constraints={"type": "ineq", "fun": lambda x: real @ x, "jac": lambda x: real},
        bounds=[(None, None)] * 3 + [(0, None)] * 3,
        method="SLSQP",
        options={"ftol": 1e-10, "maxiter": 500},
    )
    assert found.success
    assert found.fun > 0.01
    assert distance(enforce_passivity(model, BAND), z, sd) == pytest.approx(found.fun, rel=1e-4)


def test_unstable_poles_are_reflected_and_wrong_residues_removed():
    model = with_terms(finger(), [40 + 900j, 40 - 900j, 0.0], [30 + 9j, 30 - 9j, -900.0], linear=-1e-3)
    repaired = enforce_passivity(model, BAND)
    verdict = check_passivity(repaired)
    assert verdict.positive_real
    np.testing.assert_array_equal(repaired.poles[-3:], [-40 + 900j, -40 - 900j, 0.0])
    np.testing.assert_array_equal(repaired.poles[:-3], model.poles[:-3])
    assert np.all(repaired.residues[repaired.poles == 0].real >= 0)
    assert repaired.linear == 0


def test_terms_that_the_model_lacks_stay_absent():
    model = PoleResidue([-100.0, -2000.0], [900.0, -1200.0])
    assert check_passivity(model).violations[0].high_hz == np.inf
    repaired = enforce_passivity(model, BAND)
    assert check_passivity(repaired).positive_real
    assert (repaired.constant, repaired.linear) == (0, 0)


def test_least_squares_with_walls_that_nearly_face_each_other():
    """With a x + b y >= 1 and -a x + b y >= 1 the shortest vector is (0, 1/b)."""
    a, b = 1.0, 1e-5
    rows = np.array([[a, b], [-a, b], [0, 1]])
    theta, binding = passivity._constrained(
        np.eye(2, dtype=complex), np.zeros(2, dtype=complex), np.zeros(2), rows, np.array([1, 1, 0])
    )
    np.testing.assert_allclose(theta, [0, 1 / b], rtol=1e-6, atol=1e-3)
    np.testing.assert_array_equal(binding, [True, True, False])


def test_data_and_their_noise_decide_what_is_nearest():
    model = below_the_band()
    truth = finger()
    z = truth(S) * (1 + 0.01 * np.random.default_rng(3).normal(size=S.size))
    to_data = enforce_passivity(model, BAND, z)
    assert distance(to_data, z, np.abs(z)) < distance(enforce_passivity(model, BAND), z, np.abs(z))
    sd = np.where(BAND > 1000, 1e-3, 1.0) * np.abs(z)
    weighted = enforce_passivity(model, BAND, z, noise_sd=sd)
    assert check_passivity(weighted).positive_real
    assert distance(weighted, z, sd) < distance(to_data, z, sd)
    scaled = enforce_passivity(model, BAND, z, noise_sd=7 * sd)
    np.testing.assert_allclose(scaled(S), weighted(S), rtol=1e-6)


def test_input_that_cannot_be_used():
    model = below_the_band()
    z = model(S)
    for message, arguments, options in [
        ("above 0", (-BAND,), {}),
        ("above 0", (BAND[:0],), {}),
        ("shape", (BAND, z[1:]), {}),
        ("shape", (BAND, z), {"noise_sd": np.ones(3)}),
        ("above 0", (BAND, z), {"noise_sd": np.zeros(BAND.size)}),
        ("finite", (BAND, z * np.nan), {}),
        ("margin", (BAND,), {"margin": 0.0}),
    ]:
        with pytest.raises(InputError, match=message):
            enforce_passivity(model, *arguments, **options)


def test_dips_that_remain_are_an_error(monkeypatch):
    monkeypatch.setattr(passivity, "_ROUNDS", 1)
    with pytest.raises(RuntimeError, match=r"after 1 rounds: Re z is negative from .*Hz"):
        enforce_passivity(above_the_band(), BAND)
