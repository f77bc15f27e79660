"""Transfer functions: exact on fractions, minimal in degree, and eq. 4 of the paper with its misprints."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from conftest import published
from experiments import PAPER, printed_eq4, printed_tissue, random_elements
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from strategies import build as build_network
from strategies import networks, networks_with_elements, repeatable, shape_impedance, shapes, shapes_with_elements

from bayes_impedance.network.notation import parse
from bayes_impedance.network.rational import TransferFunction

PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71)
positive_fractions = st.fractions(Fraction(1, 50), 50, max_denominator=50)


def corrected_eq4(s, v):
    """Eq. 4 with r3 in the skin's term and +s^2 m2 n1 in the tissue's."""
    skin = s * v["n3"] / (s * v["r3"] * v["n3"] + 1)
    limb = 1 / (1 / (s * v["m1"]) + s * v["n2"] / (s * v["n2"] * v["r2"] + 1))
    tissue = (s**2 * v["m2"] * v["n1"] + s * v["n1"] * v["r1"] + 1) / (s * v["n1"]) + limb
    return 1 / (skin + 1 / tissue)


def exactly(polynomial, s):
    return sum(coefficient * s**i for i, coefficient in enumerate(polynomial))


def degree_of_common_factor(a, b):
    """Euclid's algorithm on polynomials with Fraction coefficients, ascending."""
    a, b = [Fraction(c) for c in a], [Fraction(c) for c in b]
    while any(b):
        while not b[-1]:
            b.pop()
        while len(a) >= len(b):
            factor, shift = a[-1] / b[-1], len(a) - len(b)
            a = [c - (factor * b[i - shift] if i >= shift else 0) for i, c in enumerate(a)][:-1]
        a, b = b, a or [Fraction(0)]
    return len(a) - 1


def prime_values(network):
    """Values that are in no special relation to each other."""
    return {name: Fraction(p, q) for name, (p, q) in zip(network.elements, pairwise(PRIMES), strict=False)}


@repeatable
@given(shapes(max_leaves=8), st.data())
def test_fractions_are_exact(shape, data):
    network = build_network(shape)
    values = {name: data.draw(positive_fractions) for name in network.elements}
    transfer = network.transfer_function(values)
    for s in (Fraction(1, 7), Fraction(3, 2), Fraction(29)):
        numerator, denominator = (exactly(polynomial, s) for polynomial in transfer.ascending)
        expected = shape_impedance(shape, s, values)
        assert isinstance(expected, Fraction)
        assert numerator / denominator == expected
        assert transfer(s) == expected
    assert all(c >= 0 for polynomial in transfer.ascending for c in polynomial)


@repeatable
@given(shapes_with_elements())
def test_floats_agree_with_the_impedance(shape_and_values):
    shape, values = shape_and_values
    network = build_network(shape)
    s = np.array([0.01, 0.3, 4.0, 0.2 + 1j, 1.7 - 0.4j])  # to the right of all poles: well conditioned
    np.testing.assert_allclose(network.transfer_function(values)(s), network.impedance(s, values), rtol=1e-12)


@repeatable
@given(networks(max_leaves=8))
def test_degrees_are_minimal(network):
    numerator, denominator = network.transfer_function(prime_values(network)).ascending
    assert numerator[-1] != 0
    assert denominator[-1] != 0
    assert numerator[0] != 0 or denominator[0] != 0  # no common power of s
    assert degree_of_common_factor(numerator, denominator) == 0
    assert abs(len(numerator) - len(denominator)) <= 1  # as every positive real function


def test_degree_of_common_factor_is_right():
    assert degree_of_common_factor((2, 3, 1), (3, 4, 1)) == 1  # (s+1)(s+2), (s+1)(s+3)
    assert degree_of_common_factor((2, 3, 1), (12, 7, 1)) == 0
    assert degree_of_common_factor((0, 2, 3, 1), (0, 2, 3, 1)) == 3


# The paper's network


def test_paper_network_is_5_over_5_with_a_pole_at_zero():
    numerator, denominator = PAPER.transfer_function(prime_values(PAPER)).ascending
    assert (len(numerator), len(denominator)) == (6, 6)
    assert denominator[0] == 0
    assert 0 not in numerator
    assert 0 not in denominator[1:]


def test_paper_network_has_ten_coefficients_for_eight_elements():
    """The map from elements to coefficients has full rank: over-determined, and not under-determined."""

    def coefficients(logarithms):
        values = dict(zip(PAPER.elements, np.exp(logarithms), strict=True))
        numerator, denominator = PAPER.transfer_function(values).normalised().ascending
        assert denominator[-1] == 1
        return np.log([*numerator, *denominator[1:-1]])

    centre = np.linspace(-1.0, 1.0, 8) ** 3
    jacobian = np.array([coefficients(centre + h) - coefficients(centre - h) for h in 1e-5 * np.eye(8)]) / 2e-5
    assert jacobian.shape == (8, 10)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    assert singular[-1] > 1e-3 * singular[0]


@repeatable
@given(st.lists(positive_fractions, min_size=8, max_size=8))
def test_paper_network_is_the_corrected_eq4(values):
    v = dict(zip(PAPER.elements, values, strict=True))
    transfer = PAPER.transfer_function(v)
    for s in (Fraction(2, 9), Fraction(5)):
        assert transfer(s) == corrected_eq4(s, v)
    s = 2j * np.pi * np.geomspace(5, 5000, 50)
    floats = {name: float(value) for name, value in v.items()}
    np.testing.assert_allclose(PAPER.impedance(s, floats), corrected_eq4(s, floats), rtol=1e-10)


