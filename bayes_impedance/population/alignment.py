r"""Deviations of recordings whose resonances repositioning has moved by more than their width.

The E step brings the deviations :math:`d_j` of a person's recordings to their mode by linear steps. Beside a resonance
the impedance is linear in the log elements only within the resonance's width, a share 1/(2Q) of its frequency; from the
person's elements, linear steps do not lead to those of a recording whose resonance lies farther off. Then every
recording is searched alone, by the exact and by the bounded error (:mod:`bayes_impedance.person.bounded_search`), under
a prior about the person's elements as wide as the dispersion between repetitions, and

.. math:: \theta = \tfrac 1 J \sum_j \theta_j, \qquad d_j = \theta_j - \theta .
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import GROSS, modes_from
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.person.mode import find_mode
from bayes_impedance.population.e_step import PersonFit

_REACH = 0.1
"""Least prior standard deviation of a recording's log elements about the person's: where the dispersion between
repetitions starts."""


def aligned(
    kernel: Kernel, precision: np.ndarray, rho: np.ndarray, likelihood: Likelihood, fit: PersonFit, mean: np.ndarray
) -> PersonFit:
    """The fit of a person, or a better place if the recordings are described badly and have one.

    Parameters
    ----------
    kernel : Kernel
    precision : ndarray, shape (P, P)
        Inverse covariance of the population.
    rho : ndarray, shape (P,)
        The population's dispersion between repetitions.
    likelihood : Likelihood
    fit : PersonFit
    mean : ndarray, shape (P,)
        Population mean for this person's covariates.
    """
    repetitions = len(likelihood.z)
    if repetitions == 1 or fit.mode.scale <= GROSS:
        return fit
    held, own = np.diag(np.maximum(rho, _REACH) ** -2.0), []
    for j in range(repetitions):
        alone = replace(
            likelihood, z=likelihood.z[[j]], weight=likelihood.weight[[j]], deviations=np.zeros((1, rho.size)),
            count=likelihood.count / repetitions,
        )  # fmt: skip
        own.append(modes_from(kernel, alone, fit.theta[None], fit.theta, held)[0][0])
    theta = np.mean(own, axis=0)
    deviations = np.ascontiguousarray(own - theta)
    mode = find_mode(kernel, likelihood.moved(deviations), np.array([theta, fit.theta]), mean, precision)
    least = np.maximum(rho, LEAST_RHO)
    gain = fit.mode.objective - mode.objective
    gain += 0.5 * float(np.sum((fit.expanded / least) ** 2) - np.sum((deviations / least) ** 2))
    if gain <= 0:
        return fit
    return PersonFit.between_iterations(mode, deviations, deviations)
