r"""Networks of masses, compliances and dampers: the tree, its notation, its places and its transfer function.

Two elements that share one **velocity** are in parallel, and the forces they need add up; two that pass on one
**force** are in series, and their velocities add up. With z = F/v therefore

.. math::
    (a\,|\,b):\; z = z_a + z_b, \qquad\qquad (a - b):\; \frac1z = \frac1{z_a} + \frac1{z_b} .

The same two characters build a network in Python and in text, with Python's precedence (``-`` binds tighter)::

    Element("n3") | Element("r3")                       an elastic, lossy skin
    parse("skin:(n3|r3)-tissue:(m2|r1|n1|(m1-(n2|r2)))")  the fingertip with named groups

A mass has its other end in the inertial frame, so it is a one-port like the others. Nested groups of one kind are
flattened unless they have a label: addition is associative, so that each network has a unique notation.

The transfer function is computed on polynomials in s. A leaf is a monomial over a monomial, sums and reciprocals keep
all coefficients positive, and the only factors that can cancel for every value of the elements are powers of s; they
are found from coefficients that are exactly zero by structure, without a tolerance. With :class:`fractions.Fraction`
values the result is exact.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.rational import TransferFunction, add_fractions, monomial
from bayes_impedance.runtime.user_table import shown, text_in

PAPER_NETWORK = "skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))"
"""The fingertip network of fig. 1 and eq. 4 of the paper, with its groups named."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,59}")

DEEPEST = 50
"""Largest nesting depth of parentheses and labels. By choice: recursion takes a few calls per level, and Python allows
a thousand in all. The fingertip's network has four levels."""
LONGEST = 10_000
"""Most characters of a notation. By choice: a thousand elements with their groups, far more than can be estimated."""


class Place(NamedTuple):
    """A position in a network at which an element or operation may be inserted.

    Attributes
    ----------
    path : tuple of int
        Index of the part at each level, from the root.
    name : str
        ``port`` for the whole network; otherwise the label, or the notation of the part there.
    """

    path: tuple[int, ...]
    name: str


