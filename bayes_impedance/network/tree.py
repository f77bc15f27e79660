r"""Networks as trees: elements, groups and wrappers, their places and their transfer function.

Two elements that share one **velocity** are in parallel, and the forces they need add up; two that pass on one
**force** are in series, and their velocities add up. With z = F/v therefore

.. math::
    (a\,|\,b):\; z = z_a + z_b, \qquad\qquad (a - b):\; \frac1z = \frac1{z_a} + \frac1{z_b} .

The same two characters build a network in Python and in text, with Python's precedence (``-`` binds tighter)::

    Element("n3") | Element("r3")                       an elastic, lossy skin
    parse("skin:(n3|r3)-tissue:(m2|r1|n1|(m1-(n2|r2)))")  the fingertip with named groups

A mass has its other end in the inertial frame, so it is a one-port like the others. Nested groups of one kind are
flattened unless they have a label: addition is associative, so that each network has a unique notation. Power laws and
wrappers are in :mod:`bayes_impedance.network.constructs`.

The transfer function is computed on polynomials in s. A leaf is a monomial over a monomial, sums and reciprocals keep
all coefficients positive, and the only factors that can cancel for every value of the elements are powers of s; they
are found from coefficients that are exactly zero by structure, without a tolerance. With :class:`fractions.Fraction`
values the result is exact.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.parameters import Parameter, Symbol, plain_parameter
from bayes_impedance.network.rational import TransferFunction, add_fractions, monomial
from bayes_impedance.network.shown import Shown
from bayes_impedance.runtime.user_table import shown

PAPER_NETWORK = "skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))"
"""The fingertip network of fig. 1 and eq. 4 of the paper, with its groups named."""

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,59}")


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


@dataclass(frozen=True, repr=False)
class Network(Shown, ABC):
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
    def own_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of this node alone, without those of its parts."""
        return ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order in which they are written; those that are held included."""
        return tuple(p for _, node in self.walk() for p in node.own_parameters)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the parameters that are not held, in the order in which they are written."""
        return tuple(p.name for p in self.parameters if not p.held)

    @property
    def plain(self) -> bool:
        """Whether it holds masses, compliances and dampers only, each a person's own."""
        leaves = (node for _, node in self.walk() if not isinstance(node, _Group))
        return all(isinstance(leaf, Element) and leaf.symbol == Symbol(leaf.name) for leaf in leaves)

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
        if label is not None and (label == "port" or NAME.fullmatch(label) is None):
            raise InputError(f"'{label}' cannot be a label: use letters, digits and '_', and not the word 'port'")
        return replace(self, _label=label)  # type: ignore[call-arg]

    def holding(self, values: Mapping[str, float]) -> Network:
        """The same network with some of its parameters held at these values."""
        parts = [part.holding(values) for part in self.parts]
        same = all(new is old for new, old in zip(parts, self.parts, strict=True))
        result = self if same else self.with_parts(parts).labelled(self.label)
        return result._holding_own(values)

    def sharing(self, names: Collection[str]) -> Network:
        """The same network with some of its parameters the same for everybody, and estimated if they were held."""
        result = self
        if self.parts:
            result = self.with_parts([part.sharing(names) for part in self.parts]).labelled(self.label)
        return result._sharing_own(names)

    def _holding_own(self, _values: Mapping[str, float]) -> Network:
        return self

    def _sharing_own(self, _names: Collection[str]) -> Network:
        return self

    # ---------------------------------------------------------------- notation

    @abstractmethod
    def _notation(self) -> str:
        """Text of the node without its label."""

    def _as_part(self) -> str:
        """Text of the node inside a larger one: groups in parentheses, with label."""
        text = f"({self._notation()})" if isinstance(self, _Group) else self._notation()
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
            Value of each parameter in its unit; broadcast against `s`. Those that are held need none. Complex values
            are allowed (the impedance is analytic in them).

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

        Raises
        ------
        InputError
            If the network holds what no ratio of polynomials describes: a power law, a wrapper.
        """

    # ---------------------------------------------------------------- places and edits

    def places(self) -> tuple[Place, ...]:
        """All places, the port first."""
        return tuple(Place(path, place_name(path, node)) for path, node in self.walk())

    def place(self, name: str) -> Place:
        """The place with this name: ``port``, a label, an element, or the notation of a group.

        Raises
        ------
        InputError
            If there is none.
        """
        for path, node in self.walk():
            if name in (place_name(path, node), node._notation(), str(node)):
                return Place(path, place_name(path, node))
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
        return self.with_parts(parts).labelled(self.label)

    def with_parts(self, parts: Sequence[Network]) -> Network:
        """The same node, without its label, with other parts; only nodes that have parts are asked."""
        raise NotImplementedError

    def beside(self, place: Place | str, addition: Network) -> Network:
        """The network with `addition` in parallel to the part at `place` (common velocity)."""
        return self.replaced(place, self.at(place) | addition)

    def in_series(self, place: Place | str, addition: Network) -> Network:
        """The network with `addition` in series with the part at `place` (common force)."""
        return self.replaced(place, self.at(place) - addition)

    def _resolve(self, place: Place | str) -> Place:
        return self.place(place) if isinstance(place, str) else place


@dataclass(frozen=True, repr=False)
class Element(Network):
    """A single mass, compliance or damper: the first letter of its name says which.

    Attributes
    ----------
    name : str
    shared : bool
        Whether it is the same for everybody: what belongs to the rig.
    value : float, optional
        The value at which it is held, if it is known.
    """

    name: str
    _label: str | None = None
    shared: bool = False
    value: float | None = None

    def __post_init__(self) -> None:
        require_name(self.name, "an element", "a letter m, n or r and then digits")
        kind_of(self.name)
        require_allowed(self.own_parameters)

    @property
    def symbol(self) -> Symbol:
        """The element as a parameter is written."""
        return Symbol(self.name, self.shared, self.value)

    @property
    def own_parameters(self) -> tuple[Parameter, ...]:
        return (plain_parameter(self.symbol),)

    def _holding_own(self, values: Mapping[str, float]) -> Network:
        return replace(self, shared=False, value=values[self.name]) if self.name in values else self

    def _sharing_own(self, names: Collection[str]) -> Network:
        return replace(self, shared=True, value=None) if self.name in names else self

    def _notation(self) -> str:
        return str(self.symbol)

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        return kind_of(self.name).impedance(s, value_of(self.symbol, values))

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        kind = kind_of(self.name)
        return monomial(value_of(self.symbol, values), kind.exponent, kind.power)


@dataclass(frozen=True, repr=False)
class _Group(Network):
    members: tuple[Network, ...]
    _label: str | None = None

    def __post_init__(self) -> None:
        if len(self.members) < 2:
            raise InputError("a group needs at least two parts")
        require_distinct(self)

    @property
    def parts(self) -> tuple[Network, ...]:
        return self.members

    def with_parts(self, parts: Sequence[Network]) -> Network:
        return type(self)(_flatten(type(self), parts))


@dataclass(frozen=True, repr=False)
class Parallel(_Group):
    """Parts with one velocity in common: their impedances add."""

    def _notation(self) -> str:
        return "|".join(part._as_part() for part in self.members)

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        parts = np.broadcast_arrays(*(part.impedance(s, values) for part in self.members))
        return np.asarray(np.sum(parts, axis=0))

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        return add_fractions([part.transfer_function(values) for part in self.members])


@dataclass(frozen=True, repr=False)
class Series(_Group):
    """Parts with one force in common: their mobilities (1/z) add."""

    def _notation(self) -> str:
        return "-".join(part._as_part() for part in self.members)

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        mobilities = np.broadcast_arrays(*(1 / part.impedance(s, values) for part in self.members))
        return np.asarray(1 / np.sum(mobilities, axis=0))

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        return add_fractions([part.transfer_function(values).reciprocal() for part in self.members]).reciprocal()


def group_of(kind: type[_Group], parts: Sequence[Network]) -> Network:
    """A group of two or more parts; made at once, as adding part by part would repeat its checks for each."""
    return kind(_flatten(kind, parts))


def place_name(path: tuple[int, ...], node: Network) -> str:
    """Name of a node as a place: ``port``, its label, its element, or its notation."""
    if not path:
        return "port"
    return node.label or (node.name if isinstance(node, Element) else node._notation())


def value_of(symbol: Symbol, values: Mapping[str, Any]) -> Any:
    """Value of a parameter: the one at which it is held, or the one given for it."""
    if symbol.value is not None:
        return symbol.value
    if symbol.name not in values:
        raise InputError(f"element '{symbol.name}' has no value: there are values for {', '.join(values) or 'none'}")
    return values[symbol.name]


def require_name(name: str, what: str, form: str) -> None:
    """Refuse what is not a plain word; `form` tells what would be."""
    if NAME.fullmatch(name) is None:
        raise InputError(f"{shown(name)} is not a name of {what}: use {form}")


def require_allowed(parameters: Sequence[Parameter]) -> None:
    """Refuse values at which a parameter cannot be held."""
    for parameter in parameters:
        if parameter.symbol.value is not None:
            parameter.u(parameter.symbol.value)


def require_distinct(network: Network) -> None:
    """Refuse a name that is used twice."""
    names = [p.name for p in network.parameters if p.name]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"element '{twice[0]}' occurs twice in the network: give each element a name of its own")
    labels = [node.label for _, node in network.walk() if node.label is not None]
    clash = sorted({label for label in labels if label in names or labels.count(label) > 1})
    if clash:
        raise InputError(f"label '{clash[0]}' is used twice or names an element: give each group a name of its own")


def _flatten(kind: type[_Group], parts: Sequence[Network]) -> tuple[Network, ...]:
    flat: list[Network] = []
    for part in parts:
        flat.extend(part.parts if isinstance(part, kind) and part.label is None else (part,))
    return tuple(flat)
