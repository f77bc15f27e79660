"""Power laws, wrappers, shared and held parameters: the compiled kernel against formulas and complex analysis."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from strategies import language_impedance, language_with_u, repeatable, span, value_of_u, values_of_u

from bayes_impedance.errors import InputError
from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Element, Network, PowerLaw, Wrapped, parse
from bayes_impedance.network.parameters import LOG, LOGIT, QUANTITIES, SIGNED, Parameter, Symbol

FREQUENCY = np.array([0.037, 0.11, 0.41, 1.3, 5.9, 17.7])
S = 2j * np.pi * FREQUENCY

BODY = "(n71|r71)-(m71|(r72-n72))"
WRAPPERS = (
    *(f"{word}[{letter}1{mark}]({BODY})" for word, letter, mark in (
        ("delay", "d", ""), ("delay", "d", "*"), ("highpass", "f", ""), ("highpass", "f", "*"), ("lowpass", "t", ""),
        ("lowpass", "t", "*"), ("gain", "g", ""), ("gain", "g", "*"), ("offset", "m", ""), ("offset", "m", "*"),
        ("offset", "r", "*"), ("offset", "k", ""), ("offset", "k", "*"), ("line_free", "m", ""),
        ("line_free", "r", "*"), ("line_fixed", "m", ""), ("line_fixed", "r", ""), ("line_matched", "m", ""),
        ("line_matched", "r", "*"),
    )),
    "hysteretic[e1](n1)",
    "m1|hysteretic[e1](n1)",
    f"reflex[k1,d1,f1]({BODY})",
    f"reflex[k1*,d1*,f1*]({BODY})",
    f"m9|reflex[k1=2.5,d1,f1]({BODY})",
    f"reflex[r1,d1,f1]({BODY})",
    f"squeeze_film[r1,t1]({BODY})",
    f"m9|squeeze_film[r1*,t1*]({BODY})",
)  # fmt: skip
POWER_LAWS = ("p1^a1", "p1^b1@3|n1", "p1*^a1*@0.2-m1", "p1^0.5-r1", "p1=2^a1|(r1-n1)", "p1^b1=1.25@7")
EVERYTHING = (*WRAPPERS, *POWER_LAWS)

LONG = np.finfo(np.longdouble).eps < 1e-18
RADIUS = np.longdouble(1e-7 if LONG else 1e-4)
ROOTS_OF_ONE = np.exp(np.arange(16) * (1j * np.arccos(np.longdouble(-1)) / 8))

ALMOST_ZERO = -60.0
"""u of a positive coefficient that is as small as none: exp(-60) is 1e-26."""


def some_u(network: Network, seed: int, sign: float) -> np.ndarray:
    """Values across the span of every letter; signed ones with the given sign."""
    rng = np.random.default_rng(seed)
    result = []
    for p in (p for p in network.parameters if not p.held):
        low, high = span(p.letter)
        x = rng.uniform(low, high) if p.link == LOGIT else float(np.exp(rng.uniform(np.log(low), np.log(high))))
        result.append(sign * x if p.link == SIGNED else float(p.u(x)))
    return np.array(result)


def freed(network: Network, values: dict[str, float]) -> tuple[Network, dict[str, float]]:
    """The network with nothing held, and the values of all of its parameters."""
    values = dict(values)

    def free(symbol: Symbol, signed: bool = False) -> Symbol:
        if symbol.value is None:
            return symbol
        name = symbol.name or f"{'b' if symbol.value > 1 else 'a'}_{len(values)}"
        values[name] = symbol.value
        return Symbol(name, shared=signed)

    def visit(node: Network) -> Network:
        if isinstance(node, Element):
            return Element(free(node.symbol).name)
        if isinstance(node, PowerLaw):
            return PowerLaw(free(node.size), free(node.exponent), node.reference_hz)
        if isinstance(node, Wrapped):
            signed = [node.construct.signed and i == 0 for i in range(len(node.symbols))]
            return Wrapped(node.construct, tuple(map(free, node.symbols, signed)), visit(node.part))
        return type(node)(tuple(visit(part) for part in node.parts), node.label)

    return visit(network), values


def amplification(network: Network, u: np.ndarray, frequency: np.ndarray = FREQUENCY) -> np.ndarray:
    """How much larger relative errors of z are than those of the parameters, shape (F,): at least one."""
    free, values = freed(network, values_of_u(network, u))
    z, dz = Kernel(free).derivative(np.array([float(p.u(values[p.name])) for p in free.parameters]), frequency)
    size = np.array([abs(values[p.name]) if p.link == SIGNED else 1.0 for p in free.parameters])
    return 1 + np.sum(np.abs(dz) * size[:, None], axis=0) / np.abs(z)


def assert_derivative_by_cauchy(network: Network, u: np.ndarray) -> None:
    """The kernel's dz/du against Cauchy's integral over the formulas, which are analytic in every u.

    Sixteen points on a circle are exact to (radius/distance of the next pole)^16; those of a line without losses may be
    as near as 1e-6. Rounding of z is divided by the radius, so numbers are long where the machine has such.
    """
    z, dz = Kernel(network).derivative(u, FREQUENCY)
    s, radius, circle = S.astype(np.clongdouble), RADIUS, ROOTS_OF_ONE
    for one, slope in zip(np.eye(u.size), dz, strict=True):
        around = [
            language_impedance(network, s, values_of_u(network, u + radius * turn * one)) / turn for turn in circle
        ]
        expected = (sum(around) / (radius * circle.size)).astype(complex)
        assert np.all(np.abs(slope - expected) <= 1e-11 * amplification(network, u) * np.abs(z))


# One by one


def test_everything_is_tried() -> None:
    tried = {node.construct.word for text in WRAPPERS for _, node in parse(text).walk() if hasattr(node, "construct")}
    assert tried == set(CONSTRUCTS)
    for construct in CONSTRUCTS.values():  # with every letter, and shared wherever that has a sign of its own
        for letter in construct.letters[0]:
            assert any(f"{construct.word}[{letter}1" in text for text in WRAPPERS)
        assert not construct.signed or any(f"{construct.word}[{construct.letters[0][0]}1*" in text for text in WRAPPERS)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("text", EVERYTHING)
def test_the_kernel_is_the_formula(text: str, sign: float) -> None:
    network = parse(text)
    for seed in range(3):
        u = some_u(network, seed, sign)
        values = values_of_u(network, u)
        z = Kernel(network).impedance(u, FREQUENCY)
        assert np.all(np.abs(z / network.impedance(S, values) - 1) < 1e-13 * amplification(network, u))
        assert np.all(np.abs(z / language_impedance(network, S, values) - 1) < 1e-13 * amplification(network, u))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("text", EVERYTHING)
def test_the_derivative_is_that_of_complex_analysis(text: str, sign: float) -> None:
    network = parse(text)
    u = some_u(network, 4, sign)
    z, dz = Kernel(network).derivative(u, FREQUENCY)
    np.testing.assert_array_equal(z, Kernel(network).impedance(u, FREQUENCY))
    assert_derivative_by_cauchy(network, u)
    assert np.all(np.abs(dz).max(axis=1) > 0)


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e-3, 0.03])
@pytest.mark.parametrize("text", [text for text in WRAPPERS if "line_" in text])
def test_thin_lines_are_as_exact_as_thick_ones(text: str, size: float) -> None:
    """Where the closed formulas cancel, power series take over; both belong to one function."""
    network = parse(text)
    u = some_u(network, 1, 1.0)
    u[0] = np.log(size)
    z = Kernel(network).impedance(u, FREQUENCY)
    exact = language_impedance(network, S.astype(np.clongdouble), values_of_u(network, u.astype(np.longdouble)))
    np.testing.assert_allclose(z, exact.astype(complex), rtol=1e-13)
    ends = {"line_free": lambda y, z: z + y / 3, "line_fixed": lambda y, z: y}
    word = text.partition("[")[0]
    if word in ends and size < 1e-6:
        inner = parse(BODY).impedance(S, values_of_u(network, u))
        along = size * (S if "[m" in text else 1)
        assert np.all(np.abs(z / ends[word](along, inner) - 1) < np.abs(along / inner) + 1e-14)
    assert_derivative_by_cauchy(network, u)


@pytest.mark.parametrize("text", [text for text in WRAPPERS if text.split("[")[0] in CONSTRUCTS])
def test_without_its_coefficient_a_wrapper_does_nothing(text: str) -> None:
    network = parse(text)
    word = text.partition("[")[0]
    u = some_u(network, 5, 1.0)
    inner = network.parts[0]
    rest = {name: value for name, value in values_of_u(network, u).items() if name in inner.elements}
    u[0] = 0.0 if network.parameters[0].link == SIGNED or word == "gain" else ALMOST_ZERO
    z = Kernel(network).impedance(u, FREQUENCY)
    without = {"line_fixed": 0, "line_matched": 0}.get(word, 1) * inner.impedance(S, rest)
    np.testing.assert_allclose(z, without, rtol=1e-13, atol=1e-10 if not without.any() else 0)


@pytest.mark.parametrize("text", [text for text in WRAPPERS if parse(text).parameters[0].link == SIGNED])
def test_signed_parameters_pass_zero_smoothly(text: str) -> None:
    """The formulas of the two signs have one slope at zero, so that optimisers and chains can cross it."""
    network = parse(text)
    u, one = some_u(network, 6, 1.0), np.eye(len(network.elements))[0]
    u[0] = 0.0
    kernel, h = Kernel(network), 1e-6
    slope = kernel.derivative(u, FREQUENCY)[1][0]
    for side in (1, -1):
        z, near, far = (kernel.impedance(u + k * side * h * one, FREQUENCY) for k in (0, 1, 2))
        np.testing.assert_allclose((4 * near - far - 3 * z) / (2 * side * h), slope, rtol=1e-5)


def test_a_lossless_line_without_end_is_a_damper() -> None:
    """y/z is negative there, and the sign of its root a matter of rounding: a wave that leaves takes energy along."""
    network = parse("line_matched[m1](n1)")
    z = Kernel(network).impedance(np.log([3.0, 0.75]), FREQUENCY)
    np.testing.assert_allclose(z, 2.0, rtol=1e-14)
    np.testing.assert_allclose(network.impedance(S, {"m1": 3.0, "n1": 0.75}), 2.0, rtol=1e-14)


def test_scales_of_signed_parameters() -> None:
    network = parse("offset[m1*](highpass[f1*](r1))")
    z = Kernel(network, scales={"m1": 0.01, "f1": 2.0}).derivative([3.0, -0.5, 0.1], FREQUENCY)
    plain = Kernel(network).derivative([0.03, -1.0, 0.1], FREQUENCY)
    np.testing.assert_allclose(z[0], plain[0], rtol=1e-14)
    np.testing.assert_allclose(z[1], plain[1] * np.array([[0.01], [2.0], [1.0]]), rtol=1e-13)


# Random networks


@repeatable
@given(language_with_u())
def test_any_network_is_its_formula(network_and_u) -> None:
    network, u = network_and_u
    z, values = Kernel(network).impedance(u, FREQUENCY), values_of_u(network, u)
    reference, by_hand = network.impedance(S, values), language_impedance(network, S, values)
    limit = 1e-12 * amplification(network, u)
    assert np.all(np.abs(z - reference) <= limit * np.abs(reference))
    assert np.all(np.abs(z - by_hand) <= limit * np.abs(by_hand))


@repeatable
@given(language_with_u(max_leaves=5))
def test_any_derivative_is_that_of_complex_analysis(network_and_u) -> None:
    network, u = network_and_u
    assert_derivative_by_cauchy(network, u)


@repeatable
@given(language_with_u(passive=True))
def test_networks_of_passive_parts_are_passive(network_and_u) -> None:
    network, u = network_and_u
    frequency = np.geomspace(1e-3, 1e3, 97)
    z = Kernel(network).impedance(u, frequency)
    rounding = 1e-13 * amplification(network, u, frequency) * np.abs(z)
    assert np.all(z.real >= -rounding)


# Shared and held


def marked(network: Network, mark: str) -> str:
    """The network's text with a mark on the parameters that are free and not signed when they are shared."""
    return re.sub(r"\b([mnrpabgke]\d+)\b(?![=*])", rf"\1{mark}", str(network))


