r"""Frequency bands in which residuals have structure, in magnitude or phase, and the people who have it.

:mod:`~bayes_impedance.diagnosis.residuals.windows` computes the significance of many windows. Here the significant ones
are selected one after the other. The most significant window explains a part of the structure; with its template A
absorbed from the pooled sums x,

.. math:: x \leftarrow x - C A (A^T C A)^{-1} A^T x, \qquad C \leftarrow C - C A (A^T C A)^{-1} A^T C,

the next one is selected from the remainder, until none is significant. Among windows that explain almost as much, the
narrowest is taken. So a structure that the free elements have spread over all frequencies is reported at its origin,
and not wherever it can be seen.

Coherent structure is selected first. The remainder, after fitting its amplitude in each recording, is searched for
incoherent structure. Templates of this kind are also absorbed with an amplitude for each recording; windows in which
only the energy is too large are masked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.multiple_testing import bonferroni
from bayes_impedance.diagnosis.residuals.amplitudes import Amplitudes, carriers, energy_amplitudes, pattern_amplitudes
from bayes_impedance.diagnosis.residuals.nodes import MINIMUM_CONTRASTS, Pooled, pool, turn
from bayes_impedance.diagnosis.residuals.windows import (
    Null,
    Ratios,
    Windows,
    normal_score,
    null_distributions,
    refined,
    scatter_between,
    scatter_ratios,
    variances,
    visible,
    windows,
)
from bayes_impedance.errors import InputError

Noise = Literal["repetitions", "assumed"]

_PARTS: tuple[Literal["magnitude"], Literal["phase"]] = ("magnitude", "phase")
_MOST_WINDOWS = 12
"""Largest number of windows of one kind. By choice: a structure in more of them is described by those that explain
most."""

_LEAST_SHARE = {"coherent": 0.01, "incoherent": 0.05}
"""Fraction of the largest gain that a further window must explain: smaller gains come from the difference between
template and true shape. By choice."""

_NEARLY = 0.8
"""Fraction of the energy's statistic from which a template is preferred: unlike energy, it has a shape and a sign. By
choice."""

_VISIBLE = 0.1
"""Fraction of a template's variance that previous windows must leave for it to be tested. By choice."""

_ONE_PART = 0.8
"""Share of the structure from which it is reported in magnitude alone, or in phase alone. By choice."""

_EXCESS = {"repetitions": 1.02, "assumed": 1.3}
"""Ratio of variance between persons to noise up to which it is not called structure: error of the linear theory, and of
the noise if it was not estimated from repetitions. By choice."""


@dataclass(frozen=True, kw_only=True)
class MismatchBand:
    """A band of frequencies with structure in it.

    Attributes
    ----------
    low_hz, high_hz : float
    part : {"magnitude", "phase"}
    kind : {"coherent", "incoherent"}
        Whether the structure is the same in all people or differs between them.
    statistic : float
        Normal score of the null hypothesis; signed if coherent (the sign where the magnitude or phase is too large
        is positive, or of the slope or bend if its mean is zero).
    p_value : float
        Corrected for all tests.
    """

    low_hz: float
    high_hz: float
    part: Literal["magnitude", "phase"]
    kind: Literal["coherent", "incoherent"]
    statistic: float
    p_value: float


@dataclass(frozen=True, kw_only=True)
class Location:
    """Where structure remains.

    Attributes
    ----------
    p_value : float
        Of the hypothesis that there is none, corrected for all tests.
    bands : tuple of MismatchBand
        Most significant first; disjoint within a part and kind; empty if there is no significant structure.
    part : {"magnitude", "phase", "both"}
        Which has more than four fifths of the structure; "both" if neither has.
    magnitude_share : float
        Part of the structure, as chi-square, that is in magnitude; NaN if there is none.
    subjects : "all" or tuple of str
        The people who have it, if a minority.
    subjects_p_value : float
        Largest corrected p-value of a named person; 1 if nobody is named.
    """

    p_value: float
    bands: tuple[MismatchBand, ...]
    part: Literal["magnitude", "phase", "both"]
    magnitude_share: float
    subjects: Literal["all"] | tuple[str, ...]
    subjects_p_value: float


@dataclass(frozen=True, kw_only=True)
class _Found:
    """One window: nodes low <= k < high of a part, what it explains, and its template (None for energy)."""

    low: int
    high: int
    part: int
    kind: Literal["coherent", "incoherent"]
    statistic: float
    p_value: float
    gain: float
    template: np.ndarray | None
    noise: float = 1.0


