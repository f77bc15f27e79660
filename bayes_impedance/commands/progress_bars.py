"""Progress bars on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any


class Bars:
    """Progress bars on a terminal, one for each stage; nothing is drawn elsewhere."""

    def __init__(self) -> None:
        self.stage, self.bar = "", None  # type: tuple[str, Any]
        self.make: Callable[..., Any] | None = None

    def __enter__(self) -> Bars:
        return self

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Move the stage's bar; a new stage ends the last one."""
        if self.make is None:
            from tqdm import tqdm

            self.make = tqdm
        if stage != self.stage or self.bar is None:
            self.__exit__()
            self.stage = stage
            self.bar = self.make(total=total, desc=f"{stage:22}", disable=None, unit="", leave=True, file=sys.stderr)
        self.bar.total = total
        self.bar.update(done - self.bar.n)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
            self.bar = None
