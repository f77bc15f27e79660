"""Correlation matrices and their partial correlations in the order of a C-vine (Lewandowski et al. 2009)."""

from __future__ import annotations

import numpy as np


def log_cosh(u: np.ndarray) -> np.ndarray:
    """Ln cosh u without overflow."""
    return np.asarray(np.abs(u) + np.log1p(np.exp(-2 * np.abs(u))) - np.log(2))


def cholesky_from_partial(partial: np.ndarray, n: int) -> np.ndarray:
    """Cholesky factors, shape (W, n, n), of the correlation matrices with partial correlations (W, n (n-1)/2)."""
    factor = np.zeros((partial.shape[0], n, n))
    factor[:, :1, :1] = 1
    k = 0
    for i in range(1, n):
        rest = np.ones(partial.shape[0])
        for j in range(i):
            factor[:, i, j] = partial[:, k] * rest
            rest = rest * np.sqrt(1 - partial[:, k] ** 2)
            k += 1
        factor[:, i, i] = rest
    return factor


def partial_from_cholesky(factor: np.ndarray) -> np.ndarray:
    """Partial correlations of one Cholesky factor, shape (n, n): inverse of `cholesky_from_partial`."""
    n = factor.shape[0]
    partial = []
    for i in range(1, n):
        rest = 1.0
        for j in range(i):
            partial.append(factor[i, j] / rest)
            rest *= np.sqrt(max(1 - partial[-1] ** 2, 1e-12))
    return np.asarray(np.clip(np.array(partial), -0.999, 0.999))