def test_corrected_eq4_is_positive_real():
    """Passive: Re z >= 0 on and to the right of the imaginary axis."""
    omega = np.geomspace(1e-6, 1e6, 301)
    s = np.concatenate([1j * omega, *(omega * np.exp(1j * angle) for angle in (0, 0.4, 0.8, 1.2, 1.5, -0.7))])
    for v in random_elements():
        assert corrected_eq4(s, v).real.min() >= 0


def test_printed_eq4_is_not_positive_real():
    """With -s^2 m2 n1 the tissue's mass is negative: for some real s > 0, a growing motion, z itself is negative.

    On the imaginary axis nothing is to be seen, since -j w m2 has no real part; the function has a pole to its right.
    """
    for v in random_elements():
        zero = brentq(lambda x, v=v: printed_tissue(np.exp(x), v), -60, 60)
        s = np.exp(zero) * (1 + 1e-6)
        assert printed_eq4(s, v) < 0
        assert corrected_eq4(s, v) > 0
        # Further to the right the mobility goes through zero: a pole of z, growth without a cause.
        above = np.exp(zero + np.geomspace(1e-6, 60, 4000))
        mobility = 1 / printed_eq4(above, v)
        assert mobility[0] < 0 < mobility[-1]


def test_printed_eq4_does_not_know_the_skins_damper():
    s = 2j * np.pi * np.geomspace(5, 5000, 20)
    v = dict(zip(PAPER.elements, np.linspace(0.2, 1.6, 8), strict=True))
    other = v | {"r3": 10 * v["r3"]}
    np.testing.assert_array_equal(printed_eq4(s, v), printed_eq4(s, other))
    assert np.abs(PAPER.impedance(s, other) / PAPER.impedance(s, v) - 1).max() > 1
    assert np.abs(printed_eq4(s, v) / PAPER.impedance(s, v) - 1).max() > 0.1


def test_appendix_sit_has_the_form_of_eq4_and_the_opposite_sign():
    """The SIT curve of appendix A: 5/5, no constant term below, and -z is what has a positive real part."""
    printed = published("sit", sign=1)
    assert [len(p) for p in printed.ascending] == [6, 6]
    assert printed.ascending[1][0] == 0
    s = 2j * np.pi * np.geomspace(5, 5000, 401)
    assert np.mean(printed(s).real < 0) > 0.95


# Poles and operations


@repeatable
@given(networks_with_elements(max_leaves=8))
def test_poles_and_zeros_are_in_the_closed_left_half_plane(network_and_elements):
    network, log_elements = network_and_elements
    transfer = network.transfer_function(dict(zip(network.elements, np.exp(log_elements).tolist(), strict=True)))
    for roots, polynomial in ((transfer.poles(), transfer.denominator), (transfer.zeros(), transfer.numerator)):
        assert roots.size == polynomial.size - 1
        assert np.all(roots.real <= 1e-6 * np.abs(roots))


def test_poles_and_zeros_of_a_known_function():
    transfer = TransferFunction.from_coefficients((3, 9, 6), (1, 7, 12, 0))
    np.testing.assert_allclose(np.sort(transfer.zeros()), [-2, -1], rtol=1e-12)
    np.testing.assert_allclose(np.sort(transfer.poles()), [-4, -3, 0], atol=1e-12)


def test_coefficients_are_descending():
    transfer = TransferFunction.from_coefficients((1, 2, 3), (4, 5))
    assert transfer.ascending == ((3, 2, 1), (5, 4))
    np.testing.assert_array_equal(transfer.numerator, [1, 2, 3])
    np.testing.assert_array_equal(transfer.denominator, [4, 5])
    assert transfer(2.0) == 11 / 13


@repeatable
@given(networks_with_elements(max_leaves=8))
def test_reciprocal_and_normalised(network_and_elements):
    network, log_elements = network_and_elements
    transfer = network.transfer_function(dict(zip(network.elements, np.exp(log_elements).tolist(), strict=True)))
    s = np.array([0.3, 2.0 + 1j])
    np.testing.assert_allclose(transfer.reciprocal()(s) * transfer(s), 1, rtol=1e-12)
    assert transfer.reciprocal().reciprocal() == transfer
    normalised = transfer.normalised()
    assert normalised.denominator[0] == 1
    np.testing.assert_allclose(normalised(s), transfer(s), rtol=1e-12)


def test_normalised_keeps_fractions_exact():
    transfer = PAPER.transfer_function(prime_values(PAPER))
    normalised = transfer.normalised()
    assert all(isinstance(c, Fraction) for polynomial in normalised.ascending for c in polynomial)
    assert normalised(Fraction(3, 7)) == transfer(Fraction(3, 7))


@pytest.mark.parametrize(
    ("notation", "numerator", "denominator"),
    [
        ("m1", (2, 0), (1,)),
        ("n1", (1,), (3, 0)),
        ("m1|n1", (6, 0, 1), (3, 0)),
        ("m1-n1", (2, 0), (6, 0, 1)),
        ("m1-m2", (10, 0), (7,)),
        ("n1|n2", (10,), (21, 0)),
        ("r1|m1|n1", (6, 33, 1), (3, 0)),
    ],
)
def test_small_networks_by_hand(notation, numerator, denominator):
    values = {"m1": 2, "m2": 5, "n1": 3, "n2": 7, "r1": 11}
    transfer = parse(notation).transfer_function(values)
    np.testing.assert_array_equal(transfer.numerator, numerator)
    np.testing.assert_array_equal(transfer.denominator, denominator)
