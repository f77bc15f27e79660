"""What is done person by person, on any executor of the standard interface.

Threads of this process, processes of this machine (``ProcessPoolExecutor``) and the workers of a Dask cluster
(``Client.get_executor()``) are all the same here: a function of a module is sent out with the data of some persons, and
the results come back in the persons' order. So the result does not depend on who has worked, and a cluster that loses a
worker repeats what was lost.
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
        yield client.get_executor(pure=False, retries=_RETRIES)


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
