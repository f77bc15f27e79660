r"""F test of the points nearest to one frequency against their neighbours in frequency.

All recordings are aligned at that point. With white residuals r, their leverage h and an orthonormal basis Q of the
elements' tangent space, column k has the mean square

.. math:: x_k = \sum |(1-QQ^T) r|_k^2 \Big/ \sum (1 - h_k), \qquad F = x_k / \bar x

over all recordings; for a common error of all recordings it is the square of their sum, with two degrees of freedom.
The neighbours' mean square is the level :math:`\bar x`, for a common error at least that of independent recordings. The
noise is not known exactly from point to point: the scatter e^2 of ln x over the neighbours in excess of chance limits
how well they predict the point. So the level is given the degrees of freedom that correspond to this variance,
:math:`2/\nu = 2/\nu_{\bar x} + e^2`.

A noise shape that was estimated from repetitions may already contain the excess, and whitening then hides it.
Therefore the noise is predicted in *absolute* units from that of the neighbours: by a parabola in log frequency through
the logarithm of sd or of sd/\|Z\|, whichever fits better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.residuals.nodes import MINIMUM_CONTRASTS, contrast_matrix

_LEAST_COLUMNS, _MOST_COLUMNS = 40, 300
"""Smallest and largest number of points used on either side: on coarse grids more than the neighbours, on dense ones
not all. By choice."""

_REACH_OCTAVES = (0.5, 1.0, 1.5)
"""Distance up to which points are neighbours; the first with enough of them is used, because the noise may differ at
larger distances. By choice."""

_FARTHEST_OCTAVES = (2.0, 3.0, 4.0)
"""The same for frequencies with neighbours on both sides, as low ones of a coarse grid have. Noise mostly rises toward
low frequencies, the faster the lower they are: a line lies above it between neighbours, and below beyond them. By
choice."""

_FEWEST_NEIGHBOURS = 8
"""Smallest number of neighbours in each recording: a parabola takes three, and the others give the scatter. By
choice."""

_FLANK, _FLANK_P, _FLANK_RATIO = 2, 0.01, 30.0
"""Number of points on either side that must not be significant at this level, unless the mean square of the point
itself is so many times theirs: strong hum leaks into them through the analyser's window. By choice."""

