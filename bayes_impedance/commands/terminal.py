"""Where text goes out: one line at a time, without control codes, whatever the terminal is and whether it is there."""

from __future__ import annotations

import errno
import os
import re
import sys
import unicodedata
from typing import Any

_SEQUENCE = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)?|[\x1b\x9b].?")
"""What a terminal takes as a command: control sequences, operating system commands, and other escapes."""
_INVISIBLE = frozenset({"Cc", "Cf"})
"""Categories of Unicode that a terminal obeys: control codes, and marks that change the direction of the text."""
_SPACES = frozenset("\t\n\v\f\r\x85\u2028\u2029")
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""No space on the disk, none in the user's share, none in the longest file that is allowed."""


def prepare_streams() -> None:
    """Let no character that the terminal's encoding lacks end a command."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def tell(line: str = "") -> None:
    """Write a line to standard output; where it is closed, or nobody reads it any more, nothing happens.

    Raises
    ------
    OSError
        If standard output is a file that cannot be written.
    """
    _write(line, sys.stdout)


def complain(line: str) -> None:
    """Write a line to standard error; where that is impossible, nothing happens."""
    try:
        _write(line, sys.stderr)
    except OSError:
        return


def printable(text: str) -> str:
    """Text without what a terminal would obey: names and titles come from files that others have written."""
    spaced = "".join(" " if c in _SPACES else c for c in _SEQUENCE.sub("", text))
    return "".join(c for c in spaced if unicodedata.category(c) not in _INVISIBLE)


def sentence_of(error: OSError) -> str:
    """What the system has refused, where, and what to do."""
    where = "" if error.filename is None else os.fsdecode(error.filename)
    what = error.strerror or str(error) or type(error).__name__
    if error.errno in _FULL:
        reason = "" if error.errno == errno.ENOSPC else f" ({what})"
        where = where or "where results are written"
        return f"no space left on device{reason}: {where}; make room, or name another folder"
    return f"{where}: {what}; check the path and its permissions" if where else f"{what}; check paths and permissions"


def _write(line: str, stream: Any) -> None:
    if stream is None:  # closed when the process began
        return
    try:
        stream.write(printable(line) + "\n")
        stream.flush()
    except BrokenPipeError:  # `| head` has seen enough
        _silence(stream)
    except OSError as error:
        _silence(stream)
        raise OSError(error.errno, error.strerror, "standard output") from None
    except ValueError:  # closed since
        return


def _silence(stream: Any) -> None:
    """Send to nowhere what is still in the stream's buffer: the interpreter would try again at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, stream.fileno())
    except (OSError, ValueError):
        return
    finally:
        os.close(nowhere)
