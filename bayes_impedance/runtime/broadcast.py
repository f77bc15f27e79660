"""Data that many tasks need, sent to each worker once.

Threads share the data in memory, a cluster keeps them with one of its workers, and any other process caches the data it
has received.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from enum import Enum
from functools import partial
from threading import Lock
from typing import Any
from uuid import uuid4

from bayes_impedance.runtime.executors import Cluster, Result, unchanged

_MOST_REMEMBERED = 256_000_000
"""Bytes of data cached by a process. By choice: limits the memory; data dropped from the cache are sent again."""


class Lent:
    """Data used by many tasks: shared within this process, sent once to other processes and cached there.

    A task sent to another process refers to the data by name. A process without data of that name requests them, as
    does the replacement of a lost worker. A :class:`Cluster` keeps the data with one of its workers and runs the tasks
    that need them there.

    Parameters
    ----------
    data : object
        Must not be modified afterwards.
    """

    def __init__(self, data: Any) -> None:
        self.data = data
        self.name = uuid4().hex
        self._sent = False
        self._kept: tuple[Cluster, Any] | None = None

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _recalled, (self.name,)

    @staticmethod
    def ask(executor: Executor, function: Callable[..., Result], rows: Sequence[tuple[Lent, Any]]) -> list[Result]:
        """Results of ``function(data, task)`` for every pair of lent data and task, in order."""
        if isinstance(executor, Cluster):
            return executor.ask(function, [(lent._with(executor), task) for lent, task in rows])
        lents, tasks = [lent for lent, _ in rows], [task for _, task in rows]
        call = partial(_with_lent, function)
        answers = list(executor.map(call, [lent if lent._sent else _Whole(lent) for lent in lents], tasks))
        unknown = [k for k, answer in enumerate(answers) if answer is _Answer.NOT_KNOWN]
        if unknown:
            again = executor.map(call, [_Whole(lents[k]) for k in unknown], [tasks[k] for k in unknown])
            for k, answer in zip(unknown, again, strict=True):
                answers[k] = answer
        for lent in lents:
            lent._sent = True
        return [answer for answer in answers if not isinstance(answer, _Answer)]

    def _with(self, cluster: Cluster) -> Any:
        """The cluster's reference (future) to the data."""
        if self._kept is None or self._kept[0] is not cluster:
            self._kept = cluster, cluster.keep(unchanged, self.data)
        return self._kept[1]


class _Answer(Enum):
    NOT_KNOWN = "not known"


class _Whole:
    """Lent data including their content, sent to a process that may not have them."""

    def __init__(self, lent: Lent) -> None:
        self.name, self.data = lent.name, lent.data

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _learned, (self.name, self.data)


_remembered: OrderedDict[str, Lent] = OrderedDict()


_remembering = Lock()


def _learned(name: str, data: Any) -> Lent:
    """Cache received data; the least recently used are dropped if the cache is too large."""
    lent = Lent(data)
    with _remembering:
        _remembered[name] = lent
        while len(_remembered) > 1 and sum(_size(known.data) for known in _remembered.values()) > _MOST_REMEMBERED:
            _remembered.popitem(last=False)
    return lent


def _recalled(name: str) -> Lent:
    with _remembering:
        if name not in _remembered:
            return Lent(_Answer.NOT_KNOWN)
        _remembered.move_to_end(name)
        return _remembered[name]


def _size(data: Any) -> int:
    """Bytes of the arrays in nested tuples or lists."""
    return sum(_size(part) for part in data) if isinstance(data, tuple | list) else getattr(data, "nbytes", 0)


def _with_lent(function: Callable[[Any, Any], Result], lent: Lent | _Whole, task: Any) -> Result | _Answer:
    return _Answer.NOT_KNOWN if lent.data is _Answer.NOT_KNOWN else function(lent.data, task)
