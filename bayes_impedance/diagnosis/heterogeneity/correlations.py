r"""Score test of correlations between elements: a diagonal against a full covariance between persons.

At the diagonal maximum the derivative of the log likelihood with respect to all covariances :math:`T_{ab}` at once is
:math:`G = \sum (uu^T - W + WVW)`, with each person's pull u and weight W
(:mod:`bayes_impedance.diagnosis.heterogeneity.reml`), and their expected information I is known. With the variances'
share projected out (they are estimated as well), the score :math:`g^T I^{-1} g` of all covariances is to first order
the likelihood ratio of a full to a diagonal covariance, without a fit of the full one for every replicate. The score of
one covariance, :math:`g_{ab}^2 / I_{ab,ab}`, is much more powerful if only one pair is correlated. Both are tested,
each against replicates of a diagonal population (:mod:`bayes_impedance.diagnosis.heterogeneity.bootstrap`): the result
is twice the smaller p.

The sizes of the correlations come from the full covariance at its restricted maximum, with the standard error of
:math:`\operatorname{artanh} r` from the information.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.heterogeneity.bootstrap import Residuals, replicates
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.reml import Fit, FullCovariance, centred_fit
from bayes_impedance.diagnosis.multiple_testing import bonferroni, holm
from bayes_impedance.units import NORMAL_Q95, counted

REPLICATES = 200
"""Number of replicates. They only scale the scores and their sum: 200 give a standard deviation to 5 %."""

MINIMUM_PERSONS = 8
"""With fewer persons only a correlation near one could be detected. By choice."""

_BATCH = 50
"""Replicates computed at a time. By choice: it limits memory only."""


@dataclass(frozen=True, kw_only=True)
class Correlation:
    """Correlation of two elements.

    Attributes
    ----------
    first, second : str
    estimate, q05, q95 : float
        Correlation of the log elements between persons, and its 90 % interval.
    statistic : float
        Score, standard normal if they vary independently.
    p_value : float
        Two-sided.
    p_corrected : float
        For all pairs (Holm).
    """

    first: str
    second: str
    estimate: float
    q05: float
    q95: float
    statistic: float
    p_value: float
    p_corrected: float


@dataclass(frozen=True, kw_only=True)
class CorrelationTest:
    """A diagonal against a full covariance.

    Attributes
    ----------
    statistic : float
        Score of all covariances; chi-square of `degrees_of_freedom` if there are very many persons and none varies.
    degrees_of_freedom : int
        Number of pairs.
    p_value : float
        Of that score.
    p_corrected : float
        Of the score and the largest pair together: twice the smaller, the pair's for all pairs.
    pairs : tuple of Correlation
        Smallest p first.
    tried : int
        Statistics for which `p_corrected` is corrected: all pairs, and the score of all.
    persons : int
    reason : str
        Why nothing was tested; empty if it was.
    remarks : tuple of str
        Elements that were left out.
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float
    p_corrected: float
    pairs: tuple[Correlation, ...]
    tried: int
    persons: int
    reason: str = ""
    remarks: tuple[str, ...] = ()


def correlation_test(likelihoods: PersonLikelihoods, seed: int, count: int = REPLICATES) -> CorrelationTest:
    """Test whether any elements are correlated between persons.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
    seed : int
        For the replicates.
    count : int
        Number of replicates.

    Returns
    -------
    CorrelationTest
    """
    from scipy.stats import chi2, norm

    n = len(likelihoods)
    if n < MINIMUM_PERSONS:
        return _nothing(n, f"only {counted(n, 'subject')}; at least {MINIMUM_PERSONS} are needed")
    _, diagonal = centred_fit(likelihoods, diagonal=True)
    kept = np.flatnonzero(diagonal.determined)
    remarks = tuple(
        f"{e} is not determined by the recordings" for k, e in enumerate(likelihoods.elements) if k not in kept
    )
    if kept.size < 2:
        return _nothing(n, "fewer than two elements are determined", remarks)
    pairs = [(int(a), int(b)) for k, a in enumerate(kept) for b in kept[:k]]
    single, whole = scores(Residuals.of(diagonal), diagonal, pairs)
    null = [scores(r, diagonal, pairs) for r in replicates(diagonal, count, _BATCH, seed)]
    null_single, null_whole = (np.concatenate(parts) for parts in zip(*null, strict=True))
    # With few persons the scores' standard deviation is not quite one: it is estimated from the replicates.
    z = single[0] / np.sqrt(np.mean(null_single**2, axis=0))
    p_pair = 2 * norm.sf(np.abs(z))
    # A scaled chi-square with the replicates' mean, and their variance if that is the larger one.
    mean, variance = float(np.mean(null_whole)), float(np.var(null_whole))
    freedom = min(float(len(pairs)), 2 * mean**2 / variance)
    p_whole = float(chi2.sf(whole[0] * freedom / mean, freedom))
    p_holm = holm(p_pair)
    estimate, low, high = _sizes(centred_fit(likelihoods, diagonal.covariance)[1], pairs)
    found = [
        Correlation(
            first=likelihoods.elements[min(a, b)],
            second=likelihoods.elements[max(a, b)],
            estimate=float(estimate[k]),
            q05=float(low[k]),
            q95=float(high[k]),
            statistic=float(z[k]),
            p_value=float(p_pair[k]),
            p_corrected=float(p_holm[k]),
        )
        for k, (a, b) in enumerate(pairs)
    ]
    found.sort(key=lambda c: (c.p_value, -abs(c.statistic)))
    corrected = bonferroni(min(p_whole, float(p_holm.min())), 2)
    return CorrelationTest(
        statistic=float(whole[0]),
        degrees_of_freedom=len(pairs),
        p_value=p_whole,
        p_corrected=corrected,
        pairs=tuple(found),
        tried=len(pairs) + 1,
        persons=n,
        reason="",
        remarks=remarks,
    )


