"""Numbers in sentences, held against the JSON that they come from."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

NUMBER = re.compile(r"(?<![\w.])[−-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?![\w.]*\w)")
"""A number that is no part of a name such as n3 or P01."""

FITS = ("to within their noise", "as the model predicts", "Nothing is missing")
"""Words of a network that describes the recordings."""

DOES_NOT_FIT = ("does not describe", "leaves out", "by more than the model explains", "Physics is missing")
"""Words of one that does not."""


def numbers(record: Any) -> Iterator[float]:
    """All numbers of a JSON value."""
    if isinstance(record, dict):
        record = list(record.values())
    if isinstance(record, list | tuple):
        for item in record:
            yield from numbers(item)
    elif isinstance(record, int | float) and not isinstance(record, bool):
        yield float(record)


def value_of(text: str) -> float:
    """A number as it is written."""
    return float(text.replace("−", "-"))


def is_rounded(text: str, value: float) -> bool:
    """Whether a text is a value with fewer digits: off by less than one of its last place."""
    digits = text.lstrip("−-").split("e")[0].replace(".", "").lstrip("0")
    written = abs(value_of(text))
    last = 10.0 ** (math.floor(math.log10(written)) + 1 - max(len(digits), 1)) if written else 0.01
    return abs(written - abs(value)) <= 0.51 * last * (1 + 1e-9)


def recorded(text: str, values: Sequence[float]) -> bool:
    """Whether a number is one of the record, maybe in a unit with a prefix or in per cent."""
    scales = (1.0, 100.0, *(10.0 ** (3 * k) for k in range(-4, 5)))
    return any(is_rounded(text, value * scale) for value in values for scale in scales)


def contradictions(words: str) -> list[tuple[str, str]]:
    """Pairs of statements on one page of which only one can be true."""
    return [(one, other) for one in FITS for other in DOES_NOT_FIT if one in words and other in words]


def sentences(words: str) -> list[str]:
    """What ends with a full stop."""
    return re.findall(r"[^.]*(?:\.\d[^.]*)*\.(?!\d)", words)
