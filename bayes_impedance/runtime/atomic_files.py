"""Files that are complete or absent, whenever the process is killed.

A file is written under a temporary name in its own folder and then renamed, because renaming within a folder is atomic:
a reader sees either the former file or the new one. The temporary name is unpredictable, and the file is created with
``O_EXCL | O_NOFOLLOW``: a symbolic link planted there is never followed. A killed process leaves the temporary file,
whose name holds the process's number and the machine's name; the next process that writes the same file removes it. An
exception removes it at once.
"""

from __future__ import annotations

import csv
import errno
import io
import json
import math
import os
import secrets
import socket
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

Content = bytes | Iterable[bytes]
"""Bytes of a file, or parts of them one after the other, so that they need not be in memory together."""

TEMPORARY_SUFFIX = ".tmp"
"""Suffix of the temporary file's name."""

_ATTEMPTS = 100
"""Attempts to find an unused name of eight random bytes. By choice: even one collision has probability 1e-19."""


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """Write a file that appears, or replaces what is there, only when it is complete.

    Parameters
    ----------
    file : Path
        Its folder is created if it does not exist.

    Yields
    ------
    Path
        An empty file in the same folder, which must be written before the context ends.

    Raises
    ------
    OSError
        With the name of `file`, whichever step of the writing has failed.
    """
    temporary = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(file)
        temporary = _new(file)
        yield temporary
        temporary.replace(file)
    except OSError as error:
        _unlink(temporary)
        if error.errno is None:  # some libraries give a message only
            raise OSError(errno.EIO, str(error), str(file)) from error
        other = error.filename not in (None, str(temporary), temporary)
        name = str(error.filename) if other else str(file)
        raise OSError(error.errno, error.strerror or os.strerror(error.errno), name) from error
    except BaseException:
        _unlink(temporary)
        raise


def _new(file: Path) -> Path:
    """A new empty file with an unpredictable name."""
    flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0)
    for _ in range(_ATTEMPTS):
        temporary = file.with_name(f"{_stem(file)}{os.getpid()}-{secrets.token_hex(8)}{TEMPORARY_SUFFIX}")
        with suppress(FileExistsError):
            os.close(os.open(temporary, flags, 0o666))
            return temporary
    raise FileExistsError(errno.EEXIST, "no temporary name is free", str(file))


def _stem(file: Path) -> str:
    """Common beginning of the temporary names that this machine gives to a file."""
    machine = "".join(c if c.isalnum() else "_" for c in socket.gethostname())
    return f".{file.name}.{machine}-"


def _remove_leftovers(file: Path) -> None:
    """Remove temporary files of this file left by killed processes of this machine."""
    stem = _stem(file)
    with os.scandir(file.parent) as entries:
        names = [e.name for e in entries if e.name.startswith(stem) and e.name.endswith(TEMPORARY_SUFFIX)]
    for name in names:
        number = name.removeprefix(stem).partition("-")[0]
        if number.isdecimal() and not process_lives(int(number)):
            _unlink(file.with_name(name))


def _unlink(file: Path | None) -> None:
    with suppress(OSError):
        if file is not None and stat.S_ISREG(file.lstat().st_mode):
            file.unlink()


def process_lives(number: int) -> bool:
    """Whether a process with this number runs on this machine; assumed true if that cannot be determined."""
    if os.name == "nt":  # os.kill would end it
        return True
    try:
        os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it belongs to another user
        return True
    return True


def write_bytes(file: Path, content: bytes | memoryview) -> Path:
    """Write bytes and return the file's path."""
    with replacing(file) as temporary:
        temporary.write_bytes(content)
    return file


def write_text(file: Path, text: str) -> Path:
    """Write text as UTF-8 and return the file's path."""
    with replacing(file) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return file


def finite_or_none(value: float) -> float | None:
    """The number, or None if it is not finite, which JSON cannot represent."""
    return float(value) if math.isfinite(value) else None


def write_json(file: Path, content: Any, *, indent: int = 2) -> Path:
    """Write JSON and return the file's path.

    Raises
    ------
    ValueError
        If a number is not finite: JSON cannot represent it.
    """
    return write_text(file, json.dumps(content, indent=indent, allow_nan=False) + "\n")


def write_together(contents: Mapping[Path, Content]) -> None:
    """Write several files, each as a whole or part by part; none is replaced before all are complete."""
    with ExitStack() as stack:
        # Contexts end in reverse order, but the files are to be renamed in the given order.
        temporary = {file: stack.enter_context(replacing(file)) for file in reversed(list(contents))}
        for file, content in contents.items():
            if isinstance(content, bytes):
                temporary[file].write_bytes(content)
                continue
            with temporary[file].open("wb") as stream:
                stream.writelines(content)


def csv_bytes(rows: Iterable[Sequence[object]]) -> bytes:
    """Rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
