r"""Hum of the electric mains: a narrow additive line at 50 or 60 Hz and its harmonics.

Hum has the phase of the mains, which is random in each recording unless the recording is synchronised to them. So it
appears as excess scatter at few points (:mod:`~bayes_impedance.diagnosis.hum.neighbours`) or, if synchronised, as the
same error in all recordings. Hum must not extend to the neighbouring points, and it must scatter between the
repetitions of a person: a badly described resonance is wide, and the same in all repetitions. An undamped resonance of
one person can be as narrow as hum; so hum must also be found without the people in whom it is strongest by far.

Weak hum may be significant at no single harmonic. Therefore Fisher's combination of the first m of them,

.. math:: -2 \sum_{k \le m} \ln p_k \sim \chi^2_{2m},

is also tested for a few m. If the smallest of these p-values is significant, those of its harmonics that are
significant at 1 % by themselves count as affected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.hum.neighbours import Excess, Neighbourhood, around, excess, predicted, projected
from bayes_impedance.diagnosis.multiple_testing import bonferroni
from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.units import NORMAL_Q95

LINES_HZ = (50.0, 60.0)
"""Nominal frequencies of public mains."""

HARMONICS = 10
"""Above the tenth, 3 % reach from one harmonic nearly to the next."""

NEAR = 0.03
"""A point further from a harmonic than this fraction of its frequency is not attributed to hum. By choice."""

_MAINS_ACCURACY = 0.01
"""On a dense grid, hum may deviate from its nominal frequency by this fraction; on others, by the spacing of points. By
choice."""

_COMBINED = (2, 3, 5, 10)
"""Numbers of harmonics whose p-values are combined, for hum with few harmonics and with many. By choice: each number is
one more test to correct for."""

_AFFECTED_P = 0.01
"""Level at which a single harmonic counts as affected once the combination is significant. By choice."""

_ENOUGH_TO_OMIT = 5
"""Number of people from which hum must be found without the one in whom it is strongest as well, of many without up to
one in so many. By choice: hum is in everybody's recordings, so that four fifths of them show it as well; a resonance at
the line's frequency is in those of a few people only."""

_OUTLYING = 10.0
"""Residual energy at the affected points, over the median person's, from which people are omitted. By choice: of the
hum's chi-square with two degrees of freedom one in a thousand is above it, and narrow resonances are at a hundred."""

CHI_SQUARE_Q90 = NORMAL_Q95**2
"""Drop of twice the log likelihood at the ends of a 90 % interval: chi-square with one degree of freedom."""


@dataclass(frozen=True, kw_only=True)
class Hum:
    """Hum that was found.

    Attributes
    ----------
    line_hz : float
        50 or 60.
    harmonics : tuple of int
        Those that are affected.
    frequencies_hz : tuple of float
        Points of the recordings that are affected.
    near : float
        Largest relative distance of an affected point from its harmonic.
    amplitude, q05, q95 : float
        Root mean square of the hum's real and of its imaginary part, over recordings and affected harmonics, in the
        impedance's unit, with its 90 % interval.
    coherent : bool
        Whether it is the same in all recordings rather than of random phase.
    p_value : float
        Corrected for all tests at both lines.
    """

    line_hz: float
    harmonics: tuple[int, ...]
    frequencies_hz: tuple[float, ...]
    near: float
    amplitude: float
    q05: float
    q95: float
    coherent: bool
    p_value: float


@dataclass(frozen=True, eq=False)  # a test is equal to itself only
class _Test:
    """Test of one point near one harmonic, for excess scatter or (`coherent`) for a common error in all recordings."""

    harmonic: int
    column: int
    table: Neighbourhood
    excess: Excess
    coherent: bool

    @property
    def frequency_hz(self) -> np.ndarray:
        """Frequency of the point in each recording that has it, in Hz."""
        column = self.table.frequency_hz[:, self.column]
        return np.asarray(column[np.isfinite(column)])


