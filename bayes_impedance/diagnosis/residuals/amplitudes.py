r"""People who have a structure that was found: tests of each person's amplitude, and of whether only a minority has it.

The structure is the span of the K templates A that were found. With :math:`t_i` the scores of A in the recordings of
person i and :math:`M_i` their covariance, :math:`t_i^T M_i^{-1} t_i` is chi-square with K degrees of freedom if the
person has none of it. The principal direction of all whitened scores gives each person one signed
amplitude :math:`z_i`, standard normal without structure. A structure that was found as excess energy has no template;
then a normal score of the energy takes the amplitude's place.

Two models of the amplitudes are compared. Either all people have the structure, :math:`z_i \sim N(\mu, 1 + \tau^2)` (or
amplitudes are log-normal, which is skew), or a share :math:`\pi` of the people has it,
:math:`z_i \sim (1 - \pi)\, N(0, 1) + \pi\, N(\mu, 1 + \tau^2)`. People are named only if the second model is much
more likely, if they are a minority, and if each of them is significant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.two_group_mixture import log_mixture, membership, share_of
from bayes_impedance.diagnosis.multiple_testing import holm
from bayes_impedance.diagnosis.residuals.nodes import Pooled
from bayes_impedance.diagnosis.residuals.windows import normal_score

_MINIMUM_PERSONS = 6
"""With fewer, the mixture has nearly as many parameters (share, mean, spread) as a minority has people."""

_LEAST_GAIN = 5.0
"""Log likelihood by which "some have it" must exceed "all have it". The mixture has one parameter more and three forms
of the rival are tried, so chance alone gains one or two. By choice above that: amplitudes that merely vary must not
name anyone."""

_SMALLEST_SHARE = 1e-3
"""Smallest share of the mixture, less than one person in the data: it only keeps logarithms finite."""

_ROUNDS = 100
"""Rounds of expectation-maximisation from each start. By choice: groups with a relevant gain are well separated and
converge in few."""

_LEAST_COVERAGE = 0.05
"""Fraction of the mean information about a structure below which a person has no amplitude: the quotient would be
arbitrary. By choice."""


@dataclass(frozen=True)
class Amplitudes:
    """Amplitude of a structure in each person.

    Attributes
    ----------
    z : ndarray, shape (N,)
        Amplitude in standard deviations of the noise; NaN where the person's recordings do not cover the structure.
    p_value : ndarray, shape (N,)
        Of the null hypothesis that the person lacks the structure, not corrected; 1 where it is not covered.
    """

    z: np.ndarray
    p_value: np.ndarray


def pattern_amplitudes(pooled: Pooled, templates: np.ndarray) -> Amplitudes:
    """Amplitudes along the principal direction of the span of templates (2 G, K)."""
    from scipy.stats import chi2

    k = templates.shape[1]
    absorbed = pooled.basis.transpose(0, 2, 1) @ templates
    covariance = np.einsum("rg,gk,gl->rkl", pooled.count, templates, templates, optimize=True)
    covariance -= absorbed.transpose(0, 2, 1) @ absorbed
    m, t = pooled.by_person(covariance), pooled.by_person(pooled.scores @ templates)
    mean = m.mean(axis=0)
    m = m + 1e-9 * np.trace(mean) * np.eye(k)
    factor = np.linalg.cholesky(mean + 1e-9 * np.trace(mean) * np.eye(k))
    white = np.linalg.solve(factor, t.T).T
    direction = np.linalg.eigh(white.T @ white)[1][:, -1]
    direction *= 1.0 if np.sum(white @ direction) >= 0 else -1.0
    weight = np.linalg.solve(factor.T, direction)
    v = np.einsum("k,nkl,l->n", weight, m, weight)
    covered = v > _LEAST_COVERAGE * v.mean()
    energy = np.sum(t * np.linalg.solve(m, t[:, :, None])[:, :, 0], axis=1)
    return Amplitudes(
        np.where(covered, t @ weight / np.sqrt(v), np.nan),
        np.where(covered, chi2.sf(energy, k), 1.0),
    )


def energy_amplitudes(pooled: Pooled, inside: np.ndarray, noise: float) -> Amplitudes:
    """Amplitudes from the energy at nodes (2 G,), relative to the noise.

    Parameters
    ----------
    pooled : Pooled
    inside : ndarray, shape (2 G,)
        1 at the nodes whose energy is summed, else 0.
    noise : float
        Ratio of the noise variance to the assumed one.
    """
    from scipy.stats import norm

    scores, count, variance = (pooled.by_person(a) for a in (pooled.scores, pooled.count, pooled.node_variance()))
    seen = np.where(count > 0, inside, 0.0) / np.maximum(count, 1.0)
    freedom = np.sum(variance * seen, axis=1)
    ratio = np.sum(scores**2 * seen, axis=1) / np.maximum(freedom * noise, 1e-300)
    covered = freedom > _LEAST_COVERAGE * freedom.mean()
    z = normal_score(ratio, freedom, np.full(freedom.size, np.inf))
    return Amplitudes(np.where(covered, z, np.nan), np.where(covered, norm.sf(z), 1.0))


def carriers(amplitudes: Amplitudes, alpha: float) -> tuple[np.ndarray, float]:
    """Name the people who have the structure, if only a minority has it.

    Parameters
    ----------
    amplitudes : Amplitudes
    alpha : float
        Corrected level at which each of them must be significant.

    Returns
    -------
    who : ndarray of int
        Their indices; empty unless a minority has it.
    p_value : float
        Largest corrected p-value among them; 1 if nobody is named.
    """
    known = np.flatnonzero(np.isfinite(amplitudes.z))
    nobody = np.zeros(0, dtype=int), 1.0
    if known.size < _MINIMUM_PERSONS:
        return nobody
    z = amplitudes.z[known]
    gain, posterior = _mixture_gain(z)
    corrected = holm(amplitudes.p_value)[known]
    named = (posterior > 0.5) & (corrected < alpha)
    if gain < _LEAST_GAIN or not 0 < np.sum(named) <= known.size / 2:
        return nobody
    return known[named], float(corrected[named].max())


def _mixture_gain(z: np.ndarray) -> tuple[float, np.ndarray]:
    """Log likelihood ratio of "some have it" to "all have it" for z (N,), and the memberships (N,)."""
    nothing = _log_normal_density(z, 0.0, 1.0)
    everybody = float(np.sum(_log_normal_density(z, z.mean(), max(z.var(), 1.0))))
    everybody = max(everybody, _skew_log_likelihood(z), _skew_log_likelihood(-z))
    best, posterior = -np.inf, np.zeros(z.size)
    order = np.argsort(-np.abs(z))
    for size in {1, max(z.size // 8, 1), max(z.size // 4, 1), z.size // 2}:
        member = np.zeros(z.size)
        member[order[:size]] = 1.0
        for _ in range(_ROUNDS):
            share, weight = share_of(member, _SMALLEST_SHARE), max(member.sum(), 1e-9)
            centre = float(member @ z) / weight
            spread = max(float(member @ (z - centre) ** 2) / weight, 1.0)
            log_ratio = _log_normal_density(z, centre, spread) - nothing
            member = membership(log_ratio, share)
        value = float(np.sum(nothing + log_mixture(log_ratio, share)))
        if value > best:
            best, posterior = value, member
    return best - everybody, posterior


def _log_normal_density(z: np.ndarray, mean: float | np.ndarray, variance: float) -> np.ndarray:
    """Logarithm of a normal density."""
    return np.asarray(-0.5 * ((z - mean) ** 2 / variance + np.log(2 * np.pi * variance)))


def _skew_log_likelihood(z: np.ndarray) -> float:
    """Largest log likelihood of z (N,) if amplitudes are positive and log-normal."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    middle = np.log(np.geomspace(0.3, max(float(z.max()), 1.0), 24))
    spread = np.linspace(0.05, 1.5, 12)
    amplitude = np.exp(middle[:, None, None] + spread[:, None] * nodes)
    log_density = _log_normal_density(z, amplitude[..., None], 1.0)
    density = np.einsum("q,msqn->msn", weights / weights.sum(), np.exp(np.maximum(log_density, -600.0)))
    return float(np.log(density).sum(axis=2).max())
