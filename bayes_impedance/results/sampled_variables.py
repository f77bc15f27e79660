r"""Variables of the posterior and of the prior, and to which group of people each person belongs.

A person belongs to the second of two groups (:mod:`bayes_impedance.population.two_components`) with the probability

.. math:: \mathrm E\left[\frac{w\,N(\theta; \mu_2, T)}{(1-w)\,N(\theta; \mu_1, T) + w\,N(\theta; \mu_2, T)}\right],
          \qquad T = \Sigma_w + \operatorname{diag}(\rho^2)/J,

the mean over posterior draws of the population and of the person's own log elements, the mean over J repetitions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import expit

from bayes_impedance.network.parameters import values_of
from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.two_components import parts_of_groups
from bayes_impedance.results.meanings import DIFFERENCE, SHARE, TAIL


def sampled_variables(fit: PopulationFit, parameters: PopulationParameters, chains: int) -> dict[str, np.ndarray]:
    """Population parameters, of the posterior or of the prior, with axes chain and draw."""
    seen = np.where(fit.identified, 1.0, np.nan)

    def by_chain(values: np.ndarray) -> np.ndarray:
        return values.reshape(chains, -1, *values.shape[1:])

    p = parameters
    variables = {"mu": by_chain(p.mu * seen), "central": by_chain(values_of(fit.kernel.parameters, p.mu) * seen)}
    if not fit.one_person:
        variables["dispersion_between_persons"] = by_chain(p.between_persons * seen)
        variables["correlation"] = by_chain(p.correlation * seen[:, None] * seen)
        if fit.repeated:
            variables["dispersion_between_repetitions"] = by_chain(p.between_repetitions * seen)
    if p.tail is not None:
        variables[TAIL] = by_chain(p.tail)
    if p.groups is not None:
        variables[SHARE] = by_chain(p.groups.share)
        variables[DIFFERENCE] = by_chain(p.groups.difference(p.covariance_cholesky) * seen)
    if fit.settings.covariates:
        variables["slope"] = by_chain(p.slopes * seen[:, None])
    return variables


def second_group_probability(fit: PopulationFit) -> np.ndarray:
    """Probability of each person to belong to the second group, shape (N,), of a fit of two groups."""
    varying = np.array([not parameter.shared for parameter in fit.kernel.parameters])
    p = _columns(fit.parameters, varying)
    theta = fit.person_draws.reshape(len(p.mu), -1, varying.size)[..., varying]
    if fit.settings.covariates:
        x = standardised_covariates(fit.recordings, fit.settings.covariates)
        theta = theta - np.einsum("wpq,nq->wnp", p.slopes, x)
    parts, log_weight = parts_of_groups(p)
    means, n_groups = parts.mu.reshape(*log_weight.shape, -1), log_weight.shape[1]
    counts = np.array([len(s.repetitions) for s in fit.recordings.subjects])
    result = np.empty(counts.size)
    for j in np.unique(counts):
        rho = np.eye(p.mu.shape[1]) * p.between_repetitions[:, None] ** 2 / j
        whitening = np.linalg.inv(np.linalg.cholesky(parts.covariance[::n_groups] + rho))
        for i in np.flatnonzero(counts == j):
            white = np.einsum("wpq,wkq->wkp", whitening, theta[:, i, None] - means)
            own = log_weight - 0.5 * np.sum(white**2, axis=-1)
            result[i] = np.mean(expit(own[:, 1] - own[:, 0]))
    return result


def _columns(p: PopulationParameters, varying: np.ndarray) -> PopulationParameters:
    """Parameters of the elements that vary, a bool (P,) says which: the others have no dispersion."""
    assert p.groups is not None  # it is asked for fits of two groups
    return replace(
        p,
        mu=p.mu[:, varying],
        between_persons=p.between_persons[:, varying],
        correlation_cholesky=p.correlation_cholesky[:, varying][..., varying],
        between_repetitions=p.between_repetitions[:, varying],
        slopes=p.slopes[:, varying],
        groups=replace(p.groups, separation=p.groups.separation[:, varying]),
    )
