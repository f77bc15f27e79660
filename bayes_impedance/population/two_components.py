r"""Populations of two groups of people: a mixture of two normal distributions with one covariance.

With mean :math:`\mu_i = \mu + Bx_i`, share w of the second group, difference :math:`\delta` of the groups' centres and
covariance :math:`\Sigma_w` within a group, the same in both, a person's log elements are

.. math:: \theta_i \sim (1 - w)\,N(\mu_i - w\delta,\ \Sigma_w) + w\,N(\mu_i + (1 - w)\delta,\ \Sigma_w), \qquad
          \mathrm E\,\theta_i = \mu_i, \quad \operatorname{cov}\theta_i = \Sigma = \Sigma_w + w(1-w)\,\delta\delta^T .

So centre, dispersions and correlations mean what they mean of a normal population, and have the same prior: the mixture
adds what a normal distribution with these moments does not say. With the factor :math:`\Sigma = LL^T` it is a vector v,
the separation:

.. math:: \delta = \frac{L v}{\sqrt{w(1-w)\,(1 + |v|^2)}}, \qquad \Sigma_w = L\,(I + vv^T)^{-1} L^T, \qquad
          |v|^2 = w(1-w)\,D^2, \quad D^2 = \delta^T\Sigma_w^{-1}\delta ,

any v being possible. D is the distance of the centres in standard deviations within a group: at w = 1/2 the density has
two peaks where it is above two. At v = 0 the population is normal whatever w is, and as its moments do not depend on v
the likelihood is flat there to second order: nothing is singular where people are of one kind.

Why one covariance: two of P (P + 1)/2 numbers each are more than some dozens of people determine, and a group of few
people with a covariance of its own can shrink onto one person, where the likelihood has no bound.

**Repetitions.** Their mean over J has :math:`\operatorname{diag}(\rho^2)/J` more in both groups. The likelihood of the
population is the sum of those of two normal ones from the same draws
(:mod:`bayes_impedance.population.importance_likelihood`).

**Prior.** w is uniform on (0.1, 0.9) (:data:`LEAST_SHARE`), v is normal with standard deviation
:math:`c/\sqrt P` in each of P elements (:data:`SEPARATION`), which prefers no direction, whatever the correlations are.
Sampled are v in units of this deviation, and the probit of w's prior probability.

**Labels.** (w, v) and (1 - w, -v) are one population. Draws are labelled when they have been sampled
(:func:`bayes_impedance.mcmc.mirrored.labelled`): the second group is the smaller one on average.

**Derivatives.** With g and h the derivatives of the log density with respect to the two groups' means, S that with
respect to :math:`\Sigma_w`, :math:`G = (1-w)h - wg` and :math:`B = L^T S L`, those with respect to L and v are

.. math:: \frac{\partial}{\partial L} = \frac{G v^T}{\sqrt{w(1-w)(1+|v|^2)}} + 2SL(I + vv^T)^{-1}, \qquad
          \frac{\partial}{\partial v} = \frac{(I + vv^T)^{-1} L^T G}{\sqrt{w(1-w)(1+|v|^2)}}
          - \frac{2Bv}{1 + |v|^2} + \frac{2\,(v^TBv)\,v}{(1+|v|^2)^2} .

The derivative with respect to :math:`\Sigma` follows from that with respect to L: the symmetric part of
:math:`L^{-T}\,\Phi(L^T\,\partial/\partial L)\,L^{-1}`, where :math:`\Phi` takes the lower triangle and half of the
diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr, ndtri

if TYPE_CHECKING:
    from bayes_impedance.population.parameters import PopulationParameters

MIXTURE = "mixture"
"""Distribution of people's log elements: two groups."""

LEAST_SHARE = 0.1
"""Least share of people in a group. By choice: one or two people far from the others are no group, but what
:mod:`bayes_impedance.population.heavy_tails` is for; and a group of which nobody was recorded is believed less the more
people there are (0.9^N)."""
SEPARATION = 1.5
"""Root mean square of the separation \\|v\\| under the prior: three standard deviations between two groups of equal
size. By choice: at two the density begins to have two peaks, and at four groups hardly overlap."""
_GROUPS = 2
"""Number of groups. By choice: more of them are more than some dozens of people determine."""


