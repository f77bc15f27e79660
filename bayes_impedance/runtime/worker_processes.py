"""Processes of this machine as an executor that survives the loss of some of them.

A process may be killed by a user, or by the system when memory runs out. A pool of the standard library then fails with
all its tasks; and because its processes share queues, one that dies while sending may block the others. Here each
process has its own pipe, and a thread of this process sends it one task after the other. If the pipe closes, the thread
starts another process and repeats the lost task: other tasks are not affected, and the results are the same because a
task depends on its arguments alone.

Processes are started by ``spawn``, never forked: a fork of a process with threads may hang. They do not search the
working directory for modules: a file there with a module's name must not be run. Compiled functions are loaded from
numba's files on disk, and linear algebra libraries use one thread in each process.
"""

from __future__ import annotations

import os
import pickle
import signal
import traceback
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import Any

from bayes_impedance.errors import WorkerError

_REPEATS = 3
"""Repeats of a task that has lost its process. By choice: after more losses the task itself is the likely cause."""

_CONTEXT = get_context("spawn")

_SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable set for a new process: it imports modules of the standard library before it receives its
parent's path, and would otherwise search the working directory first."""
_STARTING = Lock()
"""Held while :data:`_SAFE_PATH` is set."""

_ONE_THREAD_EACH = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@dataclass
class _Task:
    call: tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
    future: Future[Any] = field(default_factory=Future)


class Processes(Executor):
    """Processes of this machine; a task whose process dies is repeated by a new one.

    A script that uses it needs ``if __name__ == "__main__":`` around its code, because processes import the script.

    Parameters
    ----------
    workers : int
        Number of processes, which start when they are needed.

    Raises
    ------
    WorkerError
        From the future of a task that has lost four processes.
    """

    def __init__(self, workers: int) -> None:
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._closed, self._abandoned, self._lock = False, Event(), Lock()
        self._workers = [_Worker(self._tasks, self._abandoned) for _ in range(workers)]

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a task to the next free process; function, arguments and result must be picklable."""
        with self._lock:
            if self._closed:
                raise RuntimeError("these processes were told to end")
            task = _Task((fn, args, kwargs))
            self._tasks.put(task)
        return task.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes after all submitted tasks, or after the running ones only."""
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
        """Shut down; after an error the remaining tasks are not awaited."""
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
                    task.future.set_running_or_notify_cancel()  # notifies those waiting for it
        except Empty:
            return


class _Worker:
    """A process, and the thread of this process that controls it."""

    def __init__(self, tasks: SimpleQueue[_Task | None], abandoned: Event) -> None:
        self.process: Any = None
        self._connection: Connection | None = None
        self._tasks, self._abandoned, self._lock = tasks, abandoned, Lock()
        self.thread = Thread(target=self._serve, daemon=True)
        self.thread.start()

    def stop(self) -> None:
        """Kill the process, even during a task."""
        with self._lock:
            if self.process is not None:
                self.process.kill()

    def _serve(self) -> None:
        while (task := self._tasks.get()) is not None:
            if task.future.set_running_or_notify_cancel():
                try:
                    done, result = self._done(pickle.dumps(task.call, pickle.HIGHEST_PROTOCOL))
                except BaseException as error:  # must reach those waiting for the result
                    done, result = False, error
                if done:
                    task.future.set_result(result)
                else:
                    task.future.set_exception(result)
            del task  # else its data stay in memory until the next task
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
            f"{1 + _REPEATS} processes died on the same task, killed or out of memory; "
            "use fewer --workers, or leave them out to work in one process"
        )

    def _start(self) -> Connection:
        here, there = _CONTEXT.Pipe()
        with self._lock:
            if self._abandoned.is_set():
                raise WorkerError("the work was given up")
            self.process = _CONTEXT.Process(target=_work, args=(there,), daemon=True)
            _start_isolated(self.process)
        there.close()  # so that the pipe closes with the process
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
    """Run tasks until the pipe closes: after the last task, or when the process at its other end ends."""
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
    except Exception:  # pickling and unpickling of exceptions can raise any exception
        answer = pickle.dumps((False, RuntimeError(traceback.format_exc())))
    return answer


def _prepare() -> None:
    """Use one thread for linear algebra, and leave the handling of interrupts to the parent process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in _ONE_THREAD_EACH:
        os.environ[name] = "1"
    use_one_thread()


@cache
def use_one_thread() -> None:
    """Use one thread for linear algebra in this process from now on."""
    import numpy  # noqa: F401  (libraries must be loaded before threads can be limited)
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
