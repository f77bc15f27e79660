"""The compiled impedance and its derivative against plain recursion and complex analysis."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from strategies import network_impedance, networks_with_elements, repeatable

import bayes_impedance.network.kernel as kernel_module
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import COMPLIANCE, DAMPER, KINDS, MASS, band_scale, kind_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, Element, Parallel, Series, parse

FREQUENCY = np.array([0.037, 0.11, 0.41, 1.3, 5.9, 17.7])
S = 2j * np.pi * FREQUENCY


def by_name(network, log_elements):
    return dict(zip(network.elements, np.exp(log_elements), strict=True))


def analytic_derivative(network, theta, s):
    """dz/dtheta by Cauchy's integral around theta: z is analytic in every log element. Shape (P, F).

    For real theta, Re z and Im z as functions of theta are (z(s) +- z(-s))/2; the derivatives of these two analytic
    functions are returned as real and imaginary part. Sixteen points on a circle are exact to (radius/distance of the
    next pole)^16.
    """
    radius, angles = 1e-2, 2j * np.pi * np.arange(16) / 16
    result = []
    for p in range(len(network.elements)):
        total = np.zeros((2, s.size), dtype=complex)
        for angle in angles:
            shifted = theta + radius * np.exp(angle) * (np.arange(theta.size) == p)
            ahead, behind = (network_impedance(network, sign * s, by_name(network, shifted)) for sign in (1, -1))
            total += np.array([(ahead + behind) / 2, (ahead - behind) / 2j]) * np.exp(-angle)
        real, imag = total / radius / angles.size
        result.append(real.real + 1j * imag.real)
    return np.array(result)


@repeatable
@given(networks_with_elements())
def test_impedance_equals_the_recursion(network_and_elements):
    network, theta = network_and_elements
    z = Kernel(network).impedance(theta, FREQUENCY)
    np.testing.assert_allclose(z, network.impedance(S, by_name(network, theta)), rtol=1e-12)


@repeatable
@given(networks_with_elements())
def test_derivative_equals_complex_analysis(network_and_elements):
    network, theta = network_and_elements
    z, dz = Kernel(network).derivative(theta, FREQUENCY)
    expected = analytic_derivative(network, theta, S)
    np.testing.assert_array_equal(z, Kernel(network).impedance(theta, FREQUENCY))
    assert dz.shape == expected.shape
    # An element that hardly matters has a derivative that no difference of z can show to nine digits of its own.
    assert np.all(np.abs(dz - expected) <= 1e-9 * np.abs(expected) + 1e-12 * np.abs(z))


@repeatable
@given(networks_with_elements())
def test_derivative_is_homogeneous(network_and_elements):
    """All masses and dampers c times, all compliances 1/c times: z is c times. Euler: sum of +-dz/dtheta is z."""
    network, theta = network_and_elements
    z, dz = Kernel(network).derivative(theta, FREQUENCY)
    exponents = np.array([kind_of(name).exponent for name in network.elements])
    np.testing.assert_allclose(exponents @ dz, z, rtol=1e-10)


@repeatable
@given(networks_with_elements())
def test_networks_are_passive(network_and_elements):
    network, theta = network_and_elements
    assert np.all(Kernel(network).impedance(theta, np.geomspace(1e-3, 1e3, 97)).real >= 0)


def dual(node):
    """Series for parallel, masses for compliances and conductances for resistances: the network of 1/z."""
    if isinstance(node, Element):
        return Element({"m": "n", "n": "m", "r": "r"}[node.name[0]] + node.name[1:])
    kind = {Parallel: Series, Series: Parallel}[type(node)]
    return kind(tuple(dual(part) for part in node.parts)).labelled(node.label)


@repeatable
@given(networks_with_elements())
def test_dual_network_has_the_reciprocal_impedance(network_and_elements):
    network, theta = network_and_elements
    signs = np.array([-1.0 if name[0] == "r" else 1.0 for name in network.elements])
    z = Kernel(network).impedance(theta, FREQUENCY)
    np.testing.assert_allclose(Kernel(dual(network)).impedance(signs * theta, FREQUENCY), 1 / z, rtol=1e-12)


# Shapes


@pytest.mark.parametrize("lead", [(), (1,), (5,), (2, 3), (0,), (2, 1, 4)])
def test_leading_axes_are_kept(lead):
    kernel = Kernel(parse(PAPER_NETWORK))
    theta = np.random.default_rng(1).normal(size=(*lead, 8))
    z = kernel.impedance(theta, FREQUENCY)
    z_again, dz = kernel.derivative(theta, FREQUENCY)
    assert z.shape == z_again.shape == (*lead, FREQUENCY.size)
    assert dz.shape == (*lead, 8, FREQUENCY.size)
    for index in np.ndindex(lead):
        np.testing.assert_array_equal(z[index], kernel.impedance(theta[index], FREQUENCY))
        np.testing.assert_array_equal(dz[index], kernel.derivative(theta[index], FREQUENCY)[1])


def test_layout_of_the_input_does_not_matter():
    kernel = Kernel(parse(PAPER_NETWORK))
    theta = np.random.default_rng(1).normal(size=(3, 8))
    expected = kernel.impedance(theta, FREQUENCY)
    np.testing.assert_array_equal(kernel.impedance(np.asfortranarray(theta), FREQUENCY), expected)
    np.testing.assert_array_equal(kernel.impedance(theta.tolist(), FREQUENCY.tolist()), expected)
    np.testing.assert_array_equal(kernel.impedance(np.repeat(theta, 2, axis=1)[:, ::2], FREQUENCY), expected)
    np.testing.assert_array_equal(kernel.impedance(theta, np.repeat(FREQUENCY, 2)[::2]), expected)


@pytest.mark.parametrize("shape", [(2,), (4,), (3, 2), ()])
def test_wrong_shape_is_refused(shape):
    message = f"log_elements has shape {shape}: its last axis must be the 3 elements n1, m1, r1"
    kernel = Kernel(parse("n1|(m1-r1)"))
    for method in (kernel.impedance, kernel.derivative):
        with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
            method(np.zeros(shape), FREQUENCY)


def test_elements_are_ordered_as_written():
    kernel = Kernel(parse("n1|(m1-r1)|n2"))
    assert kernel.elements == ("n1", "m1", "r1", "n2")
    n1, m1, r1, n2 = theta = np.log([0.3, 2.0, 5.0, 0.7])
    expected = 1 / (S * np.exp(n1)) + 1 / (1 / (S * np.exp(m1)) + np.exp(-r1)) + 1 / (S * np.exp(n2))
    np.testing.assert_allclose(kernel.impedance(theta, FREQUENCY), expected, rtol=1e-13)


def test_labels_do_not_change_the_impedance():
    """A labelled group of its parent's kind stays a node of its own, and passes its sum on as it is."""
    theta = np.log([0.3, 2.0, 5.0, 0.7])
    for labelled, plain in (("a:(m1|n1)|r1|n2", "m1|n1|r1|n2"), ("m1-b:(n1-c:(r1-n2))", "m1-n1-r1-n2")):
        one, other = (Kernel(parse(notation)).derivative(theta, FREQUENCY) for notation in (labelled, plain))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-13)


