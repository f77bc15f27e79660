"""Validation of tables written by users: known keys, and values of the right type and range.

Devices, datasets' descriptions, populations to simulate, effects and priors are all checked by the functions here. A
misspelt key must not silently fall back to a default. Unknown keys are therefore refused (or, where other programs'
keys are allowed, reported) together with the most similar known key.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from numbers import Integral, Real
from typing import Any

from bayes_impedance.errors import InputError

_LONGEST_SHOWN = 60
"""Most characters of a value or name quoted in a message. By choice: a message stays one readable sentence."""


def similar(name: str, candidates: Iterable[str]) -> str | None:
    """Return the candidate that looks most like a misspelt name, or None."""
    close = difflib.get_close_matches(name[:_LONGEST_SHOWN], list(candidates), n=1, cutoff=0.6)
    return close[0] if close else None


def hint(name: str, candidates: Collection[str]) -> str:
    """End of a sentence that suggests the intended name."""
    guess = similar(name, candidates)
    return f'did you mean "{guess}"?' if guess else f"known are {', '.join(candidates)}"


def shown(value: object) -> str:
    """A value as quoted in a message: shortened, in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int) and value.bit_length() > 64:
        return f"an integer of {int(value.bit_length() * math.log10(2)) + 1} digits"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple | set | frozenset):
        return f"a {type(value).__name__}"
    return _short(" ".join(str(value).split()))


def _quoted(text: str) -> str:
    return f'"{_short(text)}"' if text.isprintable() else _short(repr(text[: 2 * _LONGEST_SHOWN]))


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST_SHOWN else text[: _LONGEST_SHOWN - 3] + "..."


def number_in(
    value: object,
    what: str,
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
) -> float:
    """Return a value that must be a finite number, and no boolean, within its range.

    Parameters
    ----------
    value : object
    what : str
        Location and name of the value, the subject of the message's sentence.
    above, at_least, below, at_most : float, optional
        Range, in the value's unit.

    Raises
    ------
    InputError
        If it is not a finite number within the range.
    """
    bounds = [
        f"{word} {bound:g}"
        for word, bound in (("above", above), ("at least", at_least), ("below", below), ("at most", at_most))
        if bound is not None
    ]
    wanted = " ".join(["a finite number", " and ".join(bounds)]).strip()
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
    inside = (
        math.isfinite(number)
        and (above is None or number > above)
        and (at_least is None or number >= at_least)
        and (below is None or number < below)
        and (at_most is None or number <= at_most)
    )
    if not inside:
        raise InputError(f"{what} is {shown(value)}, but must be {wanted}")
    return number


def whole_number_in(value: object, what: str, at_least: int) -> int:
    """Return a value that must be a whole number, and no boolean, from `at_least` on.

    Raises
    ------
    InputError
        If it is not.
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or value < at_least:
        raise InputError(f"{what} is {shown(value)}, but must be a whole number from {at_least} on")
    return int(value)


def text_in(value: object, what: str) -> str:
    """Return a value that must be text.

    Raises
    ------
    InputError
        If it is not text.
    """
    if not isinstance(value, str):
        raise InputError(f"{what} is {shown(value)}, but must be text; put it in quotation marks")
    return value


def choice_in(value: object, what: str, choices: Collection[str]) -> str:
    """Return a value that must be one of several words.

    Raises
    ------
    InputError
        If it is none of them; the message names the most similar one.
    """
    if isinstance(value, str) and value in choices:
        return value
    guess = similar(value, choices) if isinstance(value, str) else None
    meant = f' (did you mean "{guess}"?)' if guess else ""
    raise InputError(f"{what} is {shown(value)}{meant}, but must be one of {', '.join(c or repr(c) for c in choices)}")


class UserTable:
    """A table with a fixed set of keys.

    Parameters
    ----------
    content : object
        The parsed content.
    where : str or callable
        Location for messages; a function of a key can name its line.
    known : collection of str
        Allowed keys.
    tolerant : bool
        Whether other keys are allowed; they are listed in :attr:`unknown`.

    Raises
    ------
    InputError
        If it is not a table, or has an unknown key and `tolerant` is false.
    """

    def __init__(
        self, content: object, where: str | Callable[[str], str], known: Collection[str], *, tolerant: bool = False
    ) -> None:
        self._where = where
        if not isinstance(content, Mapping):
            raise InputError(f"{self.where('')}: is {shown(content)}, but must be a table of {', '.join(known)}")
        self._content: dict[str, Any] = {str(key): value for key, value in content.items()}
        self._known = known
        self.unknown = tuple(key for key in self._content if key not in known)
        if self.unknown and not tolerant:
            raise InputError(self.about_unknown(self.unknown[0]))

    def where(self, key: str) -> str:
        """Location of a key."""
        return self._where if isinstance(self._where, str) else self._where(key)

    def about_unknown(self, key: str) -> str:
        """Message about an unknown key."""
        return f"{self.where(key)}: key {_quoted(key)} is not used; {hint(key, self._known)}"

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def __getitem__(self, key: str) -> Any:
        """Value of a required key.

        Raises
        ------
        InputError
            If it is missing.
        """
        if key not in self._content:
            raise InputError(f'{self.where("")}: key "{key}" is missing; add it')
        return self._content[key]

    def get(self, key: str, default: Any) -> Any:
        """Value of a key, of any type, or the default."""
        return self._content.get(key, default)

    def text(self, key: str, default: str | None = None) -> str:
        """Text of a key, or the default; without a default the key is required."""
        if default is not None and key not in self:
            return default
        return text_in(self[key], f"{self.where(key)}: {key}")

    def number(self, key: str, default: float | None = None, **bounds: float) -> float:
        """Number of a key within the bounds of :func:`number_in`, or the default."""
        if default is not None and key not in self:
            return default
        return number_in(self[key], f"{self.where(key)}: {key}", **bounds)

    def choice(self, key: str, choices: Collection[str]) -> str:
        """Word of a key, one of `choices`."""
        return choice_in(self[key], f"{self.where(key)}: {key}", choices)
