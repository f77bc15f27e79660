r"""Errors of a model curve relative to the measured curves: the paper's eq. 5 and related measures.

.. math:: \Delta_{m,A}(f) = \frac1n\sum_i \bigl|\,|z_\text{model}(f)| - |z_i(f)|\,\bigr|, \qquad
          \Delta_{m,P}(f) = \frac1n\sum_i \bigl|\arg z_\text{model}(f) - \arg z_i(f)\bigr|

(the square root of the square in eq. 5 is the absolute value), then mean and standard deviation over frequency as in
fig. 4. Among all single curves the pointwise **median** of the magnitudes has the least :math:`\Delta_{m,A}`, by the
definition of the median: the look-up table of medians is a lower bound for every network, not a competing model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.recordings.files import Recordings

_FALLBACK_POINTS = 200
"""Frequencies of the logarithmic grid used if the subjects' grids differ. By choice: 67 per decade over the paper's
three decades, finer than the structure of the curves."""


@dataclass(frozen=True, repr=False)
class ErrorCurves(Brief):
    """Eq. 5 over frequency for one model curve.

    Attributes
    ----------
    magnitude : ndarray, shape (F,)
        In the unit of the impedance.
    phase_deg : ndarray, shape (F,)
    """

    magnitude: np.ndarray
    phase_deg: np.ndarray

    def summary(self) -> dict[str, float]:
        """Mean and standard deviation over frequency, as in the paper's fig. 4."""
        return {
            "delta_magnitude": float(np.nanmean(self.magnitude)),
            "delta_magnitude_sd": float(np.nanstd(self.magnitude)),
            "delta_phase_deg": float(np.nanmean(self.phase_deg)),
            "delta_phase_deg_sd": float(np.nanstd(self.phase_deg)),
        }


def common_grid(recordings: Recordings) -> np.ndarray:
    """Frequencies for population curves in Hz, shape (F,): the grid common to all subjects, or a logarithmic one."""
    first = recordings.subjects[0].frequency_hz
    if all(np.array_equal(s.frequency_hz, first) for s in recordings.subjects):
        return np.asarray(first)
    low = min(s.frequency_hz[0] for s in recordings.subjects)
    high = max(s.frequency_hz[-1] for s in recordings.subjects)
    return np.geomspace(low, high, _FALLBACK_POINTS)


def on_grid(recordings: Recordings, frequency_hz: np.ndarray) -> np.ndarray:
    """Each person's mean recording on a common grid, complex, shape (N, F); NaN outside the person's own range.

    Interpolation is linear in real and imaginary part over log frequency.
    """
    result = np.full((len(recordings.subjects), frequency_hz.size), np.nan + 0j)
    x = np.log(frequency_hz)
    for row, subject in zip(result, recordings.subjects, strict=True):
        own, mean = np.log(subject.frequency_hz), subject.mean
        inside = (x >= own[0] - 1e-9) & (x <= own[-1] + 1e-9)
        row[inside] = np.interp(x[inside], own, mean.real) + 1j * np.interp(x[inside], own, mean.imag)
    return result


def wrapped_deg(difference: np.ndarray) -> np.ndarray:
    """Phase difference in degrees, wrapped to -180..180."""
    return np.asarray((difference + 180.0) % 360.0 - 180.0)


def error_curves(model_magnitude: np.ndarray, model_phase_deg: np.ndarray, z: np.ndarray) -> ErrorCurves:
    """Eq. 5 for one model curve and the measured curves.

    Parameters
    ----------
    model_magnitude, model_phase_deg : ndarray, shape (F,)
    z : ndarray, complex, shape (..., N, F)
        NaN where a person has no data.

    Returns
    -------
    ErrorCurves
        Arrays of shape (..., F).
    """
    magnitude = np.abs(np.abs(z) - model_magnitude)
    phase = np.abs(wrapped_deg(np.angle(z, deg=True) - model_phase_deg))
    return ErrorCurves(np.nanmean(magnitude, axis=-2), np.nanmean(phase, axis=-2))


def lookup_table(z: np.ndarray, statistic: str) -> tuple[np.ndarray, np.ndarray]:
    """The paper's look-up table: mean or median over people, of magnitude and of phase separately.

    Parameters
    ----------
    z : ndarray, complex, shape (N, F)
    statistic : str
        ``mean`` or ``median``.

    Returns
    -------
    magnitude, phase_deg : ndarray, shape (F,)
    """
    if statistic not in ("mean", "median"):
        raise ValueError(f"statistic is '{statistic}': choose 'mean' or 'median'")
    reduce = np.nanmean if statistic == "mean" else np.nanmedian
    return np.asarray(reduce(np.abs(z), axis=0)), np.asarray(reduce(np.angle(z, deg=True), axis=0))


def relative_rms(model: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Root mean square of |model - z| / |z| over frequency: (..., F) to (...)."""
    return np.asarray(np.sqrt(np.nanmean((np.abs(model - z) / np.abs(z)) ** 2, axis=-1)))


def coverage(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Share of people inside a band at every frequency: values (N, F), bounds (F,), result (F,)."""
    inside = (values >= lower) & (values <= upper)
    present = np.isfinite(values)
    return np.asarray(np.sum(inside & present, axis=0) / np.maximum(np.sum(present, axis=0), 1))
