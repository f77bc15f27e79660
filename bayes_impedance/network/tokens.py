"""Words and signs of a notation, read one after the other; messages name the character at which reading stopped."""

from __future__ import annotations

import re

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import shown, text_in

DEEPEST = 50
"""Largest nesting depth of parentheses and labels. By choice: recursion takes a few calls per level, and Python allows
a thousand in all. The fingertip's network has four levels."""
LONGEST = 10_000
"""Most characters of a notation. By choice: a thousand elements with their groups, far more than can be estimated."""

NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_TOKEN = re.compile(rf"[A-Za-z_][A-Za-z0-9_]*|{NUMBER.pattern}|\S")


class Tokens:
    """A text in pieces, and the place up to which it has been read.

    Parameters
    ----------
    text : str
    what : str
        What the text is, for messages: a network, a circuit.

    Raises
    ------
    InputError
        If it is no text, or longer than any that is read.
    """

    def __init__(self, text: str, what: str) -> None:
        self.text = text_in(text, f"a {what}")
        if len(text) > LONGEST:
            raise InputError(f"{what} {shown(text)} has {len(text)} characters; at most {LONGEST} are read")
        self.shown = f"{what} " + (shown(text) if len(text) > 200 or not text.isprintable() else f"'{text}'")
        self.tokens = [(m.group(), m.start()) for m in _TOKEN.finditer(text)]
        self.position = 0

    def peek(self, ahead: int = 0) -> str:
        """The next piece, or one further ahead; empty at the end."""
        i = self.position + ahead
        return self.tokens[i][0] if i < len(self.tokens) else ""

    def take(self) -> str:
        """The next piece, which is read with that."""
        token = self.peek()
        self.position += 1
        return token

    def expect(self, sign: str) -> None:
        """Read a sign that must come next."""
        if self.peek() != sign:
            raise self.error(f"'{sign}'")
        self.take()

    def error(self, expected: str) -> InputError:
        """What is wrong with the next piece."""
        if not self.peek():
            return InputError(f"{self.shown} ends too early: expected {expected}")
        token, start = self.tokens[self.position]
        token = repr(token) if len(token) <= 60 else shown(token)
        return InputError(f"{self.shown}: {token} at character {start + 1} is not {expected}")

    def too_deep(self) -> InputError:
        """The sentence for what is nested too deep."""
        return InputError(f"{self.shown} is nested more than {DEEPEST} levels deep; write it in fewer")
