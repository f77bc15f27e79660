r"""Deviations of recordings whose resonances repositioning has moved by more than their width.

The E step brings the deviations :math:`d_j` of a person's recordings to their mode by linear steps. Beside a resonance
the impedance is linear in the log elements only within the resonance's width, a share 1/(2Q) of its frequency; from the
person's elements, linear steps do not lead to those of a recording whose resonance lies farther off. Recordings that
are described worse than the person's best one, or all of a person who is described badly, are searched alone, by the
exact and by the bounded error (:mod:`bayes_impedance.person.bounded_search`), under a prior about the person's elements
as wide as the dispersion between repetitions. The search begins at the person's elements, at those of the other
recordings, and at the recording's own with each element changed so that a resonance moves by half a gap of the grid to
either side: without damping the error is unbounded where the resonance meets a point, and no step leads across. Then

.. math:: \theta = \tfrac 1 J \sum_j \theta_j, \qquad d_j = \theta_j - \theta .
"""

from __future__ import annotations

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

_HELD = 1e-4
"""Prior width of what is held. By choice: far below any standard error."""

_UNEQUAL = 2.0
"""Standard errors by which a recording's squared misfit must exceed that of the person's best described one to be
searched alone. By choice: chance costs time only."""


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
    if len(likelihood.z) == 1:
        return fit
    places = fit.theta + fit.expanded
    least = np.maximum(rho, LEAST_RHO)
    own = searched_alone(kernel, likelihood, places, fit.theta, least, everyone=fit.mode.scale > GROSS)
    if own is places:
        return fit
    theta = np.mean(own, axis=0)
    deviations = np.ascontiguousarray(own - theta)
    mode = find_mode(kernel, likelihood.moved(deviations), np.array([theta, fit.theta]), mean, precision)
    gain = fit.mode.objective - mode.objective
    gain += 0.5 * float(np.sum((fit.expanded / least) ** 2) - np.sum((deviations / least) ** 2))
    if gain <= 0:
        return fit
    return PersonFit.between_iterations(mode, deviations, deviations)


def searched_alone(
    kernel: Kernel,
    likelihood: Likelihood,
    places: np.ndarray,
    centre: np.ndarray,
    rho: np.ndarray,
    everyone: bool,
) -> np.ndarray:
    """Log elements (J, P) of a person's recordings, some of them searched alone.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    places : ndarray, shape (J, P)
        Where the recordings are; returned if none is searched.
    centre : ndarray, shape (P,)
        The person's log elements.
    rho : ndarray, shape (P,)
        The population's dispersion between repetitions; zero for what is the same in all of them, which is held.
    everyone : bool
        Whether all recordings are searched, and not only those that are described worse than the best.
    """
    misfit = _misfits(kernel, likelihood, places)
    chance = 1 + _UNEQUAL * np.sqrt(2 / likelihood.omega.size)  # of the ratio of two sums of 2 F squares
    searched = np.flatnonzero(everyone | ~(misfit <= chance * misfit.min()))
    if not searched.size:
        return places
    free = rho > 0
    held, own = np.diag(np.where(free, np.maximum(rho, _REACH), _HELD) ** -2.0), places.copy()
    # A resonance's frequency is the root of two elements' product: half a gap, to the middle of the next one.
    across = float(np.median(np.diff(np.log(likelihood.omega)))) * np.eye(rho.size)[free]
    for j in searched.tolist():
        alone = likelihood.recording(j, rho.size)
        starts = np.concatenate([centre[None], np.roll(places, -j, axis=0), places[j] + across, places[j] - across])
        ends, objectives = modes_from(kernel, alone, starts, centre, held)
        own[j] = np.where(free, ends[np.argmin(objectives)], places[j])
    return own


def _misfits(kernel: Kernel, likelihood: Likelihood, places: np.ndarray) -> np.ndarray:
    """Weighted squares (J,) of what log elements (J, P) leave of each recording."""
    z = kernel.impedance(places, likelihood.omega / (2 * np.pi))
    left = likelihood.z[:, 0] + 1j * likelihood.z[:, 1] - z
    return np.asarray(np.nan_to_num(np.sum(np.abs(left) ** 2 * likelihood.weight, axis=1), nan=np.inf))
