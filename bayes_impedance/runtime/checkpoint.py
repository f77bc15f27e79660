"""What a fit keeps as it comes, in a folder that belongs to this fit alone.

Numbers of another dataset or of other settings would be taken up in silence, so the folder says whose they are. What is
worked out person by person is kept in pieces: a fit that has been killed in the middle of ten thousand persons goes on
from the last piece.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import load_arrays, save_arrays, write_text

_NAME = "belongs_to.txt"
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
        If it has been claimed for other recordings or settings.
    """
    digest = hashlib.sha256(repr(settings).encode())
    for own in digests:
        digest.update(own.encode())
    owner, file = digest.hexdigest() + "\n", folder / _NAME
    if file.is_file():
        if file.read_text(encoding="utf-8") != owner:
            raise InputError(
                f"{folder}: is of other data or other options; repeat those, or start anew (without --resume, "
                "or with another folder)"
            )
        return
    write_text(file, owner)


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
