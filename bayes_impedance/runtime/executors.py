"""Computations person by person, on any executor of the standard interface.

Threads of this process, processes of this machine (:class:`~bayes_impedance.runtime.worker_processes.Processes`, or a
pool of the standard library) and the workers of a Dask cluster (``Client.get_executor()``) are interchangeable: a
module-level function is sent with the data of some persons, and results are returned in the persons' order. The result
does not depend on the executor, and a task lost with a process or a cluster's worker is repeated.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from threading import Event, Thread
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from bayes_impedance.errors import InputError, WorkerError
from bayes_impedance.runtime.worker_processes import Processes, use_one_thread

Result = TypeVar("Result")

_MOST_TASKS = 64
"""Most tasks of one map. By choice: a task costs a cluster about a millisecond; sixty-four keep many workers busy."""

_RETRIES = 5
"""Retries of a task whose worker is lost. By choice: more than for a local process (three), because a cluster's workers
are often lost for reasons unrelated to the task."""

_SCHEDULER_SECONDS, _WORKER_SECONDS, _FAREWELL_SECONDS = 15, 60, 5
"""Timeouts, by choice: for a scheduler's answer (a wrong address should be reported within seconds), for its first
worker (several times the start of a worker process), and for closing a connection that may be dead."""

_say = logging.getLogger(__name__).warning
"""Reports what is awaited: Python prints warnings to standard error unless logging is configured."""


@contextmanager
def executor_of(threads: int = 2, processes: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Threads of this process, processes of this machine, or a Dask cluster's workers.

    Parameters
    ----------
    threads : int
        Number of threads; used if neither of the others is given.
    processes : int, optional
        Number of processes of this machine.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:8786``; it takes precedence.

    Raises
    ------
    InputError
        If ``distributed`` is not installed, or no scheduler answers.
    WorkerError
        If a task has repeatedly lost its worker, or the scheduler or all its workers are lost.
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
    _require_certificates(scheduler)
    _say("waiting up to %d s for the Dask scheduler at %s", _SCHEDULER_SECONDS, scheduler)
    try:
        asyncio.run(asyncio.wait_for(_require_scheduler(scheduler), _SCHEDULER_SECONDS))
        with without_message_log():
            client: Any = Client(  # type: ignore[no-untyped-call]
                scheduler, timeout=_SCHEDULER_SECONDS, set_as_default=False
            )
    except Exception as error:  # a wrong address or port raises many types of exception
        reason = " ".join(str(error).split()) or f"nothing within {_SCHEDULER_SECONDS} s"
        raise InputError(
            f"no Dask scheduler answers at '{scheduler}' ({reason}); start one with 'dask scheduler', "
            "give its address, or leave out --scheduler"
        ) from None
    with _quiet(), _closing(client), _Watch(client, scheduler) as watch:
        try:
            _await_workers(client, scheduler)
            yield Cluster(client)
        except KilledWorker:
            raise WorkerError(
                "several workers of the cluster died on the same task, killed or out of memory; give workers more "
                "memory, or leave out --scheduler"
            ) from None
        except (InputError, WorkerError):
            raise
        except (Exception, CancelledError):
            if watch.lost or client.status != "running":  # other errors follow from this one
                raise WorkerError(watch.lost or _lost(scheduler)) from None
            raise


@contextmanager
def without_message_log() -> Iterator[None]:
    """Clients and schedulers made meanwhile do not keep the messages that they have sent.

    Dask keeps the last thousand for its developers, with the data in them: 20 kB for each person of a population.
    """
    from dask import config

    with config.set({"distributed.admin.low-level-log-length": 0}):
        yield


def _require_certificates(address: str) -> None:
    """Check that Dask's configuration names certificates if the address needs them, and that they can be read."""
    from distributed.security import Security

    if not address.startswith("tls://"):
        return
    try:
        security = Security()  # type: ignore[no-untyped-call]
        given = security.get_connection_args("client")["ssl_context"] is not None  # type: ignore[no-untyped-call]
        reason = "Dask's configuration does not name them"
    except (OSError, ValueError) as error:  # ssl's errors are of the system's
        given, reason = False, " ".join(str(error).split())
    if not given:
        raise InputError(
            f"the Dask scheduler at '{address}' needs certificates ({reason}); name their files in Dask's "
            "configuration as distributed.comm.tls.ca-file, .client.cert and .client.key, or leave out --scheduler"
        )


