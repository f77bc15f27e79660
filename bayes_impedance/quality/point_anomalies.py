r"""Outliers, steps and non-passive stretches of single curves: array functions used by the checks.

A measured impedance is smooth in log-frequency except for its noise. The deviation of a point from the straight line
through its two neighbours,

.. math:: d_i = \frac{z_i - (1-w) z_{i-1} - w z_{i+1}}{\sqrt{1 + w^2 + (1-w)^2}}, \qquad
          w = \frac{\ln f_i - \ln f_{i-1}}{\ln f_{i+1} - \ln f_{i-1}},

has the size of the noise, whatever the curve. Its running median is a robust local scale, because noise depends on
frequency (it grows below 10 Hz). For complex Gaussian noise :math:`|d|/\sigma` is Rayleigh distributed and exceeds t
with probability :math:`e^{-t^2/2}`: 5.6 among 85 000 points at one per cent. The limits below are about twice as high,
because the scale is itself estimated from some twenty points that share their noise.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray

BoolArray = npt.NDArray[np.bool_]
IndexArray = npt.NDArray[np.intp]

MINIMUM_POINTS = 11
"""Fewest points of a recording that is checked: half of the window of the local scale."""
OUTLIER_LIMIT, OUTLIER_MINIMUM = 11.0, 0.01
"""Smallest distance of an outlier from its neighbours: in local standard deviations, about twice what chance reaches
(see above), and relative to the local magnitude (by choice)."""
OUTLIER_CONTRAST = 5.0
"""Smallest ratio of an outlier's deviation to that of its neighbours without it. By choice: at a resonance the
neighbours deviate as well."""
JUMP_LIMIT, JUMP_MINIMUM = 12.0, 0.05
"""Smallest height of a jump: in standard errors, about twice what chance reaches (see above), and in nepers or radians
(5 %, 3 degrees, by choice)."""
JUMP_CONTRAST = 3.0
"""Smallest ratio of a jump to the steps between the points around it. By choice: a resonance changes over several
points."""
NOT_PASSIVE_LIMIT, NOT_PASSIVE_MINIMUM = 8.0, 1e-3
"""Smallest depth of a negative real part: in standard errors over its stretch, and relative to |z|. By choice: chance
reaches about five (see above), and less than a thousandth can result from a phase error of 0.06 degrees."""

_SCALE_WINDOW = 21
"""Points of the running median for the local scale. By choice: a median of 21 Rayleigh values is known to a sixth."""
_JUMP_SIDE = 5
"""Points on each side of a jump to which lines are fitted. By choice: more reduce noise, fewer follow the curve."""
_PASSIVE_WINDOW = 7
"""Points over which the real part is averaged. By choice: more reduce noise, fewer resolve short stretches."""
_RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))
"""Median of |d|, Rayleigh distributed, for a standard deviation of one."""


def running_median(values: FloatArray, window: int) -> FloatArray:
    """Return the running median over the last axis, with the ends mirrored.

    Parameters
    ----------
    values : ndarray of float, shape (..., F)
    window : int
        Odd number of points; at most 2 F - 1 are used.

    Returns
    -------
    ndarray of float, shape (..., F)
    """
    half = min(window // 2, values.shape[-1] - 1)
    padding = [(0, 0)] * (values.ndim - 1) + [(half, half)]
    median: FloatArray = np.median(sliding_window_view(np.pad(values, padding, "reflect"), 2 * half + 1, -1), axis=-1)
    return median


def deviation(frequency_hz: FloatArray, z: ComplexArray) -> ComplexArray:
    """Return each point's deviation from a line through its two neighbours, relative to the local magnitude.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
        Ascending, F >= 3.
    z : ndarray of complex, shape (..., F)

    Returns
    -------
    ndarray of complex, shape (..., F)
        Scaled to the variance of the noise in one point. The two ends are compared with the line through the next two.
    """
    x = np.log(frequency_hz)
    centre = np.arange(x.size)
    centre[0], centre[-1] = 1, x.size - 2
    # Of each triple (left, middle, right) the point itself is middle, except at the ends.
    left, middle, right = centre - 1, centre, centre + 1
    w = (x[middle] - x[left]) / (x[right] - x[left])
    d = z[..., middle] - (1 - w) * z[..., left] - w * z[..., right]
    gain = np.sqrt(1 + w**2 + (1 - w) ** 2)
    # d of a triple is proportional to the extrapolation error of its ends, so only signs and sizes differ there.
    local = running_median(np.abs(z), 5)
    relative: ComplexArray = d / gain / np.maximum(local, np.finfo(float).tiny)
    return relative


def noise_scale(d: ComplexArray) -> FloatArray:
    """Return the local standard deviation of each of real and imaginary part of the deviations.

    Parameters
    ----------
    d : ndarray of complex, shape (..., F)
        From `deviation`.

    Returns
    -------
    ndarray of float, shape (..., F)
        The running median, but not below a third of the recording's, since the median of a few points can be small
        by chance.
    """
    size = np.abs(d)
    whole = np.median(size, axis=-1, keepdims=True)
    scale: FloatArray = np.maximum(running_median(size, _SCALE_WINDOW), whole / 3) / _RAYLEIGH_MEDIAN
    return scale


def _caution(points: int) -> float:
    """Return the factor on the limits for short recordings, whose scale is less certain."""
    return 1 + MINIMUM_POINTS / points


def outliers(frequency_hz: FloatArray, z: ComplexArray) -> BoolArray:
    """Return which points are isolated outliers.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
    z : ndarray of complex, shape (J, F)

    Returns
    -------
    ndarray of bool, shape (J, F)
        Two adjacent points with the same error are found, too. Steps between two levels are not outliers.
    """
    if frequency_hz.size < MINIMUM_POINTS:
        return np.zeros(z.shape, dtype=bool)
    found = np.zeros(z.shape, dtype=bool)
    x = np.log(frequency_hz)
    size = z.shape[1]
    magnitude = np.maximum(running_median(np.abs(z), 5), np.finfo(float).tiny)
    limit = np.maximum(OUTLIER_LIMIT * _caution(size) * noise_scale(deviation(frequency_hz, z)), OUTLIER_MINIMUM)
    for length in (1, 2):
        # A run of points between the indices a and b, whose outer neighbours should lie on one curve with it.
        a = np.arange(0, size - length - 1)
        b = a + length + 1
        run = a[:, None] + np.arange(1, length + 1)
        error, gain = _line_error(x, z, run, a[:, None], b[:, None])
        error = (error / magnitude[:, run]).min(axis=-1)
        inner, _ = _line_error(x, z, a[1:], a[1:] - 1, b[1:])
        outer, _ = _line_error(x, z, b[:-1], a[:-1], b[:-1] + 1)
        rest = np.zeros(error.shape)
        rest[:, 1:] = inner / magnitude[:, a[1:]]
        rest[:, :-1] = np.maximum(rest[:, :-1], outer / magnitude[:, b[:-1]])
        off = (error > (limit[:, run] * gain).max(axis=-1)) & (rest < error / OUTLIER_CONTRAST)
        for k in range(length):
            found[:, run[:, k]] |= off
    for end, one, two, three in ((0, 1, 2, 3), (size - 1, size - 2, size - 3, size - 4)):
        index = np.array([end, one]), np.array([one, two]), np.array([two, three])
        error, gain = _line_error(x, z, *index)
        error /= magnitude[:, [end, one]]
        found[:, end] |= (error[:, 0] > limit[:, end] * gain[0]) & (error[:, 1] < error[:, 0] / OUTLIER_CONTRAST)
    return found


def _line_error(
    x: FloatArray, z: ComplexArray, at: IndexArray, one: IndexArray, two: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Return the distance of points from the lines through two others, and its noise gain.

    Parameters
    ----------
    x : ndarray of float, shape (F,)
    z : ndarray of complex, shape (J, F)
    at, one, two : ndarray of int, shape (...)
        Indices of the point and of the two points that define the line.

    Returns
    -------
    distance : ndarray of float, shape (J, ...)
    gain : ndarray of float, shape (...)
        Standard deviation of the distance for noise of unit standard deviation.
    """
    w = (x[at] - x[one]) / (x[two] - x[one])
    distance: FloatArray = np.abs(z[:, at] - (1 - w) * z[:, one] - w * z[:, two])
    return distance, np.sqrt(1 + w**2 + (1 - w) ** 2)


