r"""A person's importance draws when the dispersions between repetitions move.

The likelihood of population parameters takes the contrasts between repetitions at each person's mode
(:mod:`bayes_impedance.population.contrasts`). But what they say of rho depends on where the person's mean lies: the
likelihood of a draw changes by :math:`c_k(\rho)` more than that at the mode
(:mod:`bayes_impedance.person.dispersion_response`), and

.. math:: p(z_i\,|\,\mu, T, \rho) \approx C_i(\rho)\,\frac1K \sum_k \frac{L_i(\theta_k)}{q_i(\theta_k)}\,
          N(\theta_k; \mu, T)\,e^{c_k(\rho)} .

Without :math:`c_k` the likelihood of a dispersion is too narrow where one person's recordings determine an element
weakly: 16 people whose repetitions differed by 0.22 in a spring were given 0.07 with a standard deviation of 0.03.

**A polynomial for each draw.** Elements' dispersions act nearly independently, so that :math:`c_k` is taken as a sum
over elements of functions of one dispersion each. If recordings determine a deviation with curvature h and slope b,

.. math:: \ln p(\rho) = -\tfrac12\ln(1 + h\rho^2) + \tfrac12\,b^2 v, \qquad v = \frac{\rho^2}{1 + h\rho^2},

where v is the deviation's posterior variance. A draw at which h and b are a little different from those at the mode
changes that by :math:`-\tfrac12 v\,\delta h - \tfrac12 b^2 v^2\,\delta h + b v\,\delta b`, a polynomial of degree two
in v. So :math:`c_k` is taken as one in

.. math:: t_p \propto \frac{\rho_p^2}{\rho_p^2 + s_p^2}, \qquad s_p = h_p^{-1/2},

where :math:`s_p`, the standard deviation with which recordings determine a deviation, is that of the median person. t
is zero at :math:`\bar\rho_p`, where the draws are made and the polynomials have no constant, and its range is one wide.
The nodes at which polynomials are fitted span what the contrasts at the modes leave possible. Beyond that a draw's
likelihood is that at the edge. The contrasts go on there, so that an edge inside the posterior would be a false peak:
the range moves outward until the posterior lies within it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.dispersion_response import response_of, responses
from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO, Ridge
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.e_step import PersonFit, contrasts_of
from bayes_impedance.population.prior import Prior
from bayes_impedance.runtime.sharded import Kept

_DEGREE, _NODES = 2, 6
"""Degree of the polynomials and number of nodes. Measured: of 20 people whose recordings resolve a spring's change only
where it exceeds what is likely, the log likelihood of a change of nearly zero was 0.3 to 1.1 too low against that of
the likely one when t bent at the likely dispersion, and is off by 0.3 at most (0.15 in the middle) where it bends at
what recordings resolve; polynomials of degree four are no better. In four populations of 16 people cross terms between
elements changed the log likelihood by less than 0.01."""
_GRID, _LEAST_SHARE, _FARTHER = 60, 0.005, 1.5
"""Number of dispersions at which the contrasts' likelihood is taken, the share of it that is left out on either side,
and by how much the range of the rest is widened. By choice: with the other dispersions held, a range is too narrow."""
_FAR = 10.0
"""Most by which the bend of t lies beyond the range, as a factor. By choice: t is proportional to the square of rho, or
to that of its reciprocal, to a hundredth then."""
BEYOND_ALLOWED = 0.025
"""Largest share of an element's likely dispersions that may lie beyond either end of the range: half of what a 90 %
interval leaves out there, so that its ends lie where the likelihood is known."""
_NEGLIGIBLE, _LEFT_OUT, _ROUGH = 12.0, 1e4, 1.0
"""As in :mod:`bayes_impedance.population.shared_draws`: the logarithm of how much smaller than the average a draw's
weight may be, what such draws are divided by, and the largest error of a polynomial."""


@dataclass(frozen=True)
class DispersionRange:
    """Where dispersions between repetitions may be, each of shape (P,).

    Attributes
    ----------
    middle : ndarray
        At which deviations are integrated out of the draws' likelihoods.
    lowest, highest : ndarray
        The ends, above zero.
    resolved : ndarray
        Standard deviation with which the median person's recordings determine a deviation.
    """

    middle: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    resolved: np.ndarray

    @classmethod
    def of_draws(cls, rho: np.ndarray, fits: Sequence[PersonFit]) -> DispersionRange:
        """That of posterior draws (W, P), for the recordings of some people."""
        levels = np.quantile(np.maximum(rho, LEAST_RHO), (_LEAST_SHARE, 0.5, 1 - _LEAST_SHARE), axis=0)
        return cls._wider(levels, _typical([_resolved(fits, levels[1])], levels[1]))

    @classmethod
    def _wider(cls, levels: np.ndarray, resolved: np.ndarray) -> DispersionRange:
        """From the lowest, middle and highest dispersions (3, P) that leave a small share on either side."""
        lowest, middle, highest = levels
        lowest = np.maximum(middle - _FARTHER * (middle - lowest), 0.5 * LEAST_RHO)
        highest = np.maximum(middle + _FARTHER * (highest - middle), 2 * LEAST_RHO)
        return cls(np.maximum(middle, LEAST_RHO), lowest, highest, resolved)

    def beyond(self, rho: np.ndarray) -> np.ndarray:
        """Share of dispersions (W, P) below and above the range, shape (2, P); what is negligible is all the same."""
        own = np.maximum(rho, LEAST_RHO)
        return np.array([np.mean(own < self.lowest, axis=0), np.mean(own > self.highest, axis=0)])

    def reaching(self, rho: np.ndarray, free: Sequence[int]) -> DispersionRange:
        """The range with those ends moved outward beyond which too many of likely dispersions (W, P) lie.

        Only those of the elements `free`, given by their indices; if none moves, this range itself returns. An end
        moves no farther than these dispersions ask for, since polynomials describe a wider range less precisely.
        """
        below, above = (self.beyond(rho) > BEYOND_ALLOWED) & np.isin(np.arange(rho.shape[1]), free)
        if not np.any(below | above):
            return self
        least, most = np.quantile(np.maximum(rho, LEAST_RHO), (_LEAST_SHARE, 1 - _LEAST_SHARE), axis=0)
        wider = self._wider(np.array([least, self.middle, most]), self.resolved)
        lowest, highest = np.where(below, wider.lowest, self.lowest), np.where(above, wider.highest, self.highest)
        return replace(self, lowest=lowest, highest=highest)

    @property
    def nodes(self) -> np.ndarray:
        """Dispersions at which draws' likelihoods are computed, shape (P, M), evenly spread in t."""
        share = np.linspace(self._share(self.lowest), self._share(self.highest), _NODES, axis=1)
        return np.asarray(self._bend[:, None] * np.sqrt(share / (1 - share)))

    def terms(self, rho: np.ndarray) -> np.ndarray:
        """Powers of t of dispersions (W, P), shape (W, M): all elements' first, then all elements' squares."""
        t = self._t(np.clip(rho, self.lowest, self.highest))
        return np.concatenate([t**power for power in range(1, _DEGREE + 1)], axis=-1)

    def slopes(self, rho: np.ndarray, on_terms: np.ndarray) -> np.ndarray:
        """Derivatives with respect to dispersions (W, P), from those with respect to :meth:`terms` (W, M)."""
        inside = (rho > self.lowest) & (rho < self.highest)
        t = self._t(rho)
        own = np.split(on_terms, _DEGREE, axis=-1)
        on_t = sum(power * t ** (power - 1) * slope for power, slope in enumerate(own, start=1))
        turning = 2 * rho * self._bend**2 / (rho**2 + self._bend**2) ** 2 / self._width
        return np.asarray(np.where(inside, on_t * turning, 0.0))

    def _t(self, rho: np.ndarray) -> np.ndarray:
        return np.asarray((self._share(rho) - self._share(self.middle)) / self._width)

    def _share(self, rho: np.ndarray) -> np.ndarray:
        return np.asarray(rho**2 / (rho**2 + self._bend**2))

    @property
    def _bend(self) -> np.ndarray:
        return np.asarray(np.clip(self.resolved, self.lowest / _FAR, self.highest * _FAR))

    @property
    def _width(self) -> np.ndarray:
        return np.asarray(self._share(self.highest) - self._share(self.lowest))


