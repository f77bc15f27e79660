"""Work done person by person, on any executor of the standard interface.

Threads of this process, processes of this machine (:class:`~bayes_impedance.runtime.worker_processes.Processes`, or a
pool of the standard library) and the workers of a Dask cluster (``Client.get_executor()``) are interchangeable: a
function of a module is sent out with the data of some persons, and results come back in the persons' order. The result
does not depend on who has worked, and a task lost with a process or a cluster's worker is repeated.
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

import numpy as np

from bayes_impedance.errors import InputError, WorkerError
from bayes_impedance.runtime.worker_processes import Processes

Result = TypeVar("Result")

_MOST_TASKS = 64
"""A task costs a cluster about a millisecond; sixty-four are enough to keep many workers busy to the end."""

_RETRIES = 5
"""A task whose worker is lost is done again so often: more than a process of this machine has (three), because a
cluster's workers go for reasons that have nothing to do with the task."""

_SCHEDULER_SECONDS, _WORKER_SECONDS, _FAREWELL_SECONDS = 15, 60, 5
"""Time that a scheduler has to answer: a wrong address should be told within seconds. Time that it has to find a
worker: what a worker's process needs to start, several times over. Time to close a connection that may be dead."""

_say = logging.getLogger(__name__).warning
"""What is awaited: Python shows warnings on standard error where nobody has asked for anything else."""


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
        If the same task has lost its worker again and again, or the scheduler or all its workers are gone.
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
    _say("waiting up to %d s for the Dask scheduler at %s", _SCHEDULER_SECONDS, scheduler)
    try:
        asyncio.run(asyncio.wait_for(_require_scheduler(scheduler), _SCHEDULER_SECONDS))
        client: Any = Client(  # type: ignore[no-untyped-call]
            scheduler, timeout=_SCHEDULER_SECONDS, set_as_default=False
        )
    except Exception as error:  # an address, a port and what answers there can be wrong in any way
        reason = " ".join(str(error).split()) or "no answer"
        raise InputError(
            f"no Dask scheduler answers at '{scheduler}' within {_SCHEDULER_SECONDS} s ({reason}); start one with "
            "'dask scheduler', give its address, or leave out --scheduler"
        ) from None
    with _quiet(), _closing(client), _Watch(client, scheduler) as watch:
        try:
            _await_workers(client, scheduler)
            yield Cluster(client)
        except KilledWorker:
            raise WorkerError(
                "the same task has lost one of the cluster's workers after the other, killed by somebody or for want "
                "of memory; give workers more memory, or leave out --scheduler"
            ) from None
        except (InputError, WorkerError):
            raise
        except (Exception, CancelledError):
            if watch.lost or client.status != "running":  # what else is said follows from this
                raise WorkerError(watch.lost or _lost(scheduler)) from None
            raise


async def _require_scheduler(address: str) -> None:
    """Ask who is there: a client of Dask waits much longer than it is told for a program that is no scheduler."""
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
        f"the Dask scheduler at {scheduler} does not answer any more; start it again and repeat the command, with "
        "--resume to go on from what was kept"
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
    """Keep to itself what Dask logs of a connection that breaks: it is told in one sentence."""
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
    """Close the client; one whose scheduler is gone cannot say farewell, which nobody needs to hear."""
    try:
        yield
    finally:
        with suppress(Exception):
            client.close(timeout=_FAREWELL_SECONDS)


class _Watch:
    """A thread that ends what waits for a cluster without workers, or for a scheduler that is gone."""

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
                    f"{_WORKER_SECONDS} s; start some and repeat the command, with --resume to go on from what was kept"
                )
            if self.lost:
                with suppress(Exception):
                    self.client.close(timeout=_FAREWELL_SECONDS)  # everything that waits for a result hears of it
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
        executor.submit(over_rows, function, *(column[start : start + size] for column in columns))
        for start in range(0, n, size)
    )
    while tasks:  # what has been passed on is not held
        yield from tasks.popleft().result()


def over_rows(function: Callable[..., Result], *columns: Sequence[Any] | np.ndarray) -> list[Result]:
    """Results of ``function(*row)`` for every row of the columns."""
    return [function(*row) for row in zip(*columns, strict=True)]


def _called(*row: Any, function: Callable[..., Result], shared: Sequence[Any]) -> Result:
    return function(*row, *shared)


def _name(function: Callable[..., Any]) -> str:
    """What a cluster calls tasks of this kind, whose durations it remembers."""
    while isinstance(function, partial):
        function = function.args[0] if function.func is over_rows else function.func
    return getattr(function, "__name__", type(function).__name__)


def unchanged(part: Result) -> Result:
    """Return the part itself: the task that fetches it, or hands it over."""
    return part
