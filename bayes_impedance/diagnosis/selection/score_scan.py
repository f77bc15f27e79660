r"""All candidates at all places in one pass, without a refit.

A candidate's **signature** in a recording is the whitened change of the port's impedance per unit of its coefficient,
projected outside of what the elements of that recording can absorb, :math:`\tilde g = (1 - QQ^T)\,g`. If r are the
whitened residuals, the score and information of person i are

.. math:: b_i = \sum_j \tilde g_{ij}\cdot r_{ij}, \qquad m_i = \sum_j \tilde g_{ij}\cdot\tilde g_{ij},

and with :math:`B = \sum b_i`, :math:`I = \sum m_i` the estimate of a **shared** coefficient is B/I, its score

.. math:: Z = B/\sqrt{I} \sim N(0, 1)

when nothing is missing. Previous additions are projected out of B and I as well. Coefficients that **vary** are
detected by the spread of the scores about the common coefficient,

.. math:: V = \sum_i \frac{(b_i - m_i\hat x)^2 - m_i}{\sqrt{2\sum m_i^2}}, \qquad \hat x = \frac{B}{I} ,

with B and I before that projection, as b and m are: a sum of chi-squares whose distribution is that of one scaled
chi-square with the same mean and variance.

**Correction for many candidates.** All Z are linear in the residuals, so they are jointly normal with the correlations
of the signatures. The distribution of the largest |Z| is simulated, and its tail is
:math:`p \approx n_\text{eff}\, 2\Phi(-|Z|)` with the effective number of candidates fitted to the draws.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy.special import gammaincc, gammaln, log_ndtr

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect, direction, shape_grid
from bayes_impedance.diagnosis.fit.model import Model, inner_places
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.sensitivity import local_impedances, motion_at, spot_of
from bayes_impedance.diagnosis.selection.level_starts import LevelEvidence, best_levels, has_levels
from bayes_impedance.network.operations import ADDING

_DRAWS = 6_000
"""Draws of the largest score. The 0.98 quantile rests on 120 of them: the effective number is known to 9 %, 0.09 of a
log p-value."""

_MOST_SUMS = 128
"""Largest number of tasks into which people are divided. By choice: each returns one Gram matrix of all signatures, so
that memory does not grow with the number of people."""

_SMALLEST_LOG = -600.0
"""Log probability below which the asymptotic tail is used: a double underflows at -708."""

_INVISIBLE = 1e-3
"""Candidates of whose signature the elements leave at most this fraction are dropped: the remainder is rounding
error."""


@dataclass(frozen=True, kw_only=True)
class Screening:
    """Scores of C candidates.

    Attributes
    ----------
    candidates : tuple of Candidate
    score, information : ndarray, shape (N, C)
        b and m of each person.
    z : ndarray, shape (C,)
        Z of a shared coefficient; NaN for invisible candidates.
    size : ndarray, shape (C,)
        One-step estimate of the coefficient.
    spread : ndarray, shape (C,)
        V, the statistic of a varying coefficient.
    log_p_spread : ndarray, shape (C,)
        Natural logarithm of the p-value of V, corrected for all candidates.
    cosine : ndarray, shape (C, C)
        Between the signatures, outside of the elements and of previous additions.
    visible : ndarray, shape (C,)
        Fraction of each signature's length that the elements cannot absorb.
    effective : float
        Effective number of independent candidates.
    levels : tuple of LevelEvidence
        Effects with poles of their own of which a grid of coefficients says that they are there, best first
        (:mod:`.level_starts`).
    """

    candidates: tuple[Candidate, ...]
    score: np.ndarray
    information: np.ndarray
    z: np.ndarray
    size: np.ndarray
    spread: np.ndarray
    log_p_spread: np.ndarray
    cosine: np.ndarray
    visible: np.ndarray
    effective: float
    levels: tuple[LevelEvidence, ...] = ()

    def log_p(self, z: np.ndarray | float, two_sided: bool = True) -> np.ndarray:
        """Natural logarithm of the p-value of scores, corrected for all candidates."""
        tail = log_ndtr(-np.abs(z)) + (np.log(2) if two_sided else 0.0)
        return np.asarray(np.minimum(tail + np.log(self.effective), 0.0))

    @property
    def log_p_levels(self) -> float:
        """Natural logarithm of the p-value of the largest evidence on a grid of coefficients, of all on one."""
        if not self.levels:
            return 0.0
        on_grid = {(c.effect, c.place) for c in self.candidates if has_levels(c)}
        return min(float(np.log(len(on_grid))) - self.levels[0].log_e, 0.0)

    @property
    def physical(self) -> np.ndarray:
        """Whether each coefficient has an admissible sign, bool, shape (C,)."""
        return np.array([c.effect.signed for c in self.candidates], dtype=bool) | (self.size > 0)


def candidates_for(
    fit: Refit, effects: Sequence[Effect], places: Collection[str] | None = None
) -> tuple[Candidate, ...]:
    """Every effect at every place, or those named, with every scanned shape, except those added already."""
    model = fit.model
    taken = {addition.key for addition in model.additions}
    found = []
    for effect in effects:
        for place in effect.sites(model.network):
            if (effect.id, effect.form, place.name) in taken or (places is not None and place.name not in places):
                continue
            found += [Candidate(effect, place.name, shape) for shape in shape_grid(effect, model.scales)]
    return tuple(found)


def screen(
    fit: Refit,
    residuals: Sequence[PersonResiduals],
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
    places: Collection[str] | None = None,
) -> Screening:
    """Score all candidates.

    Parameters
    ----------
    fit : Refit
    residuals : sequence of PersonResiduals
        Of that fit.
    effects : sequence of Effect
    seed : int
        For the draws of the largest score.
    executor : Executor
    places : collection of str, optional
        Names of the places at which the effects are candidates; all by default. The cross products of all candidates
        are computed, which takes minutes for many effects at all places of a large network.
    """
    candidates = candidates_for(fit, effects, places)
    n, c = len(residuals), len(candidates)
    starts = np.r_[0, np.cumsum([len(r.white) for r in residuals])]
    added = np.arange(fit.model.n_elements, fit.u.shape[1])
    grids: dict[bytes, int] = {}
    grid_of = [grids.setdefault(r.frequency_hz.tobytes(), len(grids)) for r in residuals]
    frequencies = [residuals[grid_of.index(k)].frequency_hz for k in range(len(grids))]
    directions = [_constant_directions(fit, candidates, frequency) for frequency in frequencies]

    u = [fit.u[starts[i] : starts[i + 1]] for i in range(n)]
    own_directions = [directions[k] for k in grid_of]
    size = -(-n // _MOST_SUMS)
    chunks = [[column[i : i + size] for i in range(0, n, size)] for column in (residuals, own_directions, u)]
    shares = executor.map(partial(_shares, fit.model, candidates, added), *chunks)

    gram, score, information, total = np.zeros((c + len(added),) * 2), [], [], np.zeros(c + len(added))
    for b, m, before, own in shares:
        gram += own
        score.append(b)
        information.append(m)
        total += before
    b, m = np.concatenate(score), np.concatenate(information)
    length = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram *= np.outer(np.sqrt(m.sum(axis=0)) / length, np.sqrt(m.sum(axis=0)) / length)
    return replace(_pooled(candidates, b, m, gram, total, c, seed), levels=best_levels(fit, candidates, executor))


def _shares(
    model: Model,
    candidates: Sequence[Candidate],
    added: np.ndarray,
    persons: Sequence[PersonResiduals],
    directions: Sequence[Sequence[np.ndarray | None]],
    u: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Per person b and m, shape (n, C + A), and their sums of the signatures' squares and cross products.

    The cross products, (C + A)^2 numbers, are the large part of what is returned.
    """
    score, information = [], []
    squares, products = np.zeros(len(candidates) + added.size), np.zeros((len(candidates) + added.size,) * 2)
    for person, constant, own in zip(persons, directions, u, strict=True):
        g = _signatures(model, candidates, constant, added, person, own)
        squares += np.einsum("jcf,jcf->c", g, g)
        g -= np.matmul(np.matmul(g, person.basis), np.swapaxes(person.basis, 1, 2))
        score.append(np.einsum("jcf,jf->c", g, person.white))
        information.append(np.einsum("jcf,jcf->c", g, g))
        # For the correlations one recording of each person is enough; the lengths are exact.
        products += (g[0] @ g[0].T) * len(person.white)
    return np.array(score), np.array(information), squares, products


