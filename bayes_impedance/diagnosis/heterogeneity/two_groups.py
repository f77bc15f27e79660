r"""Mixtures of two groups along given directions: likelihood ratios to one group, for many directions at once.

If the groups differ by a shift along v, the projections of each person's pull and weight are sufficient statistics,
:math:`s_i = v^Tu_i` and :math:`I_i = v^TW_iv`. Together they are one measurement :math:`x_i = s_i/I_i` for each person,
with variance :math:`1/I_i`, of which :math:`t_0 = 1/(v^TT^{-1}v)` is the spread between persons along v and the rest is
the uncertainty from the other elements and the noise. With the spread t free and :math:`w_i = I_i / (1 + I_i (t -
t_0))`

.. math:: x_i \sim (1-\pi)\,N(m, 1/w_i) + \pi\,N(m + d, 1/w_i)

is a mixture in one dimension, whatever the number of elements; a person without information on v has :math:`w_i = 0`
and does not contribute. Its reference has m and t free as well, and d = 0. This is exact: a shift along v changes
nothing but m, and taking the spread of the groups out of T along v changes nothing but t (Sherman and Morrison). In
white coordinates T is the identity, and :math:`t_0 = 1` for a unit vector.

Both are maximised by expectation-maximisation, with a scoring step for t because the noise differs between persons.
The spread within the groups is common to both; the likelihood would be unbounded otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from bayes_impedance.diagnosis.fit.two_group_mixture import log_mixture, membership, share_of
from bayes_impedance.diagnosis.heterogeneity.bootstrap import Residuals

SMALLEST_SHARE, SMALLEST_GROUP = 0.05, 3.0
"""Smallest share and smallest number of persons of a group. By choice: fewer are outliers, not a group."""

_SPLITS = (0.1, 0.35, 0.65, 0.9)
"""Quantiles of the persons, ordered along a direction, at which a start splits them: small, medium and large groups. By
choice."""

_FIRST, _MORE = 6, 24
"""Rounds of expectation-maximisation to select the best start or direction, and rounds that follow from it. By choice:
replicates are treated in the same way, so that incomplete convergence does not bias the p-value."""

_REFINEMENTS, _STARTS = 6, 3
"""Updates of a direction to the difference between its groups, and number of directions that are updated. By choice."""

_SMALLEST_SPREAD = 0.02
"""Smallest variance within the groups, as a fraction of the variance of one group along v: with two points it would
be zero. By choice."""

_RIDGE = 1e-3
"""Added to the mean weight, so that it can be inverted in undetermined directions. By choice."""


@dataclass(frozen=True, kw_only=True)
class Mixture:
    """Maximum-likelihood mixtures along S directions in each of R populations.

    Attributes
    ----------
    direction : ndarray, shape (R, S, P)
        v as a unit vector in white coordinates: L^-1 (shift of the log elements), normalised.
    statistic : ndarray, shape (R, S)
        Twice the log likelihood ratio of two groups to one.
    share : ndarray, shape (R, S)
        pi, of the second group.
    middle, shift, spread : ndarray, shape (R, S)
        m, d and t, along the unit vector.
    membership : ndarray, shape (R, S, N)
        Probability of belonging to the second group.
    """

    direction: np.ndarray
    statistic: np.ndarray
    share: np.ndarray
    middle: np.ndarray
    shift: np.ndarray
    spread: np.ndarray
    membership: np.ndarray

    def best(self, count: int) -> Mixture:
        """The directions with the largest statistics, in each population."""
        order = np.argsort(-self.statistic, axis=1)[:, :count]

        def pick(values: np.ndarray) -> np.ndarray:
            index = order if values.ndim == 2 else order[..., None]
            return np.asarray(np.take_along_axis(values, index, axis=1))

        return Mixture(
            direction=pick(self.direction),
            statistic=pick(self.statistic),
            share=pick(self.share),
            middle=pick(self.middle),
            shift=pick(self.shift),
            spread=pick(self.spread),
            membership=pick(self.membership),
        )


def along_elements(residuals: Residuals, elements: np.ndarray) -> Mixture:
    """Mixtures whose groups differ in one element, for each of `elements` (indices): two directions per element.

    First the element conditional on the others, which is most powerful if they are correlated. Then the element
    marginally, the others shifting with it by regression: a large shift makes chance differences between the groups
    look like correlations, and the conditional expectation is then misleading.
    """
    beyond = np.swapaxes(np.linalg.inv(residuals.factor)[:, :, elements], 1, 2)
    return along(residuals, _unit(np.concatenate([beyond, residuals.factor[:, elements]], axis=1)))


def along_any(residuals: Residuals, first: Mixture) -> Mixture:
    """The best mixture along any direction, searched from the best elements and the least normal directions.

    Two groups make the distribution along the line between them flat, or skewed if they are unequal. So eigenvectors of
    the fourth moments, and the third moment, are further starts (Tyler, Critchley, Dümbgen and Oja, J. R. Statist. Soc.
    B 71, 549-592, 2009). From a few of the best, v is updated to the difference between the groups.

    Returns
    -------
    Mixture
        One direction for each population.
    """
    pull, weight = residuals.pull, residuals.weight
    p = pull.shape[2]
    values, vectors = np.linalg.eigh(weight.mean(axis=1) + _RIDGE * np.eye(p))
    inverse = (vectors / values[:, None]) @ np.swapaxes(vectors, 1, 2)
    root = (vectors / np.sqrt(values)[:, None]) @ np.swapaxes(vectors, 1, 2)
    z = pull @ root
    square = np.sum(z**2, axis=2, keepdims=True)
    fourth = np.swapaxes(square * z, 1, 2) @ z
    third = np.sum(square * z, axis=1, keepdims=True)
    starts = np.concatenate([np.swapaxes(np.linalg.eigh(fourth)[1], 1, 2), third], axis=1) @ root
    found = _joined(first, along(residuals, _unit(starts), _FIRST)).best(_STARTS)
    for k in range(_REFINEMENTS):
        contrast = found.membership - found.membership.mean(axis=2, keepdims=True)
        direction = _unit(contrast @ pull @ inverse)
        new = along(residuals, direction, _MORE if k == _REFINEMENTS - 1 else _FIRST, found.membership)
        found = _joined(found, new).best(_STARTS)
    return found.best(1)


def along(residuals: Residuals, direction: np.ndarray, more: int = _MORE, belongs: np.ndarray | None = None) -> Mixture:
    """Mixtures along unit vectors in white coordinates, shape (R, S, P).

    The start is `belongs`, memberships (R, S, N), if given, else the best of some splits of the persons.
    """
    s = direction @ np.swapaxes(residuals.pull, 1, 2)
    r, n, p, _ = residuals.weight.shape
    outer = (direction[..., :, None] * direction[..., None, :]).reshape(r, -1, p * p)
    information = np.maximum(outer @ np.swapaxes(residuals.weight.reshape(r, n, p * p), 1, 2), 0.0)
    x = np.where(information > 1e-12, s / np.maximum(information, 1e-12), 0.0)
    middle, spread = _one_group(x, information)
    smallest = _SMALLEST_SPREAD * spread
    reference = _log_likelihood(x, information, middle, spread, np.zeros_like(middle), np.full_like(middle, 0.5))
    if belongs is None:
        # Persons above a quantile of the standardised values form the second group.
        rank = np.argsort(np.argsort(s / np.sqrt(np.maximum(information, 1e-12)), axis=2), axis=2)
        split = (rank[:, :, None] >= np.array(_SPLITS)[:, None] * n).astype(float)  # (R, S, starts, N)
        wide, wide_information = x[:, :, None], information[:, :, None]
        state = _maximise(wide, wide_information, split, spread[..., None], smallest[..., None], _FIRST)
        best = np.argmax(_log_likelihood(wide, wide_information, *state[:4]), axis=2)[..., None]
        belongs = np.take_along_axis(state[4], best[..., None], axis=2)[:, :, 0]
        spread = np.take_along_axis(state[1], best, axis=2)[..., 0]
    middle, spread, shift, share, belongs = _maximise(x, information, belongs, spread, smallest, more)
    value = _log_likelihood(x, information, middle, spread, shift, share)
    return Mixture(
        direction=direction,
        statistic=2 * (value - reference),
        share=share,
        middle=middle,
        shift=shift,
        spread=spread,
        membership=belongs,
    )


def _one_group(x: np.ndarray, information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and spread of one group along each direction: x, information (..., N)."""
    spread = np.ones(x.shape[:-1])
    middle = np.zeros_like(spread)
    for _ in range(_FIRST):
        w = information / (1 + information * (spread[..., None] - 1))
        middle = np.sum(w * x, axis=-1) / np.maximum(np.sum(w, axis=-1), 1e-12)
        excess = w * (w * (x - middle[..., None]) ** 2 - 1)
        spread = spread + np.sum(excess, axis=-1) / np.maximum(np.sum(w * w, axis=-1), 1e-12)
        spread = np.maximum(spread, _SMALLEST_SPREAD)
    return middle, spread


