r"""The body alone: a network without what belongs to the rig.

A fit describes what was recorded, the rig included. A device meets only the body. Bodies differ, so what is the same
for everybody (``*``), or known and held (``=``), is taken for the rig's:

===================================  =================================================================================
delay, highpass, lowpass, gain,      of such a parameter are errors of the measuring channels and what was subtracted
offset                               too little: the wrapper is taken off its part
mass, compliance, damper, power law  of such a size are parts of the rig: beside others (``|``) it is taken out as an
                                     impedance of zero, in a chain (``-``) as a rigid link, a mobility of zero
===================================  =================================================================================

Everything else stays. The other wrappers (``hysteretic``, ``line_*``, ``reflex``) are of materials and muscles whatever
their parameters are, and so is a power law of a person's own size with an exponent that all people share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Element, Network, PowerLaw, Wrapped
from bayes_impedance.network.tree import Parallel, Series, group_of

CHANNELS = ("delay", "highpass", "lowpass", "gain", "offset")
"""Wrappers that are of the rig if their parameter is the same for everybody."""


@dataclass(frozen=True, repr=False)
class Body(Brief):
    """What a device meets.

    Attributes
    ----------
    network : Network
    columns : ndarray of int, shape (Q,)
        Of its parameters among those of the whole network.
    removed : tuple of str
        What was taken out, in the notation of networks.
    """

    network: Network
    columns: np.ndarray
    removed: tuple[str, ...]

    @property
    def note(self) -> str:
        """What was taken out, as a sentence; empty if nothing was."""
        if not self.removed:
            return ""
        return (
            "users are what was measured without the rig, because that alone loads a device; removed as parts of the "
            f"rig, because they are the same for all or held: {', '.join(self.removed)}"
        )


def body_of(network: Network) -> Body:
    """Take out what belongs to the rig.

    Raises
    ------
    InputError
        If nothing of the body is left, in the whole network or inside a wrapper of the body.
    """
    removed: list[str] = []
    left = _stripped(network, removed)
    if left is None:
        raise InputError(
            f"nothing of {network} belongs to the body: all its elements are the same for all or held, so there "
            "are no users; fit a network with elements that differ between subjects"
        )
    place = {name: i for i, name in enumerate(network.elements)}
    return Body(left, np.array([place[name] for name in left.elements], dtype=int), tuple(removed))


def _stripped(node: Network, removed: list[str]) -> Network | None:
    if isinstance(node, Element | PowerLaw):
        size = node.own_parameters[0]
        if not (size.shared or size.held):
            return node
        removed.append(node._notation())
        return None
    if isinstance(node, Wrapped):
        return _unwrapped(node, removed)
    kept = [left for part in node.parts if (left := _stripped(part, removed)) is not None]
    if len(kept) < 2:
        return _named(kept[0], node.label) if kept else None
    assert isinstance(node, Parallel | Series)  # there is no third kind of group
    return group_of(type(node), kept).labelled(node.label)


def _unwrapped(node: Wrapped, removed: list[str]) -> Network | None:
    head = f"{node.construct.word}[{', '.join(map(str, node.symbols))}](...)"
    rig = node.construct.word in CHANNELS and all(p.shared or p.held for p in node.own_parameters)
    if rig:
        removed.append(head)
    part = _stripped(node.part, removed)
    if rig:
        return None if part is None else _named(part, node.label)
    if part is None:
        raise InputError(
            f"{head} belongs to the body, but all that it wraps ({node.part}) is the same for all or held, and "
            "so belongs to the rig: wrap a part with elements that differ between subjects"
        )
    return node.with_parts([part]).labelled(node.label)


def _named(part: Network, label: str | None) -> Network:
    """The last part of a group keeps its own name, or takes the group's."""
    return part if part.label is not None else part.labelled(label)
