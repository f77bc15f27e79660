"""What is done person by person, on any executor of the standard interface.

Threads of this process, processes of this machine (:class:`~bayes_impedance.processes.Processes`, or a pool of the
standard library) and the workers of a Dask cluster (``Client.get_executor()``) are all the same here: a function of a
module is sent out with the data of some persons, and the results come back in the persons' order. So the result does
not depend on who has worked, and what was lost with a process or a cluster's worker is repeated.

What is known of everybody may stay where it was worked out (:class:`Kept`): with a cluster's workers, or in this
process. It lies in parts of some dozens to hundreds of persons, which are asked for sums, and only the sums travel.
Parts depend on the number of persons alone and are summed in order, so sums do not depend on who has worked either. A
cluster makes again what a lost worker had kept, from what it had been made of, back to the recordings.

What is asked hundreds of times may be lent (:class:`Lent`): threads use it as it is, a cluster keeps it, and any other
process remembers what it has been sent once.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from enum import Enum
from functools import partial
from threading import Lock
from typing import Any, TypeVar
from uuid import uuid4

import numpy as np

from bayes_impedance.errors import InputError, WorkerError
from bayes_impedance.processes import Processes

Result = TypeVar("Result")

_MOST_TASKS = 64
"""A task costs a cluster about a millisecond; sixty-four are enough to keep many workers busy to the end."""

_RETRIES, _PATIENCE = 5, "15s"

_MOST_PARTS, _SMALLEST_PART, _LARGEST_PART = 8, 128, 512

_MOST_REMEMBERED = 256_000_000
"""Bytes of lent data that a process remembers; one that does not remember is sent them again."""


@contextmanager
def executor_of(threads: int = 2, processes: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Threads of this process, processes of this machine, or a Dask cluster's workers.

    Parameters
    ----------
    threads : int
        Used if nothing else is asked for.
    processes : int, optional
        Processes of this machine.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:8786``; it comes first.

    Raises
    ------
    InputError
        If ``distributed`` is not installed, or no scheduler answers.
    WorkerError
        If the same task has lost its worker again and again.
    """
    if scheduler is None:
        with ThreadPoolExecutor(threads) if processes is None else Processes(processes) as executor:
            yield executor
        return
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise InputError(
            'a scheduler needs the package distributed: pip install "bayes_impedance[dask]", or leave out --scheduler'
        ) from None
    try:
        client: Any = Client(scheduler, timeout=_PATIENCE, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at '{scheduler}' ({error}); start one with 'dask scheduler', "
            "or leave out --scheduler"
        ) from None
    with client:
        try:
            yield Cluster(client)
        except KilledWorker:
            raise WorkerError(
                "the same task has lost one of the cluster's workers after the other, killed by somebody or for want "
                "of memory; give workers more memory, or leave out --scheduler"
            ) from None


