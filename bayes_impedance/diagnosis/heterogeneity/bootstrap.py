r"""Parametric bootstrap under the null hypothesis: replicates of pulls and weights of a fitted normal population.

The largest of many statistics has no tabulated distribution, but it can be simulated: each person keeps the information
H of the own recordings, the elements are drawn from the fitted population, and the same statistic is computed. In white
coordinates (:mod:`bayes_impedance.diagnosis.heterogeneity.reml`), with M = L^T H L, the linear coefficient of a
person's likelihood is :math:`\tilde b \sim N(0, M(I + M))` and the pull is :math:`(I + M)^{-1}\tilde b`.

The population must be re-estimated from each replicate, or the statistic would be a different one. One step of Fisher
scoring from the population that the replicate was drawn from is nearly enough: its start is as close as
:math:`N^{-1/2}`, so the step ends within :math:`1/N` of the maximum (Davidson and MacKinnon, International Economic
Review 40, 487-508, 1999), and is exact if every recording determines every element. The information matrix is the same
for all replicates, so all of them are computed at once. Steps of expectation-maximisation follow, which never decrease
the likelihood; further scoring with the old information could.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.heterogeneity.reml import COEFFICIENT_SD, Fit

_STEPS = 3
"""One of scoring, two of expectation-maximisation (see the module's docstring)."""

_LARGEST_RATIO = 10.0
"""Largest ratio of a variance after a step to the one before. By choice: the replicate's population is much closer."""

_TAIL = 0.1
"""Upper fraction of the replicates from which the exponential tail is estimated. By choice."""

_SMALLEST_SCALE = 2.0
"""Smallest scale of the exponential tail: that of a likelihood ratio, chi-square with two degrees of freedom."""

_FEWEST_IN_TAIL = 3
"""With fewer replicates in the tail its mean excess is not estimated, and p-values are obtained by counting. By
choice."""


@dataclass(frozen=True)
class Residuals:
    """Pulls and weights of R fits: of the real data (R = 1) or of replicates.

    Attributes
    ----------
    factor : ndarray, shape (R, P, P)
        L, with T = L L^T.
    pull : ndarray, shape (R, N, P)
        L^T u.
    weight : ndarray, shape (R, N, P, P)
        L^T W L.
    """

    factor: np.ndarray
    pull: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, fit: Fit) -> Residuals:
        """Residuals of the real data."""
        return cls(fit.factor[None], fit.pull[None], fit.weight[None])


def replicates(fit: Fit, count: int, batch: int, seed: int) -> Iterator[Residuals]:
    """Replicates of a population in which nothing is missing.

    Parameters
    ----------
    fit : Fit
        The population, with a full or a diagonal covariance.
    count, batch : int
        Number of replicates, and number computed at a time.
    seed : int

    Yields
    ------
    Residuals
        Of at most `batch` replicates.
    """
    rng = np.random.default_rng(seed)
    n, p = fit.pull.shape
    white = fit.factor.T @ fit.problem.likelihoods.information @ fit.factor
    values, vectors = np.linalg.eigh(white)
    values = np.maximum(values, 0.0)
    root = vectors * np.sqrt(values * (1 + values))[:, None, :]
    basis = fit.structure.directions(fit.factor)
    information = fit.scoring()[1] + fit.structure.curvature(fit.factor)
    information = information + 1e-9 * np.trace(information) * np.eye(information.shape[0])
    fixed = fit.mean_correction() + fit.structure.penalty(fit.factor)[1]
    for begin in range(0, count, batch):
        linear = np.einsum("npq,rnq->rnp", root, rng.standard_normal((min(batch, count - begin), n, p)))
        change = np.broadcast_to(np.eye(p), (linear.shape[0], p, p))
        for k in range(_STEPS + 1):
            turned = np.swapaxes(change, 1, 2)
            wider = np.linalg.inv(np.eye(p) + turned[:, None] @ white @ change[:, None])
            weight = np.eye(p) - wider
            free = np.einsum("rnpq,rnq->rnp", wider, linear @ change)
            pull = free - _fitted(np.linalg.solve(change[:, None], fit.white_design), weight, free)
            if k == _STEPS:
                break
            excess = np.swapaxes(pull, 1, 2) @ pull - weight.sum(axis=1) + fixed
            gradient = 0.5 * np.tensordot(basis, excess, ([1, 2], [1, 2]))
            # Expectation-maximisation uses the information of complete data: n / 2 in place of the observed one.
            step = (np.linalg.solve(information, gradient) if k == 0 else 2 * gradient / n).T
            ratio, directions = np.linalg.eigh(np.eye(p) + np.tensordot(step, basis, 1))
            root_ratio = np.sqrt(np.clip(ratio, 1 / _LARGEST_RATIO, _LARGEST_RATIO))
            change = change @ (directions * root_ratio[:, None]) @ np.swapaxes(directions, 1, 2)
        yield Residuals(fit.factor @ change, pull, weight)


def _fitted(x: np.ndarray, weight: np.ndarray, free: np.ndarray) -> np.ndarray:
    """W X beta with beta by generalised least squares: x (R, N, P, K), weight (R, N, P, P), free (R, N, P)."""
    y = weight @ x
    r, n, p, k = x.shape
    flat = np.swapaxes(x.reshape(r, n * p, k), 1, 2)
    normal = flat @ y.reshape(r, n * p, k) + np.eye(k) / COEFFICIENT_SD**2
    coefficients = np.linalg.solve(normal, flat @ free.reshape(r, n * p, 1))
    return np.asarray((y.reshape(r, n * p, k) @ coefficients).reshape(r, n, p))


def tail_probability(statistic: float, null: np.ndarray) -> float:
    """Probability that a statistic is at least as large under the null hypothesis, from replicates (R,).

    Up to the highest tenth, replicates are counted. Beyond, likelihood ratios fall off like exp(-x / 2) or slightly
    slower; the scale is the mean excess of the highest tenth plus 1.5 times its standard error, and at least 2. So the
    p-value of a statistic beyond all replicates is conservative.
    """
    count = null.size
    counted = (1 + float(np.sum(null >= statistic))) / (count + 1)
    border = float(np.quantile(null, 1 - _TAIL))
    excess = null[null > border] - border
    if statistic <= border or excess.size < _FEWEST_IN_TAIL:
        return counted
    scale = max(float(excess.mean()) * (1 + 1.5 * excess.size**-0.5), _SMALLEST_SCALE)
    return _TAIL * float(np.exp(-(statistic - border) / scale))
