r"""Networks in the spelling of electrical circuits, ``R0-p(R1,CPE1)-Wo1``, as the program impedance.py reads it.

Parts in series carry one current, which is the velocity, so impedances add: the ``-`` of circuits is the ``|`` of
networks, and ``p(a,b)`` is ``a-b``. The elements, with their parameters in circuits and here:

=========  ====================================  =========================  ================================
circuits   Z                                     written here               conversion
=========  ====================================  =========================  ================================
R1         R                                     r1                         r = R
C1         1/(s C)                               n1                         n = C
L1         s L                                   m1                         m = L
CPE1       1/(Q s^alpha)                         p1^a1                      p = 1/Q, a = 1 - alpha
La1        L s^alpha                             pLa1^bLa1                  p = L, b = 1 + alpha
W1         A (1 - j)/sqrt(omega)                 pW1^0.5                    p = sqrt(2) A
Wo1        Z0 coth(sqrt(s tau))/sqrt(s tau)      line_free[rWo1](nWo1)      r = Z0, n = tau/Z0
Ws1        Z0 tanh(sqrt(s tau))/sqrt(s tau)      line_fixed[rWs1](nWs1)     r = Z0, n = tau/Z0
=========  ====================================  =========================  ================================

A constant-phase element's size is that at 1 rad/s. :func:`values_from_circuit` and :func:`values_to_circuit` convert
values, which impedance.py calls ``R1``, ``CPE1_0``, ``CPE1_1``. (Its La is documented as above; the program computes
(L s)^alpha, so that its L is ours to the power of 1/alpha.)

The two spellings cannot be mixed up: in circuits every element begins with a capital letter, in networks none does, and
only labels, before a colon, may.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from bayes_impedance.errors import InputError
from bayes_impedance.network.extensions import PowerLaw, wrapped
from bayes_impedance.network.parameters import Symbol
from bayes_impedance.network.tokens import DEEPEST, Tokens
from bayes_impedance.network.tree import Element, Network, Parallel, Place, Series, group_of

Values = Sequence[float]


@dataclass(frozen=True, kw_only=True)
class CircuitElement:
    """An element of circuits.

    Attributes
    ----------
    word : str
    formula : str
        Its impedance, as it is printed.
    names : tuple of str
        Its parameters here, with ``{}`` for its number.
    build : function
        The network from its parameters' names.
    conversion : str
        As it is printed.
    here, there : function
        Values in our parameters from those of circuits, and back.
    """

    word: str
    formula: str
    names: tuple[str, ...]
    build: Callable[..., Network]
    conversion: str
    here: Callable[..., Values] = lambda *values: values
    there: Callable[..., Values] = lambda *values: values

    def network(self, number: str) -> Network:
        """Written here."""
        return self.build(*(name.format(number) for name in self.names))

    def parameters(self, number: str) -> tuple[str, ...]:
        """What impedance.py calls its parameters."""
        name = f"{self.word}{number}"
        return (name,) if len(self.names) == 1 else tuple(f"{name}_{i}" for i in range(len(self.names)))


def _power_law(size: str, exponent: str) -> Network:
    return PowerLaw(Symbol(size), Symbol(exponent))


def _line(word: str) -> Callable[[str, str], Network]:
    return lambda along, across: wrapped(word, [Symbol(along)], Element(across))


CIRCUIT_ELEMENTS: dict[str, CircuitElement] = {
    e.word: e
    for e in (
        CircuitElement(word="R", formula="R", names=("r{}",), build=Element, conversion="r = R"),
        CircuitElement(word="C", formula="1/(s C)", names=("n{}",), build=Element, conversion="n = C"),
        CircuitElement(word="L", formula="s L", names=("m{}",), build=Element, conversion="m = L"),
        CircuitElement(
            word="CPE",
            formula="1/(Q s^alpha)",
            names=("p{}", "a{}"),
            build=_power_law,
            conversion="p = 1/Q, a = 1 - alpha",
            here=lambda q, alpha: (1 / q, 1 - alpha),
            there=lambda p, a: (1 / p, 1 - a),
        ),
        CircuitElement(
            word="La",
            formula="L s^alpha",
            names=("pLa{}", "bLa{}"),
            build=_power_law,
            conversion="p = L, b = 1 + alpha",
            here=lambda inductance, alpha: (inductance, 1 + alpha),
            there=lambda p, b: (p, b - 1),
        ),
        CircuitElement(
            word="W",
            formula="A (1 - j)/sqrt(omega)",
            names=("pW{}",),
            build=lambda size: PowerLaw(Symbol(size), Symbol("", value=0.5)),
            conversion="p = sqrt(2) A",
            here=lambda a: (math.sqrt(2) * a,),
            there=lambda p: (p / math.sqrt(2),),
        ),
        CircuitElement(
            word="Wo",
            formula="Z0 coth(sqrt(s tau))/sqrt(s tau)",
            names=("rWo{}", "nWo{}"),
            build=_line("line_free"),
            conversion="r = Z0, n = tau/Z0",
            here=lambda z0, tau: (z0, tau / z0),
            there=lambda r, n: (r, r * n),
        ),
        CircuitElement(
            word="Ws",
            formula="Z0 tanh(sqrt(s tau))/sqrt(s tau)",
            names=("rWs{}", "nWs{}"),
            build=_line("line_fixed"),
            conversion="r = Z0, n = tau/Z0",
            here=lambda z0, tau: (z0, tau / z0),
            there=lambda r, n: (r, r * n),
        ),
    )
}
"""Every element of circuits by its word."""

_NAME = re.compile(r"([A-Za-z]+)([0-9_]*)")
_CAPITAL = re.compile(r"[A-Z][A-Za-z0-9_]*")


def is_circuit(text: str) -> bool:
    """Whether a text is in the spelling of circuits: it begins with a capital letter that is no label's, or ``p(``."""
    start = Tokens(text, "network")
    return (start.peek(), start.peek(1)) == ("p", "(") or (
        _CAPITAL.fullmatch(start.peek()) is not None and start.peek(1) != ":"
    )