_SAME_P = 0.01
"""Level at which the people's means must exceed the contrasts for the contrasts alone to be used. By choice."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Neighbourhood:
    """R recordings, or contrasts of them, at K columns; the point nearest to the frequency is in the middle.

    Attributes
    ----------
    frequency_hz : ndarray, shape (R, K)
        NaN where a grid has no point.
    value : ndarray, complex, shape (R, K)
        Projected residual over the noise.
    left : ndarray, shape (2, R, K)
        1 - leverage of the real and of the imaginary part.
    sd : ndarray, shape (R, K)
        The noise by which residuals were divided.
    magnitude : ndarray, shape (R, K)
        |Z|.
    neighbour : ndarray of bool, shape (R, K)
    owner : ndarray of int, shape (R,)
        Person.
    level_error : float
        Variance of the log noise predicted at the point, in units of the neighbours' scatter.
    """

    frequency_hz: np.ndarray
    value: np.ndarray
    left: np.ndarray
    sd: np.ndarray
    magnitude: np.ndarray
    neighbour: np.ndarray
    owner: np.ndarray
    level_error: float = 0.0

    @property
    def middle(self) -> int:
        """Column of the nearest point."""
        return int(self.frequency_hz.shape[1] // 2)

    def mean_square(self, rows: np.ndarray, together: bool) -> tuple[np.ndarray, np.ndarray]:
        """Mean squares of the columns over the points in `rows` (R, K), and their degrees of freedom, shape (K,)."""
        known = rows & np.isfinite(self.value)
        value, left = np.where(known, self.value, 0.0), np.where(known, self.left.sum(axis=0), 0.0)
        total = left.sum(axis=0)
        if together:
            energy, freedom = np.abs(value.sum(axis=0)) ** 2, np.where(total > 0, 2.0, 0.0)
        else:
            energy, freedom = np.sum(np.abs(value) ** 2, axis=0), total
        return energy / np.maximum(total, 1e-12), freedom

    def between_repetitions(self, column: int) -> tuple[float, float] | None:
        """Mean square of the contrasts at a column, and its degrees of freedom.

        None if there are too few, or if the people's means are not significantly larger and can be used as well.
        """
        from scipy.stats import f

        known = np.isfinite(self.value[:, column])
        matrix = contrast_matrix(self.owner[known])
        if matrix.shape[0] < MINIMUM_CONTRASTS:
            return None
        value, left = self.value[known, column], self.left[:, known, column].sum(axis=0)
        contrast, n = float(np.sum(np.abs(matrix @ value) ** 2)), float(np.sum(matrix**2 @ left))
        mean, n_mean = float(np.sum(np.abs(value) ** 2)) - contrast, float(left.sum()) - n
        same = f.sf(mean / n_mean / (contrast / n), n_mean, n) < _SAME_P
        return (contrast / n, n) if same else None


@dataclass(frozen=True)
class Excess:
    """Comparison of a column with its neighbours: p-value, their level, and the degrees of freedom of the level."""

    p_value: float
    level: float
    freedom: float


def projected(person: PersonResiduals) -> tuple[np.ndarray, np.ndarray]:
    """Projected residuals, complex (J, F), and 1 - leverage of real and imaginary parts (2, J, F)."""
    f = person.frequency_hz.size
    outside = person.outside(person.white)
    left = 1 - np.sum(person.basis**2, axis=2)
    return outside[:, :f] + 1j * outside[:, f:], np.array([left[:, :f], left[:, f:]])


def around(
    residuals: Sequence[PersonResiduals],
    projections: Sequence[tuple[np.ndarray, np.ndarray]],
    frequency: float,
    near: float,
    excluded_hz: np.ndarray,
) -> Neighbourhood | None:
    """Align all recordings at the point nearest to a frequency.

    Parameters
    ----------
    residuals : sequence of PersonResiduals
    projections : sequence of tuple
        Of `projected`.
    frequency : float
    near : float
        Persons whose nearest point is further away, relative to the frequency, are left out.
    excluded_hz : ndarray, shape (E,)
        Points that are as near to one of these are not used as neighbours.

    Returns
    -------
    Neighbourhood or None
        None if no person has a near point, or if any recording has too few neighbours.
    """
    log_f = np.log(frequency)
    closest = [int(np.argmin(np.abs(np.log(p.frequency_hz) - log_f))) for p in residuals]
    chosen = [i for i, k in enumerate(closest) if abs(residuals[i].frequency_hz[k] / frequency - 1) <= near]
    if not chosen:
        return None
    reach = _REACH_OCTAVES[0] * np.log(2)
    points = max(int(np.sum(np.abs(np.log(residuals[i].frequency_hz) - log_f) < reach)) for i in chosen)
    offset = np.arange(-(half := int(np.clip(points, _LEAST_COLUMNS, _MOST_COLUMNS))), half + 1)
    rows: dict[str, list[np.ndarray]] = {"frequency": [], "value": [], "left": [], "sd": [], "magnitude": []}
    for i in chosen:
        person = residuals[i]
        index = closest[i] + offset
        inside = (index >= 0) & (index < person.frequency_hz.size)
        grid = np.broadcast_to(person.frequency_hz, person.model.shape)
        for key, values in zip(rows, (grid, *projections[i], person.sd, np.abs(person.model)), strict=True):
            rows[key].append(np.where(inside, values[..., np.where(inside, index, 0)], np.nan))
    stacked = {key: np.concatenate(values, axis=-2) for key, values in rows.items()}
    frequency_hz = stacked["frequency"]
    owner = np.repeat(chosen, [residuals[i].model.shape[0] for i in chosen])
    away = np.all(np.abs(frequency_hz[..., None] / excluded_hz - 1) > near, axis=-1) & np.isfinite(frequency_hz)
    distance = np.log2(frequency_hz / frequency)
    for octaves in (*_REACH_OCTAVES, *_FARTHEST_OCTAVES):
        neighbour = away & (np.abs(distance) <= octaves)
        between = all(np.any(neighbour & (side * distance > 0), axis=1).all() for side in (-1, 1))
        if neighbour.sum(axis=1).min() >= _FEWEST_NEIGHBOURS and (between or octaves <= _REACH_OCTAVES[-1]):
            return Neighbourhood(
                frequency_hz=frequency_hz,
                value=stacked["value"],
                left=stacked["left"],
                sd=stacked["sd"],
                magnitude=stacked["magnitude"],
                neighbour=neighbour,
                owner=owner,
            )
    return None


def predicted(table: Neighbourhood, frequency: float) -> Neighbourhood:
    """The table whitened by the noise that a parabola through the neighbours predicts."""
    u = np.nan_to_num(np.log(table.frequency_hz / frequency))
    scale = np.max(np.abs(u) * table.neighbour)
    u = np.clip(u, -scale, scale)  # points further away are not used
    sides = min(int(np.sum(table.neighbour & (side * u > 0), axis=1).min()) for side in (-1, 1))
    design = (u / scale)[..., None] ** np.arange(3 if sides >= 3 else 2)
    weighted = design * table.neighbour[..., None]
    inverse = np.linalg.inv(weighted.transpose(0, 2, 1) @ weighted)

    def fit(log_sd: np.ndarray) -> tuple[np.ndarray, float]:
        known = np.where(table.neighbour, log_sd, 0.0)
        coefficients = inverse @ (weighted.transpose(0, 2, 1) @ known[..., None])
        fitted = (design @ coefficients)[..., 0]
        return fitted, float(np.sum((known - fitted)[table.neighbour] ** 2))

    absolute, misfit = fit(np.log(table.sd))
    relative, misfit_relative = fit(np.log(table.sd / table.magnitude))
    sd = np.exp(relative) * table.magnitude if misfit_relative < misfit else np.exp(absolute)
    return replace(table, value=table.value * (table.sd / sd), sd=sd, level_error=float(inverse[:, 0, 0].mean()))


def excess(table: Neighbourhood, column: int, meant: np.ndarray, together: bool) -> Excess:
    """Compare a column with its neighbours.

    Parameters
    ----------
    table : Neighbourhood
    column : int
    meant : ndarray of bool, shape (K,)
        Columns that may have the same excess. The flanks are the nearest two others on either side of the column.
    together : bool
        Test for a common error in all recordings instead of scatter.

    Returns
    -------
    Excess
        For scatter, only that between the repetitions of a person if the people's means scatter more. The p-value is 1
        where the flanks are significant as well, unless they are far lower: hum is narrow.
    """
    from scipy.special import polygamma
    from scipy.stats import f

    x, n = table.mean_square(table.neighbour, together)
    used = n > 0.5 * n.max()
    level, freedom = float(np.sum(x[used] * n[used]) / n[used].sum()), float(n[used].sum())
    if not together:  # with two degrees of freedom each, chance scatters too much to estimate the excess
        wiggle = float(np.var(np.log(np.maximum(x[used], 1e-12)), ddof=1))
        beyond = max(wiggle - float(np.mean(polygamma(1, n[used] / 2))), 0.0)
        freedom = 2.0 / (2.0 / freedom + beyond + table.level_error * wiggle)
    else:  # the sum of independent recordings scatters as much as they do, and less only by chance
        own, own_n = table.mean_square(table.neighbour, together=False)
        level = max(level, float(np.sum(own[used] * own_n[used]) / own_n[used].sum()))

    x, n = table.mean_square(np.isfinite(table.frequency_hz), together)
    places = np.flatnonzero((n > 0.5 * n.max()) & ~meant)
    flank = np.concatenate([places[places < column][-_FLANK:], places[places > column][:_FLANK]])
    beside, beside_n = float(np.sum(x[flank] * n[flank]) / n[flank].sum()), float(n[flank].sum())
    wide = f.sf(beside / level, beside_n, freedom) < _FLANK_P and x[column] < _FLANK_RATIO * beside
    at, at_n = float(x[column]), float(n[column])
    if not together and (contrast := table.between_repetitions(column)):
        at, at_n = contrast
    return Excess(1.0 if wide else float(f.sf(at / level, at_n, freedom)), level, freedom)
