"""Random networks and elements for the tests, with arithmetic that does not use the package's own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from itertools import count
from operator import or_, sub

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.extensions import PowerLaw, Wrapped, wrapped
from bayes_impedance.network.notation import Element, Network, Parallel
from bayes_impedance.network.parameters import Symbol

# Compiling takes seconds, so there are no deadlines; a float comparison that fails must fail again.
repeatable = settings(deadline=None, derandomize=True, max_examples=80)

LABELS = ("skin", "tissue", "limb", "x", "Joint_2", "m", "_", "elastic", "arm", "bone", "pad", "nail")


@dataclass(frozen=True)
class Group:
    """A group as it is drawn: an operator, a label or None, and at least two members (names or groups)."""

    operator: str
    label: str | None
    members: tuple


def _named(shape, numbers, labels):
    """Give every leaf a number and every group that wants one a label of its own."""
    if isinstance(shape, str):
        return f"{shape}{next(numbers)}"
    operator, labelled, members = shape
    label = next(labels, None) if labelled else None
    return Group(operator, label, tuple(_named(member, numbers, labels) for member in members))


def shapes(max_leaves=10, min_leaves=1):
    """Trees of names and groups in which no name occurs twice; groups of one kind may be nested in one another."""

    def group(parts):
        return st.tuples(st.sampled_from("|-"), st.booleans(), st.lists(parts, min_size=2, max_size=3))

    leaf = st.sampled_from("mnr")
    start = leaf if min_leaves == 1 else group(leaf)
    tree = st.recursive(start, lambda parts: group(st.one_of(leaf, parts)), max_leaves=max_leaves)
    return tree.map(lambda shape: _named(shape, count(1), iter(LABELS)))


def build(shape) -> Network:
    """The network of a tree, by Python's operators."""
    if isinstance(shape, str):
        return Element(shape)
    network = reduce(or_ if shape.operator == "|" else sub, map(build, shape.members))
    return network if shape.label is None else network.labelled(shape.label)


def text(shape) -> str:
    """The notation of a tree with more parentheses than necessary."""
    if isinstance(shape, str):
        return shape
    inner = f" {shape.operator} ".join(text(member) for member in shape.members)
    return f"({inner})" if shape.label is None else f"{shape.label} : ({inner})"


def names(shape) -> tuple[str, ...]:
    return (shape,) if isinstance(shape, str) else sum((names(member) for member in shape.members), ())


def leaf_impedance(name, s, value):
    """Works for arrays, for complex numbers and for Fractions."""
    return {"m": lambda: s * value, "n": lambda: 1 / (s * value), "r": lambda: value + 0 * s}[name[0]]()


def combined(parallel, parts):
    """Impedance of parts that share a velocity (sum) or a force (reciprocal of the sum of reciprocals)."""
    return sum(parts) if parallel else 1 / sum(1 / part for part in parts)


def shape_impedance(shape, s, values):
    """Impedance of a tree."""
    if isinstance(shape, str):
        return leaf_impedance(shape, s, values[shape])
    return combined(shape.operator == "|", [shape_impedance(member, s, values) for member in shape.members])


def network_impedance(network, s, values, path=None, replacement=None):
    """Impedance of a network by hand; at `path` stands something of another impedance, if one is given."""
    if path == ():
        return replacement(network_impedance(network, s, values))
    if isinstance(network, Element):
        return leaf_impedance(network.name, s, values[network.name])
    parts = [
        network_impedance(part, s, values, path[1:] if path and path[0] == i else None, replacement)
        for i, part in enumerate(network.parts)
    ]
    return combined(isinstance(network, Parallel), parts)


def networks(max_leaves=10, min_leaves=1):
    """Networks with unique names."""
    return shapes(max_leaves, min_leaves).map(build)


def log_elements(n, low=-2.0, high=2.0):
    """Arrays of n logarithms."""
    return st.lists(st.floats(low, high), min_size=n, max_size=n).map(np.array)


