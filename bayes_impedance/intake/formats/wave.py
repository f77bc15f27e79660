"""Sound files (.wav, .flac) by soundfile: channels of samples; full scale is 1 unless the samples are floats."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_impedance.intake.contents import Contents, Variable
from bayes_impedance.intake.formats.optional_libraries import damaged, library


def read(file: Path, record: str | None) -> list[Contents]:  # noqa: ARG001  (has no records)
    """Channels by number, ``channel 1`` first."""
    soundfile = library("soundfile", "soundfile", file)
    try:
        samples, rate = soundfile.read(file, dtype="float64", always_2d=True)
    except Exception as error:  # libsndfile's errors, and those of its wrapper
        raise damaged(file, "a sound file", error) from error
    variables = [
        Variable(name=f"channel {i + 1}", values=np.ascontiguousarray(column), rate_hz=float(rate))
        for i, column in enumerate(samples.T)
    ]
    return [Contents(file=str(file), variables=tuple(variables))]