@repeatable
@given(language_with_u())
def test_held_equals_free_at_that_value(network_and_u) -> None:
    """By the kernel, one after the other; rounding is the same, so every bit is."""
    network, u = network_and_u
    free = Kernel(network)
    z, dz = free.derivative(u, FREQUENCY)
    for k in range(min(3, u.size)):
        held = free.holding({free.elements[k]: float(u[k])})
        assert held.elements == tuple(np.delete(free.elements, k))
        assert held.parameters == tuple(p for p in free.parameters if p.name != free.elements[k])
        some = held.derivative(np.delete(u, k), FREQUENCY)
        np.testing.assert_array_equal(some[0], z)
        np.testing.assert_array_equal(some[1], np.delete(dz, k, axis=0))


@pytest.mark.parametrize("text", EVERYTHING)
def test_held_in_the_text_equals_free_at_that_value(text: str) -> None:
    network = parse(text)
    u = some_u(network, 7, 1.0)
    values = values_of_u(network, u)
    z, dz = Kernel(network).derivative(u, FREQUENCY)
    free = [p for p in network.parameters if not p.held]
    for k, p in enumerate(free):
        written = re.sub(rf"\b{p.name}\b\*?", f"{p.name}={float(values[p.name])!r}", str(network))
        held = Kernel(parse(written))
        assert held.elements == tuple(name for name in network.elements if name != p.name)
        some = held.derivative(np.delete(u, k), FREQUENCY)
        np.testing.assert_allclose(some[0], z, rtol=1e-12)
        np.testing.assert_allclose(some[1], np.delete(dz, k, axis=0), rtol=1e-10, atol=1e-12 * np.abs(z).max())


