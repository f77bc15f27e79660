r"""Structural identifiability: elements of a network that no recording can distinguish, at any band and precision.

**Adjacent elements of one kind.** Elements of one kind that share a velocity or a force act as one element:

.. math::
    (m_1\,|\,m_2) = m_1 + m_2, \qquad (r_1\,|\,r_2) = r_1 + r_2, \qquad
    (n_1\,|\,n_2) = \left(\tfrac1{n_1} + \tfrac1{n_2}\right)^{-1}

and in series the other way round. Only that combination can be determined, so the network is written with one element
in their place before it is fitted (:func:`merged`).

**Other cases.** A network may have more elements than its rational function has coefficients without having two
adjacent elements of one kind. Element p is structurally identifiable if its derivative is no combination of the
others':

.. math:: \operatorname{rank} J_{(p)} < \operatorname{rank} J, \qquad
          J_{kp} = \frac{\partial z(s_k;\, x)}{\partial x_p}

for generic x and more values of s than there are elements. The rank is decided exactly: impedance and derivatives are
computed with integers modulo a large prime at random x and s, where sums, products and reciprocals are exact, as for
rational numbers. By the Schwartz-Zippel lemma, the chance that a random point shows a smaller rank than the
generic one is below the degree of the determinant over the prime: 1e-16 (J. T. Schwartz, J. ACM 27, 1980).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.notation import Element, Network, Parallel

_PRIME = 2**61 - 1
"""Mersenne prime: a product of two residues is exact in Python's integers."""

_SEED = 1
"""Seed of the random point. By choice: the result depends on it with probability 1e-16 only."""

_MORE_POINTS = 3
"""Values of s in excess of the number of elements. By choice: the rank needs no more than the number of elements."""


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
    result = _merged(network, set(network.elements), found)
    return (result, tuple(found)) if found else (network, ())


def _merged(node: Network, taken: set[str], found: list[Combination]) -> Network:
    if not node.parts:
        return node
    parts = [_merged(part, taken, found) for part in node.parts]
    alike: dict[str, list[str]] = {}
    for part in parts:
        if isinstance(part, Element) and part.label is None:
            alike.setdefault(kind_of(part.name).letter, []).append(part.name)
    kept = list[Network]()
    for part in parts:
        same = alike.get(kind_of(part.name).letter, []) if isinstance(part, Element) and part.label is None else []
        if len(same) < 2:
            kept.append(part)
        elif isinstance(part, Element) and part.name == same[0]:
            kept.append(Element(_combined(same, isinstance(node, Parallel), taken, found)))
    group = kept[0]
    for part in kept[1:]:
        group = group | part if isinstance(node, Parallel) else group - part
    return group.labelled(node.label) if node.label is not None else group


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
    rng = np.random.default_rng(_SEED)
    x = {name: int(rng.integers(1, _PRIME)) for name in names}
    rows = []
    for _ in range(len(names) + _MORE_POINTS):
        _, slopes = _value(network, int(rng.integers(1, _PRIME)), x)
        rows.append([slopes.get(name, 0) for name in names])
    whole = _rank(rows)
    if whole == len(names):
        return ()
    return tuple(name for p, name in enumerate(names) if _rank([r[:p] + r[p + 1 :] for r in rows]) == whole)


def _value(node: Network, s: int, x: dict[str, int]) -> tuple[int, dict[str, int]]:
    """Impedance and its derivatives with respect to the elements, modulo the prime."""
    if isinstance(node, Element):
        kind = kind_of(node.name)
        factor, value = pow(s, kind.power, _PRIME), x[node.name]
        z = factor * pow(value, kind.exponent, _PRIME) % _PRIME
        return z, {node.name: kind.exponent * z * pow(value, -1, _PRIME) % _PRIME}
    total, slopes = 0, dict[str, int]()
    for part in node.parts:
        z, own = _value(part, s, x)
        inverse = 1 if isinstance(node, Parallel) else pow(z, -1, _PRIME)
        weight = 1 if isinstance(node, Parallel) else -inverse * inverse
        total += z if isinstance(node, Parallel) else inverse
        slopes.update({name: weight * slope % _PRIME for name, slope in own.items()})
    if isinstance(node, Parallel):
        return total % _PRIME, slopes
    z = pow(total, -1, _PRIME)
    return z, {name: -z * z * slope % _PRIME for name, slope in slopes.items()}


def _rank(rows: list[list[int]]) -> int:
    """Rank of a matrix of residues, by elimination."""
    left, rank = [row[:] for row in rows], 0
    for column in range(len(left[0]) if left else 0):
        pivot = next((row for row in left if row[column] % _PRIME), None)
        if pivot is None:
            continue
        left.remove(pivot)
        rank += 1
        inverse = pow(pivot[column], -1, _PRIME)
        left = [[(a - row[column] * inverse * b) % _PRIME for a, b in zip(row, pivot, strict=True)] for row in left]
    return rank
