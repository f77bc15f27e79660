"""Local processes: they may be killed, what is lost is done again, and what is lent to them travels once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures import wait as all_done
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from process_numbers import pids

from bayes_impedance.errors import InputError, WorkerError
from bayes_impedance.runtime import broadcast
from bayes_impedance.runtime.broadcast import Lent
from bayes_impedance.runtime.worker_processes import Processes


def square(n: int) -> int:
    return n * n


def refuse(message: str) -> None:
    raise InputError(message)


class NeverArrivesError(Exception):
    """Leaves the process where it was raised, but cannot be made again from what it was."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def fail_for_good() -> None:
    raise NeverArrivesError(1, 2)


def die_unless(file: Path, n: int) -> int:
    """Leaves a mark; without one mark more than n it kills its process."""
    with file.open("a") as marks:
        marks.write(".")
    if len(file.read_text()) <= n:
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def libraries() -> tuple[list[int], bool]:
    """Threads of each library of linear algebra, and whether an interrupt is left to others."""
    from threadpoolctl import threadpool_info

    return [library["num_threads"] for library in threadpool_info()], signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_results_and_errors_come_back() -> None:
    with Processes(2) as executor:
        assert list(executor.map(square, range(20))) == [n * n for n in range(20)]
        with pytest.raises(InputError, match="no such thing") as caught:
            executor.submit(refuse, "no such thing").result()
        assert any("in a worker process" in note for note in caught.value.__notes__)
        with pytest.raises(RuntimeError, match="NeverArrivesError: 1 and 2"):
            executor.submit(fail_for_good).result()
        with pytest.raises(AttributeError, match="local"):
            executor.submit(lambda: 1).result()
        assert executor.submit(square, 3).result() == 9
        threads, left_to_others = executor.submit(libraries).result()
        assert threads
        assert set(threads) == {1}
        assert left_to_others
    with pytest.raises(RuntimeError, match="told to end"):
        executor.submit(square, 1)


def test_a_lost_task_is_done_again_and_nobody_else_is_disturbed(tmp_path: Path) -> None:
    with Processes(2) as executor:
        others = [executor.submit(square, n) for n in range(10)]
        lost = executor.submit(die_unless, tmp_path / "marks", 2)
        others += [executor.submit(square, n) for n in range(10, 20)]
        assert [other.result() for other in others] == [n * n for n in range(20)]
        assert lost.result() in pids(executor)
    assert (tmp_path / "marks").read_text() == "..."


def test_a_process_that_dies_while_it_has_nothing_to_do_is_replaced() -> None:
    with Processes(1) as executor:
        assert executor.submit(square, 2).result() == 4
        (pid,) = pids(executor)
        os.kill(pid, signal.SIGKILL)
        assert executor.submit(square, 3).result() == 9
        assert pids(executor) != (pid,)


def test_what_kills_every_process_is_given_up_and_the_rest_is_done(tmp_path: Path) -> None:
    with Processes(2) as executor:
        hopeless = executor.submit(die_unless, tmp_path / "marks", 99)
        others = [executor.submit(square, n) for n in range(5)]
        with pytest.raises(WorkerError, match=r"4 processes died.*--workers"):
            hopeless.result()
        assert [other.result() for other in others] == [0, 1, 4, 9, 16]
    assert (tmp_path / "marks").read_text() == "...."


def test_after_an_error_nobody_waits_for_what_is_left() -> None:
    begun: list[Future[Any]] = []

    def interrupted() -> None:
        with Processes(1) as executor:
            begun.extend((executor.submit(time.sleep, 3600), executor.submit(square, 2)))
            while not (begun[0].running() and pids(executor)):
                time.sleep(0.01)
            raise KeyError

    with pytest.raises(KeyError):
        interrupted()
    running, waiting = begun
    assert all_done([running, waiting]).not_done == set()
    assert isinstance(running.exception(), WorkerError)
    with pytest.raises(CancelledError):
        waiting.result()


def test_processes_end_with_the_one_that_has_started_them(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import math, multiprocessing, time\n"
        "from bayes_impedance.runtime.worker_processes import Processes\n"
        "if __name__ == '__main__':\n"
        "    executor = Processes(1)\n"
        "    executor.submit(math.sqrt, 4.0).result()\n"
        "    print(multiprocessing.active_children()[0].pid, flush=True)\n"
        "    time.sleep(3600)\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as started:
        assert started.stdout is not None
        pid = int(started.stdout.readline())
        assert _lives(pid)
        started.kill()
    for _ in range(3000):
        if not _lives(pid):
            return
        time.sleep(0.01)
    pytest.fail("the process outlives its parent")


def _lives(pid: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


# -------------------------------------------------------------------- what is lent


class Counted:
    """Numbers that count how often they travel."""

    def __init__(self, numbers: np.ndarray) -> None:
        self.numbers, self.travelled = numbers, 0

    @property
    def nbytes(self) -> int:
        return self.numbers.nbytes

    def __getstate__(self) -> dict[str, Any]:
        self.travelled += 1
        return {"numbers": self.numbers, "travelled": 0}


def scalar_product(data: Counted, task: np.ndarray) -> float:
    return float(data.numbers @ task)


def ask_all(executor: Executor, lents: list[Lent], times: int = 5) -> None:
    for k in range(times):
        tasks = [(lent, np.full(3, float(k + i))) for i, lent in enumerate(lents)]
        expected = [float(lent.data.numbers @ task) for lent, task in tasks]
        assert Lent.ask(executor, scalar_product, tasks) == expected


def lend(n: int) -> list[Lent]:
    return [Lent(Counted(np.arange(3.0) + i)) for i in range(n)]


def test_what_is_lent_stays_here_with_threads_and_travels_once_to_a_process() -> None:
    lents = lend(4)
    with ThreadPoolExecutor(2) as executor:
        ask_all(executor, lents)
    assert [lent.data.travelled for lent in lents] == [0] * 4
    for executor in (Processes(1), ProcessPoolExecutor(1, mp_context=get_context("spawn"))):
        lents = lend(4)
        with executor:
            ask_all(executor, lents)
        assert [lent.data.travelled for lent in lents] == [1] * 4


def test_a_new_process_is_sent_what_it_has_to_know() -> None:
    lents = lend(3)
    with Processes(1) as executor:
        ask_all(executor, lents)
        os.kill(pids(executor)[0], signal.SIGKILL)
        ask_all(executor, lents)
    assert [lent.data.travelled for lent in lents] == [2] * 3


def test_what_is_too_much_is_forgotten_and_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, as one that tasks travel to: two pieces of 24 bytes are remembered and not three."""
    import pickle

    class There(ThreadPoolExecutor):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            fn, args, kwargs = pickle.loads(pickle.dumps((fn, args, kwargs)))
            return super().submit(fn, *args, **kwargs)

    monkeypatch.setattr(broadcast, "_MOST_REMEMBERED", 48)
    monkeypatch.setattr(broadcast, "_remembered", type(broadcast._remembered)())
    lents = lend(3)
    with There(1) as executor:
        ask_all(executor, lents[:2])
        assert [lent.data.travelled for lent in lents] == [1, 1, 0]
        ask_all(executor, [lents[0], lents[2]], times=1)  # forgets the second, asked for before the first
        ask_all(executor, lents[:1], times=1)
        assert [lent.data.travelled for lent in lents] == [1, 1, 1]
        ask_all(executor, lents[1:2], times=1)
        assert [lent.data.travelled for lent in lents] == [1, 2, 1]
    assert len(broadcast._remembered) == 2
