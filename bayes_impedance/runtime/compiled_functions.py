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

**Calls by address.** numba puts the code of every function that is called into that of its caller, optimises it there
once more and writes it out once more. The kernel is called by a dozen functions, some of which call each other: most of
the compiled code, of the time to compile it and of the memory for it was copies of the kernel. A function named by
:func:`by_address` is compiled once; its callers hold a symbol in its place. A symbol must be known before code that
holds it is loaded: a function's file is loaded after the functions that it calls by address.
"""

from __future__ import annotations

import atexit
import hashlib
import inspect
import io
import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import llvmlite.binding
import numba
import numpy as np
from numba.core import caching, cgutils, config, imputils, types
from numba.extending import intrinsic
from numba.misc.appdirs import user_cache_dir

_DIGEST_BYTES = hashlib.sha256().digest_size
_CacheFile: Any = caching.IndexDataCacheFile  # numba's types are not annotated
_codegen: Any = cgutils
_results: Any = imputils
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
    options = {"no_cfunc_wrapper": True} | options  # C does not call them

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
            files._elsewhere = _elsewhere(function)
            folder = None if os.environ.get(_FOLDER) else _user_cache()
            if folder is not None:
                files.move(folder)
        return dispatcher

    return decorate


@dataclass(eq=False)
class _Elsewhere:
    """A function that is called by address: its dispatcher, the types of its arguments, and the symbol of its code."""

    dispatcher: Any
    arguments: tuple[Any, ...]
    symbol: str
    result: Any = field(default=None)

    def ready(self) -> Any:
        """What numba has compiled or loaded, of which the symbol is known from now on."""
        if self.result is None:
            self.dispatcher.compile(self.arguments)
            result = self.dispatcher.overloads[self.arguments]
            address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
            llvmlite.binding.add_symbol(self.symbol, address)
            self.result = result
        return self.result


_BY_ADDRESS: dict[Any, _Elsewhere] = {}
"""What stands in for a function in its callers' code, and the function."""


def by_address(dispatcher: Any, arguments: Sequence[Any]) -> Any:
    """A compiled function under another name, by which compiled functions call it without taking its code.

    Parameters
    ----------
    dispatcher : numba dispatcher
        Made by :func:`kept_njit`.
    arguments : sequence of numba types
        Arguments of other types are accepted as well: with them it is called as any other function.
    """
    wanted = tuple(arguments)
    python = dispatcher.py_func
    named = (python.__module__, python.__qualname__, _stamp(dispatcher), wanted)
    digest = hashlib.sha256(repr(named).encode()).hexdigest()[:_NAME_DIGITS]
    one = _Elsewhere(dispatcher, wanted, f"bayes_impedance.{python.__name__}.{digest}")

    def definition(typing: Any, *given: Any) -> Any:
        if given != wanted:
            kind = types.Dispatcher(dispatcher)
            signature = kind.get_call_type(typing, given, {})

            def as_any_other(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                return context.get_function(kind, signature)(builder, values)

            return signature, as_any_other

        def apart(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            convention, types_of = context.call_conv, (signature.return_type, signature.args)
            function = _codegen.get_or_insert_function(
                builder.module, convention.get_function_type(*types_of), one.symbol
            )
            status, value = convention.call_function(builder, function, *types_of, values)
            with _codegen.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return _results.impl_ret_new_ref(context, builder, signature.return_type, value)

        return one.ready().signature, apart

    own = inspect.signature(python)
    names = [inspect.Parameter("typing", inspect.Parameter.POSITIONAL_OR_KEYWORD), *own.parameters.values()]
    definition.__signature__ = own.replace(parameters=names)  # type: ignore[attr-defined]  # numba reads it
    call = intrinsic(definition)
    _BY_ADDRESS[call] = one
    return call


def _elsewhere(function: Callable[..., Any]) -> tuple[_Elsewhere, ...]:
    """Functions that a function, or one whose code is put into its own, calls by address."""
    found: dict[_Elsewhere, None] = {}
    for name in function.__code__.co_names:
        value: Any = function.__globals__.get(name)
        if _is_stand_in(value):
            found[_BY_ADDRESS[value]] = None
        elif hasattr(value, "py_func"):
            found.update(dict.fromkeys(_elsewhere(value.py_func)))
    return tuple(found)


def _is_stand_in(value: Any) -> bool:
    return any(value is known for known in _BY_ADDRESS)


def _stamp(dispatcher: Any) -> Any:
    return getattr(getattr(getattr(dispatcher, "_cache", None), "_cache_file", None), "_source_stamp", None)


def _compiled_in(function: Callable[..., Any]) -> tuple[Any, ...]:
    """Stamps of the compiled functions and the numbers that a function takes from its module's names."""
    stamps: list[tuple[str, Any]] = []
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, bool | int | float | str | tuple | np.generic):
            stamps.append((name, value))
        elif _is_stand_in(value):
            stamps.append((name, _BY_ADDRESS[value].symbol))
        elif hasattr(value, "py_func"):
            stamps.append((name, _stamp(value)))
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
        for one in self._elsewhere:
            one.ready()
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
