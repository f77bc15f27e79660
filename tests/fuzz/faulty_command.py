"""A command that meets a fault at some moment: in this process, or in one of its own.

Moments are counted, not timed: every report of progress and every file that is begun is one. So the same number is the
same moment on every machine, as far as threads allow.
"""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from bayes_impedance.commands.cli import main
from bayes_impedance.commands.progress_bars import Bars
from bayes_impedance.runtime import atomic_files

Happening = Callable[[], None]


@contextmanager
def at_moment(number: int, happening: Happening) -> Iterator[list[int]]:
    """Let something happen at a moment, and at every later one; yields a list whose only entry counts moments."""
    count, call, new = [0], Bars.__call__, atomic_files._new

    def moment() -> None:
        count[0] += 1
        if count[0] >= number:
            happening()

    def progress(bars: Bars, stage: str, done: int, total: int) -> None:
        moment()
        call(bars, stage, done, total)

    def begun(file: Path) -> Path:
        moment()
        return new(file)

    with mock.patch.object(Bars, "__call__", progress), mock.patch.object(atomic_files, "_new", begun):
        yield count


def once(happening: Happening) -> Happening:
    """Something that happens at the first of its moments only."""
    happened: list[bool] = []

    def first() -> None:
        if not happened:
            happened.append(True)
            happening()

    return first


def kill() -> None:
    """The process is gone, without a chance to tidy up."""
    os.kill(os.getpid(), signal.SIGKILL)


def interrupt() -> None:
    """Ctrl-C."""
    os.kill(os.getpid(), signal.SIGINT)


@contextmanager
def full_disk(number: int) -> Iterator[list[int]]:
    """From a moment on every file can be begun, and no more than a half of it written."""
    write, full = Path.write_bytes, [False]

    def fill() -> None:
        full[0] = True

    def written(file: Path, content: bytes) -> int:
        if full[0]:
            write(file, content[: len(content) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(file, content)

    def text(file: Path, content: str, encoding: str = "utf-8") -> int:
        return written(file, content.encode(encoding))

    with (
        at_moment(number, fill) as count,
        mock.patch.object(Path, "write_bytes", written),
        mock.patch.object(Path, "write_text", text),
    ):
        yield count


@contextmanager
def read_only(number: int) -> Iterator[list[int]]:
    """From a moment on no file can be made, replaced or removed."""
    refusing, opened, replaced, removed = [False], os.open, Path.replace, Path.unlink

    def refuse() -> None:
        refusing[0] = True

    def checked(path: object) -> None:
        if refusing[0]:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    def make(path: str, flags: int, *more: int, **named: int) -> int:
        if flags & os.O_CREAT:
            checked(path)
        return opened(path, flags, *more, **named)

    def replace(file: Path, target: Path) -> Path:
        checked(file)
        return replaced(file, target)

    def unlink(file: Path, missing_ok: bool = False) -> None:
        checked(file)
        removed(file, missing_ok)

    with (
        at_moment(number, refuse) as count,
        mock.patch.object(os, "open", make),
        mock.patch.object(Path, "replace", replace),
        mock.patch.object(Path, "unlink", unlink),
    ):
        yield count


def removing(folder: Path) -> Happening:
    """The input disappears."""
    return once(lambda: shutil.rmtree(folder))


def second_writer(arguments: list[str], said: list[subprocess.CompletedProcess[str]]) -> Happening:
    """Another process begins the same."""
    command = [sys.executable, "-m", "bayes_impedance", *arguments]
    return once(lambda: said.append(subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)))


if __name__ == "__main__":  # python faulty_command.py NUMBER ARGUMENTS...: killed at that moment
    with at_moment(int(sys.argv[1]), kill):
        sys.exit(main(sys.argv[2:]))
