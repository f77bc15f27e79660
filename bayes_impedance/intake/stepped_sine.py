"""Stepped sine: one long record in which the frequency goes from step to step, as in the paper.

The steps are found in the record itself: rising zero crossings of the force (or of the signal that was sent) give the
length of every period, and a run of periods of equal length is a step. The first periods of a step are left out,
because the load has to settle (the paper leaves out five and averages five), and the last one, in which the next step
may begin. Over each of the others a sine of the step's frequency is fitted by least squares to force and motion, with
an offset: so nothing leaks although periods are no whole number of samples. The frequency of a step is refined by the
advance of the phase from period to period. With amplitudes F_p and X_p of P periods, g = mean(F) / mean(X) and its
noise are those of :mod:`.periodic`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.intake.periodic import FEWEST_PERIODS
from bayes_impedance.intake.ratio import ComplexArray, FloatArray, Ratio

SETTLE = 5
"""Periods of each step that are left out by default: as in the paper."""
HYSTERESIS = 0.25
"""Of the local root mean square: a crossing counts if the signal goes from below minus this to above it. By choice:
noise of a tenth of the signal does not reach it."""
SAME_STEP = 0.004
"""Relative difference of the lengths of two periods of one step, at least. By choice: the paper's 401 steps over three
decades differ by 1.7 %."""
JITTER = 5.0
"""Times the scatter of neighbouring periods, the same at least."""
_NEIGHBOURS = 15
"""Periods over which that scatter is found. By choice: so many that the first period of a step, which is different,
does not change the median."""
REFINEMENTS = 3
"""Times that the frequency of a step is corrected by the drift of its phase. By choice: each correction leaves a small
part of the error, so the third changes no digit that counts.
"""
FREQUENCY_TOLERANCE = 4e-3
"""Relative, of the same step in two records. By choice: a quarter of what separates steps."""


@dataclass(frozen=True)
class Step:
    """Periods of one frequency.

    Attributes
    ----------
    first : float
        Place of the first rising zero crossing, in samples.
    length : float
        Samples of a period.
    periods : int
    """

    first: float
    length: float
    periods: int


def crossings_of(signal: FloatArray) -> FloatArray:
    """Places of the rising zero crossings, in samples, interpolated; noise near zero does not count."""
    from scipy.ndimage import uniform_filter1d

    x = signal - np.median(signal)
    changes = np.flatnonzero(np.diff(np.signbit(x)))
    if changes.size < 4:
        return np.empty(0)
    window = int(2 * np.diff(changes).max()) + 1
    level = HYSTERESIS * np.sqrt(np.maximum(uniform_filter1d(x**2, window), 0.0))
    state = np.where(x > level, 1, np.where(x < -level, -1, 0))
    place = np.maximum.accumulate(np.where(state != 0, np.arange(x.size), 0))
    held = state[place]
    rises = np.flatnonzero((held[1:] == 1) & (held[:-1] == -1)) + 1
    candidates = np.flatnonzero(np.signbit(x[:-1]) & ~np.signbit(x[1:]))
    last = candidates[np.maximum(np.searchsorted(candidates, rises) - 1, 0)]
    return np.asarray(last + x[last] / (x[last] - x[last + 1]))


def steps_of(signal: FloatArray, settle: int = SETTLE) -> list[Step]:
    """Runs of periods of equal length with enough periods to settle and to average."""
    from scipy.ndimage import median_filter

    crossings = crossings_of(signal)
    lengths = np.diff(crossings)
    if lengths.size < settle + FEWEST_PERIODS + 1:
        return []
    difference = np.abs(np.diff(lengths, prepend=lengths[0])) / lengths
    tolerance = np.maximum(SAME_STEP, JITTER * 1.48 * median_filter(difference, _NEIGHBOURS))
    steps, start = [], 0
    for i in range(1, lengths.size + 1):
        middle = float(np.median(lengths[start:i]))
        # A crossing that noise has shifted changes two neighbouring periods against each other, not their mean.
        pair = float(np.mean(lengths[i : i + 2])) if i < lengths.size else np.inf
        if abs(pair / middle - 1) <= tolerance[min(i, lengths.size - 1)]:
            continue
        # The last period of a run may hold the beginning of the next step.
        periods = i - start - 1
        if periods >= settle + FEWEST_PERIODS:
            steps.append(Step(first=float(crossings[start]), length=middle, periods=periods))
        start = i
    return steps


def stepped_ratio(
    force: FloatArray, motion: FloatArray, rate_hz: float, sent: FloatArray | None = None, settle: int = SETTLE
) -> Ratio | None:
    """Force over motion at every step; None if there are no steps.

    Parameters
    ----------
    force, motion : ndarray of float, shape (N,)
    rate_hz : float
    sent : ndarray of float, shape (N,), optional
        The signal in which the steps are looked for; by default the force.
    settle : int
        Periods of each step to leave out.
    """
    finder = force if sent is None else sent
    rows = []
    for step in steps_of(finder, settle):
        omega, begins = _refined(finder, step, settle)
        f, x = (_amplitudes(signal, omega, begins) for signal in (force, motion))
        periods = f.size
        g = f.mean() / x.mean()
        residual = f - g * x
        variance = float(np.sum(np.abs(residual) ** 2)) / (periods - 1) / periods / abs(x.mean()) ** 2
        rows.append((omega * rate_hz / (2 * np.pi), g, np.sqrt(variance / 2), periods))
    if not rows:
        return None
    rows.sort(key=lambda row: row[0])
    kept = [row for i, row in enumerate(rows) if i == 0 or row[0] > rows[i - 1][0] * (1 + FREQUENCY_TOLERANCE)]
    notes = [f"{len(rows)} steps were found, from {rows[0][0]:.4g} to {rows[-1][0]:.4g} Hz"]
    if len(kept) < len(rows):
        notes.append(f"{len(rows) - len(kept)} of them at frequencies that were there before, and not used")
    fewest = min(row[3] for row in kept)
    return Ratio(
        frequency_hz=np.array([row[0] for row in kept]),
        value=np.array([row[1] for row in kept]),
        inverse=False,
        noise_sd=np.array([row[2] for row in kept]),
        degrees_of_freedom=2.0 * (fewest - 1),
        facts={"steps": float(len(kept)), "periods_averaged": float(fewest)},
        notes=tuple(notes),
    )


def _refined(signal: FloatArray, step: Step, settle: int) -> tuple[float, FloatArray]:
    """Angle per sample of a step, and the beginning of each period that is averaged."""
    omega = 2 * np.pi / step.length
    count = step.periods - settle
    begins: FloatArray = step.first + step.length * (settle + np.arange(float(count)))
    for _ in range(REFINEMENTS):
        turns: FloatArray = np.angle(_amplitudes(signal, omega, begins)).astype(np.float64)
        phase = np.unwrap(turns)
        omega += float(np.polyfit(begins, phase, 1)[0])
        begins = begins[0] + 2 * np.pi / omega * np.arange(float(count))
    return omega, begins


def _amplitudes(signal: FloatArray, omega: float, begins: FloatArray) -> ComplexArray:
    """Complex amplitude of the sine in each period, with the time counted from sample zero."""
    size = 2 * np.pi / omega
    found = []
    for begin in begins:
        n = np.arange(int(np.ceil(begin)), min(int(np.floor(begin + size)) + 1, signal.size))
        design = np.stack([np.cos(omega * n), -np.sin(omega * n), np.ones(n.size)], axis=1)
        a, b, _ = np.linalg.lstsq(design, signal[n], rcond=None)[0]
        found.append(a + 1j * b)
    return np.array(found)
