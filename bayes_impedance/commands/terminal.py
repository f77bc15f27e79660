"""Text output: one line at a time, without control codes, on any terminal and also if there is none."""

from __future__ import annotations

import errno
import os
import re
import sys
import unicodedata
from typing import Any

_SEQUENCE = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)?|[\x1b\x9b].?")
"""Text that a terminal interprets as a command: control sequences, operating system commands, and other escapes."""
_INVISIBLE = frozenset({"Cc", "Cf"})
"""Unicode categories that a terminal interprets: control codes, and marks that change the direction of the text."""
_SPACES = frozenset("\t\n\v\f\r\x85\u2028\u2029")
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Error numbers: no space on the disk, quota of the user exceeded, largest allowed file size exceeded."""


def prepare_streams() -> None:
    """Replace characters that the terminal's encoding lacks, so that they do not end a command with an error."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def tell(line: str = "") -> None:
    """Write a line to standard output; nothing happens if it is closed or no longer read.

    Raises
    ------
    OSError
        If standard output is a file that cannot be written.
    """
    _write(line, sys.stdout)


def complain(line: str) -> None:
    """Write a line to standard error; nothing happens if that is impossible."""
    try:
        _write(line, sys.stderr)
    except OSError:
        return


def printable(text: str) -> str:
    """Text without terminal control codes, because names and titles come from the user's files."""
    spaced = "".join(" " if c in _SPACES else c for c in _SEQUENCE.sub("", text))
    return "".join(c for c in spaced if unicodedata.category(c) not in _INVISIBLE)


def sentence_of(error: OSError) -> str:
    """A system error as a sentence: what was refused, where, and what to do."""
    where = "" if error.filename is None else os.fsdecode(error.filename)
    what = error.strerror or str(error) or type(error).__name__
    if error.errno in _FULL:
        reason = "" if error.errno == errno.ENOSPC else f" ({what})"
        where = where or "where results are written"
        return f"no space left on device{reason}: {where}; make room, or name another folder"
    return f"{where}: {what}; check the path and its permissions" if where else f"{what}; check paths and permissions"


def _write(line: str, stream: Any) -> None:
    if stream is None:  # closed when the process started
        return
    try:
        stream.write(printable(line) + "\n")
        stream.flush()
    except BrokenPipeError:  # the reader, for example `| head`, has ended
        _silence(stream)
    except OSError as error:
        _silence(stream)
        raise OSError(error.errno, error.strerror, "standard output") from None
    except ValueError:  # closed in the meantime
        return


def _silence(stream: Any) -> None:
    """Discard the rest of the stream's buffer: the interpreter would try to write it again when it ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, stream.fileno())
    except (OSError, ValueError):
        return
    finally:
        os.close(nowhere)