@dataclass(frozen=True)
class Groups:
    """What W populations of two groups have besides their moments.

    Attributes
    ----------
    share : ndarray, shape (W,)
        Share w of people in the second group.
    separation : ndarray, shape (W, P)
        The vector v; zero for elements in which groups do not differ.
    """

    share: np.ndarray
    separation: np.ndarray

    def __getitem__(self, rows: slice | np.ndarray) -> Groups:
        return Groups(self.share[rows], self.separation[rows])

    @property
    def distance(self) -> np.ndarray:
        """Distance D of the centres in standard deviations within a group, shape (W,)."""
        return np.asarray(np.linalg.norm(self.separation, axis=-1) / np.sqrt(self.share * (1 - self.share)))

    def difference(self, factor: np.ndarray) -> np.ndarray:
        """Centre of the second group less that of the first, (W, P), for factors (W, P, P) of the whole covariance."""
        return np.asarray(np.einsum("wpq,wq->wp", factor, self.separation * self._of_difference[:, None]))

    @property
    def _of_difference(self) -> np.ndarray:
        """Factor on v of the difference in coordinates in which the whole covariance is one, shape (W,)."""
        return np.asarray(1 / np.sqrt(self.share * (1 - self.share) * (1 + np.sum(self.separation**2, axis=-1))))

    @property
    def offsets(self) -> np.ndarray:
        """Centres of the two groups less the mean in these coordinates, shape (W, 2, P)."""
        away = np.stack([-self.share, 1 - self.share], axis=-1)[..., None]
        return np.asarray(away * (self.separation * self._of_difference[:, None])[:, None])

    @property
    def log_weight(self) -> np.ndarray:
        """Logarithms of the shares of both groups, shape (W, 2)."""
        return np.asarray(np.log(np.stack([1 - self.share, self.share], axis=-1)))

    @property
    def within(self) -> np.ndarray:
        """Covariance within a group in these coordinates, (I + v v^T)^-1, shape (W, P, P)."""
        v, longer = self.separation, 1 + np.sum(self.separation**2, axis=1)
        return np.asarray(np.eye(v.shape[1]) - v[:, :, None] * v[:, None, :] / longer[:, None, None])

    def of_people(self, white: np.ndarray) -> np.ndarray:
        """Log density of people in these coordinates, (W, N, P), with the log probability of either group.

        Returns
        -------
        ndarray, shape (W, N, 2)
            Relative to the normalisation (2 pi)^(-P/2); the log density of a person is the logarithm of the sum of
            exponentials over the last axis.
        """
        away = white[:, :, None] - self.offsets[:, None]
        along = np.einsum("wnkp,wp->wnk", away, self.separation)
        square = np.sum(away**2, axis=-1) + along**2
        volume = np.log1p(np.sum(self.separation**2, axis=-1))
        return np.asarray(self.log_weight[:, None] - 0.5 * square + 0.5 * volume[:, None, None])


def groups_of(difference: np.ndarray, share: np.ndarray, factor: np.ndarray) -> Groups:
    """Inverse of :meth:`Groups.difference`, for elements some of which may have no dispersion.

    Parameters
    ----------
    difference : ndarray, shape (W, P)
    share : ndarray, shape (W,)
    factor : ndarray, shape (W, P, P)
        Lower factors of the whole covariance; rows of zeros for what is the same in everybody.

    Raises
    ------
    ValueError
        If groups that far apart have a larger covariance than the whole.
    """
    p = np.arange(factor.shape[-1])
    solvable = factor.copy()
    solvable[:, p, p] = np.where(factor[:, p, p] == 0, 1.0, factor[:, p, p])
    white = np.linalg.solve(solvable, difference[..., None])[..., 0]
    explained = share * (1 - share) * np.sum(white**2, axis=1)  # part of the variance along v: |v|^2 / (1 + |v|^2)
    if not np.all(explained < 1):
        raise ValueError("the groups are farther apart than the dispersions of all subjects allow")
    length = np.sqrt(share * (1 - share) / (1 - explained))
    return Groups(share, white * length[:, None])


def share_of(coordinate: np.ndarray) -> np.ndarray:
    """Share of the second group for its coordinate, which is standard normal under the prior."""
    return np.asarray(LEAST_SHARE + (1 - 2 * LEAST_SHARE) * ndtr(coordinate))


def share_coordinate(share: np.ndarray) -> np.ndarray:
    """Inverse of :func:`share_of`."""
    return np.asarray(ndtri((share - LEAST_SHARE) / (1 - 2 * LEAST_SHARE)))


def share_slope(coordinate: np.ndarray) -> np.ndarray:
    """Derivative of :func:`share_of`."""
    return np.asarray((1 - 2 * LEAST_SHARE) * np.exp(-0.5 * coordinate**2) / np.sqrt(2 * np.pi))


def parts_of_groups(parameters: PopulationParameters) -> tuple[PopulationParameters, np.ndarray]:
    """The two normal populations of each of W populations: 2 W sets, and the logarithms of their shares, (W, 2)."""
    groups = parameters.groups
    assert groups is not None  # it has been asked whether there are groups
    factor = parameters.covariance_cholesky
    each = replace(parameters[np.repeat(np.arange(len(factor)), _GROUPS)], groups=None)
    own = factor @ np.linalg.cholesky(groups.within)
    sd = np.linalg.norm(own, axis=-1)
    away = np.einsum("wpq,wkq->wkp", factor, groups.offsets).reshape(each.mu.shape)
    return replace(
        each,
        mu=each.mu + away,
        between_persons=np.repeat(sd, _GROUPS, axis=0),
        correlation_cholesky=np.repeat(own / sd[..., None], _GROUPS, axis=0),
    ), groups.log_weight


