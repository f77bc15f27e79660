r"""Spectral leakage of mains hum: with a finite averaging time a line is spread over the analyser's window.

A lock-in that averages over K periods of its own frequency f passes the fraction
:math:`\operatorname{sinc}(K(f_h/f - 1))` of hum at :math:`f_h`. In a sweep that is not synchronised with the mains the
phase of the hum is random, so it adds scatter, with the total variance

.. math:: v(f) = B(f)\,\Bigl[1 + a\,p(f)\Bigr], \qquad
          p(f) = \sum_h h^{-2\gamma} \operatorname{sinc}^2\bigl(K(h f_1/f - 1)\bigr)

over a smooth background B, relative to the impedance. Hum that is the same force at every frequency is not the same
share of a small impedance and of a large one: then p is multiplied by the mean of :math:`|z|^{-2}` over people, each in
units of their own noise. Between a resonance and its antiresonance that can be a factor of a thousand: hum that changed
the impedance of 39 people by 0.3 was not seen without it. Both are tried.

A noise estimate that is smooth in frequency attributes hum to noise, so the scatter itself
is tested: the contrasts between the repetitions of each person, which contain no misfit of the network, and from which
changes of the elements were projected out. Where nobody was recorded twice, each point is compared with the mean of the
two beside it, :math:`r_k - (r_{k-1} + r_{k+1})/2`, in which what is smooth in frequency cancels; these contrasts
overlap, which takes half of their degrees of freedom, and see the hum of the two neighbours too. A narrow resonance
that the network lacks can look like hum there, but at one frequency; so the other harmonics must be significant without
the strongest. The logarithm of their mean square over people is normal with known variance; ln B is a cubic spline with
about one knot per factor e, and for every :math:`f_1`, K and gamma the amplitude a is profiled. Hum is reported if the
best :math:`f_1` is a mains frequency, and significantly better than no hum after correction for all tests.
Roughness of the background beyond its spline is counted as scatter.

**Size.** The pattern is fitted to all harmonics at once, whose strengths it does not know, and to mean squares over
people, most of which may come from the few whose impedance is small: as a measure of the hum it was off by factors of
0.4 to 1.7. So once hum is known to be there, its size is found at the strongest point alone, by maximum likelihood over
everybody's contrasts, beside the background at the nearest points without hum. If that is zero, it was no hum: an
element that changed in the course of the sweeps had scatter of a line's pattern, and none at its strongest point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.interpolate import BSpline
from scipy.special import digamma, polygamma

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.hum.line import CHI_SQUARE_Q90, HARMONICS, LINES_HZ, Hum
from bayes_impedance.diagnosis.hum.neighbours import projected
from bayes_impedance.diagnosis.multiple_testing import bonferroni
from bayes_impedance.units import NORMAL_Q95

PERIODS = (3.0, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Averaging times in periods of the excitation: with fewer the window covers an octave, with more it is a
line."""

_DECAYS = (0.0, 1.0)
"""Exponents gamma: harmonics of equal strength, and falling as 1/h."""

_AMPLITUDES = np.geomspace(0.03, 3000.0, 36)
"""Values of a, hum over background variance, 39 % apart: from undetectable to dominating all other scatter. By
choice."""

_FIRST_HZ = np.geomspace(33.0, 90.0, 101)
"""First harmonics that compete with those of the mains, 1 % apart. By choice: both mains frequencies and their
surroundings."""

_OF_MAINS = 0.03
"""Largest relative distance of the best first harmonic from the mains frequency: three steps of its grid."""

_AFFECTED = 3.0
"""Ratio of hum to background variance above which a point is left out: its noise standard deviation is doubled. Smaller
ratios are covered by the estimated noise."""

_NEIGHBOURS = 1.5
"""Variance of a point minus the mean of its two neighbours, in units of the points' own."""

_OVERLAP = 1 + 2 * ((2 / 3) ** 2 + (1 / 6) ** 2)
"""Contrasts with neighbours overlap: their correlations are -2/3 and 1/6, and the variance of a sum of correlated
squares is larger by this factor than that of independent ones."""

_FEWEST_FREEDOM, _FEWEST_POINTS = 8.0, 30
"""Smallest number of degrees of freedom at every point, for the logarithm of a mean square to be nearly normal, and of
points, because spline and pattern take a dozen parameters. The first is that of eight people recorded once. Measured at
the level of 1 % with noise alone, normal or of a t distribution with 5 degrees of freedom: 0 or 1 false detections of
150 at each of 4 to 32 people and 100 or 200 points (4 of 3300 in all), and none in 16 drawn populations of 8 to 34
people, most of whose networks lack something else. The second by choice."""

