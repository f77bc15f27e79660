r"""A density that does not change when some coordinates change their signs together: how it is sampled and labelled.

The two groups of a mixture can be exchanged: x and -x are one population. Draws of one population with its labels this
way in one part of a chain and that way in another would look as if the chain had two modes. So the sign of each draw is
chosen such that its component along one direction is positive, the leading eigenvector of the draws' second moment
:math:`\mathrm E\,xx^T`, which does not depend on the signs (the pivot of Marin, Mengersen and Robert 2005, with the
direction that separates the two images best). Which of the images this is, is decided for all draws together.

**Proposals.** Where such coordinates are hardly determined the density has several low peaks, between which moves near
the present point seldom lead. Their prior is standard normal. With :math:`\beta` between 0 and 1 and a standard normal
:math:`\xi`

.. math:: x' = \pm\sqrt{1 - \beta^2}\,x + \beta\,\xi

is reversible with respect to it (a Crank-Nicolson step, Cotter et al. 2013), so only the likelihood decides; at
:math:`\beta = 1` it is a draw from the prior. The other coordinates stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

_SMALLEST_STEP = 0.1
"""Least beta; its logarithm is uniform up to zero. By choice: where groups are well determined about one in two such
steps is accepted, and other moves are as good."""


def mirrored_move(mirrored: np.ndarray) -> Any:
    """An emcee move of these coordinates alone; valid for any target.

    Parameters
    ----------
    mirrored : ndarray of bool, shape (D,)
    """
    from emcee.moves import MHMove

    rows = np.flatnonzero(mirrored)

    def propose(x: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        own, there = x[:, rows], x.copy()
        beta = np.exp(rng.uniform(np.log(_SMALLEST_STEP), 0, (len(x), 1)))
        sign = np.where(rng.uniform(size=(len(x), 1)) < 0.5, -1.0, 1.0)
        there[:, rows] = sign * np.sqrt(1 - beta**2) * own + beta * rng.standard_normal(own.shape)
        return there, 0.5 * (np.sum(there[:, rows] ** 2, axis=1) - np.sum(own**2, axis=1))

    return MHMove(propose)


def labelled(chains: Sequence[np.ndarray], mirrored: np.ndarray) -> list[np.ndarray]:
    """Draws with signs chosen.

    Parameters
    ----------
    chains : sequence of ndarray, shape (..., D)
    mirrored : ndarray of bool, shape (D,)
        Coordinates that change their signs together. The last of them is below zero on average in what is returned.
    """
    rows = np.flatnonzero(mirrored)
    if not rows.size:
        return list(chains)
    some = np.concatenate([chain[..., rows].reshape(-1, rows.size) for chain in chains])
    direction = np.linalg.eigh(some.T @ some)[1][:, -1]
    below = np.mean(np.where(some @ direction < 0, -some[:, -1], some[:, -1])) > 0
    direction = -direction if below else direction
    result = []
    for chain in chains:
        own = chain.copy()
        turned = chain[..., rows] @ direction < 0
        own[..., rows] = np.where(turned[..., None], -chain[..., rows], chain[..., rows])
        result.append(own)
    return result
