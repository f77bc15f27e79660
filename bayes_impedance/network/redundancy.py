r"""Structural identifiability: elements of a network that no recording can distinguish, at any band and precision.

**Adjacent elements of one kind.** Elements of one kind that share a velocity or a force act as one element:

.. math::
    (m_1\,|\,m_2) = m_1 + m_2, \qquad (r_1\,|\,r_2) = r_1 + r_2, \qquad
    (n_1\,|\,n_2) = \left(\tfrac1{n_1} + \tfrac1{n_2}\right)^{-1}

and in series the other way round. Only that combination can be determined, so the network is written with one element
in their place before it is fitted (:func:`merged`).

**Other cases.** A network may have more parameters than its impedance has degrees of freedom without having two
adjacent elements of one kind. A gain absorbs the size of everything inside it; of a line without an end only the
product of the roots of its two impedances shows. Parameter p is structurally identifiable if its derivative is no
combination of the others':

.. math:: \operatorname{rank} J_{(p)} < \operatorname{rank} J, \qquad
          J_{kp} = \frac{\partial z(s_k;\, x)}{\partial x_p}

for generic x and more values of s than there are parameters. The rank is decided exactly, for every network
(:mod:`bayes_impedance.network.residues`): p is not identifiable if a vector of the null space of J has a component
along p. Filters whose parameter may have either sign are taken above zero, as the filters that they are called.

This is about one curve. A parameter that is the same for all and one that varies, side by side and of one kind, cannot
be told apart by any single person's curve, however many people there are: they are not merged, as the sum of a
constant and of something log-normal is not log-normal, but no number is reported for either. What is held is known,
and is never merged.
"""

from __future__ import annotations

from dataclasses import dataclass

from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.notation import Element, Network, Parallel, Place, Series
from bayes_impedance.network.residues import PRIME, slopes_at_points
from bayes_impedance.network.tree import group_of


@dataclass(frozen=True)
class Combination:
    """Elements of one kind of which only a combination can be determined.

    Attributes
    ----------
    name : str
        Name of the single element that replaces them.
    elements : tuple of str
        As they were written.
    expression : str
        The combination, such as ``n1 + n2`` or ``1/(1/m1 + 1/m2)``.
    """

    name: str
    elements: tuple[str, ...]
    expression: str


def merged(network: Network) -> tuple[Network, tuple[Combination, ...]]:
    """The network with adjacent elements of one kind replaced by a single element.

    Those that are held stay as they are, and so do two of which only one is the same for all.

    Parameters
    ----------
    network : Network

    Returns
    -------
    network : Network
        The network itself if there are none.
    combinations : tuple of Combination
        The replaced elements.
    """
    found: list[Combination] = []
    taken = {p.name for p in network.parameters} | {node.label for _, node in network.walk() if node.label is not None}
    result = _merged(network, taken, found)
    return (result, tuple(found)) if found else (network, ())


def _merged(node: Network, taken: set[str], found: list[Combination]) -> Network:
    if not node.parts:
        return node
    parts = [_merged(part, taken, found) for part in node.parts]
    if len(parts) == 1:
        return node.replaced(Place((0,), ""), parts[0])
    alike: dict[tuple[str, bool], list[str]] = {}
    for part in parts:
        if isinstance(part, Element) and (kind := _kind(part)):
            alike.setdefault(kind, []).append(part.name)
    kept = list[Network]()
    for part in parts:
        kind = _kind(part) if isinstance(part, Element) else None
        if not isinstance(part, Element) or kind is None or len(alike[kind]) < 2:
            kept.append(part)
        elif part.name == alike[kind][0]:
            name = _combined(alike[kind], isinstance(node, Parallel), taken, found)
            kept.append(Element(name, shared=part.shared))
    group = kept[0] if len(kept) == 1 else group_of(Parallel if isinstance(node, Parallel) else Series, kept)
    return group.labelled(node.label) if node.label is not None else group


def _kind(element: Element) -> tuple[str, bool] | None:
    """Kind, and whether it is the same for all, of an element that may be merged with its like; None if it may not."""
    if element.label is not None or element.value is not None:
        return None
    return kind_of(element.name).letter, element.shared


def _combined(same: list[str], parallel: bool, taken: set[str], found: list[Combination]) -> str:
    """Name of the element that replaces others of its kind; the combination is appended to `found`."""
    earlier = {c.name: c for c in found}
    written = tuple(e for name in same for e in (earlier[name].elements if name in earlier else (name,)))
    terms = [earlier[name].expression if name in earlier else name for name in same]
    name = "_".join(written)
    while name in taken:
        name += "_"
    taken.add(name)
    found[:] = [c for c in found if c.name not in same]
    adds = parallel == (kind_of(name).exponent > 0)
    expression = " + ".join(terms) if adds else f"1/({' + '.join(f'1/{_factor(t)}' for t in terms)})"
    found.append(Combination(name, written, expression))
    return name


def _factor(term: str) -> str:
    return f"({term})" if " " in term else term


def inseparable(network: Network) -> tuple[str, ...]:
    """Elements that are not structurally identifiable: changes of others can compensate any change of theirs.

    Parameters
    ----------
    network : Network

    Returns
    -------
    tuple of str
        In the order in which they are written; empty if all are structurally identifiable.
    """
    names = network.elements
    free = _null_space(slopes_at_points(network), len(names))
    return tuple(name for p, name in enumerate(names) if any(vector[p] for vector in free))


def _null_space(rows: list[list[int]], width: int) -> list[list[int]]:
    """A basis of the vectors that a matrix of residues takes to zero, by elimination."""
    left, pivots = [row[:] for row in rows], dict[int, list[int]]()
    for column in range(width):
        pivot = next((row for row in left if row[column]), None)
        if pivot is None:
            continue
        left.remove(pivot)
        inverse = pow(pivot[column], -1, PRIME)
        pivot = [a * inverse % PRIME for a in pivot]
        left, above = ([_without(row, pivot, column) for row in r] for r in (left, list(pivots.values())))
        pivots = dict(zip(pivots, above, strict=True)) | {column: pivot}
    return [
        [1 if p == f else -pivots[p][f] % PRIME if p in pivots else 0 for p in range(width)]
        for f in range(width)
        if f not in pivots
    ]


def _without(row: list[int], pivot: list[int], column: int) -> list[int]:
    factor = row[column]
    return [(a - factor * b) % PRIME for a, b in zip(row, pivot, strict=True)] if factor else row
