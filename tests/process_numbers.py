"""Numbers of the processes that an executor has started, to kill one of them."""

from __future__ import annotations

from bayes_impedance.runtime.worker_processes import Processes


def pids(executor: Processes) -> tuple[int, ...]:
    """Of the processes that run now."""
    return tuple(w.process.pid for w in executor._workers if w.process is not None and w.process.pid is not None)
