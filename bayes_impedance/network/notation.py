r"""The notation of networks: text to tree.

The grammar, in which blanks do not matter::

    network = term {"|" term}                                      parallel: impedances add
    term    = part {"-" part}                                      series: mobilities add
    part    = [label ":"] (leaf | wrapper | "(" network ")")
    leaf    = symbol                                               m1, n1, r1
            | symbol "^" (symbol | number) ["@" hertz]             p1^a1, a power law
    wrapper = word "[" symbol {"," symbol} "]" "(" network ")"     delay[d1*](...)
    symbol  = name ["*" | "=" number]                              * : the same for everybody; = : held at a value

What the leaves and wrappers mean is in :mod:`bayes_impedance.network.constructs`. ``str(network)`` writes a network in
the notation from which :func:`parse` makes an equal one.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from bayes_impedance.errors import InputError
from bayes_impedance.network.extensions import PowerLaw, Wrapped, wrapped
from bayes_impedance.network.parameters import Symbol
from bayes_impedance.network.tree import NAME, PAPER_NETWORK, Element, Network, Parallel, Place, Series, group_of
from bayes_impedance.runtime.user_table import shown, text_in

__all__ = ["PAPER_NETWORK", "Element", "Network", "Parallel", "Place", "PowerLaw", "Series", "Wrapped", "parse"]

DEEPEST = 50
"""Largest nesting depth of parentheses and labels. By choice: recursion takes a few calls per level, and Python allows
a thousand in all. The fingertip's network has four levels."""
LONGEST = 10_000
"""Most characters of a notation. By choice: a thousand elements with their groups, far more than can be estimated."""

_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|\S")
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


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
    """Recursive descent by the grammar above."""

    def __init__(self, text: str) -> None:
        self.text = text_in(text, "a network")
        if len(text) > LONGEST:
            raise InputError(f"network {shown(text)} has {len(text)} characters; at most {LONGEST} are read")
        self.shown = shown(text) if len(text) > 200 or not text.isprintable() else f"'{text}'"
        self.depth = 0
        self.tokens = [(m.group(), m.start()) for m in _TOKEN.finditer(text)]
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

    def group(self, sign: str, kind: type[Parallel | Series], read: Callable[[], Network]) -> Network:
        parts = [read()]
        while self.peek() == sign:
            self.take()
            parts.append(read())
        return parts[0] if len(parts) == 1 else group_of(kind, parts)

    def part(self) -> Network:
        self.depth += 1
        if self.depth > DEEPEST:
            raise InputError(f"network {self.shown} is nested more than {DEEPEST} levels deep; write it in fewer")
        try:
            return self._part()
        finally:
            self.depth -= 1

    def _part(self) -> Network:
        if self.peek(1) == ":" and NAME.fullmatch(self.peek()):
            label = self.take()
            self.take()
            part = self.part()
            if part.label is not None:
                raise InputError(f"network {self.shown}: '{label}:{part.label}:' gives one group two labels; keep one")
            return part.labelled(label)
        if self.peek() == "(":
            return self.enclosed()
        if not NAME.fullmatch(self.peek()):
            raise self.error("an element such as m1, n1 or r1, or '('")
        if self.peek(1) == "[":
            return self.wrapper()
        size = self.symbol()
        if self.peek() != "^":
            if size.name[:1] == "p":
                raise self.error("'^' and the power law's exponent, such as p1^a1")
            return Element(size.name, None, size.shared, size.value)
        self.take()
        exponent = self.symbol() if NAME.fullmatch(self.peek()) else Symbol("", value=self.number("an exponent"))
        if self.peek() != "@":
            return PowerLaw(size, exponent)
        self.take()
        return PowerLaw(size, exponent, self.number())

    def enclosed(self) -> Network:
        self.expect("(")
        network = self.expression()
        self.expect(")")
        return network

    def wrapper(self) -> Network:
        word = self.take()
        self.take()
        symbols = [self.symbol()]
        while self.peek() == ",":
            self.take()
            symbols.append(self.symbol())
        self.expect("]")
        return wrapped(word, symbols, self.enclosed())

    def symbol(self) -> Symbol:
        if not NAME.fullmatch(self.peek()):
            raise self.error("the name of a parameter")
        name = self.take()
        if self.peek() == "*":
            self.take()
            return Symbol(name, shared=True)
        if self.peek() == "=":
            self.take()
            return Symbol(name, value=self.number())
        return Symbol(name)

    def number(self, what: str = "a number") -> float:
        sign = -1.0 if self.peek() == "-" else 1.0
        if sign < 0:
            self.take()
        if not _NUMBER.fullmatch(self.peek()):
            raise self.error(what)
        return sign * float(self.take())

    def expect(self, sign: str) -> None:
        if self.peek() != sign:
            raise self.error(f"'{sign}'")
        self.take()
