"""Compiled functions cached on disk by numba, with a fallback folder and an integrity check.

numba writes compiled functions beside the module, into the user's cache or into the folder given by
``NUMBA_CACHE_DIR``. If none of these is writable, it refuses to compile; here a temporary folder is then used by this
process and its child processes. numba loads its files without a check: a damaged file could end the process or give
wrong numbers. Here every file ends with its digest, and a file with a wrong digest is ignored: the function is compiled
again.

numba compiles a function again if its own source file has changed, but not if a function or a constant of another file
that is compiled into it has. Here the stamp of a function therefore holds theirs as well.
"""

from __future__ import annotations

import atexit
import hashlib
import io
import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any

import numba
from numba.core import caching, config

_DIGEST_BYTES = hashlib.sha256().digest_size
_CacheFile: Any = caching.IndexDataCacheFile  # numba's types are not annotated
_FOLDER = "NUMBA_CACHE_DIR"


def kept_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator like ``numba.njit(cache=True, **options)`` that tolerates unwritable folders and damaged files.

    Parameters
    ----------
    **options
        Options of ``numba.njit``.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            dispatcher = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # numba has found no folder that it can write to
            if _temporary_cache() is None:
                return numba.njit(**options)(function)
            dispatcher = numba.njit(cache=True, **options)(function)
        files = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
        if isinstance(files, _CacheFile):
            files.__class__ = _Sealed
            files._source_stamp = (files._source_stamp, _compiled_in(function))
        return dispatcher

    return decorate


def _compiled_in(function: Callable[..., Any]) -> tuple[Any, ...]:
    """Stamps of the compiled functions and the numbers that a function takes from its module's names."""
    stamps: list[tuple[str, Any]] = []
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, bool | int | float | str | tuple):
            stamps.append((name, value))
        elif hasattr(value, "py_func"):
            file = getattr(getattr(value, "_cache", None), "_cache_file", None)
            stamps.append((name, getattr(file, "_source_stamp", None)))
    return tuple(stamps)


@cache
def _temporary_cache() -> str | None:
    """A cache folder that lives until this process ends; None if it cannot be created."""
    try:
        folder = tempfile.mkdtemp(prefix="bayes_impedance-numba-")
    except OSError:
        return None
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    logging.getLogger(__name__).warning(
        "no folder for compiled functions is writable: they are compiled into a temporary one, which takes longer; "
        "name a folder with %s",
        _FOLDER,
    )
    os.environ[_FOLDER] = folder
    setattr(config, "CACHE_DIR", folder)  # noqa: B010  (made at import)
    return folder


class _Sealed(_CacheFile):  # type: ignore[misc]
    """Files of numba's cache that end with a digest of their content."""

    def save(self, key: Any, data: Any) -> None:
        """Save compiled code; a cache that cannot be written is no error."""
        with suppress(OSError):
            super().save(key, data)

    def load(self, key: Any) -> Any:
        """Load compiled code; None if it is missing or damaged."""
        try:
            return super().load(key)
        except Exception:  # pickled by another version of its classes
            return None

    def _load_index(self) -> Any:
        return super()._load_index() if _is_whole(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        if not _is_whole(path):
            raise FileNotFoundError(path)
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(content.getvalue())
            file.write(hashlib.sha256(content.getvalue()).digest())


def _is_whole(path: str) -> bool:
    try:
        with open(path, "rb") as file:
            content = file.read()
    except OSError:
        return False
    return hashlib.sha256(content[:-_DIGEST_BYTES]).digest() == content[-_DIGEST_BYTES:]
