r"""Who has it: a coefficient that is zero in some people and not in others.

With the quadratic log likelihood :math:`h_ic - \tfrac12D_ic^2` of everybody's own coefficient,

.. math:: c_i \sim (1 - \pi)\,\delta_0 + \pi\,N(\mu, \tau^2), \qquad
          \ln\int e^{hc - Dc^2/2} N(c; \mu, \tau^2)\,dc = \frac{h^2\tau^2 + 2h\mu - D\mu^2}{2(1 + D\tau^2)}
          - \tfrac12\ln(1 + D\tau^2)

is maximised by expectation-maximisation and compared with everybody having it (pi = 1, with mean and dispersion free).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refit
from bayes_impedance.diagnosis.fit.normal_equations import quadratic

_ROUNDS = 200
_FEWEST = 2.5


@dataclass(frozen=True, kw_only=True)
class Members:
    """People with and without an effect.

    Attributes
    ----------
    probability : ndarray, shape (N,)
        That a person has it.
    fraction, q05, q95 : float
        Part of the people who have it, with a 90 % interval.
    mean, mean_sd, dispersion : float
        Of the coefficient among those who have it; the dispersion is relative to the mean.
    gain : float
        Log likelihood over everybody having it.
    """

    probability: np.ndarray
    fraction: float
    q05: float
    q95: float
    mean: float
    mean_sd: float
    dispersion: float
    gain: float

    @property
    def only_some(self) -> bool:
        """Whether the effect is clearly absent in a good part of the people, and not a matter of one or two."""
        return bool(self.gain > 3.0 and self.fraction < 0.85 and self.probability.sum() > _FEWEST)


def members(fit: Refit, addition: int) -> Members:
    """Who has an addition, its shapes held where they are."""
    h, d, _ = quadratic(fit.model, fit.data, fit.u, fit.equations, fit.population.covariance)
    column = fit.model.columns(addition)[0] - fit.model.n_elements
    others = [i for i in range(h.shape[1]) if i != column]
    values = fit.u[:, fit.model.n_elements :]
    first = np.searchsorted(fit.owner, np.arange(len(fit.data)))
    linear = h[:, column] - np.einsum("nk,nk->n", d[:, column][:, others], values[first][:, others])
    return mixture(linear, np.maximum(d[:, column, column], 1e-12))


def mixture(h: np.ndarray, d: np.ndarray) -> Members:
    """Split people by their quadratic log likelihoods h c - d c^2 / 2, both of shape (N,)."""
    size = np.clip(h / d, *np.quantile(h / d, (0.02, 0.98)))
    everybody = _maximised(h, d, float(np.average(size, weights=d)), False)
    candidates = [_maximised(h, d, float(np.quantile(size, q)), True) for q in (0.6, 0.8, 0.95)]
    value, probability, fraction, mean, tau = max(candidates, key=lambda c: c[0])
    from scipy.stats import beta

    count, n = float(probability.sum()), len(h)
    q05, q95 = beta.ppf((0.05, 0.95), count + 0.5, n - count + 0.5)
    precision = float(probability @ (1 / (tau**2 + 1 / d)))
    sd = float(1 / np.sqrt(max(precision, 1e-300)))
    relative = tau / max(abs(mean), 1e-300)
    return Members(
        probability=probability,
        fraction=fraction,
        q05=float(q05),
        q95=float(q95),
        mean=mean,
        mean_sd=sd,
        dispersion=relative,
        gain=value - everybody[0],
    )


def _maximised(h: np.ndarray, d: np.ndarray, mean: float, some: bool) -> tuple[float, np.ndarray, float, float, float]:
    tau, fraction = max(0.3 * abs(mean), 1e-12), 0.5 if some else 1.0
    smallest = 1e-3 * max(abs(mean), 1e-12)
    probability, value = np.ones(h.size), 0.0
    for _ in range(_ROUNDS):
        t = tau**2
        present = (h**2 * t + 2 * h * mean - d * mean**2) / (2 * (1 + d * t)) - 0.5 * np.log1p(d * t)
        both = np.stack([np.log(fraction) + present, np.full(h.size, np.log(max(1 - fraction, 1e-300)))])
        total = np.logaddexp(both[0], both[1]) if some else present
        value = float(total.sum())
        probability = np.exp(both[0] - total) if some else np.ones(h.size)
        variance = t / (1 + d * t)
        posterior = variance * (h + mean / max(t, 1e-300))
        weight = max(float(probability.sum()), 1e-9)
        mean = float(probability @ posterior) / weight
        tau = float(np.sqrt(probability @ ((posterior - mean) ** 2 + variance) / weight))
        tau = min(max(tau, smallest), 1.5 * abs(mean) + smallest)
        fraction = float(np.clip(weight / h.size, 0.02, 0.98)) if some else 1.0
    return value, probability, fraction, mean, tau
