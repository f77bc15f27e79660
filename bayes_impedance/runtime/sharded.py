"""Data of many persons that stay where they were computed: with a cluster's workers, or in this process.

They are divided into parts (shards) of dozens to hundreds of persons. Only sums over parts are transferred. The parts
depend on the number of persons alone and are added in order, so sums do not depend on the executor. A cluster
recomputes the data of a lost worker from their inputs, if necessary back to the recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np

from bayes_impedance.runtime.executors import Cluster, Result, map_persons, over_rows, unchanged

_MOST_PARTS, _SMALLEST_PART, _LARGEST_PART, _MOST_LARGE_PARTS = 8, 128, 512, 256
"""Number of parts, and fewest and most persons in one. By choice: with fewer than 128 the milliseconds of overhead per
task matter; with more than 512, workers are idle at the end, and a lost worker costs much. More than 256 parts are not
made: beyond 131 072 persons parts grow instead, since each part costs every likelihood a tenth of a millisecond and
more."""


class Kept:
    """Data of each of N persons, in parts, kept where they were computed.

    Parameters
    ----------
    executor : Executor
        A :class:`Cluster` keeps the parts with its workers; with any other executor they are in this process.
    parts : sequence
        For a cluster, references (futures) to the parts. A part is a list with one entry for each person, or any
        object that is used only through :meth:`ask`.
    """

    def __init__(self, executor: Executor, parts: Sequence[Any]) -> None:
        self.executor, self.parts = executor, list(parts)

    @classmethod
    def of(cls, executor: Executor, persons: Sequence[Any]) -> Kept:
        """Distribute data with one entry for each person."""
        parts: list[Any] = [list(persons[rows]) for rows in parts_of(len(persons))]
        if isinstance(executor, Cluster):
            parts = [executor.keep(unchanged, part) for part in parts]
        return cls(executor, parts)

    def each(self, function: Callable[..., Any], *columns: Kept | Sequence[Any] | np.ndarray) -> Kept:
        """Results of ``function(own, *row)`` for every person, kept where their inputs are.

        Parameters
        ----------
        function : callable
            As in :func:`map_persons`.
        *columns : Kept, or sequence or ndarray of N entries
            Further data of every person, kept or in this process.
        """
        if isinstance(self.executor, Cluster):
            return Kept(self.executor, self.executor.keep_each(partial(over_rows, function), self._rows(columns)))
        here = [c.gathered() if isinstance(c, Kept) else c for c in (self, *columns)]
        results = list(map_persons(self.executor, function, *here))
        return Kept(self.executor, [results[rows] for rows in parts_of(len(results))])

    @property
    def remembers_inputs(self) -> bool:
        """Whether the inputs of these data are remembered, to compute them again should they be lost."""
        return isinstance(self.executor, Cluster)

    def each_part(self, function: Callable[..., Any], rows: Sequence[Sequence[Any]]) -> Kept:
        """Results of ``function(part, *row)`` for every part, kept where the part is."""
        rows = [(part, *row) for part, row in zip(self.parts, rows, strict=True)]
        if isinstance(self.executor, Cluster):
            return Kept(self.executor, self.executor.keep_each(function, rows))
        return Kept(self.executor, [function(*row) for row in rows])

    def ask(
        self, function: Callable[..., Result], *shared: Any, columns: Sequence[Kept | np.ndarray] = ()
    ) -> list[Result]:
        """Results of ``function(part, *parts of the columns, *shared)`` for every part, computed where it is."""
        rows = self._rows(columns)
        if isinstance(self.executor, Cluster):
            return self.executor.ask(function, rows, *shared)
        return [function(*row, *shared) for row in rows]

    def ask_in_turn(self, function: Callable[..., Result], rows: Sequence[Sequence[Any]]) -> Iterator[Result]:
        """Results of ``function(part, *row)`` for every part, one by one, to hold one large result at a time."""
        rows = [(part, *row) for part, row in zip(self.parts, rows, strict=True)]
        if isinstance(self.executor, Cluster):
            return self.executor.ask_in_turn(function, rows)
        return (function(*row) for row in rows)

    def gathered(self, function: Callable[[Any], Any] | None = None) -> list[Any]:
        """All persons' entries, or a function of each, transferred to this process."""
        parts = self.ask(unchanged) if function is None else self.ask(partial(over_rows, function))
        return [entry for part in parts for entry in part]

    def of_some(self, persons: np.ndarray) -> Kept:
        """The same data of a few persons, by their ascending numbers (n,); they pass through this process."""
        wanted = np.zeros(sum(self.ask(len)), dtype=bool)
        wanted[persons] = True
        parts = self.ask(_chosen, columns=[wanted])
        return Kept.of(self.executor, [own for part in parts for own in part])

    def forget(self) -> None:
        """Release the data to free memory; a cluster can recompute them if other data depend on them."""
        self.parts = []

    def _rows(self, columns: Sequence[Kept | Sequence[Any] | np.ndarray]) -> list[tuple[Any, ...]]:
        """For each part: the part itself, and the same persons' parts of the columns."""
        split = [c.parts if isinstance(c, Kept) else [c[rows] for rows in parts_of(len(c))] for c in (self, *columns)]
        return list(zip(*split, strict=True))


def _chosen(part: Sequence[Any], wanted: np.ndarray) -> list[Any]:
    return [own for own, one_of_them in zip(part, wanted, strict=True) if one_of_them]


def parts_of(n: int) -> list[slice]:
    """Slices of persons that form the parts; they depend on the number of persons alone."""
    size = int(np.clip(-(-n // _MOST_PARTS), _SMALLEST_PART, max(_LARGEST_PART, -(-n // _MOST_LARGE_PARTS))))
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]