@st.composite
def networks_with_elements(draw, max_leaves=10, min_leaves=1):
    """A network and the logarithms of its elements."""
    network = draw(networks(max_leaves, min_leaves))
    return network, draw(log_elements(len(network.elements)))


@st.composite
def shapes_with_elements(draw, max_leaves=10, min_leaves=1):
    """A tree and the values of its elements by name."""
    shape = draw(shapes(max_leaves, min_leaves))
    values = np.exp(draw(log_elements(len(names(shape)))))
    return shape, dict(zip(names(shape), values.tolist(), strict=True))


# The whole language: power laws, wrappers, parameters that are shared or held


SPANS = {"d": (0.003, 0.3), "t": (0.003, 0.3), "a": (0.05, 0.95), "b": (1.05, 1.95)}
"""Values that are tried: times of the order of a period at 0.04 to 18 Hz; everything else from 0.1 to 10."""

SHARED = "shared"


def span(letter) -> tuple[float, float]:
    return SPANS.get(letter, (0.1, 10.0))


def _marks(letter, signed):
    """Free (None), shared, or a value at which it is held, of either sign where that has a meaning."""
    values = st.floats(*span(letter))
    signs = values.map(lambda x: -x) if signed else values
    return st.one_of(st.none(), st.just(SHARED), values, signs)


def _leaves(passive):
    plain = st.sampled_from("mnr").flatmap(lambda letter: st.tuples(st.just(letter), _marks(letter, False)))
    power = st.sampled_from("ab").flatmap(
        lambda letter: st.tuples(
            st.just("p"),
            _marks("p", False),
            st.tuples(st.just(letter), _marks(letter, False), st.booleans()),
            st.one_of(st.none(), st.floats(0.1, 10)),
        )
    )
    return st.one_of(plain, plain, power)


def _wraps(parts, passive):
    """Wrappers around parts; if passive only those that are, loss around springs only."""

    def one(construct):
        inner = st.tuples(st.just("n"), _marks("n", False)) if passive and construct.word == "hysteretic" else parts
        symbols = [
            st.sampled_from(letters).flatmap(
                lambda letter, first=i == 0: st.tuples(
                    st.just(letter), _marks(letter, first and construct.signed and not passive)
                )
            )
            for i, letters in enumerate(construct.letters)
        ]
        return st.tuples(st.just(construct.word), st.tuples(*symbols), inner)

    return st.sampled_from([c for c in CONSTRUCTS.values() if c.passive or not passive]).flatmap(one)


def _symbol(letter, mark, numbers) -> Symbol:
    name = f"{letter}{next(numbers)}"
    return Symbol(name, mark == SHARED, None if mark in (None, SHARED) else mark)


def _numbered(shape, numbers, labels) -> Network:
    """The network of a drawn tree, every parameter with a name of its own."""
    match shape:
        case ("|" | "-" as operator, labelled, members):
            parts = [_numbered(member, numbers, labels) for member in members]
            network = reduce(or_ if operator == "|" else sub, parts)
            label = next(labels, None) if labelled else None
            return network if label is None else network.labelled(label)
        case ("p", mark, (letter, exponent_mark, named), reference):
            exponent = _symbol(letter, exponent_mark, numbers)
            if exponent.value is not None and not named:
                exponent = Symbol("", value=exponent.value)
            return PowerLaw(_symbol("p", mark, numbers), exponent, reference)
        case (word, symbols, part):
            own = [_symbol(letter, mark, numbers) for letter, mark in symbols]
            return wrapped(word, own, _numbered(part, numbers, labels))
        case (letter, mark):
            symbol = _symbol(letter, mark, numbers)
            return Element(symbol.name, None, symbol.shared, symbol.value)
    raise AssertionError(shape)


