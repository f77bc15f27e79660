r"""Who carries a structure that was found, whether it drifts over the repetitions, and what it follows.

The structure is the span of the templates A that were found. With t the scores of A and M their covariance,
:math:`t_i^T M_i^{-1} t_i` is chi-square with K degrees of freedom for a person i without structure. The main direction
u of all whitened scores gives everybody one signed amplitude z_i, standard normal without structure. Where structure
was found as energy only, the energy takes the amplitude's place.

Two descriptions of the z_i compete: everybody has some, :math:`z_i \sim N(\mu, 1 + \tau^2)` (or log-normal amplitudes,
which are skew), and only a share :math:`\pi` has any, :math:`z_i \sim (1 - \pi) N(0, 1) + \pi N(\mu, 1 + \tau^2)`.
People are named only if the second is much better, they are the smaller half, and each of them is significant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.residuals.nodes import Pooled
from bayes_impedance.diagnosis.residuals.windows import normal_score
from bayes_impedance.errors import InputError

_FEWEST = 6
"""Persons among whom a minority can be told."""

_GAIN = 5.0
"""Log likelihood by which `some` must beat `all`; it has one parameter more."""

_FEWEST_VALUES = 5


@dataclass(frozen=True)
class Amplitudes:
    """How much of a structure everybody has.

    Attributes
    ----------
    owner : ndarray of int, shape (R,)
        Person of each recording.
    recording : ndarray, shape (R,)
        Amplitude in each recording, NaN where it does not cover the structure.
    person : ndarray, shape (N,)
        The same of everybody's mean.
    z : ndarray, shape (N,)
        In standard deviations of the noise.
    p_value : ndarray, shape (N,)
        That a person has nothing, not corrected.
    """

    owner: np.ndarray
    recording: np.ndarray
    person: np.ndarray
    z: np.ndarray
    p_value: np.ndarray


def pattern_amplitudes(pooled: Pooled, templates: np.ndarray) -> Amplitudes:
    """Amplitudes along the main direction of the span of templates (2 G, K)."""
    from scipy.stats import chi2

    k = templates.shape[1]
    absorbed = pooled.basis.transpose(0, 2, 1) @ templates
    covariance = np.einsum("rg,gk,gl->rkl", pooled.count, templates, templates, optimize=True)
    covariance -= absorbed.transpose(0, 2, 1) @ absorbed
    score = pooled.scores @ templates
    m, t = pooled.by_person(covariance), pooled.by_person(score)
    mean = m.mean(axis=0)
    m = m + 1e-9 * np.trace(mean) * np.eye(k)
    factor = np.linalg.cholesky(mean + 1e-9 * np.trace(mean) * np.eye(k))
    white = np.linalg.solve(factor, t.T).T
    direction = np.linalg.eigh(white.T @ white)[1][:, -1]
    direction *= 1.0 if np.sum(white @ direction) >= 0 else -1.0
    weight = np.linalg.solve(factor.T, direction)
    v = np.einsum("k,nkl,l->n", weight, m, weight)
    v_recording = np.maximum(np.einsum("k,nkl,l->n", weight, covariance, weight), 1e-300)
    covered = v > 0.05 * v.mean()
    energy = np.sum(t * np.linalg.solve(m, t[:, :, None])[:, :, 0], axis=1)
    return Amplitudes(
        pooled.owner,
        np.where(covered[pooled.owner], score @ weight / v_recording, np.nan),
        np.where(covered, t @ weight / v, np.nan),
        np.where(covered, t @ weight / np.sqrt(v), np.nan),
        np.where(covered, chi2.sf(energy, k), 1.0),
    )


def energy_amplitudes(pooled: Pooled, inside: np.ndarray, noise: float) -> Amplitudes:
    """Amplitudes from the energy at nodes (2 G,), relative to the noise; `noise` is its variance over the assumed."""
    from scipy.stats import norm

    def ratio(scores: np.ndarray, count: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen = np.where(count > 0, inside, 0.0) / np.maximum(count, 1.0)
        freedom = np.sum(variance * seen, axis=1)
        return np.sum(scores**2 * seen, axis=1) / np.maximum(freedom * noise, 1e-300), freedom

    node = pooled.node_variance()
    recording, _ = ratio(pooled.scores, pooled.count, node)
    person, freedom = ratio(*(pooled.by_person(a) for a in (pooled.scores, pooled.count, node)))
    covered = freedom > 0.05 * freedom.mean()
    z = normal_score(person, freedom, np.full(freedom.size, np.inf))
    return Amplitudes(
        pooled.owner,
        np.where(covered[pooled.owner], recording - 1, np.nan),
        np.where(covered, person - 1, np.nan),
        np.where(covered, z, np.nan),
        np.where(covered, norm.sf(z), 1.0),
    )


def holm(p_values: np.ndarray) -> np.ndarray:
    """P-values (N,) corrected by Holm's method."""
    order = np.argsort(p_values)
    corrected = np.minimum(np.maximum.accumulate(p_values[order] * np.arange(p_values.size, 0, -1)), 1.0)
    result = np.empty(p_values.size)
    result[order] = corrected
    return result