def range_of(fits: Kept, prior: Prior, rho: np.ndarray) -> DispersionRange | None:
    """The range from the contrasts at people's modes; None if nobody was recorded more than once.

    Parameters
    ----------
    fits : Kept of PersonFit
    prior : Prior
        Of the P elements that differ between people.
    rho : ndarray, shape (P,)
        Point estimate: each dispersion is varied while the others are held there.
    """
    rho = np.maximum(rho, LEAST_RHO)
    # Logarithmic, from what is negligible to what the prior allows.
    grid = np.geomspace(LEAST_RHO, np.maximum(3 * prior.dispersion_sds, 2 * rho), _GRID, axis=1)
    sets = np.repeat(rho[None], rho.size * _GRID, axis=0)
    for p in range(rho.size):
        sets[p * _GRID : (p + 1) * _GRID, p] = grid[p]
    parts = fits.ask(_profiles, sets)
    if all(part is None for part in parts):
        return None
    log_density = np.sum([part for part in parts if part is not None], axis=0).reshape(rho.size, _GRID)
    log_density = log_density - 0.5 * (grid / prior.dispersion_sds[:, None]) ** 2
    weight = np.exp(log_density - log_density.max(axis=1, keepdims=True)) * grid  # of equal steps in the logarithm
    share = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
    levels = [
        [np.interp(level, own, g) for own, g in zip(share, grid, strict=True)]
        for level in (_LEAST_SHARE, 0.5, 1 - _LEAST_SHARE)
    ]
    middle = np.array(levels[1])
    return DispersionRange._wider(np.array(levels), _typical(fits.ask(_resolved, middle), middle))