def read_circuit(text: str) -> Network:
    """Read a network in the spelling of circuits.

    Raises
    ------
    InputError
        If it is invalid; the message gives the position.
    """
    return _Reader(text, "circuit").read()


def electrical(network: Network) -> str:
    """The network in the spelling of circuits, without its labels.

    Elements keep the numbers at the end of their names; what has none, or one that is taken, gets the next that is
    free. What was read from a circuit is printed as that circuit.

    Raises
    ------
    InputError
        If circuits have no spelling for a part.
    """
    network = _unlabelled(network)
    found = [(node, *_spelled(node)) for node in _leaves(network)]
    taken = dict[str, str]()
    for own in (True, False):  # names that a circuit would give choose first
        for _, element, name in found:
            form = re.escape(element.names[0]).replace(r"\{\}", "([0-9_]*)") if own else r"[A-Za-z]+(\d+)"
            match = re.fullmatch(form, name)
            if match is not None and name not in taken.values():
                taken.setdefault(f"{element.word}{match.group(1)}", name)
    for _, element, name in found:
        if name not in taken.values():
            free = next(k for k in range(len(found) + 1) if f"{element.word}{k}" not in taken)
            taken[f"{element.word}{free}"] = name
    words = {name: word for word, name in taken.items()}
    return _printed(network, {id(node): words[name] for node, _, name in found})


def values_from_circuit(circuit: str, values: Mapping[str, float]) -> dict[str, float]:
    """Values of a network's parameters from those of a circuit.

    Parameters
    ----------
    circuit : str
        In the spelling of circuits.
    values : mapping of str to float
        As impedance.py calls them: ``R0``, ``CPE1_0``, ``CPE1_1``. SI units.

    Returns
    -------
    dict of str to float
        For ``parse(circuit)``, as :meth:`bayes_impedance.network.tree.Network.impedance` takes them.
    """
    result = dict[str, float]()
    for element, number in _elements_of(circuit):
        own = element.here(*(_one(values, name) for name in element.parameters(number)))
        result |= zip((name.format(number) for name in element.names), own, strict=True)
    return result