def test_one_compilation_serves_all_networks():
    """A network is data: after the first one nothing is compiled, whatever the tree and the number of elements."""
    functions = (kernel_module._impedance, kernel_module._derivative)
    Kernel(parse("m1|r1")).derivative(np.zeros(2), FREQUENCY)
    Kernel(parse("m1|r1")).impedance(np.zeros(2), FREQUENCY)
    before = [list(function.signatures) for function in functions]
    assert all(len(signatures) == 1 for signatures in before)
    for notation in (PAPER_NETWORK, "n1", "(m1-n1)|(r1-(m2|r2))-n2"):
        kernel = Kernel(parse(notation))
        kernel.derivative(np.zeros((2, len(kernel.elements))), FREQUENCY[:3])
        kernel.impedance(np.zeros(len(kernel.elements)), FREQUENCY)
    assert [list(function.signatures) for function in functions] == before


# Kinds of element and their units


@pytest.mark.parametrize(
    ("kind", "z", "unit", "henry"),
    [
        (MASS, 2j * np.pi * 50 * 0.2, "kg", "H"),
        (COMPLIANCE, 1 / (2j * np.pi * 50 * 0.2), "m/N", "F"),
        (DAMPER, 0.2, "N s/m", "ohm"),
    ],
)
def test_kinds(kind, z, unit, henry):
    """Newton, Hooke and a damper; by the force-voltage analogy inductance, capacitance and resistance."""
    assert kind.impedance(2j * np.pi * 50, 0.2) == pytest.approx(z, rel=1e-14)
    assert kind.unit("N s/m") == unit
    assert kind.unit("ohm") == henry
    assert kind.value_at(abs(z), 50.0) == pytest.approx(0.2, rel=1e-12)
    assert band_scale(f"{kind.letter}7", abs(z), 50.0) == pytest.approx(np.log(0.2), rel=1e-12)


