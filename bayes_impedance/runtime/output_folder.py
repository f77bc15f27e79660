"""Output folders of commands: only the package's own files are replaced, and by one process at a time.

**Ownership.** A hidden file of the folder (:data:`MARK`) lists the files that the package has written, with their
SHA-256. A file that is not listed, or has been changed since, belongs to the user. While a command runs, the files that
it will write are listed without a digest, so that files left by a killed process are recognised.

**Locking.** A lock file (:data:`LOCK`) holds the process's number and its machine. On one machine the operating
system's lock on that file decides, which ends with the process; a lock file left behind is taken over. The system's
lock may not reach other machines, so another machine's lock file is respected until it is deleted by hand.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayes_impedance.errors import BusyError, InputError
from bayes_impedance.runtime.atomic_files import write_json

MARK, LOCK = ".bayes_impedance.json", ".bayes_impedance.lock"
_LONGEST_LOCK = 1000
"""Most bytes read from a lock file. By choice: far more than the two short lines that this package writes."""

Made = dict[str, str | None]


@contextmanager
def output_folder(folder: Path, names: Iterable[str], overwrite: bool = False) -> Iterator[None]:
    """Hold a folder while files are written to it.

    Parameters
    ----------
    folder : Path
        Created if it does not exist; removed if the work ends with an error and leaves it empty.
    names : iterable of str
        Every file that may be written, replaced or removed, relative to the folder.
    overwrite : bool
        Whether files of these names are replaced even if they are not the package's.

    Raises
    ------
    InputError
        If a file of these names was not made by this package; nothing has been changed then.
    BusyError
        If another process holds the folder.
    """
    wanted = sorted(set(names))
    require_ours(folder, wanted, overwrite)
    existed = folder.is_dir()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with _locked(folder):
            require_ours(folder, wanted, overwrite)  # another process may have written meanwhile
            yield from _marked(folder, wanted)
    finally:
        if not existed:
            with suppress(OSError):
                folder.rmdir()


def _marked(folder: Path, names: list[str]) -> Iterator[None]:
    before = {name: _fingerprint(folder / name) for name in names}
    known = _made(folder)
    write_json(folder / MARK, {"made": known | dict.fromkeys(names)})
    try:
        yield
    except BaseException:
        with suppress(OSError):  # the first error is reported
            _settle(folder, known, before)
        raise
    _settle(folder, known, before)


def _settle(folder: Path, known: Made, before: dict[str, tuple[int, int, int] | None]) -> None:
    """List the written files with their digests, and remove those that were not written."""
    made = {name: digest for name, digest in known.items() if name not in before}
    for name, former in before.items():
        now = _fingerprint(folder / name)
        if now is not None and now != former:
            made[name] = _digest(folder / name)
        elif now is not None and name in known:
            made[name] = known[name]
    if made:
        write_json(folder / MARK, {"made": made})
    else:
        (folder / MARK).unlink(missing_ok=True)


def require_ours(folder: Path, names: Iterable[str], overwrite: bool) -> None:
    """Refuse a folder in which files of these names are not the package's; nothing is changed.

    Raises
    ------
    InputError
        As in :func:`output_folder`.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; name one for the results with -o")
    made = _made(folder)
    for name in names:
        file = folder / name
        if not file.exists() and not file.is_symlink():
            continue
        if file.is_dir():
            raise InputError(
                f"{file}: a file of this name is to be written, but it is a folder; name another folder with -o"
            )
        ours = name in made and not file.is_symlink() and made[name] in (None, _digest(file))
        if not ours and not overwrite:
            raise InputError(
                f"{file}: was not written by this package or was changed since, so it is not replaced; "
                "name another folder with -o, or give --overwrite"
            )


def _made(folder: Path) -> Made:
    try:
        made = json.loads((folder / MARK).read_text(encoding="utf-8"))["made"]
        return {str(name): None if digest is None else str(digest) for name, digest in made.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}  # no file counts as the package's, and none is replaced


def _fingerprint(file: Path) -> tuple[int, int, int] | None:
    """Values that change when a file is replaced: the writer gives it a new inode."""
    try:
        found = file.lstat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


def _digest(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


# -------------------------------------------------------------------- the lock


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    file = folder / LOCK
    descriptor = _open_lock(file)
    try:
        while (held := _hold(descriptor)) and os.fstat(descriptor).st_nlink == 0:
            os.close(descriptor)  # its former owner has meanwhile removed or replaced the file
            descriptor = _open_lock(file)
        number, machine = _holder(descriptor, file)
        if not held or machine not in ("", socket.gethostname()):
            who = f"process {number} on {machine}" if number else "another process"
            raise BusyError(
                f"{folder}: {who} is writing there; wait for it, or name another folder (if it has ended, delete "
                f"{file})"
            )
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n{socket.gethostname()}\n".encode(), 0)
        try:
            yield
        finally:
            file.unlink(missing_ok=True)  # before the lock ends: the next process creates its own file
    finally:
        os.close(descriptor)


def _open_lock(file: Path) -> int:
    try:
        return os.open(file, os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InputError(f"{file}: is a link that this package did not make; delete it") from None
        raise


def _hold(descriptor: int) -> bool:
    """Whether this process holds the system's lock; always true where the file system has no locks."""
    try:
        import fcntl
    except ImportError:  # not available on this system
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EAGAIN, errno.EACCES)
    return True


def _holder(descriptor: int, file: Path) -> tuple[str, str]:
    """Number of the process and name of the machine that a lock file names; empty if it names none."""
    content = os.pread(descriptor, _LONGEST_LOCK, 0)
    lines = content.decode(errors="replace").splitlines()
    if len(lines) == 2 and lines[0].isdecimal():
        return lines[0], lines[1]
    if content.count(b"\n") > 1 or (not content[:1].isdigit() and content):
        raise InputError(f"{file}: is not a lock file of this package; move it away")
    return "", ""  # empty, or its writer was killed
