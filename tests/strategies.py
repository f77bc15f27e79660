"""Random networks and elements for the tests, with arithmetic that does not use the package's own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from itertools import count
from operator import or_, sub

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from bayes_impedance.network.notation import Element, Network, Parallel

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
