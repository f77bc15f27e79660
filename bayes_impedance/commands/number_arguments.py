"""Numbers on the command line: readers that refuse what is out of range, and limits that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import number_in, shown

LARGEST_SEED = 2**63 - 1
"""Largest signed 64-bit integer, the type in which results keep the seed."""
MOST_WORKERS = 1024
"""Most worker processes. By choice: each takes some hundred megabytes, and few machines have more processors."""


def whole(at_most: int, at_least: int = 1) -> Callable[[str], int]:
    """Reader of a whole number within a range."""

    def read(text: str) -> int:
        # Every allowed number has at most twenty digits; Python refuses to convert thousands of digits.
        digits = text.strip().removeprefix("+")
        value = int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 20 else -1
        if not at_least <= value <= at_most:
            raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number from {at_least} to {at_most}")
        return value

    return read


def number(**bounds: float) -> Callable[[str], float]:
    """Reader of a finite number within a range."""

    def read(text: str) -> float:
        try:
            value: object = float(text)
        except ValueError:
            value = text
        try:
            return number_in(value, "it", **bounds)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read
