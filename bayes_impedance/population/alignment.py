r"""Deviations of recordings whose resonances repositioning has moved by more than their width.

The E step brings the deviations :math:`d_j` of a person's recordings to their mode by linear steps. Beside a resonance
the impedance is linear in the log elements only within the resonance's width, a share 1/(2Q) of its frequency; from the
person's elements, linear steps do not lead to those of a recording whose resonance lies farther off. Recordings that
are described worse than the person's best one, or all of a person who is described badly, are searched alone, by the
exact and by the bounded error (:mod:`bayes_impedance.person.bounded_search`), under a prior about the person's elements
as wide as the dispersion between repetitions. The search begins at the person's elements, at those of the other
recordings, and at all of these with a sharp resonance in other gaps of the grid (:mod:`bayes_impedance.person.gaps`).
Then

.. math:: \theta = \tfrac 1 J \sum_j \theta_j, \qquad d_j = \theta_j - \theta .
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import GROSS, best_end
from bayes_impedance.person.gaps import REACH, other_gaps
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.person.mode import find_mode
from bayes_impedance.population.e_step import PersonFit

_REACH = 0.1
"""Least prior standard deviation of a recording's log elements about the person's: where the dispersion between
repetitions starts."""

HELD = 1e-4
"""Prior width of what is held. By choice: far below any standard error."""

_MUCH_WORSE = 1.5
"""Squares that a recording leaves after a search, over those of the best recording, from which all elements are changed
by as much as they may change between recordings. By choice: of a hundred points it is 3.5 standard deviations of what
noise makes."""

_WIDER = 3.0
"""Largest changes of the elements of somebody who is described badly, in the population's standard deviations. By
choice: people who are farther off are rare."""

_UNEQUAL = 2.0
"""Standard errors by which a recording's squared misfit must exceed that of the person's best described one to be
searched alone. By choice: chance costs time only."""


def aligned(
    kernel: Kernel,
    precision: np.ndarray,
    rho: np.ndarray,
    likelihood: Likelihood,
    fit: PersonFit,
    mean: np.ndarray,
    begun: np.ndarray | None = None,
) -> PersonFit:
    """The fit of a person, or a better place if the recordings are described badly and have one.

    From where the search for the person's mode has begun, with all recordings alike, it may have gone to another
    valley, in which resonances that differ between them are none. So of a person who is described badly recordings are
    also searched from there; and later, when the population says how far one may be, from its own place with its
    resonances in every gap of the frequencies that the population allows.

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
    begun : ndarray, shape (P,), optional
        Log elements from which the fit has begun.
    """
    badly = fit.mode.scale > GROSS
    if len(likelihood.z) == 1 or (begun is not None and not badly):
        return fit
    centre = fit.theta if begun is None else begun
    places = centre + (fit.expanded if begun is None else np.zeros_like(fit.expanded))
    least = np.maximum(rho, LEAST_RHO)
    reach = None
    if badly and begun is None:  # in the first iteration most are described badly, and would each find another valley
        reach = np.maximum(_WIDER * np.sqrt(np.diag(np.linalg.inv(precision))), REACH)
    own = searched_alone(kernel, likelihood, places, centre, least, everyone=badly, reach=reach)
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
    everyone: bool = False,
    sharp: bool = False,
    reach: np.ndarray | None = None,
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
    sharp : bool
        Whether recordings with a resonance that may lie in another gap are searched too.
    reach : ndarray, shape (P,), optional
        Largest changes of the log elements in the search for resonances hidden in a gap, of all recordings; by default
        that between recordings, of those that are described much worse than the best.
    """
    misfit = _misfits(kernel, likelihood, places)
    chance = 1 + _UNEQUAL * np.sqrt(2 / likelihood.omega.size)  # of the ratio of two sums of 2 F squares
    worse = ~(misfit <= chance * misfit.min())
    free = rho > 0
    held, own = np.diag(np.where(free, np.maximum(rho, _REACH), HELD) ** -2.0), places.copy()
    searched = False
    for j in range(len(places)):
        needed = everyone or bool(worse[j])
        if not (needed or sharp):
            continue
        alone, around = likelihood.recording(j, rho.size), np.roll(places, -j, axis=0)
        across = other_gaps(kernel, alone, around, free)
        if not (needed or len(across)):
            continue
        searched = True
        starts = np.concatenate([around, centre[None], across])
        end = np.where(free, best_end(kernel, alone, starts, centre, held), places[j])
        if reach is not None or _misfits(kernel, alone, end[None])[0] > _MUCH_WORSE * misfit.min():
            # A resonance may be hidden in a gap.
            across = other_gaps(kernel, alone, end[None], free, np.full(free.size, REACH) if reach is None else reach)
            starts = np.concatenate([end[None], across])
            end = np.where(free, best_end(kernel, alone, starts, centre, held), places[j])
        own[j] = end
    return own if searched else places


def _misfits(kernel: Kernel, likelihood: Likelihood, places: np.ndarray) -> np.ndarray:
    """Weighted squares (J,) of what log elements (J, P) leave of each recording."""
    z = kernel.impedance(places, likelihood.omega / (2 * np.pi))
    left = likelihood.z[:, 0] + 1j * likelihood.z[:, 1] - z
    return np.asarray(np.nan_to_num(np.sum(np.abs(left) ** 2 * likelihood.weight, axis=1), nan=np.inf))
