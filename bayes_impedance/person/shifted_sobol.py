r"""Evenly spread points of the unit cube, another set for each person.

The first :math:`2^m` points of a Sobol sequence lie one in each of many families of equal boxes; points that are drawn
at random do not, and their mean of a smooth function errs more. Exclusive or with one random binary vector,

.. math:: u_k = 2^{-b}\,(x_k \oplus s + \tfrac12), \qquad s \sim U\{0, \dots, 2^b - 1\}^d ,

only exchanges boxes, so that the points stay as even as they were, and makes each of them uniformly distributed: means
are unbiased, and sets with other s independent given the sequence (digital shift, L'Ecuyer and Lemieux 2002). The
sequence, with its digits scrambled once by random triangular matrices (Matousek 1998), is the same for everybody:
scrambling takes some thirty times as long as the shift.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_BITS = 30
"""Binary digits of a coordinate: as many as the direction numbers of the sequence have."""
_SEED = 1
"""Seed of the scrambling. By choice: any; the shifts make the points random."""


def uniform_points(n: int, dimension: int, seed: np.random.SeedSequence) -> np.ndarray:
    """Points (n, d), each coordinate strictly between zero and one; n a power of two is even, else nearly so."""
    shift = np.random.default_rng(seed).integers(0, 2**_BITS, dimension, dtype=np.uint32)
    power = int(np.ceil(np.log2(max(n, 1))))  # the first of a whole power of two, which balances them
    return np.asarray(((_sequence(power, dimension)[:n] ^ shift) + 0.5) * 2.0**-_BITS)


@lru_cache(maxsize=32)
def _sequence(power: int, dimension: int) -> np.ndarray:
    """Binary digits of the first 2^power points as whole numbers, (2^power, d)."""
    from scipy.stats import qmc  # half a second to import

    sequence = qmc.Sobol(dimension, bits=_BITS, rng=np.random.default_rng(_SEED))
    digits = np.round(sequence.random(2**power) * 2.0**_BITS).astype(np.uint32)
    digits.flags.writeable = False  # everybody's
    return np.asarray(digits)
