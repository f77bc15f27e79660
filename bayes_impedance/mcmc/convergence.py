r"""Whether chains agree, and whether importance weights have a usable tail.

The formulas are those of ArviZ, to whose values tests hold them. They stand here because a fit needs two numbers, for
which importing ArviZ takes three seconds and a hundred megabytes.

**R-hat.** Each chain is split into halves, the draws are replaced by normal scores of their ranks, and with n draws in
a half

.. math:: \hat R = \sqrt{\frac{n - 1 + B/W}{n}}

compares the variance B of the halves' means, times n, with the mean W of their variances. The same is done with the
distances from the median, so that chains of different width are seen as well; the larger of both counts (Vehtari et al.
2021, Bayesian Analysis 16:667).

**Pareto k.** The largest importance ratios follow a generalised Pareto distribution, whose shape k tells how many
moments they have. It is estimated by Zhang and Stephens' (2009) posterior mean over a grid, and drawn a little towards
one half as ten further ratios would (Vehtari et al. 2024, JMLR 25:72).
"""

from __future__ import annotations

import numpy as np

_FEWEST_DRAWS = 4
"""Draws of a chain below which R-hat is undefined, as in ArviZ."""

_FEWEST_IN_TAIL = 5
"""Ratios in the tail below which its shape is unknown, as in ArviZ."""


def rhat(chains: np.ndarray) -> np.ndarray:
    """Rank-normalised split R-hat.

    Parameters
    ----------
    chains : ndarray, shape (C, S, D)
        S draws of each of C chains of D quantities.

    Returns
    -------
    ndarray, shape (D,)
        Infinite where it is undefined: for one chain, fewer than four draws, or draws that are constant or not finite.
    """
    if chains.shape[0] < 2 or chains.shape[1] < _FEWEST_DRAWS:
        return np.full(chains.shape[2], np.inf)
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, -half:]])
    values = np.empty(chains.shape[2])
    for d in range(values.size):
        one = halves[:, :, d]
        with np.errstate(all="ignore"):  # constant halves
            values[d] = np.maximum(_ratio(_scores(one)), _ratio(_scores(np.abs(one - np.median(one)))))
    defined = np.isfinite(values) & np.isfinite(chains).all(axis=(0, 1))
    return np.where(defined, values, np.inf)


def _scores(values: np.ndarray) -> np.ndarray:
    """Normal scores of the ranks; equal values have the mean of their ranks."""
    from scipy.special import ndtri

    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    rank = np.cumsum(count) - 0.5 * (count - 1)
    return np.asarray(ndtri((rank - 0.375) / (values.size + 0.25))[place.reshape(values.shape)])


def _ratio(halves: np.ndarray) -> float:
    n = halves.shape[1]
    within = halves.var(axis=1, ddof=1).mean()
    return float(np.sqrt((n * halves.mean(axis=1).var(ddof=1) / within + n - 1) / n))


def pareto_k(log_weights: np.ndarray) -> np.ndarray:
    """Pareto shape of the largest importance weights.

    Parameters
    ----------
    log_weights : ndarray, shape (..., K)

    Returns
    -------
    ndarray, shape (...)
        Infinite where fewer than five weights are in the tail.
    """
    flat = log_weights.reshape(-1, log_weights.shape[-1]).astype(float)
    with np.errstate(all="ignore"):
        shapes = np.array([_shape_of_tail(row) for row in flat], dtype=float)
    return shapes.reshape(log_weights.shape[:-1])


def _shape_of_tail(log_weights: np.ndarray) -> float:
    n = log_weights.size
    ordered = np.sort(log_weights) - log_weights.max()
    begin = int(np.ceil(min(n / 5.0, 3.0 * n**0.5)))
    cutoff = max(ordered[-begin - 1], np.log(np.finfo(float).tiny))
    tail = np.exp(ordered[ordered > cutoff]) - np.exp(cutoff)
    return _pareto_shape(tail) if tail.size >= _FEWEST_IN_TAIL else np.inf


def _pareto_shape(tail: np.ndarray) -> float:
    """Shape of the generalised Pareto distribution of excesses, in ascending order."""
    n = tail.size
    size = 30 + int(n**0.5)
    grid = (1.0 - np.sqrt(size / (np.arange(1, size + 1) - 0.5))) / (3.0 * tail[int(n / 4 + 0.5) - 1]) + 1.0 / tail[-1]
    shape = np.log1p(-grid[:, None] * tail).mean(axis=1)
    profile = n * (np.log(-grid / shape) - shape - 1.0)
    weight = 1.0 / np.exp(profile - profile[:, None]).sum(axis=1)
    weight = np.where(weight >= 10.0 * np.finfo(float).eps, weight, 0.0)
    middle = np.sum(grid * weight) / weight.sum()
    return float((n * np.log1p(-middle * tail).mean() + 5.0) / (n + 10.0))