def _pooled(
    candidates: tuple[Candidate, ...],
    b: np.ndarray,
    m: np.ndarray,
    gram: np.ndarray,
    total: np.ndarray,
    c: int,
    seed: int,
) -> Screening:
    """Project previous additions out of the pooled scores, and find the effective number of candidates."""
    pooled_score, nuisance = b.sum(axis=0), slice(c, None)
    visible = np.sqrt(m.sum(axis=0)[:c] / np.maximum(total[:c], 1e-300))
    net, net_gram = pooled_score[:c], gram[:c, :c]
    if gram.shape[0] > c:
        scale = np.sqrt(np.diag(gram)[nuisance]) + 1e-300
        inner = gram[nuisance, nuisance] / np.outer(scale, scale) + 1e-9 * np.eye(scale.size)
        cross = gram[:c, nuisance] / scale
        weight = np.linalg.solve(inner, cross.T).T
        net = net - weight @ (pooled_score[nuisance] / scale)
        net_gram = net_gram - weight @ cross.T
    information = np.diag(net_gram).copy()
    seen = (visible > _INVISIBLE) & (information > 1e-6 * np.diag(gram)[:c])
    information[~seen] = np.nan
    z = net / np.sqrt(information)
    size = net / information
    own, shares = m[:, :c], b[:, :c]
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = net_gram / np.sqrt(np.outer(information, information))
        squares = np.sum(own**2, axis=0)
        common = pooled_score[:c] / own.sum(axis=0)  # not `size`: b and m are not corrected for additions either
        around = np.sum((shares - own * common) ** 2, axis=0)
        spread = (around - own.sum(axis=0)) / np.sqrt(2 * squares)
        freedom = own.sum(axis=0) ** 2 / squares
        log_p = _log_chi_square_tail(around * own.sum(axis=0) / squares, freedom)
    effective = _effective(cosine[np.ix_(seen, seen)], seed)
    log_p_spread = np.minimum(np.nan_to_num(log_p) + np.log(effective), 0.0)
    return Screening(
        candidates=candidates,
        score=shares,
        information=own,
        z=z,
        size=size,
        spread=spread,
        log_p_spread=log_p_spread,
        cosine=cosine,
        visible=visible,
        effective=effective,
    )


