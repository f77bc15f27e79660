"""Files that are complete or absent, whenever the process is killed.

A file is written under a temporary name in its own folder and then renamed, because renaming within a folder is atomic:
a reader meets the former file or the new one. A process that is killed leaves the temporary file, which nobody reads
and which the next attempt removes; an exception removes it at once.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

TEMPORARY_SUFFIX = ".tmp"
"""Added to the name of a file while it is written."""


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """Write a file that appears, or replaces what is there, only when it is complete.

    Parameters
    ----------
    file : Path
        Its folder is made if it does not exist.

    Yields
    ------
    Path
        Temporary name in the same folder, at which there is no file; it must be written before the context ends.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(file.name + TEMPORARY_SUFFIX)
    temporary.unlink(missing_ok=True)  # of a process that was killed while it wrote
    try:
        yield temporary
        temporary.replace(file)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes(file: Path, content: bytes) -> Path:
    """Write bytes and return the file's path."""
    with replacing(file) as temporary:
        temporary.write_bytes(content)
    return file


def write_text(file: Path, text: str) -> Path:
    """Write text as UTF-8 and return the file's path."""
    with replacing(file) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return file


def write_json(file: Path, content: Any, *, indent: int = 2) -> Path:
    """Write JSON and return the file's path.

    Raises
    ------
    ValueError
        If a number is not finite: JSON has no word for it.
    """
    return write_text(file, json.dumps(content, indent=indent, allow_nan=False) + "\n")


def write_together(contents: dict[Path, bytes]) -> None:
    """Write several files of which none is replaced before all are complete."""
    with ExitStack() as stack:
        # Contexts end in the opposite order; the files are to be renamed in theirs.
        temporary = {file: stack.enter_context(replacing(file)) for file in reversed(contents)}
        for file, content in contents.items():
            temporary[file].write_bytes(content)


def save_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write named arrays; what is there is replaced."""
    import numpy as np

    with replacing(file) as temporary, temporary.open("wb") as opened:
        np.savez(opened, **arrays)


def load_arrays(file: Path) -> dict[str, np.ndarray] | None:
    """What `save_arrays` has written; None if there is no file or it is damaged."""
    import numpy as np

    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile):
        return None