def _typical(resolved: Sequence[np.ndarray], rho: np.ndarray) -> np.ndarray:
    """Median over all contrasts of some parts of the persons, (P,); rho (P,) where nobody was recorded twice."""
    own = np.concatenate(resolved)
    return np.asarray(np.median(own, axis=0)) if len(own) else rho


def _resolved(fits: Sequence[PersonFit], rho: np.ndarray) -> np.ndarray:
    """Standard deviation with which recordings determine every contrast between repetitions of some persons, (M, P).

    The other elements' contrasts are free within their dispersions rho (P,).
    """
    found, rho = [], np.maximum(rho, LEAST_RHO)
    for j, group in contrasts_of(fits).items():
        posterior = np.linalg.inv(np.moveaxis(group.information, -1, 0) + np.diag(np.tile(rho**-2.0, j - 1)))
        variance = np.diagonal(posterior, axis1=1, axis2=2).reshape(-1, rho.size)
        found.append(rho * np.sqrt(variance / np.maximum(rho**2 - variance, np.finfo(float).eps * rho**2)))
    return np.concatenate(found) if found else np.empty((0, rho.size))


def _profiles(fits: Sequence[PersonFit], sets: np.ndarray) -> np.ndarray | None:
    """Contrasts' log likelihood of some persons under sets of dispersions (W, P); None if there are no contrasts."""
    own = [contrasts.log_likelihood(sets) for contrasts in contrasts_of(fits).values()]
    return np.sum(own, axis=0) if own else None


def with_responses(
    kernel: Kernel,
    span: DispersionRange,
    likelihood: Likelihood,
    fit: PersonFit,
    ridge: Ridge,
    draws: Draws,
) -> tuple[Draws, np.ndarray]:
    """Coefficients (M, K) of the draws' polynomials; draws that have no weight anywhere are left out of what returns.

    Parameters
    ----------
    kernel : Kernel
    span : DispersionRange
    likelihood : Likelihood
        With the deviations at their mode.
    fit : PersonFit
        The person's mode, where the contrasts' likelihood is taken.
    ridge : Ridge
        At the middle of the range.
    draws : Draws
        K of them.
    """
    n_draws, n_elements = draws.theta.shape
    if len(likelihood.z) == 1:
        return draws, np.zeros((_DEGREE * n_elements, n_draws))
    nodes = span.nodes
    at_mode: Contrasts = next(iter(contrasts_of([fit]).values()))
    own = response_of(at_mode.information[:, :, 0], at_mode.gradient[:, 0], ridge.rho, nodes)
    changes = responses(kernel, likelihood, ridge, draws.theta, nodes) - own
    # Draws that have no weight at any node are left out: their likelihoods, far from the recordings, change by more
    # than a polynomial can follow, which might give them a weight.
    weights = draws.log_weight[:, None] + np.hstack([np.zeros((n_draws, 1)), changes.reshape(n_draws, -1)])
    weights = np.where(np.isfinite(weights), weights, -np.inf)
    weights -= np.logaddexp.reduce(weights, axis=0)
    without = ~(weights.max(axis=1) >= -np.log(n_draws) - _NEGLIGIBLE)
    changes[without] = 0.0
    t = np.array([span.terms(node) for node in nodes.T]).reshape(_NODES, _DEGREE, n_elements)
    coefficients = np.empty((_DEGREE, n_elements, n_draws))
    rough = np.zeros(n_draws, dtype=bool)
    for p in range(n_elements):
        coefficients[:, p] = np.linalg.lstsq(t[:, :, p], changes[:, p].T, rcond=None)[0]
        rough |= np.abs(t[:, :, p] @ coefficients[:, p] - changes[:, p].T).max(axis=0) > _ROUGH
    # Such draws get the smallest value that they have.
    coefficients[:, :, rough] = 0.0
    lowest = np.minimum(changes.reshape(n_draws, -1).min(axis=1), 0.0)
    log_ratio = draws.log_ratio - _LEFT_OUT * without + np.where(rough & ~without, lowest, 0.0)
    return replace(draws, log_ratio=log_ratio), coefficients.reshape(_DEGREE * n_elements, n_draws)
