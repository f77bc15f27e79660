"""What is done person by person, on any executor of the standard interface.

Threads of this process, processes of this machine (``ProcessPoolExecutor``) and the workers of a Dask cluster
(``Client.get_executor()``) are all the same here: a function of a module is sent out with the data of some persons, and
the results come back in the persons' order. So the result does not depend on who has worked, and a cluster that loses a
worker repeats what was lost.

What is large may stay with a cluster's workers (:class:`Cluster`): everybody's draws are asked for sums there, and only
the sums travel. A cluster makes again what a lost worker had kept, from what it had been made of.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from bayes_impedance.errors import InputError

Result = TypeVar("Result")

_MOST_TASKS = 64
"""A task costs a cluster about a millisecond; sixty-four are enough to keep many workers busy to the end."""

_RETRIES, _PATIENCE = 5, "15s"

_MOST_PARTS, _SMALLEST_PART, _LARGEST_PART = 8, 128, 512


@contextmanager
def executor_of(workers: int, scheduler: str | None = None) -> Iterator[Executor]:
    """Threads of this process, or a Dask cluster's workers.

    Parameters
    ----------
    workers : int
        Threads.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:8786``; then the number of threads does not matter.

    Raises
    ------
    InputError
        If ``distributed`` is not installed, or no scheduler answers.
    """
    if scheduler is None:
        with ThreadPoolExecutor(workers) as executor:
            yield executor
        return
    try:
        from distributed import Client
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
        yield Cluster(client)


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

    def ask(self, kept: Sequence[Any], function: Callable[..., Result], *arguments: Any) -> list[Result]:
        """Results of ``function(what is kept, *arguments)``, worked out where it is kept."""
        asked = [self.client.submit(function, k, *arguments, pure=False, retries=_RETRIES) for k in kept]
        return list(self.client.gather(asked))


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
    tasks = [
        executor.submit(_some, function, [column[start : start + size] for column in columns])
        for start in range(0, n, size)
    ]
    for task in tasks:
        yield from task.result()


def _some(function: Callable[..., Result], columns: Sequence[Sequence[Any] | np.ndarray]) -> list[Result]:
    return [function(*row) for row in zip(*columns, strict=True)]