def test_rotational_and_unknown_units():
    assert [kind.unit("N m s/rad") for kind in KINDS.values()] == ["kg m^2", "rad/(N m)", "N m s/rad"]
    assert [kind.unit("Pa s/m") for kind in KINDS.values()] == ["Pa s/m s", "s/(Pa s/m)", "Pa s/m"]


def test_unknown_kind_is_refused():
    for name in ("k1", "M1", ""):
        with pytest.raises(InputError, match=f"element '{name}' is of no known kind"):
            kind_of(name)


def test_battery_circuit_is_a_network():
    """R0 - p(R1,C1) - p(R2,C2): parts in series carry one current, which is the velocity, so impedances add."""
    r0, r1, c1, r2, c2 = 0.02, 0.05, 1.3, 0.08, 40.0
    network = parse("r0|(r1-n1)|(r2-n2)")
    z = Kernel(network).impedance(np.log([r0, r1, c1, r2, c2]), FREQUENCY)
    np.testing.assert_allclose(z, r0 + r1 / (1 + S * r1 * c1) + r2 / (1 + S * r2 * c2), rtol=1e-13)
    assert [kind_of(name).unit("ohm") for name in network.elements] == ["ohm", "ohm", "F", "ohm", "F"]


@pytest.mark.parametrize(
    "notation", [PAPER_NETWORK, "(m1-n1-(n2|m2))|r1|(r2-n3)", "m1|r1|n1", "(n1-r1)|(n2-r2)|(n3-r3)|m1"]
)
def test_elements_with_more_damping_are_the_recursion_at_complex_frequencies(notation):
    network, zeta = parse(notation), 0.2
    program = Kernel(network).program
    theta = np.random.default_rng(5).normal(size=len(network.elements))
    omega = 2 * np.pi * FREQUENCY

    def impedance(theta):
        sums, outputs = kernel_module.workspace(program, omega, zeta)
        kernel_module.forward(program, theta, omega, sums, outputs)
        return sums, outputs, outputs[-2, 0] + 1j * outputs[-2, 1]

    sums, outputs, z = impedance(theta)
    np.testing.assert_allclose(z, network_impedance(network, omega * (1j + zeta), by_name(network, theta)), rtol=1e-12)
    adjoints, rows = np.zeros((len(outputs), 2, omega.size)), np.empty((theta.size, 2, omega.size))
    adjoints[-1, 0] = 1.0
    kernel_module.backward(program, theta, omega, sums, outputs, adjoints, rows)
    for p, step in enumerate(1e-6 * np.eye(theta.size)):
        slope = (impedance(theta + step)[2] - impedance(theta - step)[2]) / 2e-6
        np.testing.assert_allclose(rows[p, 0] + 1j * rows[p, 1], slope, atol=1e-7 * np.abs(z).max())
