r"""Whether a network is passive by its construction: Re z >= 0 wherever Re s >= 0, whatever its parameters.

Masses, compliances, dampers and power laws are, as :math:`|\arg z| \le \pi/2`. Sums of passive impedances and of
passive mobilities are, a gain above zero keeps it, and so does a line, which is the limit of ladders of its two
impedances. What delays or filters a signal does not: its phase leaves the right half-plane somewhere.

A **loss factor** turns the phase by :math:`\arctan e < \pi/2`, so its part must have a phase between :math:`-\pi/2`
and zero. This holds for networks without inertia, :math:`\operatorname{Im} z \le 0`: of compliances, dampers and power
laws :math:`s^{a-1}` with a below 1, since sums, reciprocals of sums of reciprocals and lines of dampers keep it. A
loss factor itself is among them if its part is made of springs only, whose phase is :math:`-\pi/2`. (It is defined for
steady vibrations, and what is said of it is said of :math:`s = j\omega`.)
"""

from __future__ import annotations

from bayes_impedance.network.extensions import PowerLaw, Wrapped
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.network.tree import Element, Network


def known_passive(network: Network) -> bool:
    """Whether the network cannot give more energy than it was given, whatever its parameters."""
    return not doubts_of_passivity(network)


def doubts_of_passivity(network: Network) -> tuple[str, ...]:
    """Why it is not known to be passive, one clause for each part that may not be; empty if it is known.

    Examples
    --------
    >>> from bayes_impedance.network.notation import parse
    >>> doubts_of_passivity(parse("m1|delay[d1](n1)"))
    ('delay[d1](...) shifts the phase without bound',)
    """
    return tuple(doubt for _, node in network.walk() if isinstance(node, Wrapped) and (doubt := _doubt(node)))


def _doubt(node: Wrapped) -> str:
    """Why the wrapper alone may make something active that was passive; empty if it does not."""
    word, first = node.construct.word, node.own_parameters[0]
    value = first.symbol.value
    written = f"{word}[{', '.join(str(symbol) for symbol in node.symbols)}](...)"
    if node.construct.signed and value == 0:
        return ""
    if word == "hysteretic":
        return (
            ""
            if _relaxes(node.part)
            else f"{written} is applied to a part with inertia, whose phase it shifts beyond 90 degrees"
        )
    if word == "offset":
        if first.link != SIGNED or (value is not None and value > 0):
            return ""
        return (
            f"{written} subtracts from the impedance"
            if value is not None
            else f"{written} may subtract from the impedance"
        )
    return "" if node.construct.passive else f"{written} {_ACTIVE[word]}"


_ACTIVE = {
    "delay": "shifts the phase without bound",
    "highpass": "shifts the phase by up to 90 degrees",
    "lowpass": "shifts the phase by up to 90 degrees",
    "reflex": "responds with a delay, so that it can add energy",
}


def _relaxes(node: Network) -> bool:
    """Whether the phase is between that of a spring and that of a damper by construction."""
    if isinstance(node, Element):
        return node.name[0] in "nr"
    if isinstance(node, PowerLaw):
        return node.own_parameters[1].letter == "a"
    if not isinstance(node, Wrapped):
        return all(_relaxes(part) for part in node.parts)
    if node.construct.word == "hysteretic":
        return _is_spring(node.part)
    kept = node.construct.word == "gain" or node.construct.word.startswith("line")
    kept = kept or node.construct.word == "squeeze_film"
    along = node.symbols[0].name[0] in "grk" and (kept or node.construct.word == "offset")
    return along and not _doubt(node) and _relaxes(node.part)


def _is_spring(node: Network) -> bool:
    """Whether it is made of compliances only."""
    if isinstance(node, Element):
        return node.name[0] == "n"
    return bool(node.parts) and not isinstance(node, Wrapped) and all(_is_spring(part) for part in node.parts)
