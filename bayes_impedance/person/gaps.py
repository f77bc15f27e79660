r"""Places of a recording's log elements at which a sharp resonance lies in another gap between the frequencies.

A resonance of low damping is narrower than the grid of frequencies. Where it meets a point the error is without bound,
so that each gap of the grid holds an optimum of its own, and no step leads from one to the next. The resonance's
frequency is the root of the product of two elements: an element :math:`x` that is changed by :math:`\delta` in its
logarithm moves it by :math:`\delta/2`. The element's part in the impedance,

.. math:: s(\omega) = \left|\frac{\partial \ln z}{\partial \ln x}\right|,

is largest at the point next to the resonance. With :math:`g` the wider of the gaps beside that point, in logarithms,
a resonance whose width :math:`1/Q` exceeds the gap has :math:`s g < 1` there, as s is at most Q. One
that is narrower is nearer to the point than g/2, and has :math:`s g > 1`. Such an element is changed in steps of g, by
which the resonance goes from gap to gap, and in smaller ones at first: the optimum of a gap is narrower than the gap,
and one right beside where the recording is does not show in wide steps. Where the bounded error
(:mod:`.bounded_search`) of the recording is less than one step further to either side there may be another optimum.

A branch that hardly matters elsewhere may have s g far below one in the middle of a gap: its resonance is hidden there,
and shows only where it meets a point. So for a recording that is described badly all elements are changed, by as much
as its population allows.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import bounded_errors
from bayes_impedance.person.likelihood import Likelihood

_SHARP = 0.5
"""Change of the logarithm of z, at the point next to the resonance, by a step of an element, from which other gaps are
looked at. By choice: half of what the smallest one of a narrow resonance is."""

REACH, _MOST_STEPS = 0.3, 100
"""Largest change of a log element between a person's recordings, and largest number of steps to either side. By
choice: three times the dispersion between repetitions with which a fit begins; a step costs a hundredth of a
millisecond."""

_NEAR, _PARTS = 2, 4
"""The first steps to either side, so many, are made in so many parts; each moves the resonance by half a gap. By
choice: in halves an optimum in the next gap was not found, 170 units better, and in quarters it was."""

_MOST = 8
"""Places that are returned, of the smallest error. By choice: from each a search of a few milliseconds begins."""


def other_gaps(
    kernel: Kernel, alone: Likelihood, places: np.ndarray, free: np.ndarray, reach: np.ndarray | None = None
) -> np.ndarray:
    """Places (S, P), S at most 8, from which a recording's resonance may be found in another gap.

    Parameters
    ----------
    kernel : Kernel
    alone : Likelihood
        Of one recording.
    places : ndarray, shape (K, P)
        Log elements that are changed, one at a time; the first is where the recording is.
    free : ndarray of bool, shape (P,)
        Which may be changed.
    reach : ndarray, shape (P,), optional
        Largest changes of the log elements, of which all are changed then. By default :data:`REACH`, of those that move
        a resonance of which the recording, where it is, shows that it is narrower than the gaps.

    Returns
    -------
    ndarray, shape (S, P)
        Empty if no element moves a resonance that is narrower than the gaps.
    """
    z, slopes = kernel.derivative(places[0], alone.omega / (2 * np.pi))
    part = np.nan_to_num(np.abs(slopes / z))
    there = np.argmax(part, axis=-1)
    wide = np.diff(np.log(alone.omega))
    step = np.maximum(wide[np.minimum(there, wide.size - 1)], wide[np.maximum(there - 1, 0)])
    if reach is None:
        reach, free = np.full(free.size, REACH), free & (part.max(axis=-1) * step > _SHARP)
    found, errors = [np.zeros((0, places.shape[1]))], [np.zeros(0)]
    for p in np.flatnonzero(free):
        times = _times(int(np.clip(np.ceil(reach[p] / step[p]), 1, _MOST_STEPS)))
        for k, place in enumerate(places):
            along = np.tile(place, (times.size, 1))
            along[:, p] += times * step[p]
            error = bounded_errors(kernel, alone, along)
            beside = np.concatenate([[np.inf], error, [np.inf]])
            least = np.flatnonzero((error < beside[:-2]) & (error < beside[2:]))
            least = least[times[least] != 0] if k == 0 else least
            found.append(along[least])
            errors.append(error[least])
    order = np.argsort(np.concatenate(errors), kind="stable")[:_MOST]
    return np.concatenate(found)[order]


def _times(most: int) -> np.ndarray:
    """Changes of an element in steps, to either side of zero: in parts of them at first, and at most so many."""
    near = np.arange(1, min(_NEAR, most) * _PARTS + 1) / _PARTS
    up = np.concatenate([near, np.arange(near[-1] + 1, most + 1)])
    return np.concatenate([-up[::-1], [0.0], up])
