"""Circuits' spelling: round trips, and values against the formulas that impedance.py documents, written out here."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import networks, repeatable

from bayes_impedance.errors import InputError
from bayes_impedance.network.electrical import (
    CIRCUIT_ELEMENTS,
    electrical,
    is_circuit,
    values_from_circuit,
    values_to_circuit,
)
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, parse

OMEGA = 2 * np.pi * np.geomspace(1e-3, 1e5, 33)
JW = 1j * OMEGA

FORMULAS = {
    "R": lambda r: r + 0 * JW,
    "C": lambda c: 1 / (c * JW),
    "L": lambda inductance: inductance * JW,
    "W": lambda a: a * (1 - 1j) / np.sqrt(OMEGA),
    "Wo": lambda z0, tau: z0 / (np.sqrt(JW * tau) * np.tanh(np.sqrt(JW * tau))),
    "Ws": lambda z0, tau: z0 * np.tanh(np.sqrt(JW * tau)) / np.sqrt(JW * tau),
    "CPE": lambda q, alpha: 1 / (q * JW**alpha),
    "La": lambda inductance, alpha: inductance * JW**alpha,
}
"""Impedance of each element, as documented in impedance.models.circuits.elements."""

SPANS = {"CPE": ((1e-5, 10), (0.1, 0.9)), "La": ((1e-5, 10), (0.1, 0.9)), "Wo": ((0.1, 10), (1e-3, 10))}


def drawn(word: str, number: str, rng: np.random.Generator) -> dict[str, float]:
    """Values of one element by impedance.py's names."""
    count = FORMULAS[word].__code__.co_argcount
    spans = SPANS.get(word.replace("Ws", "Wo"), ((0.1, 10),))
    names = [f"{word}{number}"] if count == 1 else [f"{word}{number}_{i}" for i in range(count)]
    return {name: float(rng.uniform(*span)) for name, span in zip(names, spans, strict=True)}


def circuit_impedance(tree, values) -> np.ndarray:
    """Of a tree ("s" or "p", parts), whose leaves are (word, number)."""
    kind, rest = tree
    if kind == "s":
        return sum(circuit_impedance(part, values) for part in rest)
    if kind == "p":
        return 1 / sum(1 / circuit_impedance(part, values) for part in rest)
    own = [v for name, v in values.items() if re.fullmatch(rf"{kind}{rest}(_\d)?", name)]
    return FORMULAS[kind](*own)


def spelled(tree, inside_p=False) -> str:
    kind, rest = tree
    if kind == "s":
        return "-".join(spelled(part) for part in rest)
    return f"p({','.join(spelled(part) for part in rest)})" if kind == "p" else f"{kind}{rest}"


def alternating(tree, above=None):
    """The same with groups of one kind flattened, as networks are."""
    kind, rest = tree
    if kind not in ("s", "p"):
        return tree
    parts = []
    for part in (alternating(part) for part in rest):
        parts += part[1] if part[0] == kind else [part]
    return kind, tuple(parts)


@st.composite
def circuits(draw):
    """A tree of elements with numbers, each of which is used once."""
    leaf = st.sampled_from(sorted(FORMULAS))
    shape = draw(
        st.recursive(
            leaf,
            lambda parts: st.tuples(st.sampled_from("sp"), st.lists(parts, min_size=2, max_size=3)),
            max_leaves=8,
        )
    )
    used: dict[str, int] = {}

    def numbered(shape):
        if isinstance(shape, str):
            used[shape] = used.get(shape, -1) + 1
            return shape, str(used[shape])
        return shape[0], tuple(numbered(part) for part in shape[1])

    return numbered(shape)


def leaves(tree):
    return [leaf for part in tree[1] for leaf in leaves(part)] if tree[0] in ("s", "p") else [tree]


def test_every_element_has_its_formula() -> None:
    assert set(FORMULAS) == set(CIRCUIT_ELEMENTS)


@pytest.mark.parametrize("word", CIRCUIT_ELEMENTS)
def test_elements_have_the_published_impedance(word: str) -> None:
    for seed in range(5):
        values = drawn(word, "3", np.random.default_rng(seed))
        own = values_from_circuit(f"{word}3", values)
        network = parse(f"{word}3")
        assert set(own) == set(network.elements)
        z = network.impedance(JW, own)
        np.testing.assert_allclose(z, FORMULAS[word](*values.values()), rtol=1e-12)
        u = [float(p.u(own[p.name])) for p in network.parameters if not p.held]
        np.testing.assert_allclose(Kernel(network).impedance(u, OMEGA / 2 / np.pi), z, rtol=1e-12)
        back = values_to_circuit(f"{word}3", own)
        assert list(back) == list(values)
        np.testing.assert_allclose(list(back.values()), list(values.values()), rtol=1e-12)


def test_a_randles_cell() -> None:
    network = parse("R0-p(R1-Wo1,CPE1)")
    assert str(network) == "r0|((r1|line_free[rWo1](nWo1))-p1^a1)"
    values = {"R0": 0.01, "R1": 0.02, "Wo1_0": 0.05, "Wo1_1": 30.0, "CPE1_0": 2.0, "CPE1_1": 0.85}
    z = network.impedance(JW, values_from_circuit("R0-p(R1-Wo1,CPE1)", values))
    diffusion = 0.05 / np.sqrt(JW * 30) / np.tanh(np.sqrt(JW * 30))
    np.testing.assert_allclose(z, 0.01 + 1 / (1 / (0.02 + diffusion) + 2 * JW**0.85), rtol=1e-12)


