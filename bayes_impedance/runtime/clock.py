"""Wall-clock time of the steps of a computation."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """Wall-clock seconds of each named step; times of repeated steps are added.

    Attributes
    ----------
    seconds : dict of str to float
        In the order in which the steps ended first.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def measure(self, name: str) -> Iterator[None]:
        """Add the time until the context ends; a step that fails is not counted."""
        started = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started
