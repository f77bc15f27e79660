"""Effects whose size cannot be told from nothing keep no name.

A spring cannot be negative, and no loss factor either. If the 90 % interval of the mean over people of every such
coefficient reaches from below zero to above it, the recordings do not say that the effect is there at all, however much
better they are described with people's own values of it: these describe something else, which is of either sign. In
twenty-six seeds of ``analyses/other_worlds`` four names of 775 were such, and all were wrong. Coefficients that may
have either sign in everybody, and effects of which some people have none, are not asked.

The interval is that of a normal approximation, which may be far from the fit where size and shape are bent together:
the mean of a power law was said to be zero that each of 70 people had, and that predicted them 2387 +- 252 better. So
what differs between people is asked only if people themselves are of either sign.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.identifiability import without
from bayes_impedance.diagnosis.selection.stepwise import Found
from bayes_impedance.units import INTERVAL

_OF_OTHER_SIGN = 0.1
"""Least share of people whose own coefficient has the other sign, if people are of either. By choice: if the mean of
ten people or more is not told from zero because they differ, about 30 % have the other sign."""


def names_of_a_size(refitter: Refitter, found: Found, seed: int) -> Found:
    """What was found, without the effects that may as well be nothing; the least certain one is taken out first.

    Parameters
    ----------
    refitter : Refitter
    found : Found
    seed : int
        Of the posterior's draws.
    """
    begin = len(found.base.model.additions)
    while len(found.final.model.additions) > begin:
        sizes = sizes_in_deviations(found.final, seed)[begin:]
        least = int(np.argmin(sizes))
        if sizes[least] > 0:
            break
        found = without(refitter, found, [found.final.model.additions[begin + least]])
    return found


def sizes_in_deviations(fit: Refit, seed: int) -> list[float]:
    """How far each addition's most certain coefficient is from zero, beyond its interval, in standard deviations.

    Negative if every interval includes zero; infinite for what is not asked.
    """
    model = fit.model
    result: list[float] = []
    if not model.additions:
        return result
    posterior = coefficient_posterior(fit, seed)
    first_of_each = np.unique(fit.owner, return_index=True)[1]
    for i, addition in enumerate(model.additions):
        effect = addition.effect
        if not effect.operation or effect.signed or addition.only_in_some:
            result.append(np.inf)
            continue
        columns = zip(model.columns(i), effect.coefficients, strict=True)
        linear = [column - model.n_elements for column, coefficient in columns if coefficient.link == "linear"]
        draws = posterior.central[:, linear]
        low, _, high = np.quantile(draws, INTERVAL, axis=0)
        size = float(np.max(np.maximum(low, -high) / draws.std(axis=0)))
        own = fit.u[first_of_each][:, [model.n_elements + column for column in linear]]
        alike = addition.pooling != "shared" and not _of_either_sign(own)
        result.append(np.inf if alike else size)
    return result


def _of_either_sign(own: np.ndarray) -> bool:
    """Whether some people have a negative, and some a positive value of every coefficient (N, C)."""
    negative = np.mean(own < 0, axis=0)
    return bool(np.all(np.minimum(negative, 1 - negative) >= _OF_OTHER_SIGN))
