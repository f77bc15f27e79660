"""Passivity: the verdict over the whole axis, compared with dense sampling and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import published
from experiments import PAPER, printed_eq4, random_elements
from hypothesis import assume, given
from rational_models import (
    BAND,
    S,
    above_the_band,
    below_the_band,
    finger,
    only,
    random_model,
    ratio,
    sampled_relative,
    with_terms,
)
from strategies import networks_with_elements, repeatable

from bayes_impedance.classical.passivity import check_passivity, enforce_passivity
from bayes_impedance.classical.pole_residue import PoleResidue, partial_fractions
from bayes_impedance.errors import InputError
from bayes_impedance.network.rational import TransferFunction

# Networks


@repeatable
@given(networks_with_elements(max_leaves=8))
def test_every_network_is_positive_real_and_its_negative_is_not(network_and_elements):
    network, logarithms = network_and_elements
    # Equal lossless branches leave a common factor in numerator and denominator, which is not reduced.
    logarithms = logarithms + 0.01 * np.sqrt(np.arange(2.0, 2.0 + logarithms.size))
    transfer = network.transfer_function(dict(zip(network.elements, np.exp(logarithms).tolist(), strict=True)))
    verdict = check_passivity(transfer)
    assert verdict.positive_real, verdict.reasons
    assert verdict.reasons == ()
    assert 0 >= verdict.margin >= -1e-9 or verdict.margin > 0
    negative = TransferFunction((tuple(-c for c in transfer.ascending[0]), transfer.ascending[1]))
    assert not check_passivity(negative).positive_real
    try:
        model = partial_fractions(transfer)
    except ValueError:  # a multiple pole; the ratio has been looked at
        assume(False)
    verdict = check_passivity(model)
    assert verdict.positive_real, verdict.reasons
    negative = PoleResidue(model.poles, -model.residues, -model.constant, -model.linear)
    verdict = check_passivity(negative)
    assert not verdict.positive_real
    assert verdict.violations or verdict.wrong_residues


def test_corrected_eq4_is_positive_real_and_the_printed_one_has_an_unstable_pole():
    for values in random_elements(60):
        v = dict(values)
        corrected = PAPER.transfer_function(v)
        assert check_passivity(corrected).positive_real
        printed = PAPER.transfer_function(v | {"m2": -v["m2"], "r3": v["r2"]})
        s = np.array([0.3 + 1j, 7.0 + 0.2j])
        np.testing.assert_allclose(printed(s), printed_eq4(s, v), rtol=1e-8)
        verdict = check_passivity(printed)
        assert not verdict.positive_real
        assert verdict.unstable_poles.size > 0
        assert np.all(verdict.unstable_poles.real > 0)
        assert any("right half-plane" in reason for reason in verdict.reasons)


@pytest.mark.parametrize("form", [lambda t: t, partial_fractions], ids=["ratio", "fractions"])
def test_published_curves(form):
    """Appendix A with its sign turned: VFMedian is positive real, SIT is not below its band."""
    models = {name: form(published(name)) for name in ("sit", "vf_median")}
    assert all(model(S).real.min() > 0 for model in models.values())  # the band alone shows nothing
    verdict = check_passivity(models["vf_median"])
    assert verdict.positive_real
    assert verdict.margin == pytest.approx(0.2504, abs=1e-4)
    verdict = check_passivity(models["sit"], unit="N s/m")
    violation = only(verdict.violations)
    assert (violation.low_hz, violation.high_hz) == (0, pytest.approx(3.692, abs=1e-3))
    assert violation.worst_hz == pytest.approx(2.469, abs=1e-3)
    assert verdict.margin == pytest.approx(violation.relative, rel=1e-12)
    assert violation.relative == pytest.approx(-0.0428, abs=1e-4)
    assert verdict.reasons == (
        "Re z is negative from 0 Hz to 3.69 Hz, at worst -2.44 N s/m at 2.47 Hz (-4.3 % of |z|)",
    )


# Violations outside of the band


@pytest.mark.parametrize(("model", "inside_hz"), [(above_the_band(), 5e4), (below_the_band(), 0.01)])
def test_a_violation_outside_of_the_band_is_found_and_removed(model, inside_hz):
    assert check_passivity(finger()).positive_real
    assert model(S).real.min() > 0
    verdict = check_passivity(model)
    violation = only(verdict.violations)
    assert violation.low_hz < inside_hz < violation.high_hz
    assert violation.high_hz < 5 or violation.low_hz > 5000
    assert not verdict.unstable_poles.size
    assert not verdict.wrong_residues
    repaired = enforce_passivity(model, BAND)
    assert check_passivity(repaired).positive_real
    np.testing.assert_array_equal(repaired.poles, model.poles)
    change = np.abs(repaired(S) / model(S) - 1).max()
    assert 0 < change < 2e-3
    assert sampled_relative(repaired, np.geomspace(1e-4, 1e9, 20001)).min() >= -1e-9


# One condition at a time


def test_band_edges_by_hand():
    """d - k a^2/(a^2 + w^2) changes its sign at w = a sqrt(k/d - 1)."""
    model = PoleResidue([-300.0], [-300.0 * 5], 1.25)
    violation = only(check_passivity(model).violations)
    assert violation.low_hz == 0
    assert violation.worst_hz == 0
    assert violation.high_hz * 2 * np.pi == pytest.approx(300 * np.sqrt(3), rel=1e-10)
    assert (violation.real_part, violation.relative) == (pytest.approx(-3.75), -1)


@pytest.mark.parametrize("form", [lambda t: t, partial_fractions], ids=["ratio", "fractions"])
def test_touching_zero_is_passive_and_crossing_is_not(form):
    """The even part of (s^2 + a s + 1)/(s^2 + s + 4) has w^4 - (5 - a) w^2 + 4 above: (w^2 - 2)^2 for a = 1."""
    touching = check_passivity(form(ratio((1, 1, 1), (1, 1, 4))))
    assert touching.positive_real
    assert touching.margin == pytest.approx(0, abs=1e-9)
    assert check_passivity(form(ratio((1, 1.001, 1), (1, 1, 4)))).margin > 1e-5
    for short in (1e-6, 1e-3, 0.5):
        violation = only(check_passivity(form(ratio((1, 1 - short, 1), (1, 1, 4)))).violations)
        x = np.sort(np.roots([1, -(4 + short), 4]))
        edges = 2 * np.pi * np.array([violation.low_hz, violation.high_hz])
        np.testing.assert_allclose(edges, np.sqrt(x), rtol=1e-8)
        s = 2j * np.pi * violation.worst_hz
        value = (s**2 + (1 - short) * s + 1) / (s**2 + s + 4)
        assert violation.real_part == pytest.approx(value.real, rel=1e-4)
        assert violation.relative == pytest.approx(value.real / abs(value), rel=1e-4)


def test_a_band_far_narrower_than_any_grid_is_found():
    """Beside a resonance at b, Re z = d - c a/(a^2 + (w - b)^2), here a millionth of a frequency wide."""
    a, b = 1e-2, 1e4
    model = PoleResidue([-a + 1j * b, -a - 1j * b], [-2 * a, -2 * a], 1.0)
    omega = np.geomspace(1, 1e8, 10000)
    assert model(1j * omega).real.min() > 0.9
    violation = only(check_passivity(model).violations)
    assert violation.high_hz - violation.low_hz == pytest.approx(2 * a / (2 * np.pi), rel=1e-3)
    assert violation.worst_hz == pytest.approx(b / (2 * np.pi), rel=1e-9)
    assert violation.real_part == pytest.approx(-1, rel=1e-3)


def test_negative_constant_is_a_violation_up_to_infinity():
    model = PoleResidue([-100.0], [1000.0], -0.1)
    violation = only(check_passivity(model).violations)
    assert violation.low_hz * 2 * np.pi == pytest.approx(np.sqrt(1000 * 100 / 0.1 - 100**2))
    assert (violation.high_hz, violation.worst_hz) == (np.inf, np.inf)
    assert (violation.real_part, violation.relative) == (-0.1, -1)
    with_mass = check_passivity(PoleResidue([-100.0], [1000.0], -0.1, 1e-3))
    violation = only(with_mass.violations)
    assert violation.high_hz == np.inf
    assert np.isfinite(violation.worst_hz)
    assert -1 < violation.relative < -1e-3
    # So small a share of what is lost elsewhere that the sign changes ten decades above the pole.
    violation = only(check_passivity(PoleResidue([-1.0], [1.0], -1e-20)).violations)
    assert violation.low_hz * 2 * np.pi == pytest.approx(1e10, rel=1e-6)


@pytest.mark.parametrize(
    ("model", "pole", "residue"),
    [
        (with_terms(finger(), [0.0], [-900.0]), 0, -900),
        (with_terms(finger(), [], [], linear=-2e-3), np.inf, -2e-3),
        (with_terms(finger(), [300j, -300j], [-2.0, -2.0]), 300j, -2),
        (with_terms(finger(), [300j, -300j], [2 + 1j, 2 - 1j]), 300j, 2 + 1j),
        (with_terms(finger(), [1e-6 + 300j, 1e-6 - 300j], [-2.0, -2.0]), 1e-6 + 300j, -2),
        (ratio((1, 1, -900), (1, 0)), 0, -900),
        (ratio((-2e-3, 1, 1), (1, 7)), np.inf, -2e-3),
        (ratio((5, -4, 5 * 300**2), (1, 0, 300**2)), 300j, -2),
    ],
)
def test_wrong_residues_on_the_axis(model, pole, residue):
    verdict = check_passivity(model)
    assert not verdict.positive_real
    assert not verdict.violations
    found = only(verdict.wrong_residues)
    assert found.pole == pytest.approx(pole)
    assert found.residue == pytest.approx(residue)
    assert "not positive" in only(verdict.reasons)


def test_lossless_terms_with_right_residues_are_passive():
    model = with_terms(finger(), [300j, -300j], [2.0, 2.0], linear=1e-3)
    assert check_passivity(model).positive_real
    lossless = check_passivity(PoleResidue([300j, -300j, 0], [2.0, 2.0, 5.0], 0, 1e-3))
    assert (lossless.positive_real, lossless.margin) == (True, 0)


@pytest.mark.parametrize("damping", [1e-9, 1e-8, 1e-6])
def test_a_weakly_damped_pole_may_have_a_complex_residue(damping):
    """Beside the resonance, or at it, its share of Re z is negative and finite: a constant of 1 covers it."""
    pole = 100 * (-damping + 1j)
    for residue in (100 * damping * (1 + 0.5j), -50 * damping + 0j):
        poles, residues = [pole, pole.conjugate()], [residue, residue.conjugate()]
        assert check_passivity(PoleResidue(poles, residues, 1.0)).positive_real
        assert not check_passivity(PoleResidue(poles, residues, 0.0)).positive_real
        assert not check_passivity(PoleResidue(poles, residues, 0.05)).positive_real


def test_the_worst_frequency_and_the_margin_are_where_z_is_small():
    """Between a spring and a mass, z is left with its real part alone for a millionth of a decade."""
    model = PoleResidue([0, -1e4], [3e3, -1e-2], 0.0, 7e-3)
    verdict = check_passivity(model)
    violation = only(verdict.violations)
    assert violation.worst_hz == pytest.approx(np.sqrt(3e3 / 7e-3) / (2 * np.pi), rel=1e-6)
    assert violation.relative == verdict.margin == pytest.approx(-1, abs=1e-6)
    assert violation.real_part == pytest.approx(-1e-6, rel=0.01)
    # Beside a resonance: the same by sampling what can only be sampled if one knows where.
    pole, residue = 100 * (-1e-7 + 1j), 1e-5 * (1 - 2j)
    model = PoleResidue([pole, pole.conjugate()], [residue, residue.conjugate()], 1.0)
    s = 1j * (100 + 1e-5 * np.linspace(-50, 50, 200001))
    lowest = (model(s).real / np.abs(model(s))).min()
    assert lowest > 0.3
    assert check_passivity(model).margin == pytest.approx(lowest, rel=1e-6)


def test_unstable_poles():
    verdict = check_passivity(with_terms(finger(), [2 + 9j, 2 - 9j, -5], [0.1, 0.1, 1e-3]))
    np.testing.assert_allclose(np.sort_complex(verdict.unstable_poles), [2 - 9j, 2 + 9j])
    assert not verdict.positive_real
    assert "2+9j rad/s is in the right half-plane" in verdict.reasons[0]
    assert check_passivity(with_terms(finger(), [2 + 9j, 2 - 9j], [0, 0])).positive_real  # no pole without a residue


def test_ratios_with_multiple_poles():
    assert check_passivity(ratio((1, 1), (1, 4, 4))).positive_real
    assert only(check_passivity(ratio((1,), (1, 2, 1))).violations).low_hz == pytest.approx(1 / (2 * np.pi))
    for transfer, pole in [(ratio((1,), (1, 0, 0)), 0), (ratio((1, 0, 1), (1,)), np.inf)]:
        verdict = check_passivity(transfer)
        assert only(verdict.wrong_residues).pole == pole
        assert any("multiple" in reason for reason in verdict.reasons)
    assert check_passivity(ratio((1, 1, 0, 0), (1, 0, 0))).positive_real  # common powers of s are no poles


def test_complex_coefficients_and_coefficients_that_are_none():
    verdict = check_passivity(ratio((1, 1 + 1e-6j), (1, 2)))
    assert not verdict.positive_real
    assert "complex" in only(verdict.reasons)
    for bad in (ratio((1, np.nan), (1, 2)), ratio((1, 2), (0, 0))):
        with pytest.raises(InputError, match="denominator"):
            check_passivity(bad)


# Against dense sampling


@pytest.mark.parametrize("seed", range(40))
def test_verdict_bands_and_edges_agree_with_dense_sampling(seed):
    model = random_model(np.random.default_rng(seed))
    verdict = check_passivity(model)
    pairs = model.poles[model.poles.imag > 0]
    near = (np.abs(pairs.imag) * (1 + np.linspace(-3, 3, 1001)[:, None] * np.abs(pairs.real / pairs))).ravel()
    omega = np.unique(np.concatenate([np.geomspace(1e-5, 1e11, 40001), near[near > 0]]))
    relative = sampled_relative(model, omega)
    assert verdict.margin <= relative.min() + 1e-9
    if abs(relative.min()) > 1e-9:
        assert verdict.positive_real == (relative.min() > 0)
    steps = np.diff(np.concatenate([[0], (relative < 0).astype(int), [0]]))
    firsts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    assert len(verdict.violations) == firsts.size
    padded = np.concatenate([[0], omega, [np.inf]])
    for violation, first, end in zip(verdict.violations, firsts, ends, strict=True):
        low, high = 2 * np.pi * violation.low_hz, 2 * np.pi * violation.high_hz
        assert padded[first] * (1 - 1e-9) <= low <= padded[first + 1]
        assert padded[end] <= high <= padded[end + 1] * (1 + 1e-9)
        assert violation.low_hz <= violation.worst_hz <= violation.high_hz
        assert violation.relative <= relative[first:end].min() + 1e-9


def test_random_models_are_of_both_kinds():
    verdicts = [check_passivity(random_model(np.random.default_rng(seed))).positive_real for seed in range(40)]
    assert 8 < sum(verdicts) < 32
