"""Whether a network is another one with something added to it.

Names say which parameters belong to both. Parameters that are new are taken out with what they are of: an element from
its group, a wrapper from what it wraps. If the other network is left, with the same connections, it was added to.
"""

from __future__ import annotations

from typing import Any

from bayes_impedance.network.extensions import Wrapped
from bayes_impedance.network.tree import Network, Parallel, Series

Connections = tuple[Any, ...]
"""What is connected with what, without labels, the order of parts, and what is shared or held."""


def extends(network: Network, plain: Network) -> bool:
    """Whether a network is `plain` with elements or wrappers added.

    Parameters
    ----------
    network, plain : Network

    Examples
    --------
    >>> from bayes_impedance.network.notation import parse
    >>> extends(parse("delay[d1*](m1|(n1-r2)|r1)"), parse("m1|n1|r1"))
    True
    >>> extends(parse("m1-(n1|r1|r2)"), parse("m1|n1|r1"))
    False
    """
    known = _names(plain)
    return known < _names(network) and _connections(network, known) == _connections(plain, known)


def _names(network: Network) -> set[str]:
    return {p.name for _, node in network.walk() for p in node.own_parameters if p.name}


def _connections(node: Network, known: set[str]) -> Connections | None:
    """Connections of the parts whose parameters are known; None if there are none."""
    own = tuple(p.name or str(p.symbol.value) for p in node.own_parameters)
    new = any(p.name and p.name not in known for p in node.own_parameters)
    if isinstance(node, Parallel | Series):
        kind, kept = type(node).__name__, list[Connections]()
        for part in node.parts:
            inner = _connections(part, known)
            if inner is not None:
                kept += inner[1] if inner[0] == kind else [inner]
        return None if not kept else kept[0] if len(kept) == 1 else (kind, sorted(kept, key=repr))
    if isinstance(node, Wrapped):
        inner = _connections(node.part, known)
        return inner if new or inner is None else (node.construct.word, *own, inner)
    return None if new else ("element", *own)
