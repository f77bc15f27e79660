"""Folds of people for cross-validation: each person is held out once, together with the others of the fold."""

from __future__ import annotations

import numpy as np

FOLDS = 5
"""Five folds leave four fifths of the people to estimate the population from, at the price of five fits for each model;
five to ten are customary (Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section 7.10)."""


def person_folds(n: int, seed: int) -> np.ndarray:
    """Number of the fold of each of n people, int, shape (n,).

    People are assigned at random to :data:`FOLDS` folds whose sizes differ by one at most; fewer people than folds are
    held out one by one.
    """
    return np.random.default_rng(seed).permutation(n) % FOLDS