async def _require_scheduler(address: str) -> None:
    """Check that a scheduler answers: for other programs Dask's client waits much longer than its timeout."""
    from distributed.comm.core import connect
    from distributed.security import Security

    arguments = Security().get_connection_args("client")  # type: ignore[no-untyped-call]
    comm: Any = await connect(  # type: ignore[no-untyped-call]
        address, timeout=_SCHEDULER_SECONDS, **arguments
    )
    try:
        await comm.write({"op": "identity", "reply": True})
        answer = await comm.read()
    finally:
        comm.abort()
    if not isinstance(answer, dict) or answer.get("type") != "Scheduler":
        raise ValueError("another program answers")


def _lost(scheduler: str) -> str:
    return (
        f"the Dask scheduler at {scheduler} no longer answers; start it again and repeat the command, with "
        "--resume to continue from what was saved"
    )


def _await_workers(client: Any, scheduler: str) -> None:
    if client.scheduler_info()["workers"]:
        return
    _say("waiting up to %d s for a worker of the Dask scheduler at %s", _WORKER_SECONDS, scheduler)
    try:
        client.wait_for_workers(1, timeout=_WORKER_SECONDS)
    except TimeoutError:
        raise WorkerError(
            f"the Dask scheduler at {scheduler} has had no worker for {_WORKER_SECONDS} s; start some with "
            f"'dask worker {scheduler}', or leave out --scheduler"
        ) from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress Dask's log messages about a broken connection: one error message reports it."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _closing(client: Any) -> Iterator[None]:
    """Close the client; errors of closing without a scheduler are suppressed."""
    try:
        yield
    finally:
        with suppress(Exception):
            client.close(timeout=_FAREWELL_SECONDS)


class _Watch:
    """A thread that ends waiting if the cluster has no workers left or the scheduler is lost."""

    def __init__(self, client: Any, scheduler: str) -> None:
        self.client, self.scheduler, self.lost = client, scheduler, ""
        self._done = Event()
        self._thread = Thread(target=self._look, daemon=True)

    def __enter__(self) -> _Watch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _look(self) -> None:
        without = 0
        while not self._done.wait(1.0):
            try:
                alone = not self.client.scheduler_info()["workers"]
            except Exception:  # the client is closing, or has lost its scheduler
                alone = True
            if self.client.status != "running":
                self.lost = _lost(self.scheduler)
            without = without + 1 if alone else 0
            if without > _WORKER_SECONDS + _FAREWELL_SECONDS:
                self.lost = (
                    f"the Dask scheduler at {self.scheduler} has lost all its workers and got none for "
                    f"{_WORKER_SECONDS} s; start some and repeat the command, with --resume to continue from what was "
                    "saved"
                )
            if self.lost:
                with suppress(Exception):
                    self.client.close(timeout=_FAREWELL_SECONDS)  # everything waiting for a result gets an error
                return


