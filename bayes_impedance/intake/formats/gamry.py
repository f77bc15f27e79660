"""Gamry's text files (.DTA): the table of the spectrum, without those that the same experiment wrote before it.

A file holds settings and tables, each below a line of its name, the word TABLE and perhaps a number of rows; the rows
of a table begin with a tab. Before the spectrum, ``ZCURVE``, an open-circuit voltage is often recorded, ``OCVCURVE``,
which may have many more rows.
"""

from __future__ import annotations

import re

_BEGINNING = b"EXPLAIN"
_TABLE = re.compile(rb"ZCURVE\d*\tTABLE\b")


def spectrum_alone(data: bytes) -> bytes:
    """The text with empty lines in place of all that is not the spectrum; as it is, if it is of another kind.

    Parameters
    ----------
    data : bytes
        Of any text file. Rows keep their numbers.
    """
    if not data.startswith(_BEGINNING):
        return data
    lines = data.splitlines(keepends=True)
    inside, found = False, False
    kept = []
    for line in lines:
        named = _TABLE.match(line) is not None
        inside = named or (inside and line.startswith(b"\t"))
        found |= named
        kept.append(line if inside else b"\n")
    return b"".join(kept) if found else data
