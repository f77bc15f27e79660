"""Many people's elements as a Parquet file: one row for each, written a few thousand people at a time.

`result.nc` holds draws of everybody, and its readers load all of it. Where people are many a table with a median and an
interval for each is what one wants to join with other tables, and programs for large tables read Parquet in parts.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.results.tables import persons_table
from bayes_impedance.runtime.atomic_files import replacing

if TYPE_CHECKING:
    from bayes_impedance.results.result import Result

PERSONS_FILE = "persons.parquet"

MANY = 1000
"""Number of people from which the file is written. By choice: below it `export` writes a CSV file in no time, and a
folder of a result holds no more files than are needed."""

_AT_ONCE = 1000
"""People in one group of rows. By choice: 400 draws of their eight elements are 26 MB beside the result."""


def write_persons(result: Result, folder: Path) -> Path | None:
    """Write the table of people with intervals, if they are many and pyarrow is there; else remove that of another fit.

    Parameters
    ----------
    result : Result
    folder : Path

    Returns
    -------
    Path or None
        The file; None if people are few or pyarrow is not installed.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    n = len(result.coords["subject"])
    if n < MANY or find_spec("pyarrow") is None:
        (folder / PERSONS_FILE).unlink(missing_ok=True)  # beside another result it would be wrong
        return None
    import pyarrow as pa
    import pyarrow.parquet as pq

    file, writer = folder / PERSONS_FILE, None
    with replacing(file) as temporary:
        try:
            for start in range(0, n, _AT_ONCE):
                frame = persons_table(result, True, slice(start, start + _AT_ONCE))
                units: dict[str, Any] = frame.attrs.pop("units")
                table = pa.table(
                    {"subject": frame.index.to_numpy(dtype=str), **{c: np.asarray(frame[c]) for c in frame}}
                )
                fields = [f.with_metadata({"unit": units[f.name]}) if f.name in units else f for f in table.schema]
                table = table.cast(pa.schema(fields))
                if writer is None:
                    writer = pq.ParquetWriter(temporary, table.schema)
                writer.write_table(table)
        finally:
            if writer is not None:
                writer.close()
    return file