def drawn_people(groups: Groups, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """People in the coordinates in which the whole population has mean zero and covariance one.

    Parameters
    ----------
    groups : Groups
        W populations.
    normal : ndarray, shape (W, ..., P)
        Standard normal.
    rng : Generator
        Draws the group of each person.

    Returns
    -------
    ndarray, shape (W, ..., P)
    """
    shape = (len(normal), *np.ones(normal.ndim - 2, dtype=int))
    v = groups.separation.reshape(*shape, -1)
    longer = np.sqrt(1 + np.sum(v**2, axis=-1, keepdims=True))
    inside = normal - v * np.sum(v * normal, axis=-1, keepdims=True) / (longer * (1 + longer))
    second = rng.random(normal.shape[:-1]) < groups.share.reshape(shape)
    rows = np.arange(len(normal)).reshape(shape)
    return np.asarray(inside + groups.offsets[rows, second.astype(int)])


# -------------------------------------------------------------------- derivatives


def through_groups(
    parameters: PopulationParameters, on_means: np.ndarray, on_within: np.ndarray, people: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives with respect to the whole covariance, the share and the separation.

    Parameters
    ----------
    parameters : PopulationParameters
        W sets.
    on_means : ndarray, shape (W, 2, P)
        Derivatives with respect to the means of the groups.
    on_within : ndarray, shape (W, P, P)
        With respect to the covariance within a group, symmetric.
    people : ndarray, shape (W, 2)
        Sum over people of the probability of each group.

    Returns
    -------
    on_covariance : ndarray, shape (W, P, P)
        Symmetric.
    on_share : ndarray, shape (W,)
    on_separation : ndarray, shape (W, P)
    """
    groups, factor = parameters.groups, parameters.covariance_cholesky
    assert groups is not None  # it has been asked whether there are groups
    w, v, within = groups.share, groups.separation, groups.within
    scale, one = groups._of_difference[:, None], 1 + np.sum(v**2, axis=1)[:, None]
    on_difference = (1 - w)[:, None] * on_means[:, 1] - w[:, None] * on_means[:, 0]
    transposed = np.swapaxes(factor, -1, -2)
    on_factor = on_difference[:, :, None] * (scale * v)[:, None, :] + 2 * on_within @ factor @ within
    inner = np.tril(transposed @ np.tril(on_factor))
    p = np.arange(v.shape[1])
    inner[:, p, p] *= 0.5
    inverse = np.linalg.inv(factor)
    on_covariance = np.swapaxes(inverse, -1, -2) @ inner @ inverse
    pulled = np.einsum("wpq,wp->wq", factor, on_difference)
    spread = np.einsum("wpq,wq->wp", transposed @ on_within @ factor, v)
    on_v = scale * np.einsum("wpq,wq->wp", within, pulled)
    on_v += -2 * spread / one + 2 * np.sum(v * spread, axis=1)[:, None] * v / one**2
    difference = groups.difference(factor)
    on_w = people[:, 1] / w - people[:, 0] / (1 - w) - np.sum(difference * on_means.sum(axis=1), axis=1)
    on_w -= np.sum(difference * on_difference, axis=1) * (1 - 2 * w) / (2 * w * (1 - w))
    return 0.5 * (on_covariance + np.swapaxes(on_covariance, -1, -2)), on_w, on_v


# -------------------------------------------------------------------- a first estimate


def estimated_groups(white: np.ndarray) -> Groups:
    """The two groups of greatest posterior density, given people in coordinates of mean zero and covariance one (N, P).

    The search begins along each axis and principal axis, with either group the smaller one: a start for sampling.
    """
    p = white.shape[1]
    unit = SEPARATION / np.sqrt(p)

    def of(x: np.ndarray) -> Groups:
        return Groups(share_of(x[None, -1]), unit * x[None, :-1])

    def objective(x: np.ndarray) -> float:
        people = np.logaddexp.reduce(of(x).of_people(white[None]), axis=-1)
        return float(0.5 * np.sum(x**2) - np.sum(people))

    axes = np.vstack([np.eye(p), np.linalg.eigh(np.cov(white.T).reshape(p, p))[1].T])
    starts = [np.append(sign * axis / unit, -0.5) for axis in axes for sign in (1, -1)]
    found = [minimize(objective, start, method="L-BFGS-B", bounds=[(-6, 6)] * (p + 1)) for start in starts]
    return of(min(found, key=lambda own: float(own.fun)).x)
