"""Recordings as Parquet, one file or a folder of them, as the same table that a CSV file holds."""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.csv_table import Cells, Table, table_of

SUFFIX = ".parquet"
_IGNORED_PREFIXES = (".", "_")
"""Files with these prefixes belong to other programs, such as ``_SUCCESS``; pyarrow ignores the same by default."""


def parquet_table(path: Path, known: Collection[str], extra: dict[str, str] | None = None) -> tuple[Table, str]:
    """Read a table: numeric columns stay numeric, all others become text.

    Parameters
    ----------
    path : Path
        File, or folder of files, partitioned in the manner of Hive (``subject=A/part-0.parquet``) or not at all. Rows
        are in the order of the files' names and counted like a CSV file's: the first is row 2.
    known : collection of str
        Column names that are recognised in upper case too.
    extra : dict of str to str
        Additional constant columns, from the folder's own name.

    Returns
    -------
    table : Table
    digest : str
        SHA-256 of the files.

    Raises
    ------
    InputError
        If pyarrow is not installed or the table cannot be read.
    """
    _require_pyarrow(path)
    import pyarrow as pa
    import pyarrow.parquet as pq

    digest, parts = hashlib.sha256(), []
    for file, keys in _files(path):
        try:
            data = file.read_bytes()
            table = pq.ParquetFile(pa.BufferReader(data)).read(use_threads=False)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise _unreadable(file, error) from None
        digest.update(data)
        index = (table.schema.pandas_metadata or {}).get("index_columns", [])
        columns = [(name, _cells(c)) for name, c in zip(table.column_names, table.columns, strict=True)]
        parts.append([(name, cells) for name, cells in columns if name not in index])
        for name, value in ((extra or {}) | keys).items():
            if any(name == found and np.any(_text(cells) != value) for found, cells in columns):
                raise InputError(
                    f'{file}: the column {name} differs from the name of its folder, "{value}"; write the file again'
                )
            parts[-1] = [(found, cells) for found, cells in parts[-1] if found != name]
            parts[-1].append((name, np.full(table.num_rows, value, dtype=object)))
    if not parts:
        raise InputError(f"{path}: the folder contains no files; put Parquet files there")
    return table_of(_joined(parts), str(path), known), digest.hexdigest()


def partitions(path: Path, key: str) -> list[tuple[str, Path]]:
    """Values of a key and the folders that hold them, by the folders' names; empty if not partitioned by it."""
    if not path.is_dir():
        return []
    inside = sorted(p for p in path.iterdir() if not p.name.startswith(_IGNORED_PREFIXES))
    if not all(p.is_dir() and p.name.startswith(f"{key}=") for p in inside):
        return []
    _require_pyarrow(path)
    return [(_keys(p, Path(p.name), [key])[key], p) for p in inside]


def _files(path: Path) -> list[tuple[Path, dict[str, str]]]:
    """The file itself, or all files of a folder sorted by name, and the keys in the names of their folders.

    The dataset of pyarrow has an empty schema because it only lists the files: an unreadable file is detected when it
    is read, and its columns may differ from those of the others.
    """
    if not path.is_dir():
        return [(path, {})]
    import pyarrow as pa
    import pyarrow.dataset as ds

    listed = ds.dataset(path, schema=pa.schema([]), format="parquet", ignore_prefixes=list(_IGNORED_PREFIXES))
    files = sorted(Path(file) for file in listed.files)
    folders = [file.parent.relative_to(path) for file in files]
    names = list(dict.fromkeys(part.split("=")[0] for folder in folders for part in folder.parts if "=" in part))
    return [(file, _keys(file, folder, names)) for file, folder in zip(files, folders, strict=True)]


def _keys(place: Path, folder: Path, names: list[str]) -> dict[str, str]:
    """Keys and values in names of folders such as ``subject=A``, as text: numbers may have leading zeros."""
    import pyarrow as pa
    import pyarrow.dataset as ds

    partitioning = ds.partitioning(pa.schema([(name, pa.string()) for name in names]), flavor="hive")
    try:
        found = ds.get_partition_keys(partitioning.parse(f"{folder.as_posix()}/"))
    except pa.ArrowException as error:
        raise _unreadable(place, error) from None
    return {name: found[name] or "" for name in names if name in found}


def _require_pyarrow(path: Path) -> None:
    if find_spec("pyarrow") is None:
        raise InputError(
            f'{path}: Parquet needs the package pyarrow: pip install "bayes_impedance[parquet]", or give CSV'
        )


def _unreadable(file: Path, error: Exception) -> InputError:
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    return InputError(f"{file}: cannot be read as Parquet ({reason}); write the file again")


def _cells(column: Any) -> Cells:
    import pyarrow as pa

    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
        return np.asarray(column.to_numpy())  # missing values become NaN
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        column = column.dictionary_encode()  # a name is in as many rows as there are frequencies: all share one string
    if pa.types.is_dictionary(column.type):
        parts = [_of_dictionary(chunk) for chunk in column.chunks]
        return np.concatenate(parts) if parts else np.empty(0, dtype=object)
    result = np.empty(len(column), dtype=object)
    result[:] = ["" if value is None else str(value) for value in column.to_pylist()]
    return result


def _of_dictionary(chunk: Any) -> Cells:
    words = ["" if value is None else str(value) for value in chunk.dictionary.to_pylist()]
    index = chunk.indices.fill_null(len(words)).to_numpy(zero_copy_only=False)
    return np.asarray(np.array([*words, ""], dtype=object)[index])


def release_memory() -> None:
    """Give the memory of tables that are not needed any more back to the system: pyarrow keeps it for the next."""
    import pyarrow as pa

    pa.default_memory_pool().release_unused()


def _joined(parts: list[list[tuple[str, Cells]]]) -> list[tuple[str, Cells]]:
    """Equal columns of several files, concatenated."""
    if len(parts) == 1:
        return parts[0]
    joined = []
    for name in dict.fromkeys(name for part in parts for name, _ in part):
        own = [dict(part).get(name) for part in parts]
        text = any(cells is not None and cells.dtype == object for cells in own)
        missing: Any = "" if text else np.nan
        filled = [np.full(len(part[0][1]), missing) if c is None else c for c, part in zip(own, parts, strict=True)]
        joined.append((name, np.concatenate([_text(c) for c in filled] if text else filled)))
    return joined


def _text(cells: Cells) -> Cells:
    if cells.dtype == object:
        return cells
    return np.array(["" if value != value else str(value) for value in cells.tolist()], dtype=object)
