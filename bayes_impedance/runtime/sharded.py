"""Data of many persons that stay where they were computed: with a cluster's workers, or in this process.

They lie in parts (shards) of some dozens to hundreds of persons. Parts are asked for sums, and only sums travel. The
parts depend on the number of persons alone and are summed in order, so sums do not depend on who has worked. A cluster
recomputes what a lost worker had kept from what it had been computed from, back to the recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np

from bayes_impedance.runtime.executors import Cluster, Result, map_persons, over_rows, unchanged

_MOST_PARTS, _SMALLEST_PART, _LARGEST_PART = 8, 128, 512
"""Persons lie in eight parts, as far as sizes allow: with fewer than 128 in a part, a task's milliseconds of a cluster
show beside its work; more than 512 would leave workers idle at the end, and lose much with a worker."""


class Kept:
    """What is known of each of N persons, in parts, where it was worked out.

    Parameters
    ----------
    executor : Executor
        A :class:`Cluster` keeps the parts with its workers; with any other executor they are in this process.
    parts : sequence
        Of a cluster, what it knows the parts by. A part is a list with one entry for each person, or anything else
        that is only asked.
    """

    def __init__(self, executor: Executor, parts: Sequence[Any]) -> None:
        self.executor, self.parts = executor, list(parts)

    @classmethod
    def of(cls, executor: Executor, persons: Sequence[Any]) -> Kept:
        """Hand out what there is of each person."""
        parts: list[Any] = [list(persons[rows]) for rows in parts_of(len(persons))]
        if isinstance(executor, Cluster):
            parts = [executor.keep(unchanged, part) for part in parts]
        return cls(executor, parts)

    def each(self, function: Callable[..., Any], *columns: Kept | Sequence[Any] | np.ndarray) -> Kept:
        """Results of ``function(own, *row)`` for every person, kept like what they were made of.

        Parameters
        ----------
        function : callable
            As in :func:`map_persons`.
        *columns : Kept, or sequence or ndarray of N entries
            What else there is of every person, kept or here.
        """
        if isinstance(self.executor, Cluster):
            return Kept(self.executor, self.executor.keep_each(partial(over_rows, function), self._rows(columns)))
        here = [c.gathered() if isinstance(c, Kept) else c for c in (self, *columns)]
        results = list(map_persons(self.executor, function, *here))
        return Kept(self.executor, [results[rows] for rows in parts_of(len(results))])

    def ask(
        self, function: Callable[..., Result], *shared: Any, columns: Sequence[Kept | np.ndarray] = ()
    ) -> list[Result]:
        """Results of ``function(part, *parts of the columns, *shared)`` for every part, worked out where it is."""
        rows = self._rows(columns)
        if isinstance(self.executor, Cluster):
            return self.executor.ask(function, rows, *shared)
        return [function(*row, *shared) for row in rows]

    def ask_in_turn(self, function: Callable[..., Result], rows: Sequence[Sequence[Any]]) -> Iterator[Result]:
        """Results of ``function(part, *row)`` for every part, one by one: some are too large to be here twice."""
        rows = [(part, *row) for part, row in zip(self.parts, rows, strict=True)]
        if isinstance(self.executor, Cluster):
            return self.executor.ask_in_turn(function, rows)
        return (function(*row) for row in rows)

    def gathered(self, function: Callable[[Any], Any] | None = None) -> list[Any]:
        """Everybody's entry here, or the result of a function of it: it travels."""
        parts = self.ask(unchanged) if function is None else self.ask(partial(over_rows, function))
        return [entry for part in parts for entry in part]

    def forget(self) -> None:
        """Let go of it, to free memory; a cluster remembers how it was made if something depends on it."""
        self.parts = []

    def _rows(self, columns: Sequence[Kept | Sequence[Any] | np.ndarray]) -> list[tuple[Any, ...]]:
        """Part by part, this and the same persons' parts of the columns."""
        split = [c.parts if isinstance(c, Kept) else [c[rows] for rows in parts_of(len(c))] for c in (self, *columns)]
        return list(zip(*split, strict=True))


def parts_of(n: int) -> list[slice]:
    """Persons in parts that are kept together; they depend on the number of persons alone, as sums over them do."""
    size = int(np.clip(-(-n // _MOST_PARTS), _SMALLEST_PART, _LARGEST_PART))
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]
