"""Partial fractions and ratios of polynomials are the same function."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from strategies import networks_with_elements, repeatable

from bayes_impedance.classical.pole_residue import PoleResidue, partial_fractions
from bayes_impedance.network.rational import TransferFunction

S = np.array([0.02, 0.7, 30.0, 0.3 + 2j, 5 - 9j])


@repeatable
@given(networks_with_elements(max_leaves=7))
def test_networks_survive_both_ways(network_and_elements):
    network, logarithms = network_and_elements
    transfer = network.transfer_function(dict(zip(network.elements, np.exp(logarithms).tolist(), strict=True)))
    try:
        model = partial_fractions(transfer)
    except ValueError:  # two poles in one place
        assume(False)
    # Poles that nearly coincide have large residues that cancel.
    size = np.abs(model.residues).sum() / max(np.abs(model(S)).min(), 1e-300)
    np.testing.assert_allclose(model(S), transfer(S), rtol=1e-9 * max(1.0, size))
    np.testing.assert_allclose(model.transfer_function()(S), transfer(S), rtol=1e-8 * max(1.0, size))


@pytest.mark.parametrize("factor", [1e-30, 1e-9, 1.0, 1e12])
def test_the_size_of_the_coefficients_does_not_matter(factor):
    transfer = TransferFunction.from_coefficients([factor, 2 * factor, factor], [1.0, 5.0, 6.0])
    model = partial_fractions(transfer)
    np.testing.assert_allclose(sorted(model.residues.real), [-4 * factor, factor], rtol=1e-12)
    assert model.constant == pytest.approx(factor)
    assert model.linear == 0


def test_polynomial_parts():
    model = partial_fractions(TransferFunction.from_coefficients([2.0, 3.0, 4.0], [1.0, 0.0]))
    assert (model.poles.tolist(), model.residues.tolist()) == ([0], [4])  # 4/s, and the pole is exactly at 0
    assert (model.constant, model.linear) == (3.0, 2.0)
    mass = partial_fractions(TransferFunction.from_coefficients([2e-3, 5.0], [1.0]))
    assert (mass.constant, mass.linear, mass.poles.size) == (5.0, 2e-3, 0)
    proper = partial_fractions(TransferFunction.from_coefficients([2.0], [1.0, 5.0]))
    assert (proper.constant, proper.linear) == (0.0, 0.0)
    fast = partial_fractions(TransferFunction.from_coefficients([2.0, 3e6, 4.0], [1.0, 1e6]))
    assert fast.linear == pytest.approx(2.0)
    assert fast.constant == pytest.approx(1e6)


def test_conjugates_make_real_coefficients():
    model = PoleResidue([-1 + 2j, -1 - 2j, -3.0], [1 + 1j, 1 - 1j, 2.0], 0.5, 0.1)
    transfer = model.transfer_function()
    assert np.isrealobj(transfer.numerator)
    assert np.isrealobj(transfer.denominator)
    np.testing.assert_allclose(transfer(S), model(S), rtol=1e-13)
    np.testing.assert_allclose(model(S.conj()), model(S).conj(), rtol=1e-14)


@pytest.mark.parametrize(
    ("poles", "residues", "message"),
    [
        ([-1 + 2j], [1.0], "no conjugate partner"),
        ([-1 + 2j, -1 - 2j], [1 + 1j, 1 + 1j], "no conjugate partner"),
        ([-1.0], [1 + 1j], "no conjugate partner"),
        ([-1.0, -2.0], [1.0], "shape"),
        ([-1.0], [np.inf], "not finite"),
    ],
)
def test_refuses_what_is_not_real(poles, residues, message):
    with pytest.raises(ValueError, match=message):
        PoleResidue(poles, residues)


@pytest.mark.parametrize(
    ("numerator", "denominator", "message"),
    [
        ([1.0], [1.0, 2.0, 1.0], "multiple"),
        ([1.0, 0.0, 0.0, 1.0], [1.0, 2.0], "at most one pole at infinity"),
        ([1.0 + 1j, 2.0], [1.0, 3.0], "complex"),
    ],
)
def test_refuses_what_has_no_such_expansion(numerator, denominator, message):
    with pytest.raises(ValueError, match=message):
        partial_fractions(TransferFunction.from_coefficients(numerator, denominator))
