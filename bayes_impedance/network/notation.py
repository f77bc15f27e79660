r"""The notation of networks: text to tree.

The grammar, in which blanks do not matter::

    network = term {"|" term}                                      parallel: impedances add
    term    = part {"-" part}                                      series: mobilities add
    part    = [label ":"] (leaf | wrapper | "(" network ")")
    leaf    = symbol                                               m1, n1, r1
            | symbol "^" (symbol | number) ["@" hertz]             p1^a1, a power law
    wrapper = word "[" symbol {"," symbol} "]" "(" network ")"     delay[d1*](...)
    symbol  = name ["*" | "=" number]                              * : the same for everybody; = : held at a value

What the leaves and wrappers mean is in :mod:`bayes_impedance.network.constructs`. What begins with a capital letter or
with ``p(`` is no such network, and is read in the spelling of :mod:`bayes_impedance.network.electrical`.
``str(network)`` writes a network in the notation from which :func:`parse` makes an equal one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from bayes_impedance.errors import InputError
from bayes_impedance.network.electrical import is_circuit, read_circuit
from bayes_impedance.network.extensions import PowerLaw, Wrapped, wrapped
from bayes_impedance.network.parameters import Symbol
from bayes_impedance.network.tokens import DEEPEST, NUMBER, Tokens
from bayes_impedance.network.tree import NAME, PAPER_NETWORK, Element, Network, Parallel, Place, Series, group_of

__all__ = ["PAPER_NETWORK", "Element", "Network", "Parallel", "Place", "PowerLaw", "Series", "Wrapped", "parse"]


@lru_cache(maxsize=1024)
def parse(text: str) -> Network:
    """Read a network from its notation.

    >>> network = parse("(n3|r3)-(m2|r1|n1)")
    >>> network.elements
    ('n3', 'r3', 'm2', 'r1', 'n1')
    >>> parse("r2") | parse("m1-n1")  # impedances add, mobilities add
    parse('r2|(m1-n1)')

    Parameters
    ----------
    text : str
        For instance ``skin:(n3|r3)-tissue:(m2|r1|n1|(m1-(n2|r2)))``, or in the spelling of electrical circuits,
        ``R0-p(R1,CPE1)-Wo1`` (:mod:`bayes_impedance.network.electrical`). Blanks do not matter.

    Networks cannot be changed: that of a text is made once.

    Raises
    ------
    InputError
        If the notation is invalid; the message gives the position.
    """
    return read_circuit(text) if is_circuit(text) else _Parser(text).read()


class _Parser(Tokens):
    """Recursive descent by the grammar above."""

    def __init__(self, text: str) -> None:
        super().__init__(text, "network")
        self.depth = 0

    def read(self) -> Network:
        network = self.expression()
        if self.peek():
            raise self.error("'|', '-' or the end")
        return network

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
            raise self.too_deep()
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
                raise InputError(f"{self.shown}: '{label}:{part.label}:' gives one group two labels; keep one")
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
        if not NUMBER.fullmatch(self.peek()):
            raise self.error(what)
        return sign * float(self.take())
