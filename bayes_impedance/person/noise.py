r"""Estimation of the noise, from repetitions or from roughness over frequency.

A finger that is repositioned has slightly different elements. The difference between two recordings is therefore noise
plus a change within the tangent space of the network, :math:`\partial Z/\partial\theta`, and only the component
**outside** that space is noise. A resonance of low damping moves further than its width: what one recording has there
may be fifty times another's, with fifty times the noise, and a tangent space in common means nothing. So the network's
impedance with each recording's own elements is subtracted, the rest is divided by that recording's own noise, and what
is within that recording's own tangent space is taken out. With c the differences between the J recordings of what is
left (J - 1 orthonormal contrasts, free of what the network lacks in all of them), and :math:`h_{jk}` the leverage of
recording j at frequency k, real and imaginary part together, in the noise's units,

.. math:: \hat\sigma_k^2 = \frac{\sum |c|_k^2}{\sum (1 - 1/J) \sum_j (2 - h_{jk})} .

Sums run over persons and over as many neighbouring frequencies as give about 200 degrees of freedom. With many persons
the window is narrow and a sharp rise of the noise is resolved; with one person it is wide and the estimate is stable.

With one repetition the noise is estimated from the second difference over frequency of the residual from the fitted
network. (The second difference of the data would count their curvature as noise.) The ends of the band have none. Their
noise is extrapolated along the line of its logarithm over log frequency near the end, as far as the line's slope b is
known, with the factor :math:`\max(0, 1 - \operatorname{se}_b^2/b^2)` on it. (Taken to be as noisy as its neighbour, the
lowest of 51 points had a fifth too little noise, of 71 people and more, and looked like structure.) On a linear grid
the ends are far away in log frequency: with noise that rises below 10 Hz, the point at 6 Hz was taken to have a third
of its noise, that of the point at 25 Hz, and the mass of a resonator was four times too large, five standard errors
off. So such an end is compared with the fitted network itself, with its leverage, and for the same reason a wide gap
counts as several points in pooling.

The level is that of the median person: everybody has a scale of their own in the likelihood, and a few persons whose
elements have not been found yet must not make their misfit look like everybody's noise. Nor must a sharp resonance,
which is somewhere else in everybody: where an element was a line in truth, the one or two people of eleven whose
resonance was near had 20 to 350 times the noise that all others had, and the pooled noise was 40 times too large around
it, just where the line shows. So points do not count where they are ten times what the median person has around them.

At a given frequency, the noise of different persons is either proportional to the magnitude or independent of it; the
alternative with the higher likelihood is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.display import Brief

FLOOR_WITH_REPETITIONS = 1e-4
"""Lower bound of the noise relative to |z| if estimated from repetitions. By choice: no impedance head is better, and
rounding in a file must not determine the weights."""

FLOOR_WITHOUT = 1e-3
"""The same if estimated from roughness. By choice ten times as large: smoothed data have too little roughness."""

_DEGREES_OF_FREEDOM = 200.0
"""Degrees of freedom over which an estimate is pooled. By choice: a standard deviation is then known to 1/sqrt(2 x 200)
= 5 %."""

_FAR = 0.25
"""Distance in log frequency from which neighbours tell little of a point's noise. By choice: noise that rises with the
inverse square of frequency changes by 1.6 over it; the grids of most recordings are several times finer."""

_SLOPE_WIDTH = 3.0
"""Width of the window over whose points the slope at an end is estimated, relative to that of pooling; at least that of
one point. By choice: the slope of a line is less certain than its level, and noise does not follow a line for long. At
the lowest of 31 to 101 points in 71 people, noise that rises below 8 Hz is 3 to 10 % too small (half of it, 1.5: 4 to
8 %; twice, 6: 3 to 19 %)."""

_TAIL_ROUNDS = 20
"""Times that the weights of points and the noise are found in turn where noise has tails. By choice: the error is about
halved each time."""

_BEYOND_BELIEF = 10.0
"""Squares per degree of freedom, in those of the median person, that are not believed to be noise. By choice: normal
noise of two degrees of freedom is beyond with a probability of 5e-5."""

_MEDIAN_OF_TWO = float(np.log(2.0))
"""Median of a mean square of two degrees of freedom, in its expectation."""

_BARELY = 0.01
"""Share of the most that anybody knows around a node below which a person says nothing there: the far end of a window
is as good as no point. By choice."""

_GRID_POINTS = 400
"""Largest number of frequencies in pooling; more are binned. By choice: the windows are much wider than a bin."""


@dataclass(frozen=True)
class Scatter:
    """Squared noise of one person, before pooling.

    Attributes
    ----------
    frequency_hz : ndarray, shape (F,)
    magnitude : ndarray, shape (F,)
        |z| of the person's recordings, root mean square.
    square : ndarray, shape (F,)
        Sum of squared deviations, real and imaginary parts together.
    freedom : ndarray, shape (F,)
        Degrees of freedom in each.
    """

    frequency_hz: np.ndarray
    magnitude: np.ndarray
    square: np.ndarray
    freedom: np.ndarray


@dataclass(frozen=True, repr=False)
class NoiseModel(Brief):
    """Standard deviation of the real and of the imaginary part over frequency.

    Attributes
    ----------
    frequency_hz, sd : ndarray, shape (G,)
        Nodes; interpolation is linear in the logarithms.
    relative : bool
        Whether `sd` is a fraction of |z|.
    floor : float
        Smallest sd as a fraction of |z|.
    """

    frequency_hz: np.ndarray
    sd: np.ndarray
    relative: bool
    floor: float

    def at(self, frequency_hz: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
        """Noise at frequencies (F,) for a recording with |z| = magnitude (F,), smoothed: shape (F,)."""
        log_sd = np.interp(np.log(frequency_hz), np.log(self.frequency_hz), np.log(self.sd))
        sd = np.exp(log_sd) * (magnitude if self.relative else 1.0)
        return np.asarray(np.maximum(sd, self.floor * magnitude))


def contrasts(n: int) -> np.ndarray:
    """Orthonormal contrasts (Helmert) over n repetitions, shape (n - 1, n): rows sum to zero."""
    rows = np.zeros((n - 1, n))
    for c in range(1, n):
        rows[c - 1, :c], rows[c - 1, c] = 1.0, -float(c)
        rows[c - 1] /= np.sqrt(c * (c + 1))
    return rows


def scatter_of_repetitions(
    frequency_hz: np.ndarray,
    z: np.ndarray,
    derivative: np.ndarray,
    noise_sd: np.ndarray | None = None,
    model: np.ndarray | float = 0.0,
) -> Scatter:
    """Noise of one person from J >= 2 recordings.

    Parameters
    ----------
    frequency_hz : ndarray, shape (F,)
    z : ndarray, complex, shape (J, F)
    derivative : ndarray, complex, shape (J, P, F) or (P, F)
        dZ/dtheta at the fitted elements of each recording, or of the person.
    noise_sd : ndarray, shape (J, F), optional
        Current estimate of the noise, used for whitening; by default proportional to |z|. The projection is unbiased
        only with the true noise, so that the noise is estimated twice.
    model : ndarray, complex, shape (J, F), optional
        The network's impedance with elements of each recording.
    """
    white = np.abs(z) if noise_sd is None else noise_sd
    difference = (z - model) / white
    n = frequency_hz.size
    stacked = np.concatenate([difference.real, difference.imag], axis=1)
    freedom = np.empty(z.shape)
    tangent = np.broadcast_to(derivative, (len(z), *derivative.shape[-2:])) / white[:, None]
    for j, own in enumerate(np.concatenate([tangent.real, tangent.imag], axis=2)):
        basis = _orthonormal(own.T)
        stacked[j] -= basis @ (basis.T @ stacked[j])
        freedom[j] = 2 - np.sum(basis**2, axis=1).reshape(2, n).sum(axis=0)
    outside = contrasts(len(z)) @ stacked
    square = np.sum(outside[:, :n] ** 2 + outside[:, n:] ** 2, axis=0) * np.mean(white**2, axis=0)
    magnitude = np.sqrt(np.mean(np.abs(z) ** 2, axis=0))
    return Scatter(frequency_hz, magnitude, square, (1 - 1 / len(z)) * freedom.sum(axis=0))


def scatter_of_roughness(
    frequency_hz: np.ndarray, z: np.ndarray, model: np.ndarray, derivative: np.ndarray | None = None
) -> Scatter:
    """Noise of one person from one recording.

    Each inner point is compared with the straight line, over log frequency, through its two neighbours. An end that is
    far from its neighbour is compared with the network.

    Parameters
    ----------
    frequency_hz : ndarray, shape (F,)
    z, model : ndarray, complex, shape (F,)
        The recording, and the impedance of the network that was fitted to it with noise proportional to abs(z).
    derivative : ndarray, complex, shape (P, F), optional
        dZ/dtheta of the network there; without it the ends have no scatter.
    """
    x, residual = np.log(frequency_hz), z - model
    share = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
    rough = residual[1:-1] - (1 - share) * residual[:-2] - share * residual[2:]
    square = np.zeros(x.size)
    square[1:-1] = np.abs(rough) ** 2 / (1 + (1 - share) ** 2 + share**2)
    freedom = np.full(x.size, 2.0)
    freedom[[0, -1]] = 0.0
    far = np.array([0, x.size - 1])[np.diff(x)[[0, -1]] > _FAR]
    if derivative is not None and far.size:
        magnitude = np.abs(z)
        tangent = derivative / magnitude
        basis = _orthonormal(np.concatenate([tangent.real, tangent.imag], axis=1).T)
        square[far] = np.abs(residual[far]) ** 2
        freedom[far] = np.sum(1 - np.sum(basis**2, axis=1).reshape(2, -1)[:, far], axis=0)
    kept = freedom > 1e-9
    return Scatter(frequency_hz[kept], np.abs(z[kept]), square[kept], freedom[kept])


def pool(scatters: Sequence[Scatter], floor: float, degrees: float = np.inf) -> NoiseModel:
    """Common shape of the noise over frequency, from the scatter of all persons.

    Parameters
    ----------
    scatters : sequence of Scatter
        One per person; grids may differ.
    floor : float
        Smallest noise relative to |z|.
    degrees : float
        Of freedom of noise with tails: points far off then count less (:mod:`.heavy_noise`).
    """
    candidates = [_pool(scatters, relative, floor, degrees) for relative in (True, False)]
    return min(candidates, key=lambda candidate: candidate[1])[0]


def _pool(scatters: Sequence[Scatter], relative: bool, floor: float, degrees: float) -> tuple[NoiseModel, float]:
    """The noise model and its deviance."""
    x = np.log(np.concatenate([s.frequency_hz for s in scatters]))
    scale = np.concatenate([s.magnitude if relative else np.ones(s.magnitude.size) for s in scatters])
    square = np.concatenate([s.square for s in scatters]) / scale**2
    freedom = np.concatenate([s.freedom for s in scatters])
    nodes, index = np.unique(np.round(x, 9), return_inverse=True)
    if nodes.size > _GRID_POINTS:
        edges = np.linspace(x.min(), x.max(), _GRID_POINTS + 1)
        index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _GRID_POINTS - 1)
        nodes = 0.5 * (edges[1:] + edges[:-1])
    freedom_sum = np.bincount(index, freedom, minlength=nodes.size)
    filled = freedom_sum > 0
    place = (np.cumsum(filled) - 1)[index]
    nodes, freedom_sum = nodes[filled], freedom_sum[filled]

    # Rank distance, not frequency distance: the window holds the same information everywhere; across wide gaps less.
    per_node = np.median(freedom_sum)
    width = max(_DEGREES_OF_FREEDOM / per_node / np.sqrt(4 * np.pi), 0.3)
    rank = np.cumsum(np.r_[0.0, np.maximum(np.diff(nodes) / _FAR, 1.0)])
    window = np.exp(-0.5 * ((rank[:, None] - rank[None, :]) / width) ** 2)
    believed = _believed(
        place + nodes.size * np.repeat(np.arange(len(scatters)), [s.square.size for s in scatters]),
        square,
        freedom,
        window,
    )
    square_sum = np.bincount(place, square * believed, minlength=nodes.size)
    freedom_sum = np.bincount(place, freedom * believed, minlength=nodes.size)
    variance = (window @ square_sum) / (window @ freedom_sum)
    for _ in range(_TAIL_ROUNDS if np.isfinite(degrees) else 0):
        expected = np.maximum(variance[place], np.finfo(float).tiny)
        weighted = square * (degrees + freedom) / (degrees + square / expected)
        square_sum = np.bincount(place, weighted * believed, minlength=nodes.size)
        variance = (window @ square_sum) / (window @ freedom_sum)
    square = square if not np.isfinite(degrees) else weighted
    smallest = (floor * np.median(np.concatenate([s.magnitude for s in scatters]) / scale)) ** 2
    variance = np.maximum(variance, smallest)
    expected = np.interp(x, nodes, variance)
    # Gaussian deviance, profiled over each person's scale. Points that are not noise here may be noise there.
    deviance, start, scales = 0.0, 0, []
    log_scale = np.log(scale**2)
    for s in scatters:
        part = slice(start, start + s.square.size)
        white, own_freedom, kept = square[part] / expected[part], freedom[part], believed[part]
        scales.append(max(float(np.sum(white[kept]) / max(own_freedom[kept].sum(), 1e-9)), 1e-12))
        own_scale = max(float(np.sum(np.minimum(white, _BEYOND_BELIEF * own_freedom)) / own_freedom.sum()), 1e-12)
        deviance += float(np.sum(freedom[part] * (np.log(expected[part] * own_scale) + log_scale[part])))
        start += s.square.size
    variance = np.maximum(variance * np.median(scales), smallest)
    own = np.maximum(square_sum / freedom_sum, smallest) * np.median(scales)
    ends = [_beyond(nodes, np.log(own), freedom_sum, rank, width, end) for end in (0, -1)]
    nodes = np.r_[nodes[0] - _FAR, nodes, nodes[-1] + _FAR]
    variance = np.r_[variance[0] * np.exp(ends[0]), variance, variance[-1] * np.exp(ends[1])]
    return NoiseModel(np.exp(nodes), np.sqrt(np.maximum(variance, smallest)), relative, floor), deviance


def _believed(cell: np.ndarray, square: np.ndarray, freedom: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Whether a point is believed to be noise: it is not far beyond what the median person has there or around it.

    Around it more is known; there, noise that rises steeply is seen, which is the median person's too.

    Parameters
    ----------
    cell : ndarray of int
        Person and node of each point, `node + G * person`.
    square, freedom : ndarray
        Of each point.
    window : ndarray, shape (G, G)
        Weights of the nodes around each node.
    """
    size = len(window)
    shape = (cell[-1] // size + 1, size)
    own, known = (np.bincount(cell, value, minlength=shape[0] * size).reshape(shape) for value in (square, freedom))
    there = _median(own, known > 0, known) / _MEDIAN_OF_TWO
    near = known @ window
    around = _median(own @ window, near > _BARELY * near.max(axis=0), near)
    return np.asarray(square <= _BEYOND_BELIEF * np.maximum(there, around)[cell % size] * freedom)


def _median(square: np.ndarray, seen: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Median over persons of squares per degree of freedom, where they are seen by somebody: (N, G) to (G,)."""
    return np.asarray(np.nanmedian(np.where(seen, square / np.where(seen, freedom, 1.0), np.nan), axis=0))


def _beyond(
    nodes: np.ndarray, log_variance: np.ndarray, freedom: np.ndarray, rank: np.ndarray, width: float, end: int
) -> float:
    """Change of the log variance from the first or last node (end 0 or -1) to a point that is just not far from it."""
    own = np.exp(-0.5 * ((rank - rank[end]) / max(_SLOPE_WIDTH * width, 1.0)) ** 2) * freedom
    x = nodes - np.sum(own * nodes) / np.sum(own)
    square = np.sum(own * x**2)
    if not square > 0:
        return 0.0
    slope = np.sum(own * x * log_variance) / square
    error = np.sum(2 / freedom * (own * x) ** 2) / square**2  # a log chi-square has variance 2/freedom
    kept = max(0.0, 1 - error / slope**2) if slope else 0.0
    return float(kept * slope * (_FAR if end else -_FAR))


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the columns' span, without directions that have little effect within the band."""
    u, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, singular > 1e-10 * singular[0]])
