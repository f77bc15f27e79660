"""A measured ratio over frequency, with its noise: what all estimators from signals return."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False, kw_only=True)
class Ratio:
    """Motion over force, or force over motion, at some lines.

    Attributes
    ----------
    frequency_hz : ndarray of float, shape (F,)
        Above zero, ascending.
    value : ndarray of complex, shape (F,)
    inverse : bool
        Whether it is motion over force (as an accelerance), else force over motion (as an apparent mass).
    noise_sd : ndarray of float, shape (F,), or None
        Standard deviation of each of real and imaginary part; None if one recording does not give it.
    degrees_of_freedom : float or None
        Real degrees of freedom of `noise_sd`.
    coherence : ndarray of float, shape (F,), or None
    facts : dict of str to float
        What is noted of the recording.
    notes : tuple of str
        What was found out, in sentences.
    """

    frequency_hz: FloatArray
    value: ComplexArray
    inverse: bool
    noise_sd: FloatArray | None = None
    degrees_of_freedom: float | None = None
    coherence: FloatArray | None = None
    facts: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