def _log_chi_square_tail(x: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Log probability that a chi-square exceeds x, also where the probability underflows."""
    a, half = 0.5 * freedom, 0.5 * x
    direct = np.log(gammaincc(a, half))
    tail = (a - 1) * np.log(half) - half - gammaln(a) - np.log1p(-(a - 1) / half)
    return np.asarray(np.where(direct > _SMALLEST_LOG, direct, tail))


def _effective(correlation: np.ndarray, seed: int) -> float:
    """Effective number of independent scores among correlated ones, from the largest of them in many draws."""
    if not correlation.size:
        return 1.0
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    keep = values > 1e-6 * values[-1]
    factor = vectors[:, keep] * np.sqrt(values[keep])
    rng = np.random.default_rng(seed)
    largest = np.concatenate(
        [np.abs(factor @ rng.normal(size=(keep.sum(), 1000))).max(axis=0) for _ in range(_DRAWS // 1000)]
    )
    level = np.quantile(largest, 0.98)
    return float(max(1.0, 0.02 / (2 * np.exp(log_ndtr(-level)))))


def _constant_directions(
    fit: Refit, candidates: Sequence[Candidate], frequency_hz: np.ndarray
) -> list[np.ndarray | None]:
    """Directions (F,) that do not depend on the impedance at the place; None for other candidates."""
    omega = 2 * np.pi * frequency_hz
    anything = np.ones((1, omega.size), dtype=complex)
    known: dict[tuple[object, ...], np.ndarray] = {}
    result: list[np.ndarray | None] = []
    for candidate in candidates:
        if candidate.effect.operation not in ADDING:
            result.append(None)
            continue
        key = (candidate.effect.operation, candidate.effect.coefficients[0].unit, *candidate.shape.values())
        if key not in known:
            known[key] = direction(candidate.effect, candidate.shape, fit.model.scales, omega, anything)[0]
        result.append(known[key])
    return result


def _signatures(
    model: Model,
    candidates: Sequence[Candidate],
    constant: Sequence[np.ndarray | None],
    added: np.ndarray,
    person: PersonResiduals,
    u: np.ndarray,
) -> np.ndarray:
    """Whitened signatures of a person's recordings, shape (J, C + A, 2 F), those of previous additions last."""
    omega = 2 * np.pi * person.frequency_hz
    local = local_impedances(model, u, omega)
    result = np.empty((len(u), len(candidates) + added.size, 2 * omega.size))
    n = omega.size
    felt = {name: place.adjoint / person.sd for name, place in local.items()}
    paths = inner_places(model)
    moved = cache(lambda place: motion_at(model, u, omega, paths[place]))
    for k, candidate in enumerate(candidates):
        spot = spot_of(candidate)
        d = constant[k]
        if d is None:
            motion = moved(candidate.place) if candidate.effect.follows_motion else None
            d = direction(candidate.effect, candidate.shape, model.scales, omega, local[spot].z, motion)
        dz = d * felt[spot]
        result[:, k, :n], result[:, k, n:] = dz.real, dz.imag
    if added.size:
        dz = model.kernel.derivative(u, person.frequency_hz)[1][:, added] / person.sd[:, None]
        result[:, len(candidates) :, :n], result[:, len(candidates) :, n:] = dz.real, dz.imag
    return result