_WITHOUT, _NEAREST = 0.03, 4
"""Part of the strongest point's hum below which a point counts as without it, and how many on either side tell the
background. By choice: of hum with ten times the variance of the noise such a point has at most a third of the noise's;
with few points the background follows its own slope, and each has dozens of contrasts."""

_ROUNDING = 1e-9
"""Root mean square of contrasts, relative to the impedance, that is rounding and no scatter: of nine digits in a file.
A person's contrasts count by their own mean square, so that such a person would outweigh all others."""

_REACH = (0.38, 13.0)
"""Frequency range of the test, in multiples of the first harmonics: low-frequency noise below it is excluded. By
choice."""


def find_skirts(residuals: Sequence[PersonResiduals], alpha: float = 0.01) -> Hum | None:
    """Look for hum that is spread over frequency by the averaging time.

    Parameters
    ----------
    residuals : sequence of PersonResiduals
        All on the same frequencies; otherwise nothing is found.
    alpha : float
        Probability of a false detection.

    Returns
    -------
    Hum or None
    """
    grid = residuals[0].frequency_hz
    if any(not np.array_equal(person.frequency_hz, grid) for person in residuals):
        return None
    repeated = any(len(person.white) > 1 for person in residuals)
    if not repeated and 2 * len(residuals) < _FEWEST_FREEDOM * _OVERLAP:
        return None
    contrasts = (_scatter if repeated else _roughness)(residuals)
    square, freedom = contrasts.mean_square, contrasts.freedom / (1.0 if repeated else _OVERLAP)
    near = (grid > _REACH[0] * LINES_HZ[0]) & (grid < _REACH[1] * LINES_HZ[-1])
    near[[0, -1]] &= repeated  # the ends have one neighbour
    if near.sum() < _FEWEST_POINTS or freedom[near].min() < _FEWEST_FREEDOM or not grid[0] < LINES_HZ[0] < grid[-1] / 2:
        return None
    grid, square, freedom, contrasts = grid[near], square[near], freedom[near], contrasts.at(near)
    y = np.log(square) - digamma(freedom / 2) + np.log(freedom / 2)
    weight = 1 / polygamma(1, freedom / 2)
    design = _spline(np.log(grid))
    misfit = _misfit(design, np.sqrt(weight))
    without = float(misfit(y))
    best: tuple[float, float, float, float, np.ndarray] | None = None
    shares = (np.ones(grid.size), contrasts.share_of_force)
    for first, periods, decay, share in product((*_FIRST_HZ, *LINES_HZ), PERIODS, _DECAYS, shares):
        p = share * pattern(grid, first, periods, decay)
        found = misfit(y - np.log1p(_AMPLITUDES[:, None] * (p if repeated else _beside(p))))
        k = int(np.argmin(found))
        if best is None or found[k] < best[0]:
            best = float(found[k]), float(first), float(_AMPLITUDES[k]), periods, p
    assert best is not None  # the grids are not empty
    least, first, amplitude, periods, p = best
    seen = p if repeated else _beside(p)
    line = min(LINES_HZ, key=lambda f: abs(first / f - 1))
    rough = max(least / (grid.size - design.shape[1] - 4), 1.0)
    tried = len(LINES_HZ) * len(PERIODS) * len(_DECAYS) * len(shares)
    from scipy.stats import norm

    p_value = bonferroni(float(norm.sf(np.sqrt(max(without - least, 0.0) / rough))), tried)
    if abs(first / line - 1) > _OF_MAINS or p_value > alpha:
        return None
    if not repeated:
        strongest = max(round(float(grid[int(np.argmax(p))]) / line), 1)
        rest = _misfit(design, np.sqrt(weight) * (np.abs(grid / (strongest * line) - 1) > 1 / periods))
        gain = float(rest(y) - np.min(rest(y - np.log1p(_AMPLITUDES[:, None] * seen)))) / rough
        if norm.sf(np.sqrt(max(gain, 0.0))) > alpha:
            return None
    fine = np.geomspace(amplitude / 10, amplitude * 10, 401)
    ratio = float(fine[int(np.argmin(misfit(y - np.log1p(fine[:, None] * seen))))])
    hum = _hum(grid, line, periods, ratio, p, seen, y, contrasts, p_value)
    return hum if hum.amplitude > 0.0 else None  # everybody's recordings at the strongest point show none


