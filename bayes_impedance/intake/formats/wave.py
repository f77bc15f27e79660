"""Sound files (.wav, .flac) by soundfile: channels of samples; full scale is 1 unless the samples are floats."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents, Variable
from bayes_impedance.intake.formats.optional_libraries import damaged, library

_UNKNOWN = 0x7FFF0000
"""Sizes in a header from which it says nothing: programs that do not know the length yet write nearly 2 or 4 GB."""


def read(file: Path, record: str | None) -> list[Contents]:  # noqa: ARG001  (has no records)
    """Channels by number, ``channel 1`` first."""
    soundfile = library("soundfile", "soundfile", file)
    _require_whole(file)
    try:
        samples, rate = soundfile.read(file, dtype="float64", always_2d=True)
    except Exception as error:  # libsndfile's errors, and those of its wrapper
        raise damaged(file, "a sound file", error) from error
    variables = [
        Variable(name=f"channel {i + 1}", values=np.ascontiguousarray(column), rate_hz=float(rate))
        for i, column in enumerate(samples.T)
    ]
    return [Contents(file=str(file), variables=tuple(variables))]


def _require_whole(file: Path) -> None:
    """Refuse a .wav that is shorter than its header says, which libsndfile reads as far as it goes."""
    with file.open("rb") as stream:
        beginning = stream.read(8)
    order: dict[bytes, Literal["little", "big"]] = {b"RIFF": "little", b"RIFX": "big"}
    if beginning[:4] not in order:
        return
    expected = int.from_bytes(beginning[4:8], order[beginning[:4]])
    # The header does not count its first eight bytes, and some programs forget the byte that fills up an odd number.
    missing = expected + 8 - file.stat().st_size
    if missing > 1 and expected < _UNKNOWN:
        raise InputError(
            f"{file}: {missing} of the {expected + 8} bytes that its header says are missing: the file is cut short; "
            "export or copy it again"
        )
