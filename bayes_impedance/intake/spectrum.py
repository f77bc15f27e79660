"""One recording on its way into a dataset: impedance over frequency with what is known of its noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


SAME_FREQUENCY = 1e-6
"""Relative. By choice: instruments write six digits or more, and no two lines of a spectrum are as close."""

FREQUENCY_UNIT, QUANTITY = "frequency unit", "quantity"
"""What may be assumed of a recording: hertz, and an impedance because a name has the letter Z."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectrum:
    """Impedance of one subject and repetition.

    Attributes
    ----------
    subject, repetition : str
        The repetition is empty where no file says it.
    frequency_hz : ndarray of float, shape (F,)
        Ascending, above zero.
    z : ndarray of complex, shape (F,)
        In `unit`.
    unit : str
        SI unit of an impedance.
    source : str
        The file.
    noise_sd : ndarray of float, shape (F,), or None
        Standard deviation of each of real and imaginary part, in `unit`.
    degrees_of_freedom : float or None
        Real degrees of freedom of `noise_sd`: those of the chi-square distribution of its square.
    coherence : ndarray of float, shape (F,), or None
    calibration_sd : ndarray of float, shape (F, 2), or None
        Standard deviation of real and imaginary part from the error of a calibration. It is the same error in all
        recordings that the calibration corrects, and no part of `noise_sd`.
    facts : dict of str to str or float
        What is noted of the repetition.
    frequency_tolerance : float
        Relative difference of what is one frequency in two repetitions.
    downwards : bool
        Whether the file goes from the highest frequency to the lowest.
    samples : int or None
        Length of the signals that it was estimated of, if they are one record.
    assumed : frozenset of str
        Of :data:`FREQUENCY_UNIT` and :data:`QUANTITY`, what neither the file nor an option says.
    """

    subject: str
    repetition: str
    frequency_hz: FloatArray
    z: ComplexArray
    unit: str
    source: str
    noise_sd: FloatArray | None = None
    degrees_of_freedom: float | None = None
    coherence: FloatArray | None = None
    calibration_sd: FloatArray | None = None
    facts: dict[str, str | float] = field(default_factory=dict)
    frequency_tolerance: float = SAME_FREQUENCY
    downwards: bool = False
    samples: int | None = None
    assumed: frozenset[str] = frozenset()
