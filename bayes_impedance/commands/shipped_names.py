"""Names of shipped datasets in place of paths; a file or folder of that name comes first."""

from __future__ import annotations

from pathlib import Path

from bayes_impedance.datasets import SHIPPED, folder_of
from bayes_impedance.datasets.shipped import POPULATION


def dataset_path(text: str) -> Path:
    """Folder of recordings: a path, or the name of a shipped dataset."""
    path = Path(text)
    return folder_of(text) if text in SHIPPED and not path.exists() else path


def result_path(text: str) -> Path:
    """Folder of a finished fit: a path, or the name of a shipped dataset that has one."""
    path = Path(text)
    if text in SHIPPED and not path.exists() and (folder_of(text) / POPULATION).is_dir():
        return folder_of(text) / POPULATION
    return path
