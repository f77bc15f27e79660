"""Files from users: read within size limits as bytes, text, TOML or JSON, or refused with one sentence.

The cost of refusing any file is bounded: compressed content is unpacked only up to a limit, and nesting that is too
deep or numbers with too many digits for the standard library's parsers are reported as faults of the file.
"""

from __future__ import annotations

import json
import re
import tomllib
import zlib
from pathlib import Path
from typing import Any

from bayes_impedance.errors import InputError

LARGEST_TABLE = 256 * 2**20
"""Bytes of a table, uncompressed: five million rows of 50 characters. As cells of text they take ten times the memory;
what is larger belongs into Parquet, parted by subject, which is read part by part."""
LARGEST_DESCRIPTION = 2**20
"""Bytes of a TOML file: a description of ten thousand lines. The shipped ones have less than a hundredth; the parser of
TOML reads a megabyte a second."""
LARGEST_JSON = 2**23
"""Bytes of a JSON file: a summary with several findings for each of thousands of subjects. Its parser reads tens of
megabytes a second."""

_GZIP_MAGIC = b"\x1f\x8b"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_CHUNK = 2**20
"""Bytes unpacked at a time. By choice: the limit can be exceeded by no more than this."""
_GZIP_WINDOW = 31
"""zlib's `wbits`: the largest window (15) in a gzip container (16)."""


def read_bytes(path: Path, largest: int = LARGEST_TABLE) -> bytes:
    """Return the content of a file, uncompressed if it is a gzip file.

    Parameters
    ----------
    path : Path
        File to read; gzip is recognised by its content, not by its name.
    largest : int
        Largest uncompressed content in bytes; no more are read or unpacked.

    Returns
    -------
    bytes
        Uncompressed content.

    Raises
    ------
    InputError
        If the file cannot be opened, is too large, or its gzip stream is damaged.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(largest + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its name and permissions") from error
    if len(data) <= largest and data.startswith(_GZIP_MAGIC):
        try:
            unpacked = _unpacked(data, largest)
        except (EOFError, zlib.error) as error:
            raise InputError(f"{path}: the gzip file is damaged or cut short; copy or compress it again") from error
    else:
        unpacked = data if len(data) <= largest else None
    if unpacked is None:
        raise InputError(
            f"{path}: the content is larger than {largest / 2**20:g} MiB, more than is read from one file of this "
            "kind; check that it is the right file, and give very large recordings as Parquet, parted by subject"
        )
    return unpacked


def _unpacked(data: bytes, largest: int) -> bytes | None:
    """Content of a gzip file of one or more members; None as soon as it is larger than allowed."""
    parts: list[bytes] = []
    size = 0
    while data.startswith(_GZIP_MAGIC):
        member = zlib.decompressobj(wbits=_GZIP_WINDOW)
        while not member.eof:
            part = member.decompress(data, _CHUNK)
            data = member.unconsumed_tail
            if not part and not data and not member.eof:
                raise EOFError
            parts.append(part)
            size += len(part)
            if size > largest:
                return None
        # Zeros may follow the last member: some programs pad their blocks.
        data = member.unused_data.lstrip(b"\0")
    if data:
        raise zlib.error("the data after the last member are not gzip")
    return b"".join(parts)


def decode(data: bytes, file: str) -> str:
    """Return UTF-8 text (a byte order mark is removed).

    Raises
    ------
    InputError
        If the bytes are not text, or text in another encoding than UTF-8.
    """
    remedy = 'save it as UTF-8 (in a spreadsheet: "CSV UTF-8")'
    if data.startswith(_UTF16_MARKS):
        raise InputError(f"{file}: the text is UTF-16 and not UTF-8; {remedy}")
    if b"\0" in data:
        raise InputError(f"{file}: this is a binary file and not text; export the data as CSV (UTF-8)")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{file}, row {row}: the text is not UTF-8 (byte 0x{data[error.start]:02x}); {remedy}"
        ) from error


def read_toml(path: Path, wanted: str) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path : Path
    wanted : str
        What the file should be, for messages: ``"a device"``.

    Raises
    ------
    InputError
        If there is no such file, or it is not TOML.
    """
    data = _described(path, f"give {wanted} as TOML", LARGEST_DESCRIPTION)
    return parse_toml(decode(data, str(path)), str(path))


def read_json(path: Path, remedy: str) -> dict[str, Any]:
    """Read a JSON object, from a user or written by this package and perhaps damaged since.

    Parameters
    ----------
    path : Path
    remedy : str
        Remedy at the end of the error message: ``"fit the recordings again"``.

    Raises
    ------
    InputError
        If there is no such file, or it is not a JSON object.
    """
    data = _described(path, remedy, LARGEST_JSON)
    try:
        content = json.loads(data.decode("utf-8-sig"), parse_constant=_not_a_number)
    except RecursionError:
        reason = "it is nested too deeply"
    except UnicodeDecodeError:
        reason = "it is not UTF-8 text"
    except ValueError as error:
        reason = _reason(error)
    else:
        if isinstance(content, dict):
            return content
        reason = "it contains no object"
    raise InputError(f"{path}: cannot be read as JSON ({reason}); {remedy}")


def _not_a_number(text: str) -> float:
    raise ValueError(f"{text} is not a number in JSON")


def _described(path: Path, remedy: str, largest: int) -> bytes:
    if not path.exists():
        raise InputError(f"{path}: there is no such file; {remedy}")
    return read_bytes(path, largest)


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """Parse TOML text.

    Raises
    ------
    InputError
        If it is not TOML, is nested too deeply, or has an integer that cannot be read.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{file}: the TOML is nested too deeply to be read; use fewer levels") from None
    except ValueError as error:  # also integers of thousands of digits, which are grammatically valid
        raise InputError(f'{file}: {_toml_problem(_reason(error))}; correct it, e.g. title = "My data"') from None


def _reason(error: ValueError) -> str:
    text = str(error)
    return "an integer has thousands of digits" if "integer string conversion" in text else text


def _toml_problem(message: str) -> str:
    """Rewrite "Something (at line 3, column 5)" as "line 3 is not valid TOML (something)"."""
    match = re.fullmatch(r"(.*) \(at (line \d+), column \d+\)", message, flags=re.DOTALL)
    if match is not None:
        return f"{match[2]} is not valid TOML ({match[1]})"
    # The decoder reports errors at the end of the file without a line.
    where = "the last line is" if "end of document" in message else "it is"
    return f"{where} not valid TOML ({message})"


def line_of(text: str, key: str) -> int:
    """Return the line (from 1) of a TOML text that sets a key; 1 where it cannot be found."""
    match = re.search(rf'^[ \t]*\[*["\']?{re.escape(key)}(?!\w)', text, flags=re.MULTILINE)
    return text.count("\n", 0, match.start()) + 1 if match else 1
