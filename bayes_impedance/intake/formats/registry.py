"""Which reader a file needs: by its suffix, and text if no other is known."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.gamry import spectrum_alone
from bayes_impedance.intake.text_tables import TableFormat, read_text_table
from bayes_impedance.runtime.input_files import read_bytes

Reader = Callable[[Path, str | None], list[Contents]]

_READERS = {
    ".xlsx": "spreadsheet",
    ".xlsm": "spreadsheet",
    ".mat": "matlab",
    ".npz": "numpy_archive",
    ".npy": "numpy_archive",
    ".uff": "universal_file",
    ".unv": "universal_file",
    ".s1p": "touchstone",
    ".lvm": "labview",
    ".wav": "wave",
    ".flac": "wave",
    ".tdms": "tdms",
}
"""Module of each suffix; its function is ``read``. Imported when needed: most bring a library."""
_NOT_READ = {".xls": "an old Excel file: save it as .xlsx", ".zip": "an archive: unpack it", ".pdf": "no data"}


def read_file(file: Path, how: TableFormat, record: str | None = None) -> list[Contents]:
    """Contents of a file, one for each of its records.

    Parameters
    ----------
    file : Path
    how : TableFormat
        Of tables of text.
    record : str or None
        Name of the sheet, group or record to use; None for all, or the first sheet.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or the library that reads it is not installed.
    """
    if not file.exists():
        raise InputError(f"{file}: there is no such file; check the path")
    suffix = file.suffix.lower()
    if suffix in _NOT_READ:
        raise InputError(f"{file}: this is {_NOT_READ[suffix]}")
    if suffix in _READERS:
        if file.stat().st_size == 0:
            raise InputError(f"{file}: the file is empty; copy it again")
        reader: Reader = import_module(f"bayes_impedance.intake.formats.{_READERS[suffix]}").read
        return reader(file, record)
    return [read_text_table(spectrum_alone(read_bytes(file)), str(file), how)]


def files_of(source: Path) -> list[Path]:
    """The files of a source: itself, or all files of a folder that are not hidden, in the order of their names.

    Raises
    ------
    InputError
        If there is no such file, or the folder has none.
    """
    if not source.exists():
        raise InputError(f"{source}: there is no such file or folder; check the path")
    if not source.is_dir():
        return [source]
    found = sorted(p for p in source.rglob("*") if p.is_file() and not _is_hidden(p.relative_to(source)))
    if not found:
        raise InputError(f"{source}: the folder has no files; name another one")
    return found


def _is_hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)