@repeatable
@given(circuits())
def test_any_circuit(tree) -> None:
    text = spelled(tree)
    assert is_circuit(text)
    network = parse(text)
    assert parse(str(network)) == network
    assert electrical(network) == spelled(alternating(tree))
    assert parse(electrical(network)) == network
    assert parse(text.replace("(", " ( ").replace("-", " -\n").replace(",", " ,")) == network
    rng, values = np.random.default_rng(1), {}
    for word, number in leaves(tree):
        values |= drawn(word, number, rng)
    z, expected = network.impedance(JW, values_from_circuit(text, values)), circuit_impedance(tree, values)
    # Around a resonance without losses, the sum is smaller than its terms.
    lossy = np.abs(expected.real) > 1e-3 * np.abs(expected)
    np.testing.assert_allclose(z[lossy], expected[lossy], rtol=1e-9)


@repeatable
@given(networks())
def test_networks_of_masses_springs_and_dampers_are_circuits(network: Network) -> None:
    assert not is_circuit(str(network))
    text = electrical(network)
    assert is_circuit(text)
    values = dict.fromkeys(network.elements, 0.7) | {name: 1 + 0.1 * k for k, name in enumerate(network.elements)}
    renamed = dict(zip(parse(text).elements, values.values(), strict=True))
    np.testing.assert_allclose(parse(text).impedance(JW, renamed), network.impedance(JW, values), rtol=1e-9)
    assert electrical(parse(text)) == text


@pytest.mark.parametrize(
    ("written", "text"),
    [
        ("n3|p4^a9", "C3-CPE4"),
        ("m_skin-r1", "p(L0,R1)"),
        ("x:(m1|n1)-r1", "p(L1-C1,R1)"),
        ("p3^0.5|pW3^0.5", "W0-W3"),
        ("r_a|r_b|r0|r1_1", "R1-R2-R0-R1_1"),
        ("line_free[r3](n9)-line_fixed[r3x](n9x)", "p(Wo3,Ws0)"),
        ("p1^b1", "La1"),
        ("r", "R"),
    ],
)
def test_numbers_of_elements(written: str, text: str) -> None:
    assert electrical(parse(written)) == text


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("m1*|r1", "'m1*' has no spelling in circuits: what is shared or held is no part of a circuit's text"),
        ("m1=3|r1", "'m1=3' has no spelling in circuits: what is shared or held is no part of a circuit's text"),
        ("r1|gain[g1](m1)", "'gain[g1](m1)' has no spelling in circuits: circuits have no such element"),
        ("line_free[m1](n1)", "'line_free[m1](n1)' has no spelling in circuits: circuits have no such element"),
        ("line_free[r1](n1|r2)", "'line_free[r1](n1|r2)' has no spelling in circuits: circuits have no such element"),
        ("p1^0.4", "'p1^0.4' has no spelling in circuits: circuits have no such element"),
        ("p1^a1@3", "'p1^a1@3' has no spelling in circuits: circuits have no such element"),
    ],
)
def test_what_circuits_cannot_say(written: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        electrical(parse(written))


ELEMENT = (
    "an element of circuits (R, C, L, CPE, La, W, Wo, Ws) or 'p('; names in a network of masses, compliances and "
    "dampers begin with a small letter"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("M1|N1", f"circuit 'M1|N1': 'M1' at character 1 is not {ELEMENT}"),
        ("R1-m1", f"circuit 'R1-m1': 'm1' at character 4 is not {ELEMENT}"),
        ("R1-", f"circuit 'R1-' ends too early: expected {ELEMENT}"),
        ("p(R1,)", f"circuit 'p(R1,)': ')' at character 6 is not {ELEMENT}"),
        ("p(R1", "circuit 'p(R1' ends too early: expected ')'"),
        ("R1|R2", "circuit 'R1|R2': '|' at character 3 is not '-' or the end, in the spelling of circuits"),
        ("R1-R1", "circuit 'R1-R1': 'R1' occurs twice: give each element a name of its own"),
        ("r1|R2", "element 'R2' is of no known kind: its first letter must be m (mass), n (compliance) or r (damper)"),
    ],
)
def test_what_cannot_be_read(text: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        parse(text)


def test_labels_may_begin_with_a_capital_letter() -> None:
    assert str(parse("Finger:(m1|n1)")) == "Finger:(m1|n1)"
    assert str(parse("R1:(m1|n1)-r2")) == "R1:(m1|n1)-r2"
    assert parse("p:(m1|n1)").label == "p"


def test_deep_circuits_are_refused() -> None:
    with pytest.raises(InputError, match="nested more than 50 levels"):
        parse("".join(f"p(R{k}," for k in range(400)) + "C0" + ")" * 400)


def test_missing_values_are_named() -> None:
    with pytest.raises(InputError, match="'CPE1_1' has no value: there are values for R0, CPE1_0"):
        values_from_circuit("R0-CPE1", {"R0": 1.0, "CPE1_0": 2.0})
    with pytest.raises(InputError, match="'a1' has no value: there are values for p1"):
        values_to_circuit("CPE1", {"p1": 1.0})
