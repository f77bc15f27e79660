"""Solutions that a population may have in common, from where everybody's searches have ended."""

from __future__ import annotations

import numpy as np

REGRET = 50.0
"""Largest difference from a person's best objective, in nats, that counts: one outlying person must not decide, and
what is further behind at few points is not compared at all of them. By choice."""

_COMMON, _OTHER = 5, 0.3
"""Solutions common to all persons that are compared, the best first, and least difference of some log element of their
medians. By choice: more cost time."""
_GATHERINGS, _NARROWEST = 4, 0.05
"""How often everybody's end nearest to the median is chosen, and standard deviation of log elements below which a
population is not more probable. By choice: the first moves the median most; less is not told by the noise."""
_SOME = 400
"""Most persons, spread evenly, by whom solutions are ranked. By choice, for time: each is ranked several times."""


def common_solutions_of(ends: np.ndarray, regret: np.ndarray, begun: np.ndarray) -> list[np.ndarray]:
    r"""The best few solutions that differ as populations: which end (N,) of each person's searches is in them.

    From one point not everybody reaches the same valley, so in each solution everybody has the end that is nearest to
    the others' median, of those that are not far behind. With everybody's regret :math:`r_i` and the ends' standard
    deviations :math:`s_p` over N people, the best has the least :math:`\sum_i r_i + N \sum_p \ln s_p`, the marginal
    likelihood of a population but for what valleys have in common. By regret alone, those led that are nearly as good
    for everybody because they leave elements anywhere.

    Parameters
    ----------
    ends, regret : ndarray, shape (N, C, P) and (N, C)
    begun : ndarray, shape (C, P)
        Where the searches began, and so does each solution.
    """
    some = np.unique(np.linspace(0, len(ends) - 1, min(len(ends), _SOME)).round().astype(int))
    found = []
    for middle in begun:
        for _ in range(_GATHERINGS):
            chosen = _nearest(ends[some], regret[some], middle)
            gathered = ends[some, chosen]
            middle = np.median(gathered, axis=0)
        spread = np.maximum(gathered.std(axis=0), _NARROWEST)
        found.append((float(regret[some, chosen].sum() + some.size * np.log(spread).sum()), middle))
    kept: list[np.ndarray] = []
    for _, middle in sorted(found, key=lambda solution: solution[0]):
        if all(np.abs(middle - other).max() > _OTHER for other in kept):
            kept.append(middle)
    return [_nearest(ends, regret, middle) for middle in kept[:_COMMON]]


def _nearest(ends: np.ndarray, regret: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Which of each person's ends (N,) is nearest to a place (P,), of those that are not far behind."""
    far = np.where((regret < REGRET) | (regret == regret.min(axis=1, keepdims=True)), 0.0, np.inf)
    return np.asarray(np.argmin(np.abs(ends - middle).max(axis=2) + far, axis=1))