@dataclass(frozen=True)
class Network(ABC):
    """A mechanical one-port. Use :class:`Element`, the operators ``|`` and ``-``, or :func:`parse` to make one."""

    @property
    def parts(self) -> tuple[Network, ...]:
        """The direct parts of this network."""
        return ()

    @property
    def label(self) -> str | None:
        """Name of this group, if it has one."""
        return getattr(self, "_label", None)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the elements, in the order in which they are written."""
        return tuple(node.name for _, node in self.walk() if isinstance(node, Element))

    def walk(self, path: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], Network]]:
        """Every node with its path, parents before their parts."""
        yield path, self
        for i, part in enumerate(self.parts):
            yield from part.walk((*path, i))

    # ---------------------------------------------------------------- building

    def __or__(self, other: Network) -> Parallel:
        return Parallel(_flatten(Parallel, (self, other)))

    def __sub__(self, other: Network) -> Series:
        return Series(_flatten(Series, (self, other)))

    def labelled(self, label: str | None) -> Self:
        """The same network with a label.

        Raises
        ------
        InputError
            If the label is not a plain word, or is ``port``.
        """
        if label is not None and (label == "port" or _NAME.fullmatch(label) is None):
            raise InputError(f"'{label}' cannot be a label: use letters, digits and '_', and not the word 'port'")
        return replace(self, _label=label)  # type: ignore[call-arg]

    # ---------------------------------------------------------------- notation

    @abstractmethod
    def _notation(self) -> str:
        """Text of the node without its label."""

    def _as_part(self) -> str:
        """Text of the node inside a larger one: groups in parentheses, with label."""
        text = self._notation() if isinstance(self, Element) else f"({self._notation()})"
        return text if self.label is None else f"{self.label}:{text}"

    def __str__(self) -> str:
        return self._notation() if self.label is None else self._as_part()

    # ---------------------------------------------------------------- physics

    @abstractmethod
    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        """Impedance by plain recursion: slow, but simple; the reference for tests of the compiled kernel.

        Parameters
        ----------
        s : array_like, complex, shape (...)
            Complex frequency in rad/s.
        values : mapping of str to array_like
            Value of each element in its unit; broadcast against `s`. Complex values are allowed (the impedance is
            analytic in them).

        Returns
        -------
        ndarray, complex, shape (...)
            z = F/v.

        Raises
        ------
        InputError
            If an element has no value.
        """

    @abstractmethod
    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        """Numerator and denominator of z(s), without the powers of s that always cancel.

        Parameters
        ----------
        values : mapping of str to number
            Value of each element; floats, or Fractions for an exact result.
        """

    # ---------------------------------------------------------------- places and edits

    def places(self) -> tuple[Place, ...]:
        """All places, the port first."""
        return tuple(Place(path, _place_name(path, node)) for path, node in self.walk())

    def place(self, name: str) -> Place:
        """The place with this name: ``port``, a label, an element, or the notation of a group.

        Raises
        ------
        InputError
            If there is none.
        """
        for path, node in self.walk():
            if name in (_place_name(path, node), node._notation(), str(node)):
                return Place(path, _place_name(path, node))
        raise InputError(
            f"no place '{name}' in the network {self}: there are {', '.join(p.name for p in self.places())}"
        )

    def at(self, place: Place | str) -> Network:
        """The part of the network at a place."""
        node: Network = self
        for i in self._resolve(place).path:
            node = node.parts[i]
        return node

    def replaced(self, place: Place | str, new: Network) -> Network:
        """The network with another part at a place."""
        path = self._resolve(place).path
        if not path:
            return new
        parts = list(self.parts)
        child = parts[path[0]]
        parts[path[0]] = child.replaced(Place(path[1:], ""), new)
        return _combine(type(self), parts).labelled(self.label)

    def beside(self, place: Place | str, addition: Network) -> Network:
        """The network with `addition` in parallel to the part at `place` (common velocity)."""
        return self.replaced(place, self.at(place) | addition)

    def in_series(self, place: Place | str, addition: Network) -> Network:
        """The network with `addition` in series with the part at `place` (common force)."""
        return self.replaced(place, self.at(place) - addition)

    def _resolve(self, place: Place | str) -> Place:
        return self.place(place) if isinstance(place, str) else place


@dataclass(frozen=True)
class Element(Network):
    """A single mass, compliance or damper: the first letter of its name says which."""

    name: str
    _label: str | None = None

    def __post_init__(self) -> None:
        if _NAME.fullmatch(self.name) is None:
            raise InputError(f"{shown(self.name)} is not a name of an element: use a letter m, n or r and then digits")
        kind_of(self.name)

    def _notation(self) -> str:
        return self.name

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        return kind_of(self.name).impedance(s, _value(self.name, values))

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        kind = kind_of(self.name)
        return monomial(_value(self.name, values), kind.exponent, kind.power)


@dataclass(frozen=True)
class _Group(Network):
    members: tuple[Network, ...]
    _label: str | None = None

    def __post_init__(self) -> None:
        if len(self.members) < 2:
            raise InputError("a group needs at least two parts")
        names = self.elements
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"element '{twice[0]}' occurs twice in the network: give each element a name of its own")
        labels = [node.label for _, node in self.walk() if node.label is not None]
        clash = sorted({label for label in labels if label in names or labels.count(label) > 1})
        if clash:
            raise InputError(f"label '{clash[0]}' is used twice or names an element: give each group a name of its own")

    @property
    def parts(self) -> tuple[Network, ...]:
        return self.members


@dataclass(frozen=True)
class Parallel(_Group):
    """Parts with one velocity in common: their impedances add."""

    def _notation(self) -> str:
        return "|".join(part._as_part() for part in self.members)

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        parts = np.broadcast_arrays(*(part.impedance(s, values) for part in self.members))
        return np.asarray(np.sum(parts, axis=0))

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        return add_fractions([part.transfer_function(values) for part in self.members])


@dataclass(frozen=True)
class Series(_Group):
    """Parts with one force in common: their mobilities (1/z) add."""

    def _notation(self) -> str:
        return "-".join(part._as_part() for part in self.members)

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        mobilities = np.broadcast_arrays(*(1 / part.impedance(s, values) for part in self.members))
        return np.asarray(1 / np.sum(mobilities, axis=0))

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        return add_fractions([part.transfer_function(values).reciprocal() for part in self.members]).reciprocal()


def parse(text: str) -> Network:
    """Read a network from its notation.

    Parameters
    ----------
    text : str
        For instance ``skin:(n3|r3)-tissue:(m2|r1|n1|(m1-(n2|r2)))``. Blanks do not matter.

    Raises
    ------
    InputError
        If the notation is invalid; the message gives the position.
    """
    return _Parser(text).read()


class _Parser:
    """Recursive descent: expr = term {'|' term}; term = part {'-' part}; part = [label ':'] name | '(' expr ')'."""

    def __init__(self, text: str) -> None:
        self.text = text_in(text, "a network")
        if len(text) > LONGEST:
            raise InputError(f"network {shown(text)} has {len(text)} characters; at most {LONGEST} are read")
        self.shown = shown(text) if len(text) > 200 or not text.isprintable() else f"'{text}'"
        self.depth = 0
        self.tokens = [(m.group(), m.start()) for m in re.finditer(r"[A-Za-z_][A-Za-z0-9_]*|\S", text)]
        self.position = 0

    def read(self) -> Network:
        network = self.expression()
        if self.peek():
            raise self.error("'|', '-' or the end")
        return network

    def peek(self, ahead: int = 0) -> str:
        i = self.position + ahead
        return self.tokens[i][0] if i < len(self.tokens) else ""

    def take(self) -> str:
        token = self.peek()
        self.position += 1
        return token

    def error(self, expected: str) -> InputError:
        if not self.peek():
            return InputError(f"network {self.shown} ends too early: expected {expected}")
        token, start = self.tokens[self.position]
        token = repr(token) if len(token) <= 60 else shown(token)
        return InputError(f"network {self.shown}: {token} at character {start + 1} is not {expected}")

    def expression(self) -> Network:
        return self.group("|", Parallel, self.term)

    def term(self) -> Network:
        return self.group("-", Series, self.part)

    def group(self, sign: str, kind: type[_Group], read: Callable[[], Network]) -> Network:
        # The group is made once: adding part by part would repeat its checks for each.
        parts = [read()]
        while self.peek() == sign:
            self.take()
            parts.append(read())
        return parts[0] if len(parts) == 1 else kind(_flatten(kind, parts))

    def part(self) -> Network:
        self.depth += 1
        if self.depth > DEEPEST:
            raise InputError(f"network {self.shown} is nested more than {DEEPEST} levels deep; write it in fewer")
        try:
            return self._part()
        finally:
            self.depth -= 1

    def _part(self) -> Network:
        if self.peek(1) == ":" and _NAME.fullmatch(self.peek()):
            label = self.take()
            self.take()
            part = self.part()
            if part.label is not None:
                raise InputError(f"network {self.shown}: '{label}:{part.label}:' gives one group two labels; keep one")
            return part.labelled(label)
        if self.peek() == "(":
            self.take()
            network = self.expression()
            if self.peek() != ")":
                raise self.error("')'")
            self.take()
            return network
        if not _NAME.fullmatch(self.peek()):
            raise self.error("an element such as m1, n1 or r1, or '('")
        return Element(self.take())


def _value(name: str, values: Mapping[str, Any]) -> Any:
    if name not in values:
        raise InputError(f"element '{name}' has no value: there are values for {', '.join(values) or 'none'}")
    return values[name]


def _place_name(path: tuple[int, ...], node: Network) -> str:
    return "port" if not path else node.label or node._notation()


def _flatten(kind: type[_Group], parts: Sequence[Network]) -> tuple[Network, ...]:
    flat: list[Network] = []
    for part in parts:
        flat.extend(part.parts if isinstance(part, kind) and part.label is None else (part,))
    return tuple(flat)


def _combine(kind: type[Network], parts: Sequence[Network]) -> Network:
    assert issubclass(kind, _Group)  # only groups have parts
    return kind(_flatten(kind, parts))