def carriers(amplitudes: Amplitudes, alpha: float) -> tuple[np.ndarray, float]:
    """Whether only some people have the structure.

    Returns
    -------
    who : ndarray of int
        Their indices; empty if everybody may have it.
    p_value : float
        Largest corrected p-value among them; 1 if nobody is named.
    """
    known = np.flatnonzero(np.isfinite(amplitudes.z))
    nobody = np.zeros(0, dtype=int), 1.0
    if known.size < _FEWEST:
        return nobody
    z = amplitudes.z[known]
    gain, posterior = _mixture_gain(z)
    corrected = holm(amplitudes.p_value)[known]
    named = (posterior > 0.5) & (corrected < alpha)
    if gain < _GAIN or not 0 < np.sum(named) <= known.size / 2:
        return nobody
    return known[named], float(corrected[named].max())


def _mixture_gain(z: np.ndarray) -> tuple[float, np.ndarray]:
    """Log likelihood by which `some` beats `all` for z (N,), and everybody's probability of being a carrier."""
    nothing = _log_normal_density(z, 0.0, 1.0)
    everybody = float(np.sum(_log_normal_density(z, z.mean(), max(z.var(), 1.0))))
    everybody = max(everybody, _skew_log_likelihood(z), _skew_log_likelihood(-z))
    best, posterior = -np.inf, np.zeros(z.size)
    order = np.argsort(-np.abs(z))
    for size in {1, max(z.size // 8, 1), max(z.size // 4, 1), z.size // 2}:
        member = np.zeros(z.size)
        member[order[:size]] = 1.0
        for _ in range(100):
            share, weight = np.clip(member.mean(), 1e-3, 1 - 1e-3), max(member.sum(), 1e-9)
            centre = float(member @ z) / weight
            spread = max(float(member @ (z - centre) ** 2) / weight, 1.0)
            with_it = np.log(share) + _log_normal_density(z, centre, spread)
            total = np.logaddexp(with_it, np.log1p(-share) + nothing)
            member = np.exp(with_it - total)
        if total.sum() > best:
            best, posterior = float(total.sum()), member
    return best - everybody, posterior


def _log_normal_density(z: np.ndarray, mean: float | np.ndarray, variance: float) -> np.ndarray:
    """Logarithm of a normal density."""
    return np.asarray(-0.5 * ((z - mean) ** 2 / variance + np.log(2 * np.pi * variance)))


def _skew_log_likelihood(z: np.ndarray) -> float:
    """Largest log likelihood of z (N,) if everybody's amplitude is log-normal and positive."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    middle = np.log(np.geomspace(0.3, max(float(z.max()), 1.0), 24))
    spread = np.linspace(0.05, 1.5, 12)
    amplitude = np.exp(middle[:, None, None] + spread[:, None] * nodes)
    log_density = _log_normal_density(z, amplitude[..., None], 1.0)
    density = np.einsum("q,msqn->msn", weights / weights.sum(), np.exp(np.maximum(log_density, -600.0)))
    return float(np.log(density).sum(axis=2).max())


@dataclass(frozen=True)
class Trend:
    """How structure changes from one repetition to the next.

    Attributes
    ----------
    change : float
        Of the amplitude per repetition, relative to its mean: positive where it grows.
    p_value : float
        Of Student's test of everybody's slope against zero.
    """

    change: float
    p_value: float


def trend(amplitudes: Amplitudes, signed: bool) -> Trend | None:
    """Trend over the number of the repetition, in the order in which recordings are listed.

    Parameters
    ----------
    amplitudes : Amplitudes
    signed : bool
        Whether the amplitude has the same sign in everybody; if not, growing is growing away from zero.

    Returns
    -------
    Trend or None
        None if fewer than three persons have two repetitions.
    """
    from scipy.stats import ttest_1samp

    slopes, sizes = [], []
    for i in range(amplitudes.person.size):
        a = amplitudes.recording[amplitudes.owner == i]
        if a.size < 2 or not np.all(np.isfinite(a)):
            continue
        centred = np.arange(a.size) - 0.5 * (a.size - 1)
        sign = 1.0 if signed else float(np.sign(a.mean()))
        slopes.append(sign * float(centred @ a) / float(centred @ centred))
        sizes.append(sign * float(a.mean()))
    if len(slopes) < 3:
        return None
    p_value = float(ttest_1samp(slopes, 0.0).pvalue)
    direction = float(np.sign(np.mean(sizes)))
    size = max(abs(float(np.mean(sizes))), 1e-300)
    return Trend(direction * float(np.mean(slopes)) / size, p_value)


def correlations(amplitudes: Amplitudes, covariates: Mapping[str, np.ndarray]) -> dict[str, float]:
    """P-values of rank correlations between the amplitude and each covariate, corrected for their number.

    Parameters
    ----------
    amplitudes : Amplitudes
    covariates : mapping of str to ndarray, shape (N,)
        NaN where unknown.

    Returns
    -------
    dict of str to float
        1 for a covariate that is known of fewer than five persons or the same in all of them.
    """
    from scipy.stats import spearmanr

    p_values = []
    for name, values in covariates.items():
        values = np.asarray(values, dtype=float)
        if values.shape != amplitudes.person.shape:
            raise InputError(
                f"covariate '{name}' has {values.size} values for {amplitudes.person.size} persons: "
                "give one per person, NaN where it is unknown"
            )
        known = np.isfinite(values) & np.isfinite(amplitudes.person)
        if known.sum() < _FEWEST_VALUES or np.ptp(values[known]) == 0:
            p_values.append(1.0)
        else:
            p_values.append(float(spearmanr(values[known], amplitudes.person[known]).pvalue))
    return dict(zip(covariates, holm(np.array(p_values)).tolist(), strict=True))
