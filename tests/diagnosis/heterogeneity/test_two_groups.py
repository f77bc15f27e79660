"""Two groups along a line against the likelihood of all elements."""

from __future__ import annotations

import numpy as np
from populations_of_likelihoods import covariance, informations, observed, population
from scipy.optimize import minimize

from bayes_impedance.diagnosis.heterogeneity.bootstrap import Residuals
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import log_marginal
from bayes_impedance.diagnosis.heterogeneity.reml import centred_fit
from bayes_impedance.diagnosis.heterogeneity.two_groups import along


def test_the_mixture_along_a_line_is_the_mixture_of_all_elements():
    # Oracle: the whole likelihood, with the one-group reference maximised over mean and spread along the line.
    rng = np.random.default_rng(23)
    theta = population(rng, 40, covariance(3), 0.0) + np.outer(np.arange(40) < 12, [0.9, 0, 0])
    people = observed(rng, theta, informations(rng, 40, 3, unseen=1))
    centre, fit = centred_fit(people)
    around = people.around(centre)
    direction = np.array([0.6, -0.7, 0.2])
    found = along(Residuals.of(fit), (direction / np.linalg.norm(direction))[None, None])
    v = fit.factor @ direction / np.linalg.norm(direction)
    m, d, t, share = (float(x[0, 0]) for x in (found.middle, found.shift, found.spread, found.share))

    def one(parameters):
        moved = fit.covariance + (np.exp(parameters[1]) - 1) * np.outer(v, v)
        return -np.sum(log_marginal(around, parameters[0] * v, moved))

    reference = -minimize(one, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}).fun
    inside = fit.covariance + (t - 1) * np.outer(v, v)
    first, second = (log_marginal(around, x * v, inside) for x in (m, m + d))
    both = np.sum(np.logaddexp(np.log1p(-share) + first, np.log(share) + second))
    np.testing.assert_allclose(found.statistic[0, 0], 2 * (both - reference), atol=1e-3)
    member = 1 / (1 + np.exp(np.log1p(-share) + first - np.log(share) - second))
    np.testing.assert_allclose(found.membership[0, 0], member, atol=2e-2)  # one round of the iteration behind