def without(frequency_hz: FloatArray, z: ComplexArray, drop: BoolArray) -> ComplexArray:
    """Return curves with some points replaced by interpolation in log-frequency.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
    z : ndarray of complex, shape (J, F)
    drop : ndarray of bool, shape (J, F)
        Points to replace.

    Returns
    -------
    ndarray of complex, shape (J, F)
    """
    x, cleaned = np.log(frequency_hz), z.copy()
    for j in np.flatnonzero(drop.any(axis=1) & ~drop.all(axis=1)):
        keep = ~drop[j]
        cleaned[j, ~keep] = np.interp(x[~keep], x[keep], z[j, keep])
    return cleaned


def jumps(frequency_hz: FloatArray, z: ComplexArray) -> tuple[BoolArray, ComplexArray]:
    """Return where a curve jumps to another level and stays there.

    Lines through the five points on either side, in ln z against ln f, are compared halfway between the two points.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
    z : ndarray of complex, shape (J, F)
        Without outliers (see `without`), which would tilt the lines.

    Returns
    -------
    found : ndarray of bool, shape (J, F - 1)
        Whether there is a jump between a point and the next one.
    step : ndarray of complex, shape (J, F - 1)
        Its size in ln|z| (real part) and in phase in radians (imaginary part).
    """
    shape = (z.shape[0], max(frequency_hz.size - 1, 0))
    found, step = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=complex)
    k = _JUMP_SIDE
    if frequency_hz.size < max(MINIMUM_POINTS, 2 * k):
        return found, step
    x = np.log(frequency_hz)
    y = np.log(np.maximum(np.abs(z), np.finfo(float).tiny)) + 1j * np.unwrap(np.angle(z), axis=-1)
    inside = np.arange(k - 1, frequency_hz.size - k)
    x_windows, y_windows = sliding_window_view(x, k), sliding_window_view(y, k, axis=-1)
    middle = (x[inside] + x[inside + 1]) / 2
    left, left_gain, left_misfit = _line_at(x_windows[inside - k + 1], y_windows[:, inside - k + 1], middle)
    right, right_gain, right_misfit = _line_at(x_windows[inside + 1], y_windows[:, inside + 1], middle)
    difference = right - left
    size = np.abs(difference)
    scale = noise_scale(deviation(frequency_hz, z))
    scale = np.maximum(scale[:, inside], scale[:, inside + 1])
    standard_error = scale * np.sqrt(left_gain + right_gain)
    change = np.diff(y, axis=-1)
    around = sliding_window_view(np.pad(change, ((0, 0), (k - 1, k - 1)), "edge"), 2 * k - 1, axis=-1)[:, inside]
    around = np.delete(around, k - 1, axis=-1)
    usual = np.median(around.real, axis=-1) + 1j * np.median(around.imag, axis=-1)
    excess = np.abs(change[:, inside] - usual)
    candidate = (
        (size > np.maximum(JUMP_LIMIT * standard_error, JUMP_MINIMUM))
        & (np.maximum(left_misfit, right_misfit) < size / 4)
        & (excess > JUMP_CONTRAST * np.abs(around - usual[..., None]).max(axis=-1))
        & (excess > size / 2)
    )
    # Windows near a jump contain it: only the largest step within a window counts.
    padded = np.pad(np.where(candidate, size, 0.0), ((0, 0), (k, k)))
    largest = sliding_window_view(padded, 2 * k + 1, axis=-1).max(axis=-1)
    found[:, inside] = candidate & (size == largest)
    step[:, inside] = difference
    return found, step