def locate(
    residuals: Sequence[PersonResiduals],
    seed: int,
    alpha: float = 0.01,
    draws: int = 500,
) -> Location:
    """Find where structure remains in the residuals.

    Parameters
    ----------
    residuals : sequence of PersonResiduals
        N persons.
    seed : int
        For the Monte-Carlo draws.
    alpha : float
        Probability of a false detection.
    draws : int
        Number of draws of the null distribution.

    Raises
    ------
    InputError
        If there are no residuals.
    """
    if not residuals:
        raise InputError("there are no residuals to locate structure in: give at least one subject's")
    pooled = pool(residuals)
    scan = windows(pooled.frequency_hz)
    covariance = pooled.covariance()
    usable = visible(pooled, scan, covariance)
    pairs = pooled.owner.size - pooled.persons
    noise: Noise = "repetitions" if pairs >= MINIMUM_CONTRASTS else "assumed"
    rng = np.random.default_rng(seed)
    nulls = null_distributions(pooled, scan, usable, pairs if noise == "repetitions" else 0, rng, draws)
    kinds = 1 if pooled.persons == 1 else 2

    limits = [null.threshold(alpha / kinds) for null in nulls]
    ratios = scatter_ratios(pooled, scan, use_contrasts=noise == "repetitions")
    coherent, p_coherent = _coherent(pooled, scan, covariance, usable, ratios, nulls[0], limits[0], kinds)
    found, p_value = coherent, bonferroni(p_coherent, kinds)
    if kinds == 2:
        templates = [f.template for f in coherent if f.template is not None]
        left = pooled.without(np.array(templates).T) if templates else pooled
        ratios = scatter_ratios(left, scan, use_contrasts=noise == "repetitions") if templates else ratios
        largest = max((f.gain for f in coherent), default=0.0)
        incoherent, p_incoherent = _incoherent(left, scan, usable, ratios, nulls[1], limits[1], noise, largest)
        found, p_value = coherent + incoherent, min(p_value, bonferroni(p_incoherent, kinds))

    named, p_named = carriers(_amplitudes(pooled, found), alpha) if found else (np.zeros(0, dtype=int), 1.0)
    total = sum(f.gain for f in found)
    share = sum(f.gain for f in found if f.part == 0) / total if total > 0 else float("nan")
    return Location(
        p_value=float(p_value),
        bands=_bands(found, pooled.frequency_hz),
        part="magnitude" if share > _ONE_PART else "phase" if share < 1 - _ONE_PART else "both",
        magnitude_share=float(share),
        subjects=tuple(residuals[int(i)].name for i in named) or "all",
        subjects_p_value=p_named,
    )


def _coherent(
    pooled: Pooled,
    scan: Windows,
    covariance: np.ndarray,
    usable: np.ndarray,
    ratios: Ratios,
    null: Null,
    limit: float,
    kinds: int,
) -> tuple[list[_Found], float]:
    """Coherent windows, and the p-value of the first, whether significant or not."""
    templates = scan.templates()
    usable = usable[: templates.shape[1]]
    scatter = np.ones(usable.size)
    if pooled.persons > 1:
        scatter = np.maximum((ratios.excess * ratios.noise)[: usable.size], 1.0)
    whole = variances(covariance, templates)
    found: list[_Found] = []
    p_first = 1.0
    sums, left = pooled.scores.sum(axis=0), covariance
    for _ in range(_MOST_WINDOWS):
        variance = np.sum(templates * (left @ templates), axis=0)
        seen = usable & (variance > _VISIBLE * whole)
        z = np.where(seen, templates.T @ sums / np.sqrt(np.where(seen, variance, 1.0)), 0.0)
        c = np.abs(z) / np.sqrt(scatter)

        def explained(shapes: np.ndarray, x: np.ndarray = sums, covariance: np.ndarray = left) -> np.ndarray:
            variance = np.sum(shapes * (covariance @ shapes), axis=0)
            return np.asarray((shapes.T @ x) ** 2 / np.maximum(variance, 1e-6))

        # Significance is judged by c. Among significant templates z ranks: c saturates with the structure's size.
        best, low, high, template = refined(pooled, scan, np.where(c >= min(limit, c.max()), z**2, 0.0), explained)
        gain = float(explained(template[:, None])[0])
        if not found:
            p_first = null.p_value(float(c.max()))
        if c.max() < limit or (found and gain < _LEAST_SHARE["coherent"] * max(f.gain for f in found)):
            break
        p_value, statistic = bonferroni(null.p_value(float(c[best])), kinds), float(np.sign(z[best]) * c[best])
        part = best // scan.window.size
        found.append(
            _Found(
                low=low,
                high=high,
                part=part,
                kind="coherent",
                statistic=statistic,
                p_value=p_value,
                gain=gain,
                template=template,
            )
        )
        direction = left @ template
        direction /= np.sqrt(template @ direction)
        sums = sums - direction * (template @ sums) / np.sqrt(template @ left @ template)
        left = left - np.outer(direction, direction)
    return found, p_first


