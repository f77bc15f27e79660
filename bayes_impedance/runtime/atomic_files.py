"""Named arrays in a file that is complete or absent, whenever the process is killed."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


def save_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays to a temporary name and change it; what is there is replaced."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(file.name + ".tmp")
    with temporary.open("wb") as opened:
        np.savez(opened, **arrays)
    temporary.replace(file)


def load_arrays(file: Path) -> dict[str, np.ndarray] | None:
    """What `save_arrays` has written; None if there is no file or it is damaged."""
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile):
        return None
