"""Progress bars on a terminal; elsewhere, such as in a log, a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

from bayes_impedance.commands.terminal import complain

LINE_EVERY_S = 60.0
"""Least time in s between two lines of a log, and before the first. By choice: a job of an hour leaves about sixty
lines, and one that is done sooner leaves none."""


class Bars:
    """Progress bars on a terminal, one for each stage; lines of text on standard error if that is none.

    Parameters
    ----------
    clock : callable
        Returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.stage, self.bar = "", None  # type: tuple[str, Any]
        self.make: Callable[..., Any] | None = None
        self.clock, self.told = clock, clock()

    def __enter__(self) -> Bars:
        return self

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Move the stage's bar, or write a line if the last is old enough; a new stage ends the last bar."""
        if sys.stderr is None or not sys.stderr.isatty():
            if self.clock() - self.told >= LINE_EVERY_S:
                self.told = self.clock()
                complain(f"{time.strftime('%H:%M:%S')} {stage}: {done} of {total}")
            return
        if self.make is None:
            from tqdm import tqdm

            self.make = tqdm
        if stage != self.stage or self.bar is None:
            self.__exit__()
            self.stage = stage
            self.bar = self.make(total=total, desc=f"{stage:22}", unit="", leave=True, file=sys.stderr)
        self.bar.total = total
        self.bar.update(done - self.bar.n)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
            self.bar = None