class Cluster(Executor):
    """A Dask cluster's workers as an executor, whose results may stay with the workers.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Any) -> None:
        self.client = client
        self._tasks = client.get_executor(pure=False, retries=_RETRIES)
        self._worker_of: WeakKeyDictionary[Any, str] = WeakKeyDictionary()
        self._threads: dict[str, int] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
        """Submit a task to any worker."""
        return self._tasks.submit(_OneThread(fn), *args, **kwargs)

    def keep(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Submit a task whose result stays with its worker."""
        return self.client.submit(_OneThread(function), *arguments, pure=False, retries=_RETRIES)

    def keep_each(self, function: Callable[..., Any], rows: Sequence[Sequence[Any]], *shared: Any) -> list[Any]:
        """Submit ``function(*row, *shared)`` for every row in one batch, half the cost of single submissions."""
        task = partial(_called, function=_OneThread(function), shared=shared)
        columns = zip(*rows, strict=True)
        return list(self.client.map(task, *columns, key=_name(function), pure=False, retries=_RETRIES))

    def ask(self, function: Callable[..., Result], rows: Sequence[Sequence[Any]], *shared: Any) -> list[Result]:
        """Results of ``function(*row, *shared)`` for every row of kept data, computed where the data are.

        A task costs milliseconds, so rows that are with one worker are given to it together, as many tasks as it has
        threads. Each has a result of its own: what is made of them does not depend on who has which.
        """
        groups = self._together(rows)
        answers = self.client.gather(
            self.keep_each(partial(_over_lists, function, shared), [([rows[i] for i in own],) for own in groups])
        )
        results: list[Any] = [None] * len(rows)
        for own, answer in zip(groups, answers, strict=True):
            for i, result in zip(own, answer, strict=True):
                results[i] = result
        return results

    def _together(self, rows: Sequence[Sequence[Any]]) -> list[list[int]]:
        """Groups of rows whose first entries are with the same worker; a row whose worker is not known is alone.

        Where data were is remembered: if they have moved, after the loss of a worker, Dask brings them together.
        """
        firsts = [row[0] for row in rows]
        unknown = [first for first in firsts if hasattr(first, "key") and first not in self._worker_of]
        if unknown:
            places = self.client.who_has(unknown)
            for first in unknown:
                if place := tuple(places.get(first.key, ())):
                    self._worker_of[first] = place[0]
            self._threads = self.client.nthreads()
        with_worker: dict[str, list[int]] = {}
        groups: list[list[int]] = []
        for i, first in enumerate(firsts):
            worker = self._worker_of.get(first) if hasattr(first, "key") else None
            if worker is None:
                groups.append([i])
            else:
                with_worker.setdefault(worker, []).append(i)
        for worker, own in with_worker.items():
            pieces = min(max(self._threads.get(worker, 1), 1), len(own))
            groups += [own[k::pieces] for k in range(pieces)]
        return groups

    def ask_in_turn(self, function: Callable[..., Result], rows: Sequence[Sequence[Any]]) -> Iterator[Result]:
        """The same one by one, for results of which memory holds only one copy."""
        asked = deque(self.keep_each(function, rows))
        while asked:
            yield asked.popleft().result()


def map_persons(
    executor: Executor, function: Callable[..., Result], *columns: Sequence[Any] | np.ndarray
) -> Iterator[Result]:
    """Iterate over the results of ``function(*row)`` for every person, in order.

    Parameters
    ----------
    executor : Executor
    function : callable
        Module-level function, or a ``functools.partial`` of one with shared arguments: it must be picklable.
    *columns : sequence
        One entry for each person, equally many.
    """
    n = len(columns[0])
    size = -(-n // _MOST_TASKS)
    tasks = deque(
        executor.submit(over_rows, function, *(column[start : start + size] for column in columns))
        for start in range(0, n, size)
    )
    while tasks:  # results are released once yielded
        yield from tasks.popleft().result()


def over_rows(function: Callable[..., Result], *columns: Sequence[Any] | np.ndarray) -> list[Result]:
    """Results of ``function(*row)`` for every row of the columns."""
    return [function(*row) for row in zip(*columns, strict=True)]


class _OneThread:
    """A task that uses one thread for linear algebra, because more threads round differently.

    Workers that Dask starts without a nanny would use all processors; a nanny starts its worker with one thread each.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.__name__ = function, _name(function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        use_one_thread()
        return self.function(*arguments, **named)


def _over_lists(function: Callable[..., Result], shared: Sequence[Any], rows: Sequence[Sequence[Any]]) -> list[Result]:
    return [function(*row, *shared) for row in rows]


def _called(*row: Any, function: Callable[..., Result], shared: Sequence[Any]) -> Result:
    return function(*row, *shared)


def _name(function: Callable[..., Any]) -> str:
    """Name of a cluster's tasks of this kind, by which it records their durations."""
    while isinstance(function, partial):
        function = function.args[0] if function.func in (over_rows, _over_lists) else function.func
    return getattr(function, "__name__", type(function).__name__)


def unchanged(part: Result) -> Result:
    """Return the part itself: the task that fetches or transfers it."""
    return part
