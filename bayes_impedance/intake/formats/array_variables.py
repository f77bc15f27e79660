"""Arrays with names as variables: columns of matrices one by one, single numbers as facts about the sampling."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_impedance.intake.contents import Variable

MOST_COLUMNS = 64
"""Most columns of a matrix taken as variables. By choice: analysers have fewer channels, and more are a picture."""
_RATES = ("fs", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency", "timesamplerate", "ratehz")
_STEPS = ("dt", "ts", "sampletime", "deltat")


def named_arrays(arrays: Mapping[str, np.ndarray]) -> list[Variable]:
    """Variables of arrays of at least two numbers; a matrix of N rows and k columns gives ``name 1`` to ``name k``.

    A single number named as a sampling rate or step (``fs``, ``dt``, ...) becomes the rate of all variables.
    """
    rate = sampling_rate(arrays)
    found = []
    for name, array in arrays.items():
        squeezed = np.squeeze(np.asarray(array))
        if squeezed.ndim == 1 and squeezed.size > 1:
            found.append(Variable(name=name, values=_numbers(squeezed), rate_hz=rate))
        elif squeezed.ndim == 2:
            # The longer side is time or frequency.
            columns = squeezed if squeezed.shape[0] >= squeezed.shape[1] else squeezed.T
            if columns.shape[1] <= MOST_COLUMNS:
                found += [
                    Variable(name=f"{name} {i + 1}", values=_numbers(column), rate_hz=rate)
                    for i, column in enumerate(columns.T)
                ]
    return found


def sampling_rate(arrays: Mapping[str, np.ndarray]) -> float | None:
    """Sampling rate in Hz, if exactly one single number is named as one."""
    rates = set()
    for name, array in arrays.items():
        plain = "".join(c for c in name.rpartition(".")[2].lower() if c.isalnum())
        if np.size(array) == 1 and np.isrealobj(array):
            value = float(np.asarray(array).flat[0])
            if plain in _RATES and value > 0:
                rates.add(value)
            elif plain in _STEPS and value > 0:
                rates.add(1 / value)
    return rates.pop() if len(rates) == 1 else None


def _numbers(values: np.ndarray) -> np.ndarray:
    return values.astype(np.complex128 if np.iscomplexobj(values) else np.float64)