def scores(residuals: Residuals, fit: Fit, pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Scores of every pair (R, M), in standard deviations, and of all of them together (R,)."""
    r, n, p, _ = residuals.weight.shape
    flat = residuals.weight.reshape(r, n, p * p)
    traces = (np.swapaxes(flat, 1, 2) @ flat).reshape(r, p, p, p, p)  # sum of W_ij W_kl
    traces = np.transpose(traces, (0, 2, 3, 4, 1)).reshape(r, p * p, p * p)  # [jk, li]: of W E_a W E_b
    wanted = np.zeros((p + len(pairs), p, p))
    wanted[np.arange(p), np.arange(p), np.arange(p)] = 1.0
    for k, (a, b) in enumerate(pairs):
        wanted[p + k, a, b] = wanted[p + k, b, a] = 1.0
    basis = wanted.reshape(-1, p * p)
    gradient = np.swapaxes(residuals.pull, 1, 2) @ residuals.pull - residuals.weight.sum(axis=1) + fit.mean_correction()
    score = 0.5 * gradient.reshape(r, p * p) @ basis.T
    information = 0.5 * basis @ traces @ basis.T
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    information = information + 1e-9 * diagonal.max(axis=1)[:, None, None] * np.eye(basis.shape[0])
    # Project out the variances: they are estimated as well.
    share = np.linalg.solve(information[:, :p, :p], information[:, :p, p:])
    score = score[:, p:] - np.einsum("rpm,rp->rm", share, score[:, :p])
    information = information[:, p:, p:] - np.swapaxes(share, 1, 2) @ information[:, :p, p:]
    whole = np.einsum("rm,rm->r", score, np.linalg.solve(information, score[..., None])[..., 0])
    return score / np.sqrt(np.diagonal(information, axis1=1, axis2=2)), whole


def _sizes(fit: Fit, pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Correlations of a full covariance with the ends of their 90 % intervals, each (M,)."""
    basis = FullCovariance(fit.covariance).directions(fit.factor)
    information = fit.scoring()[1] + 1e-9 * np.eye(basis.shape[0])
    sd = np.sqrt(np.diag(fit.covariance))
    change = fit.factor @ basis @ fit.factor.T / np.outer(sd, sd)  # of T in units of the variances
    root = np.linalg.cholesky(information)
    result = []
    for a, b in pairs:
        r = fit.covariance[a, b] / (sd[a] * sd[b])
        slope = (change[:, a, b] - 0.5 * r * (change[:, a, a] + change[:, b, b])) / (1 - r**2)
        error = NORMAL_Q95 * float(np.linalg.norm(np.linalg.solve(root, slope)))
        result.append([r, np.tanh(np.arctanh(r) - error), np.tanh(np.arctanh(r) + error)])
    estimate, low, high = np.array(result).T
    return estimate, low, high


def _nothing(n: int, reason: str, remarks: tuple[str, ...] = ()) -> CorrelationTest:
    return CorrelationTest(
        statistic=0.0,
        degrees_of_freedom=0,
        p_value=1.0,
        p_corrected=1.0,
        pairs=(),
        tried=0,
        persons=n,
        reason=reason,
        remarks=remarks,
    )