def _maximise(
    x: np.ndarray, information: np.ndarray, belongs: np.ndarray, spread: np.ndarray, smallest: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rounds of expectation-maximisation from memberships (..., N): m, t, d, pi (...) and memberships."""
    n = x.shape[-1]
    least = min(max(SMALLEST_SHARE, SMALLEST_GROUP / n), 0.5)
    for _ in range(rounds):
        w = information / (1 + information * (spread[..., None] - 1))
        second = w * belongs
        total, other = np.sum(w, axis=-1), np.sum(second, axis=-1)
        weighted, weighted_other = np.sum(w * x, axis=-1), np.sum(second * x, axis=-1)
        middle = (weighted - weighted_other) / np.maximum(total - other, 1e-12)
        shift = weighted_other / np.maximum(other, 1e-12) - middle
        share = share_of(belongs, least)
        away = x - middle[..., None]
        gain = shift[..., None] * (shift[..., None] - 2 * away)
        excess = w * (w * (away * away + belongs * gain) - 1)
        spread = spread + np.sum(excess, axis=-1) / np.maximum(np.sum(w * w, axis=-1), 1e-12)
        spread = np.maximum(spread, smallest)
        w = information / (1 + information * (spread[..., None] - 1))
        belongs = membership(-0.5 * w * gain, share)
    return middle, spread, shift, share, belongs


def _log_likelihood(
    x: np.ndarray,
    information: np.ndarray,
    middle: np.ndarray,
    spread: np.ndarray,
    shift: np.ndarray,
    share: np.ndarray,
) -> np.ndarray:
    """Log likelihood of mixtures up to a constant for each person: x, information (..., N), the others (...)."""
    stretch = 1 + information * (spread[..., None] - 1)
    w = information / stretch
    away = x - middle[..., None]
    gain = 0.5 * w * shift[..., None] * (2 * away - shift[..., None])
    return np.asarray(np.sum(log_mixture(gain, share) - 0.5 * np.log(stretch) - 0.5 * w * away * away, axis=-1))


def _unit(direction: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 1e-12, direction / np.maximum(length, 1e-12), direction.shape[-1] ** -0.5))


def _joined(one: Mixture, other: Mixture) -> Mixture:
    names = (field.name for field in fields(Mixture))
    return Mixture(**{k: np.concatenate([getattr(one, k), getattr(other, k)], axis=1) for k in names})