class Cluster(Executor):
    """A Dask cluster's workers as an executor, whose results may stay with the workers.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Any) -> None:
        self.client = client
        self._tasks = client.get_executor(pure=False, retries=_RETRIES)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
        """A task for some worker."""
        return self._tasks.submit(fn, *args, **kwargs)

    def keep(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """A task whose result stays with the worker that has done it."""
        return self.client.submit(function, *arguments, pure=False, retries=_RETRIES)

    def keep_each(self, function: Callable[..., Any], rows: Sequence[Sequence[Any]], *shared: Any) -> list[Any]:
        """Tasks ``function(*row, *shared)`` for every row, sent together, which is half the work of one by one."""
        task = partial(_called, function=function, shared=shared)
        columns = zip(*rows, strict=True)
        return list(self.client.map(task, *columns, key=_name(function), pure=False, retries=_RETRIES))

    def ask(self, function: Callable[..., Result], rows: Sequence[Sequence[Any]], *shared: Any) -> list[Result]:
        """Results of ``function(*row, *shared)`` for every row of what is kept, worked out where it is kept."""
        return list(self.client.gather(self.keep_each(function, rows, *shared)))

    def ask_in_turn(self, function: Callable[..., Result], rows: Sequence[Sequence[Any]]) -> Iterator[Result]:
        """The same one by one, for results that are too large to be here twice."""
        asked = deque(self.keep_each(function, rows))
        while asked:
            yield asked.popleft().result()


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
            parts = [executor.keep(_itself, part) for part in parts]
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
            return Kept(self.executor, self.executor.keep_each(partial(_some, function), self._rows(columns)))
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
        parts = self.ask(_itself) if function is None else self.ask(partial(_some, function))
        return [entry for part in parts for entry in part]

    def forget(self) -> None:
        """Let go of it, to free memory; a cluster remembers how it was made if something depends on it."""
        self.parts = []

    def _rows(self, columns: Sequence[Kept | Sequence[Any] | np.ndarray]) -> list[tuple[Any, ...]]:
        """Part by part, this and the same persons' parts of the columns."""
        split = [c.parts if isinstance(c, Kept) else [c[rows] for rows in parts_of(len(c))] for c in (self, *columns)]
        return list(zip(*split, strict=True))


class Lent:
    """Data that tasks need again and again: in this process as they are, elsewhere kept where they have been once.

    Where a task travels, the data are known by a name. A process that does not know the name says so, and is sent them;
    a lost worker's successor does the same. A :class:`Cluster` keeps the data with one of its workers and does there
    what needs them.

    Parameters
    ----------
    data : object
        Must not be changed any more.
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
        """Results of ``function(data, task)`` for every pair of what is lent and a task, in order."""
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
        """What the cluster knows the data by."""
        if self._kept is None or self._kept[0] is not cluster:
            self._kept = cluster, cluster.keep(_itself, self.data)
        return self._kept[1]


class _Answer(Enum):
    NOT_KNOWN = "not known"


class _Whole:
    """What is lent, on the way to a process that may not know it."""

    def __init__(self, lent: Lent) -> None:
        self.name, self.data = lent.name, lent.data

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _learned, (self.name, self.data)


_remembered: OrderedDict[str, Lent] = OrderedDict()
_remembering = Lock()


def _learned(name: str, data: Any) -> Lent:
    """What has just arrived; the longest not asked for is forgotten if there is too much."""
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


def parts_of(n: int) -> list[slice]:
    """Persons in parts that are kept together; they depend on the number of persons alone, as sums over them do."""
    size = int(np.clip(-(-n // _MOST_PARTS), _SMALLEST_PART, _LARGEST_PART))
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]


def map_persons(
    executor: Executor, function: Callable[..., Result], *columns: Sequence[Any] | np.ndarray
) -> Iterator[Result]:
    """Results of ``function(*row)`` for every person, in order, as they come.

    Parameters
    ----------
    executor : Executor
    function : callable
        Of a module, or a ``functools.partial`` of one with what all persons share: it may have to travel.
    *columns : sequence
        One entry for each person, equally many.
    """
    n = len(columns[0])
    size = -(-n // _MOST_TASKS)
    tasks = deque(
        executor.submit(_some, function, *(column[start : start + size] for column in columns))
        for start in range(0, n, size)
    )
    while tasks:  # what has been passed on is not held
        yield from tasks.popleft().result()


def _some(function: Callable[..., Result], *columns: Sequence[Any] | np.ndarray) -> list[Result]:
    return [function(*row) for row in zip(*columns, strict=True)]


def _called(*row: Any, function: Callable[..., Result], shared: Sequence[Any]) -> Result:
    return function(*row, *shared)


def _name(function: Callable[..., Any]) -> str:
    """What a cluster calls tasks of this kind, whose durations it remembers."""
    while isinstance(function, partial):
        function = function.args[0] if function.func is _some else function.func
    return getattr(function, "__name__", type(function).__name__)


def _itself(part: Result) -> Result:
    return part
