"""Libraries that only some kinds of files need: imported when such a file is read."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from bayes_impedance.errors import InputError


def library(name: str, package: str, file: Path) -> Any:
    """A module of the extra ``intake``.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        raise InputError(
            f"{file}: files of this kind need the library {package}; install it: pip install 'bayes_impedance[intake]'"
        ) from None


def damaged(file: Path, kind: str, error: Exception) -> InputError:
    """The refusal of a file that its library cannot read."""
    reason = " ".join(str(error).split())[:100] or type(error).__name__
    return InputError(f"{file}: cannot be read as {kind} ({reason}); it is damaged or of another kind: export it again")
