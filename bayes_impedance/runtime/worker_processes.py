"""Processes of this machine as an executor that survives the loss of some of them.

Somebody, or the system when memory runs out, may kill a process. A pool of the standard library is broken then, with
all it was given; and because its processes share their queues, one that dies while it sends may block the others. Here
each process has a pipe of its own and a thread of this process that hands it one task after the other. If the pipe
ends, the thread starts another process and gives it the lost task again: nobody else is disturbed, and the results are
the same because a task depends on its arguments alone.

Processes are started afresh (``spawn``), never forked: a fork of a process with threads may hang. They do not look for
modules in the working directory: a file that lies there by the name of a module is nobody's code. What is compiled is
taken from numba's files on disk, and libraries of linear algebra have one thread in each process.
"""

from __future__ import annotations

import os
import pickle
import signal
import traceback
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import Any

from bayes_impedance.errors import WorkerError

_REPEATS = 3
"""A task that has lost its process more often than this is given up: it is likely what kills them."""

_CONTEXT = get_context("spawn")

_SAFE_PATH = "PYTHONSAFEPATH"
"""Set for a new process, which imports modules of the standard library before it is told the path of the process that
has started it: its interpreter would look for them in the working directory first."""
_STARTING = Lock()
"""Held while :data:`_SAFE_PATH` is set."""

_ONE_THREAD_EACH = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@dataclass
class _Task:
    call: tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
    future: Future[Any] = field(default_factory=Future)


class Processes(Executor):
    """Processes of this machine; a task whose process dies is done again by a new one.

    A script that uses it needs ``if __name__ == "__main__":`` around what it does: processes import the script.

    Parameters
    ----------
    workers : int
        Processes, which start when they are needed.

    Raises
    ------
    WorkerError
        From the future of a task that has lost four processes.
    """

    def __init__(self, workers: int) -> None:
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._closed, self._abandoned, self._lock = False, Event(), Lock()
        self._workers = [_Worker(self._tasks, self._abandoned) for _ in range(workers)]

    @property
    def pids(self) -> tuple[int, ...]:
        """Numbers of the processes that run now."""
        return tuple(w.process.pid for w in self._workers if w.process is not None and w.process.pid is not None)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """A task for the next process that is free; function, arguments and result must be able to travel."""
        with self._lock:
            if self._closed:
                raise RuntimeError("these processes were told to end")
            task = _Task((fn, args, kwargs))
            self._tasks.put(task)
        return task.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes when they have done what was submitted, or only what they are at."""
        with self._lock:
            if not self._closed:
                self._closed = True
                if cancel_futures:
                    self._cancel()
                for _ in self._workers:
                    self._tasks.put(None)
        if wait:
            for worker in self._workers:
                worker.thread.join()

    def __exit__(self, kind: object, *_: object) -> None:
        """After an error nobody waits for what is left to do."""
        if kind is not None:
            self._abandoned.set()
            self.shutdown(wait=False, cancel_futures=True)
            for worker in self._workers:
                worker.stop()
        self.shutdown()

    def _cancel(self) -> None:
        try:
            while True:
                task = self._tasks.get_nowait()
                if task is not None and task.future.cancel():
                    task.future.set_running_or_notify_cancel()  # who waits for it hears of it
        except Empty:
            return


class _Worker:
    """A process, and the thread of this process that looks after it."""

    def __init__(self, tasks: SimpleQueue[_Task | None], abandoned: Event) -> None:
        self.process: Any = None
        self._connection: Connection | None = None
        self._tasks, self._abandoned, self._lock = tasks, abandoned, Lock()
        self.thread = Thread(target=self._serve, daemon=True)
        self.thread.start()

    def stop(self) -> None:
        """Kill the process, whatever it is at."""
        with self._lock:
            if self.process is not None:
                self.process.kill()

    def _serve(self) -> None:
        while (task := self._tasks.get()) is not None:
            if task.future.set_running_or_notify_cancel():
                try:
                    done, result = self._done(pickle.dumps(task.call, pickle.HIGHEST_PROTOCOL))
                except BaseException as error:  # whoever waits must hear of it
                    done, result = False, error
                if done:
                    task.future.set_result(result)
                else:
                    task.future.set_exception(result)
            del task  # else the last one's data stay until the next comes
        self._end()

    def _done(self, call: bytes) -> tuple[bool, Any]:
        """Whether the call has succeeded, and its result or error."""
        for _ in range(1 + _REPEATS):
            connection = self._connection or self._start()
            try:
                connection.send_bytes(call)
                answer = connection.recv_bytes()
            except (EOFError, OSError):
                self._end()
                continue
            done, result = pickle.loads(answer)
            return done, result
        raise WorkerError(
            f"the same task has lost {1 + _REPEATS} processes, killed by somebody or for want of memory; "
            "use fewer --workers, or leave them out to work in one process"
        )

    def _start(self) -> Connection:
        here, there = _CONTEXT.Pipe()
        with self._lock:
            if self._abandoned.is_set():
                raise WorkerError("the work was given up")
            self.process = _CONTEXT.Process(target=_work, args=(there,), daemon=True)
            _start_isolated(self.process)
        there.close()  # so that the pipe ends with the process
        self._connection = here
        return here

    def _end(self) -> None:
        if self._connection is not None:
            self._connection.close()  # a process that still runs ends when it sees this
            self._connection = None
        if self.process is not None:
            self.process.join()
            with self._lock:
                self.process = None


def _start_isolated(process: Any) -> None:
    with _STARTING:
        former = os.environ.get(_SAFE_PATH)
        os.environ[_SAFE_PATH] = "1"
        try:
            process.start()
        finally:
            if former is None:
                del os.environ[_SAFE_PATH]
            else:
                os.environ[_SAFE_PATH] = former


# -------------------------------------------------------------------- in the other process


def _work(connection: Connection) -> None:
    """Do what comes until the pipe ends: at the end of the work, or with the process at its other end."""
    _prepare()
    while True:
        try:
            call = connection.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            function, arguments, named = pickle.loads(call)
            answer = pickle.dumps((True, function(*arguments, **named)), pickle.HIGHEST_PROTOCOL)
        except Exception as error:
            answer = _failure(error)
        del call
        try:
            connection.send_bytes(answer)
        except OSError:
            return


def _failure(error: Exception) -> bytes:
    error.add_note(f"in a worker process:\n{traceback.format_exc()}")
    try:
        answer = pickle.dumps((False, error))
        pickle.loads(answer)
    except Exception:  # of any kind: classes of exceptions fail to leave or to arrive in ways of their own
        answer = pickle.dumps((False, RuntimeError(traceback.format_exc())))
    return answer


def _prepare() -> None:
    """One thread for linear algebra, and an interrupted command leaves the farewell to the first process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in _ONE_THREAD_EACH:
        os.environ[name] = "1"
    import numpy  # noqa: F401  (libraries can be told what to do once they are loaded)
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
