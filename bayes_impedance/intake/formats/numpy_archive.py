"""NumPy files: .npz with named arrays, .npy with one structured array or a matrix; never pickled objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.array_variables import named_arrays
from bayes_impedance.intake.formats.optional_libraries import damaged

_ZIP, _NPY = b"PK", b"\x93NUMPY"
"""First bytes of .npz and of .npy."""


def read(file: Path, record: str | None) -> list[Contents]:
    """All arrays of numbers."""
    arrays: dict[str, np.ndarray] = {}
    with file.open("rb") as stream:
        if not stream.read(len(_NPY)).startswith((_ZIP, _NPY)):  # NumPy would take it for objects that it may not load
            raise damaged(file, "a NumPy file", ValueError("it does not begin as one"))
    try:
        with file.open("rb") as stream:  # np.load leaves a file open that it cannot read
            content = np.load(stream, allow_pickle=False)
            if isinstance(content, np.ndarray):
                named = content.dtype.names
                arrays = {name: content[name] for name in named} if named else {"column": content}
            else:
                arrays = {name: content[name] for name in content.files}
    except Exception as error:  # zip, header and pickle each raise their own
        raise damaged(file, "a NumPy file", error) from error
    numeric = {name: array for name, array in arrays.items() if array.dtype.kind in "iufc"}
    variables = named_arrays(numeric if record is None else {k: v for k, v in numeric.items() if k == record})
    if not variables:
        raise InputError(f"{file}: there are no arrays of numbers in it; save frequency and values by name with savez")
    return [Contents(file=str(file), variables=tuple(variables))]