def find_mains(residuals: Sequence[PersonResiduals], alpha: float = 0.01, absolute: bool = True) -> Hum | None:
    """Look for hum of the mains.

    Parameters
    ----------
    residuals : sequence of PersonResiduals
    alpha : float
        Probability of a false detection.
    absolute : bool
        Predict the noise at the line from neighbouring points, because the estimated noise may contain the hum. If
        False, the estimated noise is used.

    Returns
    -------
    Hum or None
        None if no hum was found, or if no point is near a harmonic and has enough neighbours.

    Raises
    ------
    InputError
        If there are no residuals.
    """
    if not residuals:
        raise InputError("there are no residuals to look for hum in: give at least one subject's")
    found = _found(residuals, alpha, absolute)
    if found is None or len(residuals) < _ENOUGH_TO_OMIT:
        return found
    energy = np.array(
        [
            np.sum(np.abs(projected(person)[0][:, affected_points(person.frequency_hz, found)]) ** 2)
            for person in residuals
        ]
    )
    order = np.argsort(energy)[::-1]
    outlying = int(np.count_nonzero(energy > _OUTLYING * np.median(energy)))
    omitted = set(order[: int(np.clip(outlying, 1, len(residuals) // _ENOUGH_TO_OMIT))].tolist())
    others = [person for i, person in enumerate(residuals) if i not in omitted]
    return found if _found(others, alpha, absolute) is not None else None


def _found(residuals: Sequence[PersonResiduals], alpha: float, absolute: bool) -> Hum | None:
    projections = [projected(person) for person in residuals]
    tests: dict[float, list[_Test]] = {}
    combined: dict[float, list[tuple[float, list[_Test]]]] = {}
    for line in LINES_HZ:
        tests[line] = []
        for harmonic in range(1, HARMONICS + 1):
            others = line * np.arange(1, 2 * HARMONICS + 1)
            table = around(residuals, projections, harmonic * line, NEAR, others)
            if table is not None:
                table = predicted(table, harmonic * line) if absolute else table
                tests[line] += _tests(table, harmonic, line)
        combined[line] = _combined(tests[line])
    tried = sum(len(tests[line]) + len(combined[line]) for line in LINES_HZ)

    affected: dict[float, list[_Test]] = {}
    for line in LINES_HZ:
        p_value, members = min(combined[line], key=lambda c: c[0], default=(1.0, []))
        members = members if bonferroni(p_value, tried) < alpha else []
        affected[line] = [t for t in tests[line] if bonferroni(t.excess.p_value, tried) < alpha or t in members]

    def evidence(line: float) -> tuple[float, int]:
        # 300 and 600 Hz are harmonics of both lines: without other evidence the line with the lower harmonic is named.
        strongest = _strongest(affected[line])
        gain = sum(-np.log10(max(t.excess.p_value, 1e-300)) for t in strongest)
        return float(gain), -min((t.harmonic for t in strongest), default=HARMONICS + 1)

    line = max(LINES_HZ, key=evidence)
    if not affected[line]:
        return None
    strongest = _strongest(affected[line])
    smallest = min([t.excess.p_value for t in affected[line]] + [p for p, _ in combined[line]])
    amplitude, q05, q95 = _amplitude(strongest)
    return Hum(
        line_hz=line,
        harmonics=tuple(t.harmonic for t in strongest),
        frequencies_hz=tuple(np.unique(np.concatenate([t.frequency_hz for t in affected[line]])).tolist()),
        near=max(float(np.max(np.abs(t.frequency_hz / (t.harmonic * line) - 1))) for t in affected[line]),
        amplitude=amplitude,
        q05=q05,
        q95=q95,
        coherent=min(strongest, key=lambda t: t.excess.p_value).coherent,
        p_value=float(bonferroni(smallest, tried)),
    )


def affected_points(frequency_hz: np.ndarray, hum: Hum) -> np.ndarray:
    """Points of a grid (F,) within the same relative distance of an affected harmonic as the hum found: bool (F,)."""
    harmonics = hum.line_hz * np.array(hum.harmonics, dtype=float)
    return np.asarray(np.any(np.abs(frequency_hz[:, None] / harmonics - 1) <= hum.near + 1e-9, axis=1))


def _tests(table: Neighbourhood, harmonic: int, line: float) -> list[_Test]:
    """All points near one harmonic, the nearest one first."""
    middle = table.middle
    spacing = np.nanmedian(np.diff(np.log(table.frequency_hz[:, middle - 1 : middle + 2]), axis=1))
    distance = np.abs(table.frequency_hz / (harmonic * line) - 1)
    # A point beside the nearest one counts if it is near in all recordings.
    near = np.all(distance <= min(NEAR, max(float(spacing), _MAINS_ACCURACY)), axis=0)
    near[middle] = True
    columns = sorted(np.flatnonzero(near).tolist(), key=lambda column: abs(column - middle))
    return [
        _Test(harmonic, column, table, excess(table, column, near, coherent), coherent)
        for column in columns
        for coherent in (False, True)
    ]


def _combined(tests: Sequence[_Test]) -> list[tuple[float, list[_Test]]]:
    """Combined p-values of the scatter at the first few harmonics' nearest points, each with its affected tests."""
    from scipy.stats import chi2

    nearest = [t for t in tests if t.column == t.table.middle and not t.coherent]
    result = []
    for m in sorted({min(m, len(nearest)) for m in _COMBINED} - {0, 1}):
        statistic = -2 * float(np.sum(np.log([max(t.excess.p_value, 1e-300) for t in nearest[:m]])))
        least = min(t.excess.p_value for t in nearest[:m])
        members = [t for t in nearest[:m] if t.excess.p_value <= max(_AFFECTED_P, least)]
        result.append((float(chi2.sf(statistic, 2 * m)), members))
    return result


def _strongest(tests: Sequence[_Test]) -> list[_Test]:
    """The most significant test of each harmonic."""
    best: dict[int, _Test] = {}
    for t in sorted(tests, key=lambda t: (t.harmonic, -t.excess.p_value)):
        best[t.harmonic] = t
    return list(best.values())


def _amplitude(tests: Sequence[_Test]) -> tuple[float, float, float]:
    """Root mean square of the hum's real or imaginary part over harmonics, and the ends of its 90 % interval."""
    squares = []
    for test in tests:
        table, column, level = test.table, test.column, test.excess.level
        known = np.isfinite(table.value[:, column])
        value, left, sd = table.value[known, column], table.left[:, known, column], table.sd[known, column]
        parts = np.array([value.real, value.imag])
        if test.coherent:
            weight = np.sum(left / sd**2, axis=1)
            size = float(np.linalg.norm(np.sum(parts / sd, axis=1) / weight))
            error = NORMAL_Q95 * float(np.sqrt(level / weight.mean()))
            squares.append((size**2 / 2, max(size - error, 0.0) ** 2 / 2, (size + error) ** 2 / 2))
        else:
            squares.append(_variance(parts**2 / level, left, level * sd**2, test.excess.freedom))
    best, low, high = np.array(squares).T
    # For a sum of independent terms, the distances to the interval's ends add in quadrature.
    lower = np.sqrt(np.sum((best - low) ** 2)) / best.size
    upper = np.sqrt(np.sum((high - best) ** 2)) / best.size
    mean = float(best.mean())
    return float(np.sqrt(mean)), float(np.sqrt(max(mean - lower, 0.0))), float(np.sqrt(mean + upper))


def _variance(energy: np.ndarray, left: np.ndarray, variance: np.ndarray, freedom: float) -> tuple[float, float, float]:
    """Maximum-likelihood mean square of the hum's real or imaginary part, with its 90 % interval.

    Parameters
    ----------
    energy, left : ndarray, shape (2, R)
        Squared projected residuals over the noise variance, and 1 - leverage. Their mean is `left` for noise alone; hum
        of mean square a adds left^2 a / variance.
    variance : ndarray, shape (R,)
        Of the noise.
    freedom : float
        Degrees of freedom of the noise variance.
    """
    from scipy.optimize import brentq, minimize_scalar

    left = np.maximum(left, 1e-6)
    unit = float(np.median(variance))

    def deviance(log_a: float) -> float:
        total = left * (1 + left * np.exp(log_a) * unit / variance)
        return float(np.sum(np.log(total) + energy / total))

    top = float(np.log(np.max(energy / left**2 * variance) / unit + 1.0)) + 1.0
    best = float(minimize_scalar(deviance, bounds=(-12.0, top), method="bounded").x)
    limit = deviance(best) + CHI_SQUARE_Q90

    def beyond(log_a: float) -> float:
        return deviance(log_a) - limit

    ends = [brentq(beyond, best, end) if beyond(end) > 0 else end for end in (-16.0, top + 3.0)]
    a, low, high = (float(np.exp(v)) * unit for v in (best, *ends))
    level = NORMAL_Q95 * np.sqrt(2 / freedom) * unit
    return a, a - float(np.hypot(a - low, level)), a + float(np.hypot(high - a, level))


def without_hum(recordings: Recordings, hum: Hum) -> Recordings:
    """The recordings without the points that are affected by hum."""
    subjects = tuple(s.at(~affected_points(s.frequency_hz, hum)) for s in recordings.subjects)
    return replace(recordings, subjects=subjects)
