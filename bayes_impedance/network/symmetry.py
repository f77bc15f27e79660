"""Parts of a network that can be exchanged without changing its impedance.

Impedances in parallel and mobilities in series add in any order. Two parts of one group that are written alike but for
the names of their elements are therefore interchangeable, and so are their elements' values: the recordings cannot say
which of them is which.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from bayes_impedance.network.extensions import PowerLaw, Wrapped
from bayes_impedance.network.tree import Network, Parallel, Series


class _Form(NamedTuple):
    """What a part is without the names of its parameters, and these names in an order that belongs to the form."""

    key: tuple[Any, ...]
    names: tuple[str, ...]


def exchanges(network: Network) -> tuple[dict[str, str], ...]:
    """Pairs of parts that can be exchanged.

    >>> from bayes_impedance.network.notation import parse
    >>> exchanges(parse("(n1-r1)|(r2-n2)|m1"))
    ({'n1': 'n2', 'r1': 'r2', 'n2': 'n1', 'r2': 'r1'},)

    Parameters
    ----------
    network : Network

    Returns
    -------
    tuple of dict of str to str
        For each pair, the name of the parameter whose value each one takes. Names that are not in it keep theirs.
        Every rearrangement of equal parts is one such exchange after another.
    """
    found = []
    for _, node in network.walk():
        if not isinstance(node, Parallel | Series):
            continue
        forms = [_form(part) for part in node.parts]
        for i, one in enumerate(forms):
            for other in forms[i + 1 :]:
                if one.key == other.key and one.names:
                    there = dict(zip(one.names, other.names, strict=True))
                    found.append(there | {b: a for a, b in there.items()})
    return tuple(found)


def branch_exchanges(network: Network) -> tuple[dict[str, str], ...]:
    """Pairs of branches that are written alike, and stand at places that are not.

    Exchanging their values is another network, with the same resonances in other places.

    >>> from bayes_impedance.network.notation import parse
    >>> branch_exchanges(parse("(m1-((n1-m2)|(n2-r1)))|(m3-n3)"))
    ({'m2': 'm3', 'n1': 'n3', 'm3': 'm2', 'n3': 'n1'},)
    >>> branch_exchanges(parse("(n1-m1)|(n2-m2)"))
    ()

    Parameters
    ----------
    network : Network

    Returns
    -------
    tuple of dict of str to str
        For each pair, as in :func:`exchanges`, which holds the pairs within one group.
    """
    branches = [(path, node) for path, node in network.walk() if path and isinstance(node, Parallel | Series)]
    found = []
    for i, (path, one) in enumerate(branches):
        for where, other in branches[i + 1 :]:
            if where[: len(path)] == path or where[:-1] == path[:-1]:
                continue
            there = corresponding(one, other)
            if there:
                found.append(there | {b: a for a, b in there.items()})
    return tuple(found)


def corresponding(one: Network, other: Network) -> dict[str, str] | None:
    """Names of the parameters of one network by those of another that is the same but for names, labels and order.

    >>> from bayes_impedance.network.notation import parse
    >>> corresponding(parse("(n1|r1)-m1"), parse("m2-skin:(r3|n3)"))
    {'m1': 'm2', 'n1': 'n3', 'r1': 'r3'}

    Returns
    -------
    dict of str to str, or None
        None if the networks differ. Of equal parts (:func:`exchanges`) any may correspond to any.
    """
    mine, theirs = _form(one), _form(other)
    return dict(zip(mine.names, theirs.names, strict=True)) if mine.key == theirs.key else None


def _form(node: Network) -> _Form:
    parts = [_form(part) for part in node.parts]
    if isinstance(node, Parallel | Series):
        parts.sort(key=lambda form: repr(form.key))
    own = node.own_parameters
    detail: tuple[Any, ...] = ()
    if isinstance(node, PowerLaw):
        detail = (node.reference_hz,)
    elif isinstance(node, Wrapped):
        detail = (node.construct.word,)
    kinds = tuple((p.letter, p.link, p.shared, p.symbol.value) for p in own)
    names = [p.name for p in own if not p.held] + [name for part in parts for name in part.names]
    return _Form((type(node).__name__, detail, kinds, *(part.key for part in parts)), tuple(names))
