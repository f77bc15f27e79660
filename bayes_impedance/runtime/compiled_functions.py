"""Compiled functions that numba keeps on disk, where it can and as long as they are whole.

numba writes what it has compiled beside the module, into the user's cache or into the folder that ``NUMBA_CACHE_DIR``
names. Where none of these can be written, it refuses to compile at all; here a temporary folder serves this process
and those that it starts. What numba has written it takes up without a check: a file that is damaged would end the
process, or give other numbers. Here every file ends with its digest, and one whose digest does not fit is as good as
none: the function is compiled anew.
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
    """Decorator like ``numba.njit(cache=True, **options)`` that works without a place to write, and with damaged files.

    Parameters
    ----------
    **options
        Of ``numba.njit``.
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
        return dispatcher

    return decorate


@cache
def _temporary_cache() -> str | None:
    """A folder for what is compiled, until this process ends; None if there is none either."""
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
        "no folder for compiled functions can be written: compiling into a temporary one, which takes longer; name a "
        "folder with %s",
        _FOLDER,
    )
    os.environ[_FOLDER] = folder
    setattr(config, "CACHE_DIR", folder)  # noqa: B010  (made at import)
    return folder


class _Sealed(_CacheFile):  # type: ignore[misc]
    """Files of numba's cache that end with a digest of what stands before it."""

    def save(self, key: Any, data: Any) -> None:
        """Keep what was compiled; a cache that cannot be written is not worth an error."""
        with suppress(OSError):
            super().save(key, data)

    def load(self, key: Any) -> Any:
        """What was compiled; None if it is not there or damaged."""
        try:
            return super().load(key)
        except Exception:  # written by another version of what is unpickled
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