def language(max_leaves=6, passive=False):
    """Networks of everything that a network may hold; if `passive`, of what is passive only."""

    def larger(parts):
        group = st.tuples(st.sampled_from("|-"), st.booleans(), st.lists(parts, min_size=2, max_size=3))
        return st.one_of(group, _wraps(parts, passive))

    leaves = _leaves(passive)
    tree = st.recursive(st.one_of(leaves, _wraps(leaves, passive)), larger, max_leaves=max_leaves)
    return tree.map(lambda shape: _numbered(shape, count(1), iter(LABELS)))


@st.composite
def language_with_u(draw, max_leaves=6, passive=False):
    """Such a network, and for each of its free parameters a u at which its value lies in the span of its letter.

    Signed parameters have either sign, unless the network is to be passive. No value is a round number: one that takes
    off exactly what another one adds leaves an impedance of zero, of which nothing is defined any more.
    """
    network, u = draw(language(max_leaves, passive)), []
    for k, p in enumerate(network.parameters):
        if p.held:
            continue
        value = draw(st.floats(*span(p.letter))) * (1 if p.link == "logit" else 1 + 0.05 * np.sin(k + 1))
        if p.link == "signed":
            u.append(value * (1 if passive else draw(st.sampled_from([1, -1]))))
        elif p.link == "logit":
            u.append(np.log(value - (p.letter == "b")) - np.log(1 + (p.letter == "b") - value))
        else:
            u.append(np.log(value * (2 * np.pi if p.letter == "f" else 1)))
    return network, np.array(u)


def value_of_u(parameter, u):
    """A parameter's value from u, which may be complex."""
    if parameter.link == "signed":
        return u
    if parameter.link == "logit":
        return (parameter.letter == "b") + 1 / (1 + np.exp(-u))
    return np.exp(u) / (2 * np.pi if parameter.letter == "f" else 1)


def values_of_u(network, u):
    """Values of the free parameters by name."""
    free = [p for p in network.parameters if not p.held]
    return {p.name: value_of_u(p, x) for p, x in zip(free, u, strict=True)}


def language_impedance(network, s, values):
    """Impedance of any network by hand; analytic in the values."""

    def value(symbol):
        return values[symbol.name] if symbol.value is None else symbol.value

    if isinstance(network, Element):
        return leaf_impedance(network.name, s, value(network.symbol))
    if isinstance(network, PowerLaw):
        w0 = 1.0 if network.reference_hz is None else 2 * np.pi * network.reference_hz
        return value(network.size) * np.exp((value(network.exponent) - 1) * np.log(s / w0))
    parts = [language_impedance(part, s, values) for part in network.parts]
    if not isinstance(network, Wrapped):
        return combined(isinstance(network, Parallel), parts)
    (z,), x, letter = parts, [value(symbol) for symbol in network.symbols], network.symbols[0].name[0]
    y = {"m": s, "r": 1 + 0 * s, "k": 1 / s}.get(letter, s) * x[0]
    sign = 1 if np.real(x[0]) >= 0 else -1
    match network.construct.word:
        case "delay":
            return z * np.exp(-s * x[0])
        case "highpass":
            return z * (s / (s + sign * 2 * np.pi * x[0])) ** sign
        case "lowpass":
            return z * (1 + s * sign * x[0]) ** -sign
        case "gain":
            return z * x[0]
        case "hysteretic":
            return z * (1 + 1j * x[0])
        case "offset":
            return z + y
        case "line_free":
            return np.sqrt(y) * np.sqrt(z) / np.tanh(np.sqrt(y) / np.sqrt(z))
        case "line_fixed":
            return np.sqrt(y) * np.sqrt(z) * np.tanh(np.sqrt(y) / np.sqrt(z))
        case "line_matched":
            return np.sqrt(y) * np.sqrt(z)
        case "reflex":
            lag = 1 + s / (2 * np.pi * x[2])
            return z + x[0] * np.exp(-s * x[1]) / ((s if letter == "k" else lag) * lag)
        case "squeeze_film":
            below = 401
            for odd in range(399, 1, -2):  # the continued fraction of tanh
                below = odd + s * x[1] / below
            return z + 3 * x[0] / (s * x[1] + below)
    raise AssertionError(network.construct.word)
