"""Whether a force is one sweep through the band: averages over segments then leave leakage that no scatter shows.

In each segment of a sweep only a part of the band is excited, and at the segment's ends the sweep is cut off. What that
leaves in H1 is alike in neighbouring segments, so that the coherence does not show it: of intervals of 95 % for sweeps
of 20 s through 5 to 1000 Hz, with noise of 0.1 %, 69 to 81 % held the truth; by the local polynomial method 93 to 95 %.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.intake.ratio import FloatArray

PARTS = 16
"""Parts of a record whose middle frequencies are compared. By choice: those of noise rise or fall throughout, but for
one step, in 6 of 1e9 records."""
_STEADY = 0.8
"""Steps from part to part in the prevailing direction less those in the other, as a share of all. By choice: one of
fifteen may be wrong."""
_SPAN = 3.0
"""Ratio of the highest to the lowest middle frequency. By choice: no spectrum is made of a sweep through less than
an octave and a half."""
_LEAST_SAMPLES = 64
"""Of a part. By choice: fewer have no middle frequency."""

SWEEPS_ONCE = (
    "the force sweeps once through the band: averages over segments leave leakage that noise_sd does not hold; "
    "--estimator 'local polynomial' knows it, and a sweep that is repeated (--excitation periodic) has none"
)


def is_single_sweep(force: FloatArray) -> bool:
    """Whether the middle frequency of a force (N,) moves steadily through a band, up or down."""
    length = force.size // PARTS
    if length < _LEAST_SAMPLES:
        return False
    parts = force[: PARTS * length].reshape(PARTS, length)
    power = np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * np.hanning(length), axis=1)) ** 2
    total = power.sum(axis=1)
    loud = total > 1e-3 * total.max()
    if loud.sum() < PARTS // 2:
        return False
    share = np.cumsum(power[loud], axis=1) / total[loud, None]
    middle = np.argmax(share >= 0.5, axis=1) + 1.0
    steps = np.sign(np.diff(middle))
    moving = steps[steps != 0]
    steady = moving.size > 0 and abs(float(moving.mean())) >= _STEADY
    return bool(steady and moving.size >= PARTS // 2 and middle.max() >= _SPAN * middle.min())
