"""What a fit keeps as it comes, in a folder that belongs to this fit alone.

Numbers of another dataset or of other settings would be taken up in silence, so the folder says whose they are, and
every file in it carries a seal: a digest of its numbers and of their owner. What has no seal that fits is damaged or of
another fit; it is made anew. What is worked out person by person is kept in pieces: a fit that has been killed in the
middle of ten thousand persons goes on from the last piece.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import TEMPORARY_SUFFIX, write_bytes, write_text

_NAME = "belongs_to.txt"
_OWN_FILES = re.compile(r"(\w+\.npz|ensemble_\d+\.h5)")
"""Names of the files that a fit keeps beside :data:`_NAME`."""
_SEAL = "seal"
_MOST_PIECES, _SMALLEST_PIECE = 64, 16
"""A kill loses one piece at most, a sixty-fourth of the work; with fewer persons than sixteen in each, files would
cost more than the fits that they save."""

Row = tuple[np.ndarray, ...]


def claim(folder: Path, digests: Iterable[str], *settings: object) -> None:
    """Make the folder this fit's own.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    digests : iterable of str
        Of everybody's recordings, in order.
    *settings : object
        All else that the numbers depend on, with a ``repr`` that says so.

    Raises
    ------
    InputError
        If it has been claimed for other recordings or settings, or if it is not a fit's.
    """
    digest = hashlib.sha256(repr(settings).encode())
    for own in digests:
        digest.update(own.encode())
    owner, file = digest.hexdigest() + "\n", folder / _NAME
    if file.is_file():
        if file.read_bytes() != owner.encode():
            raise InputError(
                f"{folder}: is of other data or other options; repeat those, or start anew (without --resume, "
                "or with another folder)"
            )
        return
    require_own(folder)
    write_text(file, owner)


def require_own(folder: Path) -> None:
    """Refuse a folder, or whatever else has its name, that no fit has made.

    Raises
    ------
    InputError
        If there is something without the mark of a fit.
    """
    foreign = InputError(
        f"{folder}: does not carry the mark of a fit ({_NAME}), so it is left as it is; move it away, or name another "
        "folder for the results"
    )
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise foreign
    if folder.is_dir() and any(not _temporary(file) for file in folder.iterdir()):
        file = folder / _NAME
        if file.is_symlink() or not file.is_file() or not re.fullmatch(rb"[0-9a-f]{64}\n", file.read_bytes()):
            raise foreign


def discard(folder: Path) -> None:
    """Remove what a fit has kept, and the folder if nothing else is in it.

    Raises
    ------
    InputError
        If no fit has made the folder.
    """
    require_own(folder)
    if not folder.is_dir():
        return
    for file in sorted(folder.iterdir()):
        if file.is_file() and not file.is_symlink() and (_OWN_FILES.fullmatch(file.name) or _temporary(file)):
            file.unlink()
    (folder / _NAME).unlink(missing_ok=True)
    with suppress(OSError):  # somebody has put something there
        folder.rmdir()


def _temporary(file: Path) -> bool:
    return file.name.startswith(".") and file.name.endswith(TEMPORARY_SUFFIX)


# -------------------------------------------------------------------- sealed files


def seal_of(folder: Path, arrays: Mapping[str, Any]) -> str:
    """Digest of named arrays and of the fit that the folder belongs to."""
    try:
        digest = hashlib.sha256((folder / _NAME).read_bytes())
    except OSError:
        digest = hashlib.sha256()
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {values.dtype.str} {values.shape}\n".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


def save_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write named arrays with their seal; what is there is replaced."""
    content = {name: np.asarray(values) for name, values in arrays.items()}
    buffer = io.BytesIO()  # a full disk must not meet a half-written archive
    sealed: dict[str, Any] = {**content, _SEAL: np.array(seal_of(file.parent, content))}
    np.savez(buffer, **sealed)
    write_bytes(file, buffer.getvalue())


def load_arrays(file: Path) -> dict[str, np.ndarray] | None:
    """What `save_arrays` has written; None if there is no file, or it is damaged or of another fit."""
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as data:
            arrays = {name: np.asarray(data[name]) for name in data.files}
    except Exception:  # damage shows itself in as many ways as there are layers in an archive
        return None
    seal = arrays.pop(_SEAL, None)
    return arrays if seal is not None and str(seal) == seal_of(file.parent, arrays) else None


# -------------------------------------------------------------------- pieces


def in_pieces(folder: Path | None, name: str, n: int, rows_from: Callable[[int], Iterator[Row]]) -> Iterator[Row]:
    """Rows of arrays in order: those that were kept, then the others, which are kept piece by piece.

    Parameters
    ----------
    folder : Path or None
        None keeps nothing.
    name : str
        Of what is kept, in names of files.
    n : int
        How many rows there are.
    rows_from : callable
        Rows from some row on, as they come.
    """
    size = max(_SMALLEST_PIECE, -(-n // _MOST_PIECES))
    start = 0
    while folder is not None and start < n:
        kept = load_arrays(_piece(folder, name, start))
        if kept is None:
            break
        columns = [kept[f"arr_{k}"] for k in range(len(kept))]
        yield from zip(*columns, strict=True)
        start += len(columns[0])
    rest: list[Row] = []
    for row in rows_from(start) if start < n else ():
        rest.append(row)
        if folder is not None and (len(rest) == size or start + len(rest) == n):
            columns = [np.array(column) for column in zip(*rest, strict=True)]
            save_arrays(_piece(folder, name, start), {f"arr_{k}": column for k, column in enumerate(columns)})
            start, rest = start + len(rest), []
        yield row


def forget_pieces(folder: Path, *names: str) -> None:
    """Remove what has been put together elsewhere."""
    for name in names:
        for file in folder.glob(f"{name}_*.npz"):
            file.unlink()


def _piece(folder: Path, name: str, start: int) -> Path:
    return folder / f"{name}_{start:08d}.npz"