@pytest.mark.parametrize("text", [*POWER_LAWS, "(n1|r1)-m1", "gain[g1](n1)", "line_free[m1](r1)", "hysteretic[e1](n1)"])
def test_what_is_shared_is_computed_alike(text: str) -> None:
    network = parse(text.replace("*", ""))
    shared = parse(marked(network, "*"))
    assert all(p.shared for p in shared.parameters if not p.held)
    assert not any(p.shared for p in network.parameters)
    u = some_u(network, 8, 1.0)
    for one, other in zip(*(Kernel(n).derivative(u, FREQUENCY) for n in (network, shared)), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("word", [word for word, construct in CONSTRUCTS.items() if construct.signed])
def test_what_is_shared_and_signed_has_another_scale_only(word: str) -> None:
    letter = CONSTRUCTS[word].letters[0][0]
    own, shared = (Kernel(parse(f"{word}[{letter}1{mark}](r1|n1)")) for mark in ("", "*"))
    u = some_u(own.network, 9, 1.0)
    value = own.parameters[0].value(u[0])
    np.testing.assert_allclose(shared.impedance([value, *u[1:]], FREQUENCY), own.impedance(u, FREQUENCY), rtol=1e-14)
    assert [k.parameters[0].link for k in (own, shared)] == [LOG, SIGNED]


# Values and u


@pytest.mark.parametrize("letter", QUANTITIES)
@pytest.mark.parametrize("link", [LOG, LOGIT, SIGNED])
def test_value_and_u_are_inverse(letter: str, link: str) -> None:
    if (link == LOGIT) != (letter in "ab"):
        return
    parameter = Parameter(symbol=Symbol(f"{letter}1"), letter=letter, link=link)
    u = np.linspace(-3, 3, 7)
    np.testing.assert_allclose(parameter.value(u), value_of_u(parameter, u), rtol=1e-14)
    np.testing.assert_allclose(parameter.u(parameter.value(u)), u, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("m1=0", "mass 'm1' cannot be 0.0: it must be above zero and finite"),
        ("m1|n1=-2", "compliance 'n1' cannot be -2.0: it must be above zero and finite"),
        ("r1=1e999", "damper 'r1' cannot be inf: it must be above zero and finite"),
        ("p1^1", "exponent 'a' cannot be 1.0: it must be between 0 and 1"),
        ("p1^-0.5", "exponent 'a' cannot be -0.5: it must be between 0 and 1"),
        ("p1^b1=0.5", "exponent 'b1' cannot be 0.5: it must be between 1 and 2"),
        ("delay[d1=1e999](m1)", "delay 'd1' cannot be inf: it must be finite"),
        ("gain[g1=-1](m1)", "gain 'g1' cannot be -1.0: it must be above zero and finite"),
    ],
)
def test_values_that_cannot_be_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        parse(text)
