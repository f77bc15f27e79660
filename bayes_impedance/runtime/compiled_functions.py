"""Compiled functions cached on disk by numba, where another installation finds them, with an integrity check.

numba writes compiled functions beside the module, into the user's cache or into the folder given by
``NUMBA_CACHE_DIR``. What lies beside a module is lost when the package is installed again or elsewhere. Here they are
written into the folder given, or else into a folder of the package in the user's cache, under a name that holds a
digest of the sources; if that cannot be written, where numba writes them. If none of numba's folders is writable, it
refuses to compile; a temporary folder is then used by this process and its child processes. numba loads its files
without a check: a damaged file could end the process or give wrong numbers. Here every file ends with its digest, and
a file with a wrong digest is ignored: the function is compiled again.

numba compiles a function again if its own source file has changed, but not if a function or a constant of another file
that is compiled into it has. Here the stamp of a function therefore holds theirs as well. It is made of the sources'
content, not of their time, which is another one after each installation.
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
import numpy as np
from numba.core import caching, config
from numba.misc.appdirs import user_cache_dir

_DIGEST_BYTES = hashlib.sha256().digest_size
_CacheFile: Any = caching.IndexDataCacheFile  # numba's types are not annotated
_FOLDER = "NUMBA_CACHE_DIR"
_NAME_DIGITS = 16
"""Digits of the digest in a file's name: 64 bits, by which no two sources are confused by chance."""


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
            files._source_stamp = (_content(function.__code__.co_filename), _compiled_in(function))
            folder = None if os.environ.get(_FOLDER) else _user_cache()
            if folder is not None:
                files.move(folder)
        return dispatcher

    return decorate


def _compiled_in(function: Callable[..., Any]) -> tuple[Any, ...]:
    """Stamps of the compiled functions and the numbers that a function takes from its module's names."""
    stamps: list[tuple[str, Any]] = []
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, bool | int | float | str | tuple | np.generic):
            stamps.append((name, value))
        elif hasattr(value, "py_func"):
            file = getattr(getattr(value, "_cache", None), "_cache_file", None)
            stamps.append((name, getattr(file, "_source_stamp", None)))
    return tuple(stamps)


@cache
def _content(file: str) -> str:
    """Digest of a source file."""
    try:
        with open(file, "rb") as source:
            return hashlib.sha256(source.read()).hexdigest()
    except OSError:  # typed into an interpreter, or read from an archive
        return file


@cache
def _user_cache() -> str | None:
    """The package's folder in the user's cache, made if need be; None if it cannot be written to."""
    folder = str(user_cache_dir("bayes_impedance", False))  # type: ignore[no-untyped-call]
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)  # who can write there can run code as the user
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


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

    def move(self, folder: str) -> None:
        """Keep the files in a folder where those of other sources and of other versions of numba lie as well."""
        digest = hashlib.sha256(repr((self._source_stamp, self._version)).encode()).hexdigest()[:_NAME_DIGITS]
        index, data = f"{digest}-{self._index_name}", f"{digest}-{self._data_name_pattern}"  # type: ignore[has-type]
        self._cache_path, self._index_name, self._data_name_pattern = folder, index, data
        self._index_path = os.path.join(folder, index)

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
