r"""Spike and slab: a coefficient that is zero in some people and normally distributed among the others.

With the quadratic log likelihood :math:`h_ic - \tfrac12D_ic^2` of each person's coefficient,

.. math:: c_i \sim (1 - \pi)\,\delta_0 + \pi\,N(\mu, \tau^2), \qquad
          \ln\int e^{hc - Dc^2/2} N(c; \mu, \tau^2)\,dc = \frac{h^2\tau^2 + 2h\mu - D\mu^2}{2(1 + D\tau^2)}
          - \tfrac12\ln(1 + D\tau^2)

is maximised by expectation-maximisation and compared with the model in which all people have it (pi = 1, with mean and
dispersion free).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.normal_equations import quadratic
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.two_group_mixture import log_mixture, membership, share_of

_ROUNDS = 200
"""Rounds of expectation-maximisation. A dispersion that is not zero has converged to rounding by then. One that goes to
zero has not: on 10 of 30 simulated populations it was still at 1 to 8 % of the mean, the gain being off by 0.7 at
most."""

_SMALLEST_FRACTION = 0.02
"""The mixture's share stays between this and one minus this: parameters of an empty group are undetermined. By
choice."""

_MOST_FRACTION = 0.85
"""Share from which an effect is attributed to all people: the few others may have a small one. By choice."""

FEWEST_MEMBERS = 2.5
"""Expected number of people who must have an effect: one or two are outliers and not a group."""

_LEAST_GAIN = 3.0
"""Log likelihood by which "some have it" must exceed "all have it", which has one parameter less: a
likelihood ratio of 20."""

_AT_REST = 1e-9
"""Relative change below which the rounds end: the log likelihood then changes by rounding only."""

_START_DISPERSION, _SMALLEST_DISPERSION, _LARGEST_DISPERSION = 0.3, 1e-3, 1.5
"""Dispersions relative to the mean: a typical one; one that is numerically zero; and an upper limit beyond what a
coefficient of one sign can have, so that a wide slab does not act as a second spike. By choice."""

_STARTS = (0.6, 0.8, 0.95)
"""Quantiles of the people's own estimates at which the slab's mean starts, for many, some, or few people with the
effect: the likelihood may have a local maximum for each. So it may if all people have it: where those without it are
known best, their weighted mean is near zero, and so is the dispersion. A slab there was 16 000 behind, and the gain of
the mixture over it was nonsense."""

_OUTLYING = 0.02
"""Quantile beyond which own estimates are clipped, for the starts only: a person without information may have any
estimate."""


@dataclass(frozen=True, kw_only=True)
class Membership:
    """Who has an effect.

    Attributes
    ----------
    probability : ndarray, shape (N,)
        Probability that each person has it.
    fraction, q05, q95 : float
        Fraction of people who have it, with a 90 % interval.
    """

    probability: np.ndarray
    fraction: float
    q05: float
    q95: float

    @classmethod
    def of(cls, probability: np.ndarray, fraction: float) -> Membership:
        """From probabilities and their maximum-likelihood share: the interval is that of a share of so many people."""
        from scipy.stats import beta

        count, n = float(probability.sum()), len(probability)
        low, high = (float(q) for q in beta.ppf((0.05, 0.95), count + 0.5, n - count + 0.5))
        return cls(probability=probability, fraction=fraction, q05=low, q95=high)


@dataclass(frozen=True, kw_only=True)
class Members(Membership):
    """The people with and without an effect, and the distribution among those who have it.

    Attributes
    ----------
    mean, mean_sd, dispersion : float
        Of the coefficient among those who have it; the dispersion is relative to the mean.
    gain : float
        Gain of log likelihood over the model in which all people have it.
    """

    mean: float
    mean_sd: float
    dispersion: float
    gain: float

    @property
    def only_some(self) -> bool:
        """Whether a substantial part of the people lacks the effect, and more than one or two have it."""
        return bool(
            self.gain > _LEAST_GAIN and self.fraction < _MOST_FRACTION and self.probability.sum() > FEWEST_MEMBERS
        )


def members(fit: Refit, addition: int) -> Members:
    """Spike and slab of the coefficient of an addition, with its shapes and all other additions held."""
    h, d, _ = quadratic(fit.model, fit.data, fit.u, fit.equations, fit.population.covariance)
    column = fit.model.columns(addition)[0] - fit.model.n_elements
    others = [i for i in range(h.shape[1]) if i != column]
    values = fit.u[:, fit.model.n_elements :]
    first = np.searchsorted(fit.owner, np.arange(len(fit.data)))
    linear = h[:, column] - np.einsum("nk,nk->n", d[:, column][:, others], values[first][:, others])
    return mixture(linear, np.maximum(d[:, column, column], 1e-12))


def mixture(h: np.ndarray, d: np.ndarray) -> Members:
    """Maximum-likelihood spike and slab for quadratic log likelihoods h c - d c^2 / 2, both h and d of shape (N,)."""
    size = np.clip(h / d, *np.quantile(h / d, (_OUTLYING, 1 - _OUTLYING)))
    among_some = [float(np.quantile(size, q)) for q in _STARTS]
    among_all = [float(np.average(size, weights=d)), *among_some]
    some = np.arange(len(among_all) + len(among_some)) >= len(among_all)
    values, memberships, fractions, means, dispersions = _maximised(h, d, np.array(among_all + among_some), some)
    best = len(among_all) + int(np.argmax(values[some]))
    probability, fraction = memberships[best], float(fractions[best])
    mean, tau = float(means[best]), float(dispersions[best])
    precision = float(probability @ (1 / (tau**2 + 1 / d)))
    sd = float(1 / np.sqrt(max(precision, 1e-300)))
    relative = tau / max(abs(mean), 1e-300)
    return Members(
        **vars(Membership.of(probability, fraction)),
        mean=mean,
        mean_sd=sd,
        dispersion=relative,
        gain=float(values[best] - values[~some].max()),
    )


def _maximised(
    h: np.ndarray, d: np.ndarray, mean: np.ndarray, some: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """From S starts of the mean: log likelihoods (S,), memberships (S, N), shares, means and dispersions (S,).

    The share is one unless only some have the effect, bool, (S,).
    """
    tau, fraction = np.maximum(_START_DISPERSION * np.abs(mean), 1e-12), np.full(mean.size, 0.5)
    smallest = _SMALLEST_DISPERSION * np.maximum(np.abs(mean), 1e-12)
    value, probability = np.zeros(mean.size), np.ones((mean.size, h.size))
    for _ in range(_ROUNDS):
        before = np.stack([mean, tau, fraction])
        t, m = tau[:, None] ** 2, mean[:, None]
        present = (h**2 * t + 2 * h * m - d * m**2) / (2 * (1 + d * t)) - 0.5 * np.log1p(d * t)
        value = np.where(some[:, None], log_mixture(present, fraction), present).sum(axis=1)
        probability = np.where(some[:, None], membership(present, fraction), 1.0)
        variance = t / (1 + d * t)
        posterior = variance * (h + m / np.maximum(t, 1e-300))
        weight = np.maximum(probability.sum(axis=1), 1e-9)
        mean = np.sum(probability * posterior, axis=1) / weight
        tau = np.sqrt(np.sum(probability * ((posterior - mean[:, None]) ** 2 + variance), axis=1) / weight)
        tau = np.minimum(np.maximum(tau, smallest), _LARGEST_DISPERSION * np.abs(mean) + smallest)
        fraction = np.where(some, share_of(probability, _SMALLEST_FRACTION), 0.5)
        if np.all(np.abs(np.stack([mean, tau, fraction]) - before) <= _AT_REST * np.abs(before)):
            break
    return value, probability, np.where(some, fraction, 1.0), mean, tau
