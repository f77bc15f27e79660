r"""Which of many importance draws are kept, and with which weights.

All that follows is computed for each draw, and each time for many populations, so that of M draws only K are kept: draw
k with probability :math:`\pi_k`, at most one, and with its weight divided by :math:`\pi_k` (Horvitz and Thompson 1952).
With :math:`w_k(s)` the weights under population s, normalised to sum to one, the variance of the log likelihood under s
is about :math:`\sum_k w_k(s)^2/\pi_k`. Its mean over some populations is least for

.. math:: \pi_k \propto \sqrt{\textstyle\sum_s w_k(s)^2} .

Where these populations are not known yet, :math:`\pi_k \propto \sqrt{w_k}`, with the weights under the reference, is a
compromise between weights that become equal and draws that count under other populations. No draw is chosen twice, so
that the squared weights still say how large the error is. A choice by other populations than those that are met later
costs draws; it is right all the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

_CHUNK = 2**17
"""Most numbers of draws under different populations at once, 1 MB. By choice: they stay in the processor's cache."""
_LEAST_ROOT = 1e-6
"""Least root of a weight, relative to the largest, with which the probability of being chosen goes. By choice: a draw
of a smaller weight counts for nothing, but some must be chosen where too few have more."""


@dataclass(frozen=True)
class Nearby:
    """Populations for which draws are chosen.

    Attributes
    ----------
    shift : ndarray, shape (S, P)
        Of their means from that of the reference population.
    covariance : ndarray, shape (S, P, P)
    """

    shift: np.ndarray
    covariance: np.ndarray

    def log_roots(self, theta: np.ndarray, log_ratio: np.ndarray, mean: np.ndarray) -> np.ndarray:
        """Logarithms of the best probabilities, up to a constant, shape (M,).

        Parameters
        ----------
        theta : ndarray, shape (M, P)
        log_ratio : ndarray, shape (M,)
            ln L - ln q.
        mean : ndarray, shape (P,)
            Of the reference population.
        """
        squares = np.full(len(theta), -np.inf)
        for log_weights in self._log_weights(theta, log_ratio, mean):
            squares = np.logaddexp(squares, np.logaddexp.reduce(2 * log_weights, axis=0))
        return 0.5 * squares

    def effective(self, theta: np.ndarray, log_ratio: np.ndarray, mean: np.ndarray) -> float:
        """Effective number of draws, harmonic mean over populations; the arguments are those of :meth:`log_roots`."""
        squares = [np.exp(2 * w).sum(axis=1) for w in self._log_weights(theta, log_ratio, mean)]
        return float(1 / np.mean(np.concatenate(squares)))

    @cached_property
    def _whitening(self) -> np.ndarray:
        """Inverse Cholesky factors, (S, P, P)."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    def _log_weights(self, theta: np.ndarray, log_ratio: np.ndarray, mean: np.ndarray) -> Iterator[np.ndarray]:
        """Log weights of all draws under some populations after others, each normalised to sum to one: (s, M)."""
        away = (theta - mean).T
        at_once = max(1, _CHUNK // away.size)
        for start in range(0, len(self.shift), at_once):
            some = slice(start, start + at_once)
            u = self._whitening[some] @ (away - self.shift[some, :, None])
            log_weight = log_ratio - 0.5 * np.einsum("spk,spk->sk", u, u)
            highest = log_weight.max(axis=1, keepdims=True)
            yield log_weight - highest - np.log(np.exp(log_weight - highest).sum(axis=1, keepdims=True))


def inclusion(log_root: np.ndarray, n: int) -> np.ndarray:
    """Probabilities, of sum n and at most one, that go with roots (M,) given by their logarithms."""
    root = np.maximum(np.exp(log_root - log_root.max()), _LEAST_ROOT)
    result = np.ones(len(root))
    certain = np.zeros(len(root), dtype=bool)
    while True:
        rest = ~certain
        result[rest] = root[rest] * (n - certain.sum()) / root[rest].sum()
        if not np.any(result[rest] > 1):
            return result
        certain |= result > 1
        result[certain] = 1.0
