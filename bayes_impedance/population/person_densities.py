r"""Each person's log density under population parameters: what networks are compared by.

The likelihood that is sampled (:mod:`bayes_impedance.population.importance_likelihood`) leaves out what does not depend
on the population, and counts the contrasts between repetitions for all persons together. Here they are put together
again. For one person with J repetitions and K draws, and population parameters mu, Sigma, rho,

.. math:: \ln p(z_i\,|\,\mu,\Sigma,\rho) = \ln\frac1K\sum_k \frac{L_i(\theta_k)}{q(\theta_k)}\,N(\theta_k; \mu_i, T_J)
          + G_i(\rho) - G_i(\rho_0) .

* :math:`L_i(\theta) = p(z_i|\theta,\rho_0)` is the density of all complex values of the person, given the mean of the
  log elements over the repetitions: noise scale and deviations are integrated out at the point estimate
  :math:`\rho_0` (the ridge's).
* q is the proposal's density. It is normalised as it stands.
* N is evaluated relative to :math:`(2\pi)^{-P/2}`, and L/q relative to the largest draw of each person: both are added.
* :math:`G_i(\rho)` is the likelihood of the deviations. Since L holds it at :math:`\rho_0` already, the difference is
  what another rho changes. It is taken at the person's mode, as in sampling.

The constants of L, and G, are derived in :mod:`bayes_impedance.person.absolute_density`.

The noise sigma is the network's own: it was estimated from what the repetitions differ by outside of the network's
tangent space, or from the roughness of what the network leaves (:mod:`bayes_impedance.person.noise`), and is held fixed
here. It is part of the model that is compared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.person.absolute_density import Deviations
from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.parameters import PopulationParameters


def constants_of(draws: Sequence[Draws], rho: np.ndarray) -> np.ndarray:
    """What does not depend on the population, for each of n persons.

    Parameters
    ----------
    draws : sequence of Draws
        Of n persons.
    rho : ndarray, shape (P,)
        Dispersion between repetitions at which the deviations were integrated out of the draws' likelihood.

    Returns
    -------
    ndarray, shape (n,)
    """
    own = np.array([d.constant + d.log_ratio.max() for d in draws])
    return np.asarray(
        own - 0.5 * rho.size * np.log(2 * np.pi) - _of_deviations([d.deviations for d in draws], rho[None])[0]
    )


def log_densities(
    marginal: ImportanceLikelihood,
    deviations: Sequence[Deviations | None],
    constants: np.ndarray,
    parameters: PopulationParameters,
) -> np.ndarray:
    """Log density of each person's recordings under W sets of population parameters.

    Parameters
    ----------
    marginal : ImportanceLikelihood
        Of n persons.
    deviations : sequence of Deviations or None
        Of the same persons.
    constants : ndarray, shape (n,)
        Of :func:`constants_of`.
    parameters : PopulationParameters
        W sets.

    Returns
    -------
    ndarray, shape (W, n)
        Natural logarithms of the density of real and imaginary parts in the unit of the recordings.
    """
    other_rho = _of_deviations(deviations, parameters.between_repetitions)
    return np.asarray(marginal.terms(parameters)[0] + constants + other_rho)


def _of_deviations(deviations: Sequence[Deviations | None], rho: np.ndarray) -> np.ndarray:
    """Each person's G(rho), shape (W, n), for dispersions (W, P)."""
    result = np.zeros((len(rho), len(deviations)))
    for i, own in enumerate(deviations):
        if own is not None:
            result[:, i] = own.log_likelihood(rho)
    return result
