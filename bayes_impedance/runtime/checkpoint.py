"""Checkpoints of a fit, in a folder that belongs to this fit alone.

Results of another dataset or of other settings must not be reused unnoticed. The folder therefore identifies its fit,
and every file in it has a seal: a digest of its content and of the fit. A file without a matching seal is damaged or
belongs to another fit, and is computed again. Results computed person by person are saved in pieces: a fit killed in
the middle of ten thousand persons resumes after the last piece.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import TEMPORARY_SUFFIX, write_bytes, write_text

_NAME = "belongs_to.txt"
_OWN_FILES = re.compile(r"(\w+\.npz|ensemble_\d+\.h5)")
"""Names of the files that a fit saves in addition to :data:`_NAME`."""
_SEAL = "seal"
_FORMAT = 2
"""Number of the format of what is saved. Raised by one when arrays change: another version's files are not resumed."""
_MOST_PIECES, _SMALLEST_PIECE = 64, 16
"""Largest number of pieces, and fewest persons in one. By choice: a kill loses at most a sixty-fourth of the work; with
fewer than sixteen persons, writing a file would cost more than repeating their fits."""

Row = tuple[np.ndarray, ...]


def claim(folder: Path, digests: Iterable[str], *settings: object) -> None:
    """Mark the folder as belonging to this fit.

    Parameters
    ----------
    folder : Path
        Created if it does not exist.
    digests : iterable of str
        Digests of all subjects' recordings, in order.
    *settings : object
        Everything else that determines the results; the ``repr`` must identify it, or that of :func:`complete`.

    Raises
    ------
    InputError
        If it belongs to other recordings or settings, or was not made by a fit.
    """
    digest = hashlib.sha256(repr((_FORMAT, *map(complete, settings))).encode())
    for own in digests:
        digest.update(own.encode())
    owner, file = digest.hexdigest() + "\n", folder / _NAME
    if file.is_file():
        if file.read_bytes() != owner.encode():
            raise InputError(
                f"{folder}: the checkpoint is of other data or other options, or of another version of the package; "
                "give the same ones, or start anew (without --resume, or with another folder)"
            )
        return
    require_own(folder)
    write_text(file, owner)


def complete(value: object) -> object:
    """Settings with every field, those at their defaults too, whatever their ``repr`` says; others as they are.

    What a version without a field did in its place is not known: its folders must not be taken for ours.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return type(value).__name__, [(f.name, complete(getattr(value, f.name))) for f in fields(value) if f.repr]
    if isinstance(value, Mapping):
        return {key: complete(own) for key, own in value.items()}
    return [complete(own) for own in value] if isinstance(value, list | tuple) else value


def require_own(folder: Path) -> None:
    """Refuse a folder, or another file of this name, that was not made by a fit.

    Raises
    ------
    InputError
        If the path exists without the mark of a fit.
    """
    foreign = InputError(
        f"{folder}: the folder is not a checkpoint (it has no {_NAME}), so it is left as it is; move it away, or name "
        "another folder for the results"
    )
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise foreign
    if folder.is_dir() and any(not _temporary(file) for file in folder.iterdir()):
        file = folder / _NAME
        if file.is_symlink() or not file.is_file() or not re.fullmatch(rb"[0-9a-f]{64}\n", file.read_bytes()):
            raise foreign


def discard(folder: Path) -> None:
    """Remove a fit's checkpoints, and the folder if it is then empty.

    Raises
    ------
    InputError
        If the folder was not made by a fit.
    """
    require_own(folder)
    if not folder.is_dir():
        return
    for file in sorted(folder.iterdir()):
        if file.is_file() and not file.is_symlink() and (_OWN_FILES.fullmatch(file.name) or _temporary(file)):
            file.unlink()
    (folder / _NAME).unlink(missing_ok=True)
    with suppress(OSError):  # the folder holds other files
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
    """Write named arrays with their seal; an existing file is replaced."""
    content = {name: np.asarray(values) for name, values in arrays.items()}
    buffer = io.BytesIO()  # in memory first, so that a full disk leaves no partial archive
    sealed: dict[str, Any] = {**content, _SEAL: np.array(seal_of(file.parent, content))}
    np.savez(buffer, **sealed)
    write_bytes(file, buffer.getvalue())


def load_arrays(file: Path) -> dict[str, np.ndarray] | None:
    """Read arrays written by `save_arrays`; None if there is no file, or it is damaged or of another fit."""
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as data:
            arrays = {name: np.asarray(data[name]) for name in data.files}
    except Exception:  # damage raises many types of exception
        return None
    seal = arrays.pop(_SEAL, None)
    return arrays if seal is not None and str(seal) == seal_of(file.parent, arrays) else None


# -------------------------------------------------------------------- pieces


def in_pieces(folder: Path | None, name: str, n: int, rows_from: Callable[[int], Iterator[Row]]) -> Iterator[Row]:
    """Rows of arrays in order: first the saved ones, then the computed ones, which are saved piece by piece.

    Parameters
    ----------
    folder : Path or None
        None saves nothing.
    name : str
        Name of the results, used in file names.
    n : int
        Number of rows.
    rows_from : callable
        Iterator over the rows from a given index on.
    """
    if folder is None:
        yield from rows_from(0)
        return
    size = max(_SMALLEST_PIECE, -(-n // _MOST_PIECES))
    start = 0
    while start < n:
        kept = load_arrays(_piece(folder, name, start))
        if kept is None:
            break
        columns = [kept[f"arr_{k}"] for k in range(len(kept))]
        yield from zip(*columns, strict=True)
        start += len(columns[0])
    rest: list[Row] = []
    for row in rows_from(start) if start < n else ():
        rest.append(row)
        if len(rest) == size or start + len(rest) == n:
            columns = [np.array(column) for column in zip(*rest, strict=True)]
            save_arrays(_piece(folder, name, start), {f"arr_{k}": column for k, column in enumerate(columns)})
            start, rest = start + len(rest), []
        yield row


def forget_pieces(folder: Path, *names: str) -> None:
    """Remove pieces that have been combined elsewhere."""
    for name in names:
        for file in folder.glob(f"{name}_*.npz"):
            file.unlink()


def _piece(folder: Path, name: str, start: int) -> Path:
    return folder / f"{name}_{start:08d}.npz"
