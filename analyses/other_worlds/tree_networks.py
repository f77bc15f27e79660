"""Networks of masses, springs and dampers as nested tuples: impedance, places, and networks drawn at random.

A network is the name of an element (``m1``, ``n1``, ``r1``) or ``(sign, part, part, ...)`` with the sign ``|`` for
parallel (impedances add) or ``-`` for series (mobilities add). An element's impedance is s m, 1/(s n) or r. Nothing of
the package is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

Node = str | tuple
"""Name of an element, or sign and parts."""
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""s (F,) and impedance of a place (..., F) to the changed impedance of that place (..., F)."""

FAMILIES: Mapping[str, Node] = {
    "finger": ("-", ("|", "n3", "r3"), ("|", "m2", "r1", "n1", ("-", "m1", ("|", "n2", "r2")))),
    "stick": ("|", "m1", "r1", "n1"),
    "padded": ("-", ("|", "n2", "r2"), ("|", "m1", "r1", "n1")),
    "loaded": ("|", "m2", ("-", ("|", "n2", "r2"), ("|", "m1", "r1", "n1"))),
    "zener": ("|", "m1", "n1", ("-", "r2", "n2")),
    "absorber": ("|", "m1", "r1", ("-", "m2", ("|", "n2", "r2"))),
}
"""The six families: the paper's finger, one mass on a spring, a pad on it, a mass before it, a standard linear solid
with a mass, and a mass that carries another."""

_OTHER = {"|": "-", "-": "|"}


def notation(node: Node) -> str:
    """Text of a network, as ``bayes-impedance --network`` reads it."""
    if isinstance(node, str):
        return node
    sign, *parts = node
    return sign.join(p if isinstance(p, str) else f"({notation(p)})" for p in parts)


def elements(node: Node) -> tuple[str, ...]:
    """Names of the elements in the order of the notation."""
    if isinstance(node, str):
        return (node,)
    return tuple(name for part in node[1:] for name in elements(part))


def impedance(node: Node, s: np.ndarray, values: Mapping[str, np.ndarray], changes: Mapping[str, Change]) -> np.ndarray:
    """Impedance of the port.

    Parameters
    ----------
    node : Node
    s : ndarray, complex, shape (F,)
    values : mapping of str to ndarray
        Elements in SI units, each of shape (..., 1).
    changes : mapping of str to function
        What happens at a place: ``port``, or the notation of a part.

    Returns
    -------
    ndarray, complex, shape (..., F)
    """
    z = _part(node, s, values, changes)
    return changes["port"](s, z) if "port" in changes else z


def _part(node: Node, s: np.ndarray, values: Mapping[str, np.ndarray], changes: Mapping[str, Change]) -> np.ndarray:
    if isinstance(node, str):
        x = values[node]
        return {"m": s * x, "n": 1 / (s * x), "r": x + 0 * s}[node[0]]
    total: np.ndarray | float = 0.0
    for part in node[1:]:
        z = _part(part, s, values, changes)
        place = notation(part)
        if place in changes:
            z = changes[place](s, z)
        total = total + (z if node[0] == "|" else 1 / z)
    return np.asarray(total if node[0] == "|" else 1 / total)


def velocity_of(node: Node, target: str, s: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Velocity of an element per unit of force at the port, shape (..., F)."""

    def down(part: Node, force: np.ndarray | float) -> np.ndarray | None:
        if part == target:
            return np.asarray(force / _part(part, s, values, {}))
        if isinstance(part, str):
            return None
        whole = _part(part, s, values, {})
        for inner in part[1:]:
            share = 1.0 if part[0] == "-" else _part(inner, s, values, {}) / whole
            found = down(inner, force * share)
            if found is not None:
                return found
        return None

    found = down(node, 1.0)
    if found is None:
        raise ValueError(f"{notation(node)} has no element {target}")
    return found


def places(node: Node) -> Iterator[tuple[str, Node]]:
    """Places beside which something can be added, each once: the port, and every part of a series group.

    What is beside one part of a parallel group is beside all of it, so that the parts of parallel groups are no places
    of their own.
    """
    yield "port", node

    def inner(part: Node) -> Iterator[tuple[str, Node]]:
        if isinstance(part, str):
            return
        for child in part[1:]:
            if part[0] == "-":
                yield notation(child), child
            yield from inner(child)

    yield from inner(node)


def parts_in_parallel(node: Node) -> tuple[Node, ...]:
    """Parts that stand beside each other at a place."""
    return tuple(node[1:]) if isinstance(node, tuple) and node[0] == "|" else (node,)


def random_tree(rng: np.random.Generator) -> Node:
    """A network of 4 to 7 elements; no group holds two elements of one kind, which would be one element."""
    while True:
        count = int(rng.integers(4, 8))
        numbers = {"m": 0, "n": 0, "r": 0}
        node = _grow(count, "|" if rng.random() < 0.6 else "-", rng, numbers)
        if node is not None and len({name[0] for name in elements(node)}) > 1:
            return node


def _grow(count: int, sign: str, rng: np.random.Generator, numbers: dict[str, int]) -> Node | None:
    if count == 1:
        raise ValueError("a group has two parts or more")
    n_parts = int(rng.integers(2, min(count, 3) + 1))
    cuts = np.sort(rng.choice(np.arange(1, count), n_parts - 1, replace=False))
    parts: list[Node] = []
    kinds: list[str] = []
    for size in np.diff([0, *cuts, count]):
        if size > 1:
            part = _grow(int(size), _OTHER[sign], rng, numbers)
            if part is None:
                return None
            parts.append(part)
            continue
        free = [kind for kind in "mnr" if kind not in kinds]
        kind = str(rng.choice(free))
        kinds.append(kind)
        numbers[kind] += 1
        parts.append(f"{kind}{numbers[kind]}")
    return (sign, *parts)
