r"""Central values and the coordinates in which they are sampled, where some are known to be below others.

Without an order the coordinate of a centre is its distance from the prior's, in standard deviations. In a list of
centres that increase, only the lowest has this coordinate; of each other one it is the distance from the one before,

.. math:: \mu_k = \mu_{k-1} + w_k\, |s_k| ,

so that every vector obeys the order and none has a density of zero. The prior is the normal one of all centres, cut off
where the order is broken; as the Jacobian is constant, its density in the coordinates is that of the centres. As for a
dispersion, the sign of :math:`s_k` has no meaning, and the posterior is an even function of it. The unit
:math:`w_k`, the root mean square of the distance under the prior without the order, makes s about one at most.

A centre with a Student t prior has a coordinate that is standard normal under it (:mod:`.prior_tails`). In an order it
has the coordinates above, in which the density is that of the centres; as recordings may overrule such a prior, its
unit is as wide as the default prior's.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.population import prior_tails
from bayes_impedance.population.prior import Prior

_TRIED, _FEWEST = 20_000, 4
"""Draws of the prior of a list's elements by which the order is tried, and least number of them that must obey it. By
choice: fewer than one in five thousand is what a list in the wrong order gives, or one of more than six elements that
have one prior (of which 1 in 6! = 720 obeys); and drawing until one obeys stays fast."""


class Centres:
    """The map between N central values and their coordinates.

    Parameters
    ----------
    prior : Prior
        Of the N central values, with their order.
    """

    def __init__(self, prior: Prior) -> None:
        self.prior, self.order = prior, prior.order
        self.curved = prior.tailed.copy()  # whose coordinates are standard normal under a Student t
        self.unit, sds = prior.centre_sds.copy(), prior.starting_sds
        for chain in self.order.chains:
            self.curved[list(chain)] = False
            self.unit[chain[0]] = sds[chain[0]]
            for low, high in pairwise(chain):
                away = prior.centre[high] - prior.centre[low]
                self.unit[high] = np.sqrt(sds[low] ** 2 + sds[high] ** 2 + away**2)

    @property
    def even(self) -> np.ndarray:
        """Coordinates whose sign has no meaning: bool, shape (N,)."""
        result = np.zeros(self.unit.size, dtype=bool)
        for chain in self.order.chains:
            result[list(chain[1:])] = True
        return result

    def values(self, u: np.ndarray) -> np.ndarray:
        """Central values of coordinates, both (W, N)."""
        values = np.asarray(self.prior.centre + self.unit * self._standard(u, prior_tails.from_standard))
        for chain in self.order.chains:
            own = list(chain)
            apart = self.unit[own[1:]] * np.abs(u[:, own[1:]])
            values[:, own[1:]] = values[:, own[:1]] + np.cumsum(apart, axis=1)
        return values

    def coordinates(self, values: np.ndarray) -> np.ndarray:
        """Coordinates of central values, both (..., N); where these are not in order, of the nearest above."""
        u = self._standard((values - self.prior.centre) / self.unit, prior_tails.to_standard)
        for chain in self.order.chains:
            own = list(chain)
            u[..., own[1:]] = np.maximum(np.diff(values[..., own], axis=-1), 0.0) / self.unit[own[1:]]
        return u

    def _standard(self, rows: np.ndarray, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Rows (..., N) with the columns of Student t priors changed that have no order."""
        return prior_tails.changed(rows, self.curved, change)

    def _stretch(self, u: np.ndarray) -> np.ndarray:
        """Derivative of central values with respect to their coordinates (..., N), without the order."""
        return np.asarray(self.unit * np.where(self.curved, prior_tails.slope(u), 1.0))

    def scale(self, sds: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Rough standard deviations of the coordinates for those of the central values at `values`, all (N,)."""
        scale = np.asarray(sds / self._stretch(self.coordinates(values)))
        for chain in self.order.chains:
            own = list(chain)
            scale[own[1:]] = np.hypot(sds[own[1:]], sds[own[:-1]]) / self.unit[own[1:]]
        return scale

    def log_prior(self, u: np.ndarray) -> np.ndarray:
        """Log prior density of coordinates (W, N), up to a constant: shape (W,)."""
        if not self.order:
            return np.asarray(-0.5 * np.sum(u**2, axis=-1))
        z = (self.values(u) - self.prior.centre) / self.prior.centre_sds
        tails = self.prior.tailed & ~self.curved
        terms = np.where(tails, prior_tails.log_density(z), -0.5 * np.where(self.curved, u, z) ** 2)
        return np.asarray(np.sum(terms, axis=-1))

    def slope(self, u: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Gradient of a log posterior density with respect to the coordinates.

        Parameters
        ----------
        u : ndarray, shape (W, N)
        gradient : ndarray, shape (W, N)
            Of the log likelihood, with respect to the central values.

        Returns
        -------
        ndarray, shape (W, N)
        """
        sds = self.prior.centre_sds
        if self.prior.heavy is None:
            result = np.asarray(gradient * sds - u)
        else:
            result = np.asarray(gradient * self._stretch(u) - u)
        if self.order:
            z = (self.values(u) - self.prior.centre) / sds
            on_values = gradient - np.where(self.prior.tailed, prior_tails.weight(z), 1.0) * z / sds
            for chain in self.order.chains:
                own = list(chain)
                above = np.cumsum(on_values[:, own[::-1]], axis=1)[:, ::-1]  # of each with all that are above it
                result[:, own[0]] = above[:, 0] * self.unit[own[0]]
                result[:, own[1:]] = above[:, 1:] * self.unit[own[1:]] * np.sign(u[:, own[1:]])
        return result

    def require_possible(self) -> None:
        """Refuse an order that the prior itself all but excludes.

        Raises
        ------
        InputError
            If too few draws of the prior obey it.
        """
        rng = np.random.default_rng(0)
        for k in range(len(self.order.chains)):
            obeying = len(self._tried(k, rng))
            if obeying < _FEWEST:
                raise InputError(
                    f"order: only {obeying} of {_TRIED} draws of the priors of {', '.join(self.order.names[k])} are in "
                    "this order; exchange the names in the list, or give centres that increase"
                )

    def drawn(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Coordinates drawn from their prior, shape (n, N)."""
        u = rng.normal(size=(n, self.unit.size))
        if not self.order:
            return u
        values = np.asarray(self.prior.centre + self.prior.centre_sds * self._standard(u, prior_tails.from_standard))
        for k, chain in enumerate(self.order.chains):
            kept: list[np.ndarray] = []
            while sum(map(len, kept)) < n:
                kept.append(self._tried(k, rng))
            values[:, list(chain)] = np.concatenate(kept)[:n]
        return self.coordinates(values)

    def _tried(self, k: int, rng: np.random.Generator) -> np.ndarray:
        """Of many draws of the elements of a list those in order, shape (M, K)."""
        own = list(self.order.chains[k])
        normal = rng.normal(size=(_TRIED, len(own)))
        z = prior_tails.changed(normal, self.prior.tailed[own], prior_tails.from_standard)
        drawn = self.prior.centre[own] + self.prior.centre_sds[own] * z
        return np.asarray(drawn[np.all(np.diff(drawn, axis=1) > 0, axis=1)])