def values_to_circuit(circuit: str, values: Mapping[str, float]) -> dict[str, float]:
    """The reverse of :func:`values_from_circuit`."""
    result = dict[str, float]()
    for element, number in _elements_of(circuit):
        own = element.there(*(_one(values, name.format(number)) for name in element.names))
        result |= zip(element.parameters(number), own, strict=True)
    return result


def _one(values: Mapping[str, float], name: str) -> float:
    if name not in values:
        raise InputError(f"'{name}' has no value: there are values for {', '.join(values) or 'none'}")
    return values[name]


def _elements_of(circuit: str) -> list[tuple[CircuitElement, str]]:
    reader = _Reader(circuit, "circuit")
    reader.read()
    return reader.elements


class _Reader(Tokens):
    """Recursive descent: circuit = part {"-" part}; part = element | "p" "(" circuit {"," circuit} ")"."""

    def read(self) -> Network:
        self.elements: list[tuple[CircuitElement, str]] = []
        network = self.circuit(1)
        if self.peek():
            raise self.error("'-' or the end, in the spelling of circuits")
        return network

    def circuit(self, depth: int) -> Network:
        if depth > DEEPEST:
            raise self.too_deep()
        parts = [self.part(depth)]
        while self.peek() == "-":
            self.take()
            parts.append(self.part(depth))
        return parts[0] if len(parts) == 1 else group_of(Parallel, parts)

    def part(self, depth: int) -> Network:
        if (self.peek(), self.peek(1)) == ("p", "("):
            self.take()
            self.take()
            branches = [self.circuit(depth + 1)]
            while self.peek() == ",":
                self.take()
                branches.append(self.circuit(depth + 1))
            self.expect(")")
            return branches[0] if len(branches) == 1 else group_of(Series, branches)
        match = _NAME.fullmatch(self.peek())
        if match is None or match.group(1) not in CIRCUIT_ELEMENTS:
            raise self.error(
                f"an element of circuits ({', '.join(CIRCUIT_ELEMENTS)}) or 'p('; names in a network of masses, "
                "compliances and dampers begin with a small letter"
            )
        self.take()
        element, number = CIRCUIT_ELEMENTS[match.group(1)], match.group(2)
        if (element, number) in self.elements:
            raise InputError(
                f"{self.shown}: '{element.word}{number}' occurs twice: give each element a name of its own"
            )
        self.elements.append((element, number))
        return element.network(number)


def _unlabelled(node: Network) -> Network:
    """Without labels, so that nested groups of one kind are one."""
    if isinstance(node, Parallel | Series):
        return group_of(type(node), [_unlabelled(part) for part in node.parts])
    for k, part in enumerate(node.parts):
        node = node.replaced(Place((k,), ""), _unlabelled(part))
    return node.labelled(None)


def _leaves(network: Network) -> list[Network]:
    if isinstance(network, Parallel | Series):
        return [leaf for part in network.parts for leaf in _leaves(part)]
    return [network]


def _spelled(node: Network) -> tuple[CircuitElement, str]:
    """The element of circuits that a leaf is, and the name of its first parameter."""
    parameters = node.parameters
    for element in CIRCUIT_ELEMENTS.values():
        own = tuple(p.name for p in parameters if not p.held)
        if [name[0] for name in own] == [name[0] for name in element.names] and node == element.build(*own):
            return element, own[0]
    marked = any(p.shared or (p.held and p.name) for p in parameters)
    why = "what is shared or held is no part of a circuit's text" if marked else "circuits have no such element"
    raise InputError(f"'{node}' has no spelling in circuits: {why}")


def _printed(node: Network, words: Mapping[int, str]) -> str:
    if isinstance(node, Parallel):
        return "-".join(_printed(part, words) for part in node.parts)
    if isinstance(node, Series):
        return f"p({','.join(_printed(part, words) for part in node.parts)})"
    return words[id(node)]