def _misfit(design: np.ndarray, root: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Weighted sum of squares (...) that a design (F, K) leaves of values (..., F); `root` (F,): roots of weights."""
    basis, _ = np.linalg.qr(design * root[:, None])

    def misfit(values: np.ndarray) -> np.ndarray:
        white = values * root
        return np.asarray(np.sum(white**2, axis=-1) - np.sum((white @ basis) ** 2, axis=-1))

    return misfit


def pattern(frequency_hz: np.ndarray, first_hz: float, periods: float, decay: float) -> np.ndarray:
    """p(f): variance of hum with harmonics falling as 1/h^decay after averaging over some periods, shape (F,)."""
    harmonics = np.arange(1, HARMONICS + 1)[:, None]
    window = np.sinc(periods * (harmonics * first_hz / frequency_hz - 1)) ** 2
    return np.asarray(np.sum(harmonics ** (-2 * decay) * window, axis=0))


@dataclass(frozen=True, eq=False)
class _Contrasts:
    """Contrasts of N people that contain no misfit, at F points.

    Attributes
    ----------
    energy, freedom_of : ndarray, shape (N, F)
        Squares relative to the impedance, summed, and how many numbers of unit variance that is in the units of the
        points' own variance.
    own : ndarray, shape (N,)
        Each person's mean square: weights are its inverse, so that all people count alike.
    inverse : ndarray, shape (N, F)
        Mean of 1/abs(z)^2: what a unit of additive variance contributes.
    """

    energy: np.ndarray
    freedom_of: np.ndarray
    own: np.ndarray
    inverse: np.ndarray

    @property
    def freedom(self) -> np.ndarray:
        """Degrees of freedom at each point, (F,)."""
        return np.asarray(self.freedom_of.sum(axis=0))

    @property
    def mean_square(self) -> np.ndarray:
        """Mean square at each point, relative to everybody's own, (F,)."""
        return np.asarray(np.sum(self.energy / self.own[:, None], axis=0) / np.maximum(self.freedom, 1e-12))

    @property
    def share_of_force(self) -> np.ndarray:
        """Mean square that the same additive variance has at each point, (F,), with a geometric mean of one."""
        share = np.sum(self.freedom_of * self.inverse / self.own[:, None], axis=0) / np.maximum(self.freedom, 1e-12)
        return np.asarray(share / np.exp(np.mean(np.log(share))))

    def at(self, points: np.ndarray) -> _Contrasts:
        """Some of the points only."""
        return _Contrasts(self.energy[:, points], self.freedom_of[:, points], self.own, self.inverse[:, points])


def _scatter(residuals: Sequence[PersonResiduals]) -> _Contrasts:
    """Contrasts between the repetitions of everybody who was recorded twice."""
    rows = []
    for person in residuals:
        if len(person.white) < 2:
            continue
        value, left = projected(person)
        magnitude = np.abs(person.model)
        value = value * person.sd / magnitude
        energy = np.sum(np.abs(value - value.mean(axis=0)) ** 2, axis=0)
        n = (1 - 1 / len(value)) * left.sum(axis=(0, 1))
        own = energy.sum() / n.sum()
        if own >= _ROUNDING**2:
            rows.append((energy, n, own, np.mean(magnitude**-2.0, axis=0)))
    return _contrasts(rows, residuals[0].frequency_hz.size)


def _contrasts(rows: Sequence[tuple[np.ndarray, np.ndarray, float, np.ndarray]], size: int) -> _Contrasts:
    if not rows:
        nothing = np.zeros((0, size))
        return _Contrasts(nothing, nothing, np.zeros(0), nothing)
    energy, n, own, inverse = (np.array(column) for column in zip(*rows, strict=True))
    return _Contrasts(energy, n, own, inverse)


def _roughness(residuals: Sequence[PersonResiduals]) -> _Contrasts:
    """Contrasts between neighbouring points; the two ends of the band have none.

    What all people have in common at a point is a misfit of the network, such as a narrow resonance, and is subtracted:
    the phase of the hum differs between them.
    """
    size = residuals[0].frequency_hz.size
    values, lefts = zip(*(projected(person) for person in residuals), strict=True)
    relative = np.array([v[0] * p.sd[0] / np.abs(p.model[0]) for v, p in zip(values, residuals, strict=True)])
    contrast = relative[:, 1:-1] - (relative[:, :-2] + relative[:, 2:]) / 2
    rough = np.flatnonzero(np.mean(np.abs(contrast) ** 2, axis=1) >= _ROUNDING**2)
    if rough.size < 2:
        return _contrasts([], size)
    contrast, lefts = contrast[rough], [lefts[i] for i in rough.tolist()]
    own = np.sum(np.abs(contrast) ** 2, axis=1, keepdims=True)
    weight = np.mean(own) / own
    contrast = contrast - np.sum(weight * contrast, axis=0) / weight.sum()
    n = np.zeros((rough.size, size))
    n[:, 1:-1] = np.array([_beside(left.sum(axis=(0, 1)))[1:-1] for left in lefts]) * (1 - weight / weight.sum())
    energy = np.zeros((rough.size, size))
    energy[:, 1:-1] = np.abs(contrast) ** 2 / _NEIGHBOURS
    inverse = np.array([np.abs(residuals[i].model[0]) ** -2.0 for i in rough.tolist()])
    return _Contrasts(energy, n, energy.sum(axis=1) / n.sum(axis=1), inverse)


def _beside(variance: np.ndarray) -> np.ndarray:
    """Variance (F,) of contrasts between neighbours, in units of :data:`_NEIGHBOURS`."""
    padded = np.concatenate([variance[:1], variance, variance[-1:]])
    return np.asarray((variance + (padded[:-2] + padded[2:]) / 4) / _NEIGHBOURS)


def _spline(log_f: np.ndarray) -> np.ndarray:
    """Cubic B-splines with about one knot per factor e, shape (F, K)."""
    inner = max(2, round(float(log_f[-1] - log_f[0])))
    knots = np.linspace(log_f[0], log_f[-1], inner + 1)
    step = knots[1] - knots[0]
    full = np.concatenate([knots[0] - step * np.arange(3, 0, -1), knots, knots[-1] + step * np.arange(1, 4)])
    return np.asarray(BSpline.design_matrix(np.clip(log_f, knots[0], knots[-1]), full, 3).toarray())


def _hum(
    grid: np.ndarray,
    line: float,
    periods: float,
    ratio: float,
    p: np.ndarray,
    seen: np.ndarray,
    y: np.ndarray,
    contrasts: _Contrasts,
    p_value: float,
) -> Hum:
    """The hum that was found; `ratio` is a, and `seen` p as it is in the contrasts."""
    strongest = int(np.argmax(p * (np.abs(grid / line - 1) < 0.5)))
    rms = np.sqrt(_mean_squares(contrasts, strongest, *_background(grid, y, seen, contrasts, strongest), seen / p))
    spoilt = grid[ratio * p > _AFFECTED]
    harmonics = [h for h in range(1, HARMONICS + 1) if np.any(np.abs(spoilt / (h * line) - 1) < 0.5 / periods)]
    kept = [f for f in spoilt.tolist() if min(abs(f / (h * line) - 1) for h in harmonics or [1]) <= 1 / periods]
    width = max((min(abs(f / (h * line) - 1) for h in harmonics) for f in kept), default=0.0) if harmonics else 0.0
    return Hum(
        line_hz=line,
        harmonics=tuple(harmonics or [1]),
        frequencies_hz=tuple(kept or [float(grid[strongest])]),
        near=float(width),
        amplitude=float(rms[0]),
        q05=float(rms[1]),
        q95=float(rms[2]),
        coherent=False,
        p_value=p_value,
    )


def _background(
    grid: np.ndarray, y: np.ndarray, seen: np.ndarray, contrasts: _Contrasts, strongest: int
) -> tuple[float, float]:
    """B at the strongest point from the nearest points without hum on either side, and its degrees of freedom."""
    free = np.flatnonzero(seen < _WITHOUT * seen[strongest])
    below, above = free[free < strongest][-_NEAREST:], free[free > strongest][:_NEAREST]
    sides = [side for side in (below, above) if side.size]
    if not sides:  # hum everywhere: the least of it
        return float(np.exp(y.min())), float(contrasts.freedom[strongest])
    x = [float(np.mean(np.log(grid[side]))) for side in sides]
    level = float(np.interp(np.log(grid[strongest]), x, [float(np.mean(y[side])) for side in sides]))
    return float(np.exp(level)), float(sum(contrasts.freedom[side].sum() for side in sides))


def _mean_squares(
    contrasts: _Contrasts, strongest: int, background: float, freedom: float, share: np.ndarray
) -> np.ndarray:
    """Mean square of the hum's real or imaginary part at a point, with the ends of its 90 % interval."""
    n = contrasts.freedom_of[:, strongest]
    energy, noise = contrasts.energy[:, strongest], background * contrasts.own
    unit = contrasts.inverse[:, strongest] * share[strongest]
    scale = float(np.median(noise / unit))
    grid = scale * np.r_[0.0, np.geomspace(1e-3, 1e6, 4001)]

    def deviance(times: float) -> np.ndarray:
        """Minus twice the log likelihood at the grid, with so many times the background: an array as the grid."""
        total = times * noise + grid[:, None] * unit
        return np.asarray(np.sum(n * np.log(total) + energy / total, axis=1))

    values = deviance(1.0)
    best = int(np.argmin(values))
    inside = np.flatnonzero(values < values[best] + CHI_SQUARE_Q90)
    # The background is known to its own degrees of freedom.
    error = NORMAL_Q95 * np.sqrt(2 / freedom)
    least, most = (float(grid[int(np.argmin(deviance(times)))]) for times in (np.exp(error), np.exp(-error)))
    low = grid[best] - np.hypot(grid[best] - grid[inside[0]], grid[best] - least)
    return np.array(
        [grid[best], max(low, 0.0), grid[best] + np.hypot(grid[inside[-1]] - grid[best], most - grid[best])]
    )