def _line_at(x: FloatArray, y: ComplexArray, at: FloatArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Fit lines to windows and evaluate them.

    Parameters
    ----------
    x : ndarray of float, shape (B, k)
    y : ndarray of complex, shape (J, B, k)
    at : ndarray of float, shape (B,)

    Returns
    -------
    value : ndarray of complex, shape (J, B)
    gain : ndarray of float, shape (B,)
        Variance of the value for unit variance of the points.
    misfit : ndarray of float, shape (J, B)
        Root mean square distance of the points from the line.
    """
    centred = x - x.mean(axis=1, keepdims=True)
    sum_squares = np.sum(centred**2, axis=1)
    mean = y.mean(axis=-1)
    slope = np.sum(centred * y, axis=-1) / sum_squares
    distance = at - x.mean(axis=1)
    residual = y - mean[..., None] - slope[..., None] * centred
    misfit = np.sqrt(np.mean(np.abs(residual) ** 2, axis=-1))
    return mean + slope * distance, 1 / x.shape[1] + distance**2 / sum_squares, misfit


def not_passive(frequency_hz: FloatArray, z: ComplexArray) -> list[list[tuple[int, int]]]:
    """Return the stretches in which the real part is negative beyond the local scatter.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
    z : ndarray of complex, shape (J, F)
        Without outliers.

    Returns
    -------
    list (length J) of list of (int, int)
        First and last index of each stretch, by recording. A single point of a smooth curve is no stretch.
    """
    found: list[list[tuple[int, int]]] = [[] for _ in z]
    if frequency_hz.size < MINIMUM_POINTS:
        return found
    magnitude = np.maximum(running_median(np.abs(z), 5), np.finfo(float).tiny)
    # Relative to |z| the sum over a stretch is not dominated by its largest magnitudes.
    real = z.real / magnitude
    variance = (_caution(frequency_hz.size) * noise_scale(deviation(frequency_hz, z))) ** 2
    half = _PASSIVE_WINDOW // 2
    smooth = sliding_window_view(np.pad(real, ((0, 0), (half, half)), "edge"), 2 * half + 1, axis=-1).mean(axis=-1)
    negative = np.pad(smooth < 0, ((0, 0), (1, 1)))
    for j in np.flatnonzero(negative.any(axis=1)):
        edges = np.flatnonzero(np.diff(negative[j].astype(int)))
        for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            total = real[j, start:stop].sum()
            limit = max(
                NOT_PASSIVE_LIMIT * np.sqrt(variance[j, start:stop].sum()), NOT_PASSIVE_MINIMUM * (stop - start)
            )
            below = start + np.flatnonzero(real[j, start:stop] < 0)
            if total < -limit and below.size > 1:
                found[j].append((int(below[0]), int(below[-1])))
    return found