def _incoherent(
    pooled: Pooled,
    scan: Windows,
    usable: np.ndarray,
    ratios: Ratios,
    null: Null,
    limit: float,
    noise: Noise,
    largest: float,
) -> tuple[list[_Found], float]:
    """Incoherent windows, and the p-value of the first, whether significant or not."""
    t, b = scan.window.size, scan.low.size
    part = np.concatenate([np.repeat([0, 1], t), np.repeat([0, 1], b)])
    window = np.concatenate([np.tile(scan.window, 2), np.tile(np.arange(b), 2)])
    masked = np.zeros(part.size, dtype=bool)
    p_first = 1.0
    found: list[_Found] = []
    for _ in range(_MOST_WINDOWS):
        excess = ratios.excess / _EXCESS[noise]
        score = normal_score(excess, ratios.freedom, ratios.noise_freedom)
        score = np.where(usable & ~masked & (ratios.freedom > 0.5), score, -np.inf)
        if not found:
            p_first = null.p_value(float(score.max()))
        if score.max() < limit:
            break

        def spread(shapes: np.ndarray, pooled: Pooled = pooled) -> np.ndarray:
            return scatter_between(pooled, shapes)[0]

        best, low, high, template = refined(
            pooled, scan, np.where(score[: 2 * t] >= limit, score[: 2 * t], 0.0), spread
        )
        shape: np.ndarray | None = template
        if score[best] < max(limit, _NEARLY * score.max()):
            best, shape = int(np.argmax(score)), None
            low, high = int(scan.low[window[best]]), int(scan.high[window[best]])
        gain = float((excess[best] - 1) * ratios.freedom[best])
        if gain < _LEAST_SHARE["incoherent"] * max([largest, *(f.gain for f in found)]):
            break
        p_value = bonferroni(null.p_value(float(score[best])), 2)
        found.append(
            _Found(low=low, high=high, part=int(part[best]), kind="incoherent", statistic=float(score[best]),
            p_value=p_value, gain=gain, template=shape,
                   noise=float(ratios.noise[best]))
        )  # fmt: skip
        if shape is None:
            masked |= (part == part[best]) & (scan.low[window] < high) & (scan.high[window] > low)
        else:
            pooled = pooled.without(shape[:, None])
            ratios = scatter_ratios(pooled, scan, use_contrasts=noise == "repetitions")
    return found, p_first


def _amplitudes(pooled: Pooled, found: list[_Found]) -> Amplitudes:
    """Amplitudes of the structure in each person: of its templates, or of its energy if that has the larger gain."""
    main = max(found, key=lambda f: f.gain)
    if main.template is not None:
        return pattern_amplitudes(pooled, np.array([f.template for f in found if f.template is not None]).T)
    inside = np.zeros((2, pooled.frequency_hz.size))
    for f in found:
        if f.kind == "incoherent":
            inside[f.part, f.low : f.high] = 1.0
    return energy_amplitudes(pooled, inside.ravel(), max(main.noise, 1.0))


def _bands(found: list[_Found], frequency_hz: np.ndarray) -> tuple[MismatchBand, ...]:
    """Merge windows of the same part and kind whose gap is less than half of the narrower."""
    groups: list[list[_Found]] = []
    for f in sorted(found, key=lambda f: (f.part, f.kind, f.low)):
        same = groups and (f.part, f.kind) == (groups[-1][0].part, groups[-1][0].kind)
        low, high = (groups[-1][0].low, max(g.high for g in groups[-1])) if same else (0, 0)
        if same and f.low - high <= max(1, 0.5 * min(f.high - f.low, high - low)):
            groups[-1].append(f)
        else:
            groups.append([f])
    bands = []
    for group in groups:
        best = max(group, key=lambda f: abs(f.statistic))
        low, high = min(f.low for f in group), max(f.high for f in group)
        bands.append(
            MismatchBand(low_hz=float(frequency_hz[low]), high_hz=float(frequency_hz[high - 1]), part=_PARTS[best.part],
            kind=best.kind,
                 statistic=best.statistic, p_value=min(f.p_value for f in group))
        )  # fmt: skip
    return tuple(sorted(bands, key=lambda band: -abs(band.statistic)))


def residual_maps(residuals: Sequence[PersonResiduals], frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual of each person outside of what the elements absorb, for plots.

    Parameters
    ----------
    residuals : sequence of PersonResiduals
        N persons.
    frequency_hz : ndarray, shape (F,)
        Of the plot. The person's nearest point in log frequency is shown, because interpolation would reduce the noise.

    Returns
    -------
    magnitude, phase : ndarray, shape (N, F)
        Along |z| and across it, averaged over repetitions and scaled to unit variance if nothing is missing; NaN
        outside of the person's range.
    """
    maps = np.full((2, len(residuals), frequency_hz.size), np.nan)
    x = np.log(frequency_hz)
    for i, person in enumerate(residuals):
        own = np.log(person.frequency_hz)
        n = own.size
        left = 1 - np.sum(turn(person, person.basis) ** 2, axis=2)
        score = turn(person, person.outside(person.white)).sum(axis=0)
        unit = (score / np.sqrt(np.maximum(left.sum(axis=0), 1e-3))).reshape(2, n)
        nearest = np.searchsorted(0.5 * (own[1:] + own[:-1]), x)
        inside = (x >= own[0] - 1e-9) & (x <= own[-1] + 1e-9)
        maps[:, i, inside] = unit[:, nearest[inside]]
    return maps[0], maps[1]
