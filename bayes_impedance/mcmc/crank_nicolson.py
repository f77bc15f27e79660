r"""Crank-Nicolson proposals as a move of emcee.

Mixed preconditioned Crank-Nicolson (Kamatani 2018) around a normal approximation N(m, C) of the target: with
:math:`u = C^{-1/2}(x - m)`,

.. math:: u' = \sqrt{1-\beta^2}\,u + \beta\,\zeta^{-1/2}\,\xi, \qquad \xi \sim N(0, I),\quad
          \zeta \sim \mathrm{Gamma}\left(D/2,\ |u|^2/2\right),

which is reversible with respect to :math:`|u|^{-D}du`; the Metropolis ratio is therefore that of the target times
:math:`(|u'|/|u|)^D`. Its acceptance does not fall with the dimension as long as the target resembles N(m, C), and since
the step grows with the distance from m, walkers do not get stuck in tails that are heavier.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_STEP_LENGTHS = (0.6, 0.8)
"""Values of beta of a Crank-Nicolson proposal, one of them chosen at random. By choice: 1 would be an independent draw
from the normal approximation, often rejected where that is poor; small values mix slowly."""


def crank_nicolson_move(mean: np.ndarray, covariance: np.ndarray) -> Any:
    """An emcee move that is efficient if the target is close to a normal distribution, and valid for any target.

    Parameters
    ----------
    mean : ndarray, shape (D,)
    covariance : ndarray, shape (D, D)
    """
    from emcee.moves import MHMove

    factor = np.linalg.cholesky(covariance)
    half = 0.5 * mean.size

    def propose(x: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        beta = _STEP_LENGTHS[rng.randint(len(_STEP_LENGTHS))]
        u = np.linalg.solve(factor, (x - mean).T).T
        square = np.maximum(np.sum(u**2, axis=1), 1e-300)
        zeta = rng.gamma(half, 2 / square)
        new = np.sqrt(1 - beta**2) * u + beta * rng.standard_normal(u.shape) / np.sqrt(zeta)[:, None]
        return mean + new @ factor.T, half * (np.log(np.sum(new**2, axis=1)) - np.log(square))

    return MHMove(propose)
