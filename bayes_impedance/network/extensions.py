"""Nodes of a network besides masses, springs and dampers: power laws and wrappers.

Their formulas are derived in :mod:`bayes_impedance.network.constructs`; the tree that they are part of is in
:mod:`bayes_impedance.network.tree`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.network.constructs import CONSTRUCTS, Construct
from bayes_impedance.network.parameters import (
    EXPONENTS,
    LOGIT,
    Parameter,
    Symbol,
    exactly,
    plain_parameter,
    quantity_of,
)
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.network.tree import Network, require_allowed, require_distinct, require_name, value_of

RADIAN_PER_SECOND = 1 / (2 * np.pi)
"""Reference frequency in Hz of a power law without one: its size is then the c of c s^(a-1)."""

POWER_LAW_SOURCES = {"a": "Scott Blair 1947; Koeller 1984; Cole and Cole 1941", "b": "Vanderkooy 1989"}
"""Where the formula is from by the exponent's letter: springpots and constant-phase elements; semi-inductances."""


@dataclass(frozen=True, repr=False)
class PowerLaw(Network):
    """A power law: p (s/w0)^(a-1), an element between spring and damper, or between damper and mass.

    Attributes
    ----------
    size : Symbol
        Its impedance's size at the reference frequency.
    exponent : Symbol
        Its letter says between what; a held exponent may have no name.
    reference_hz : float or None
        The reference frequency; 1 rad/s if there is none.
    """

    size: Symbol
    exponent: Symbol
    reference_hz: float | None = None
    _label: str | None = None

    def __post_init__(self) -> None:
        require_name(self.size.name, "a power law", "a letter p and then digits")
        if self.size.name[:1] != "p":
            raise InputError(
                f"'{self.size}^{self.exponent}' is not a power law: only p can have an exponent, as in p1^a1"
            )
        if self.exponent.name:
            require_name(self.exponent.name, "an exponent", "a letter a or b and then digits")
            if self.exponent.name[:1] not in EXPONENTS:
                raise InputError(
                    f"'{self.exponent.name}' cannot be an exponent: call it a1 (0 to 1, spring to damper) or b1 (1 to "
                    "2, damper to mass)"
                )
        if self.reference_hz is not None and not (np.isfinite(self.reference_hz) and self.reference_hz > 0):
            raise InputError(f"'{self._notation()}': the reference frequency must be above zero and finite")
        require_allowed(self.own_parameters)

    @property
    def own_parameters(self) -> tuple[Parameter, ...]:
        """The size and the exponent."""
        exponent = self.exponent
        letter = exponent.name[:1] or ("b" if exponent.value is not None and exponent.value > 1 else "a")
        own = Parameter(symbol=exponent, letter=letter, link=LOGIT)
        return plain_parameter(self.size), own

    def _holding_own(self, values: Mapping[str, float]) -> Network:
        return replace(self, size=_held(self.size, values), exponent=_held(self.exponent, values))

    def _sharing_own(self, names: Collection[str]) -> Network:
        return replace(self, size=_same(self.size, names), exponent=_same(self.exponent, names))

    def _notation(self) -> str:
        at = "" if self.reference_hz is None else f"@{exactly(self.reference_hz)}"
        return f"{self.size}^{self.exponent}{at}"

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        omega = 2 * np.pi * (self.reference_hz or RADIAN_PER_SECOND)
        size, a = (np.asarray(value_of(symbol, values)) for symbol in (self.size, self.exponent))
        return np.asarray(size * (np.asarray(s, dtype=complex) / omega) ** (a - 1))

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        raise _not_rational(self._notation())


@dataclass(frozen=True, repr=False)
class Wrapped(Network):
    """A network whose impedance is changed as a whole, such as ``delay[d1](...)``.

    Attributes
    ----------
    construct : Construct
    symbols : tuple of Symbol
        One for each of its parameters.
    part : Network
        What is wrapped.
    """

    construct: Construct
    symbols: tuple[Symbol, ...]
    part: Network
    _label: str | None = None

    def __post_init__(self) -> None:
        letters, word = self.construct.letters, self.construct.word
        wanted = ", ".join(f"{letter[0]}1" for letter in letters)
        if len(self.symbols) != len(letters):
            many = f"{len(letters)} parameter{'s' * (len(letters) > 1)}"
            raise InputError(f"{word} has {many}, not {len(self.symbols)}: {word}[{wanted}](...)")
        for symbol, allowed in zip(self.symbols, letters, strict=True):
            require_name(symbol.name, "a parameter", "a letter and then digits")
            if symbol.name[0] not in allowed:
                meant = " or ".join(f"{letter} ({quantity_of(letter).name})" for letter in allowed)
                raise InputError(f"'{symbol.name}' in {word}[...] must begin with {meant}: {word}[{wanted}](...)")
        require_allowed(self.own_parameters)
        require_distinct(self)

    @property
    def parts(self) -> tuple[Network, ...]:
        return (self.part,)

    @property
    def own_parameters(self) -> tuple[Parameter, ...]:
        """The wrapper's parameters, without those of what is wrapped."""
        return tuple(
            Parameter(
                symbol=symbol,
                letter=symbol.name[0],
                link=self.construct.link(i, symbol.shared or symbol.value is not None),
            )
            for i, symbol in enumerate(self.symbols)
        )

    def with_parts(self, parts: Sequence[Network]) -> Network:
        return replace(self, part=parts[0])

    def _holding_own(self, values: Mapping[str, float]) -> Network:
        return replace(self, symbols=tuple(_held(symbol, values) for symbol in self.symbols))

    def _sharing_own(self, names: Collection[str]) -> Network:
        return replace(self, symbols=tuple(_same(symbol, names) for symbol in self.symbols))

    def _notation(self) -> str:
        return f"{self.construct.word}[{', '.join(str(symbol) for symbol in self.symbols)}]({self.part})"

    def impedance(self, s: npt.ArrayLike, values: Mapping[str, Any]) -> np.ndarray:
        x = [np.asarray(value_of(symbol, values)) for symbol in self.symbols]
        letters = [symbol.name[0] for symbol in self.symbols]
        return self.construct.formula(np.asarray(s, dtype=complex), self.part.impedance(s, values), x, letters)

    def transfer_function(self, values: Mapping[str, Any]) -> TransferFunction:
        raise _not_rational(f"{self.construct.word}[...]")


def wrapped(word: str, symbols: Sequence[Symbol], part: Network) -> Wrapped:
    """A wrapper by its word.

    Raises
    ------
    InputError
        If there is no such wrapper, or its parameters are not those that it has.
    """
    construct = CONSTRUCTS.get(word)
    if construct is None:
        raise InputError(f"'{word}[...]' is unknown: there are {', '.join(CONSTRUCTS)}")
    return Wrapped(construct, tuple(symbols), part)


def _not_rational(what: str) -> InputError:
    return InputError(f"{what} has no transfer function that is a ratio of polynomials; use a network without it")


def _held(symbol: Symbol, values: Mapping[str, float]) -> Symbol:
    return Symbol(symbol.name, value=values[symbol.name]) if symbol.name in values else symbol


def _same(symbol: Symbol, names: Collection[str]) -> Symbol:
    return Symbol(symbol.name, shared=True) if symbol.name in names else symbol
