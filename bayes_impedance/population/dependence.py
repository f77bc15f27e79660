r"""Elements whose value depends on another one that the recordings do not determine.

In a narrow band a spring's reactance :math:`-1/(\omega n)` and a mass's :math:`\omega m` are one number: recordings
determine their sum, and the mass only from above. On a logarithmic scale nearly all of the prior lies where the mass is
negligible, so the posterior of the spring is narrow, and right only if there is no mass. Its interval would state what
the prior has decided.

So for each element h without a number of its own, everybody's likelihood is profiled: h is held at values v within its
prior, the same for all, and the others are at their mode, followed from one value to the next,

.. math:: \ell(v) = \sum_i \max_{\theta_{-h}} \ln L_i(\theta_{-h}, h = v) .

Every v with :math:`\ell` near its maximum is as possible as any other. If the mean over persons of another element
moves between two such values by more than half of its interval's width, that element is determined only together with
h, and has no number either. An element that no recording sees at all changes no other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import find_mode
from bayes_impedance.population.e_step import PersonFit
from bayes_impedance.population.em import Estimate
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.shared import Pooling
from bayes_impedance.units import NORMAL_Q95

_VALUES, _REACH = 25, 2.0
"""Values at which an element is held, and how far they reach in standard deviations of its prior: 95 % of it, in steps
of half a unit of the logarithm, so that the modes can be followed."""
_AS_LIKELY = 1.92
"""Decrease of the log likelihood up to which a value is as possible as the best: half the 95 % quantile of chi-square
with one degree of freedom."""
_HOLD = 1e8
"""Prior precision by which an element is held: to a thousandth of its logarithm, against what recordings say."""
_LOOSE = 1.0
"""Prior precision of the others about the person's estimate: a factor of e. By choice: it keeps elements that one
person's recordings do not determine from wandering, and is nothing beside what recordings determine."""


def dependent(
    point: Estimate, parameters: PopulationParameters, known: np.ndarray, known_shared: np.ndarray, prior: Prior
) -> tuple[np.ndarray, np.ndarray]:
    """Which elements depend on others that are not known.

    Parameters
    ----------
    point : Estimate
        Whose likelihoods and modes have not been released.
    parameters : PopulationParameters
        Sampled populations, of the V parameters that differ between persons and the S that are shared.
    known, known_shared : ndarray of bool, shape (V,) and (S,)
        Which of these the posterior determines.
    prior : Prior
        Of all parameters.

    Returns
    -------
    varying, shared : ndarray of bool, shape (V,) and (S,)
        True for known elements only.
    """
    pooling, sd = point.pooling, NORMAL_Q95 * parameters.mu.std(axis=0)
    shared_sd = np.zeros(0) if parameters.shared is None else NORMAL_Q95 * parameters.shared.std(axis=0)
    known, half = pooling.whole(known, known_shared).astype(bool), pooling.whole(sd, shared_sd)
    result = np.zeros_like(known)
    # An element without any information, such as one that others replace exactly, has been dealt with.
    unknown = np.flatnonzero(~known & np.isfinite(pooling.whole(point.data_sd, point.shared_data_sd)))
    for h in unknown if known.any() else ():
        values = prior.centre[h] + prior.centre_sds[h] * np.linspace(-_REACH, _REACH, _VALUES)
        # Beside a parameter that differs, those of all stay: everybody's recordings determine them.
        moving = np.arange(known.size) if h in pooling.shared else pooling.varying
        element = int(np.flatnonzero(moving == h)[0])
        of_person = partial(_profile, pooling=pooling, phi=point.shared, n=moving.size, element=element, values=values)
        moved = movement(point.data.each(of_person, point.fits).gathered())
        result[moving] |= known[moving] & (moved > half[moving])
    return result[pooling.varying], result[pooling.shared]


def movement(profiles: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """How far the means over persons move while one element takes values that are as likely as its best.

    Parameters
    ----------
    profiles : sequence of tuple
        Everybody's modes (K, P) and objectives (K,), from :func:`profile` at the same K values.

    Returns
    -------
    ndarray, shape (P,)
        Largest less smallest mean; zero if only one value is likely.
    """
    ends, objectives = (np.array(a) for a in zip(*profiles, strict=True))
    total = objectives.sum(axis=0)
    return np.asarray(np.ptp(ends.mean(axis=0)[total - total.min() < _AS_LIKELY], axis=0))


def _profile(
    likelihood: Likelihood,
    fit: PersonFit,
    pooling: Pooling,
    phi: np.ndarray,
    n: int,
    element: int,
    values: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Of a person's n parameters: all of them, or those that differ between persons."""
    theta, deviations, kernel = fit.theta, fit.deviations, pooling.at(phi)
    if n > theta.size:
        theta, kernel = pooling.whole(theta, phi), pooling.kernel
        deviations = pooling.whole(deviations, np.zeros(phi.size))
    return profile(kernel, likelihood.moved(deviations), theta, element, values)


def profile(
    kernel: Kernel, likelihood: Likelihood, theta: np.ndarray, element: int, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Modes of one person's other elements, one element being held.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    theta : ndarray, shape (P,)
        The mode, from which the others are followed to either side.
    element : int
        Which is held.
    values : ndarray, shape (K,)
        Ascending.

    Returns
    -------
    ends : ndarray, shape (K, P)
    objectives : ndarray, shape (K,)
        Negative log likelihoods, up to a constant.
    """
    precision = np.diag(np.where(np.arange(theta.size) == element, _HOLD, _LOOSE))
    ends, objectives = np.empty((values.size, theta.size)), np.empty(values.size)
    begin = int(np.clip(np.searchsorted(values, theta[element]), 0, values.size - 1))
    for way in (range(begin, values.size), range(begin - 1, -1, -1)):
        before = theta
        for k in way:
            mean, start = theta.copy(), before.copy()
            mean[element] = start[element] = values[k]
            mode = find_mode(kernel, likelihood, np.array([start]), mean, precision)
            ends[k], objectives[k], before = mode.theta, mode.objective, mode.theta
    return ends, objectives
