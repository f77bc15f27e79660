"""MATLAB files: version 5 to 7.2 by SciPy, 7.3 (HDF5) by h5py."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.array_variables import named_arrays
from bayes_impedance.intake.formats.optional_libraries import damaged

_MAGIC = b"\x89HDF"
_HDF5_OFFSETS = (0, 512)
"""Where an HDF5 file begins: MATLAB puts a header of 512 bytes before it."""


def read(file: Path, record: str | None) -> list[Contents]:
    """All arrays of numbers, also those inside structures (``record`` names one structure)."""
    with file.open("rb") as stream:
        head = stream.read(_HDF5_OFFSETS[-1] + len(_MAGIC))
    is_hdf5 = any(head[k : k + len(_MAGIC)] == _MAGIC for k in _HDF5_OFFSETS)
    arrays = _version_73(file) if is_hdf5 else _version_5(file)
    if record is not None:
        arrays = {k.removeprefix(f"{record}."): v for k, v in arrays.items() if k.startswith(f"{record}.")}
    variables = named_arrays(arrays)
    if not variables:
        raise InputError(f"{file}: there are no arrays of numbers in it; save them as plain variables")
    return [Contents(file=str(file), variables=tuple(variables), facts={})]


def _version_5(file: Path) -> dict[str, np.ndarray]:
    import scipy.io

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about entries that are no arrays, which are left out
            content = scipy.io.loadmat(file)
    except Exception as error:  # SciPy raises many kinds of errors on damaged files
        raise damaged(file, "a MATLAB file", error) from error
    found: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            _add(name, value, found)
    return found


def _add(name: str, value: Any, found: dict[str, np.ndarray]) -> None:
    """Arrays of numbers; of structures, their fields."""
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.kind in "iufc":
        found[name] = value
    elif value.dtype.names and value.size == 1 and type(value).__name__ == "ndarray":
        for key in value.dtype.names:
            _add(f"{name}.{key}", value.flat[0][key], found)


def _version_73(file: Path) -> dict[str, np.ndarray]:
    import h5py

    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#refs#"):
            return
        if item.dtype.names == ("real", "imag"):
            pair = item[()]
            found[name.replace("/", ".")] = (pair["real"] + 1j * pair["imag"]).T
        elif item.dtype.kind in "iuf" and item.attrs.get("MATLAB_class", b"double") != b"char":
            found[name.replace("/", ".")] = np.asarray(item[()]).T

    try:
        with h5py.File(file, "r") as content:
            content.visititems(visit)
    except Exception as error:  # h5py raises OSError, KeyError and RuntimeError on damaged files
        raise damaged(file, "a MATLAB 7.3 file", error) from error
    return found
