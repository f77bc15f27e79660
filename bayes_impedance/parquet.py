"""Recordings as Parquet, one file or a folder of partitions, as the same table that a CSV file holds."""

from __future__ import annotations

from pathlib import Path

from bayes_impedance.errors import InputError

SUFFIX = ".parquet"


def parquet_as_csv(path: Path) -> bytes:
    """The table as CSV: numbers to the last digit, rows in the order of the files' names, so that checks name rows.

    Parameters
    ----------
    path : Path
        File, or folder of files, partitioned in the manner of Hive (``subject=A/part-0.parquet``) or not at all.

    Raises
    ------
    InputError
        If pyarrow is not installed or the table cannot be read.
    """
    import pandas as pd

    try:
        import pyarrow as pa
    except ImportError:
        raise InputError(
            f'{path}: Parquet needs the package pyarrow: pip install "bayes_impedance[parquet]", or give CSV'
        ) from None
    try:
        frame = pd.read_parquet(path, engine="pyarrow")
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as Parquet ({str(error).splitlines()[0]}); write it anew") from None
    return frame.to_csv(index=False, lineterminator="\n").encode()
