r"""Mixtures of two groups of people: the steps of expectation-maximisation that do not depend on the groups' models.

Person i's data have the log likelihood :math:`\ell_{i0}` if the person belongs to the first group and
:math:`\ell_{i1}` if to the second; the second has the share :math:`\pi` of all people. Then

.. math:: \ell = \sum_i \ln\bigl[(1 - \pi)\,e^{\ell_{i0}} + \pi\,e^{\ell_{i1}}\bigr], \qquad
          r_i = \Bigl[1 + \tfrac{1 - \pi}{\pi}\,e^{\ell_{i0} - \ell_{i1}}\Bigr]^{-1}

are the log likelihood and the probability that the person belongs to the second group (the E step). The M step of the
share is the mean of the memberships :math:`r_i`, kept away from 0 and 1, where one group is empty and its parameters
are undetermined. The M steps of the groups' own parameters are in the modules that define the groups:

* spike at zero and normal slab, with each person's own curvature: :mod:`bayes_impedance.diagnosis.fit.spike_slab`;
* amplitudes of unit variance: :mod:`bayes_impedance.diagnosis.residuals.amplitudes`, whose M step is a weighted mean
  and variance;
* two groups along a direction, many directions at once: :mod:`bayes_impedance.diagnosis.heterogeneity.two_groups`;
* two groups in all elements: :mod:`bayes_impedance.diagnosis.heterogeneity.subgroups`.
"""

from __future__ import annotations

import numpy as np

_LARGEST_LOG_ODDS = 700.0
"""The exponential of a larger number overflows."""


def membership(log_ratio: np.ndarray, share: np.ndarray | float) -> np.ndarray:
    """Probability of belonging to the second group.

    Parameters
    ----------
    log_ratio : ndarray, shape (..., N)
        Log likelihood of each person in the second group over that in the first.
    share : ndarray, shape (...), or float
        Of the second group.

    Returns
    -------
    ndarray, shape (..., N)
    """
    share = np.asarray(share)
    odds = np.log(share / (1 - share))[..., None] + log_ratio
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -_LARGEST_LOG_ODDS, _LARGEST_LOG_ODDS))))


def log_mixture(log_ratio: np.ndarray, share: np.ndarray | float) -> np.ndarray:
    """Log likelihood of each person under the mixture over that in the first group, shape (..., N).

    Parameters
    ----------
    log_ratio, share : ndarray
        As in :func:`membership`.
    """
    share = np.asarray(share)
    return np.asarray(np.logaddexp(np.log1p(-share)[..., None], np.log(share)[..., None] + log_ratio))


def share_of(belongs: np.ndarray, least: float) -> np.ndarray:
    """M step of the share: mean of the memberships (..., N), between `least` and 1 - `least`, shape (...)."""
    return np.asarray(np.clip(np.mean(belongs, axis=-1), least, 1 - least))
