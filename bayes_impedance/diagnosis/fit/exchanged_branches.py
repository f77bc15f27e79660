"""Refits with the values of two branches of the network exchanged.

Two branches of the same kinds of elements resonate at two frequencies, and which of them at the lower one is a choice
that is the same for everybody: each choice is a valley of the whole population's. Without what is missing the network
may describe the recordings better in the wrong one. Beside the right effect everybody stays there, because nobody's own
search moves two branches at once and everybody's starts lie around the population: of 61 people with a second path to
the ground, whose branches m2-n1 and m3-n3 had changed places, residuals were 1.1 to 1.2 times the noise, and two
resonators were added beside the path. Exchanged, the path alone is 52 units of log evidence ahead of all three.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.symmetry import branch_exchanges


def with_branches_exchanged(refitter: Refitter, fit: Refit, rounds: int) -> Refit:
    """The fit, or a better one of the same model with the values of two branches of the network exchanged.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    rounds : int
        Of each refit.
    """
    names, shared = fit.model.network.elements, fit.model.shared
    place = np.cumsum(~shared) - 1  # in the population, of parameters that vary
    for taken in branch_exchanges(fit.model.network):
        columns = np.arange(shared.size)
        for name, other in taken.items():
            columns[names.index(name)] = names.index(other)
        population, order = fit.population, place[columns[~shared]]  # branches that are alike are shared alike
        exchanged = replace(
            population,
            mu=population.mu[order],
            covariance=population.covariance[np.ix_(order, order)],
            rho=population.rho[order],
        )
        found = refitter.fit(fit.model, fit.u[:, columns], exchanged, rounds)
        fit = found if found.evidence.sum() > fit.evidence.sum() else fit
    return fit
