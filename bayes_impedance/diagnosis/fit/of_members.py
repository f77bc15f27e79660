r"""A fit in which those who lack an effect are no part of its distribution.

A fit holds everybody's coefficient to one normal distribution, the mean of which lies between those who have an effect
and those who lack it. It is wide, and members who determine their own coefficient are found where they are. Where
coefficient and time constant can only be told together, along a curved ridge, a member is held to a point of it that is
too near to zero, and the elements take up what is left: with a layer in 26 of 70 people the log evidence was 664 units
below that of the model here. With :math:`g_i` 1 for those who have the effect and 0 for the others, the impedance is
instead that of the coefficient

.. math:: g_ic_i, \qquad c_i \sim N(\mu, \tau^2) .

Who lacks it has a coefficient that the recordings do not feel: they neither move it nor are described by it, and the
mean, the dispersion and a time constant that is the same for all are those of members.

**Evidence.** Who has it is not known for certain. With the distribution held there, each person's evidence is taken
with the effect and without it, and with the share of members :math:`\pi` at its maximum the population's is

.. math:: \sum_i \ln\bigl(\pi e^{\ell_i^{(1)}} + (1 - \pi)\,e^{\ell_i^{(0)}}\bigr) .

Two effects that only some people have can be told apart by that. By the evidence of a fit that holds everybody to one
normal distribution they cannot: how much it leaves to the elements is not the same for both, and a layer was 8 behind a
delay beside which it has the same evidence here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import expit, logit

from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.extend import with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import medians
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.spike_slab import members

_PASSES = 2
"""How often dispersions among members are taken over. By choice, as in :mod:`.measured`."""

_SHARE_ROUNDS = 50
"""Rounds of expectation-maximisation of the share of members. By choice: it begins near its maximum."""


def of_members(refitter: Refitter, fit: Refit, seed: int) -> tuple[Refitter, Refit]:
    """The fit with what only some have from those who have it, and the refitter that knows who they are.

    Both are the given ones if everybody has everything.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    seed : int
    """
    return _of_those_who_have_it(refitter, fit, _lacking(fit), seed)


def _of_those_who_have_it(
    refitter: Refitter, fit: Refit, lacks: dict[int, np.ndarray], seed: int
) -> tuple[Refitter, Refit]:
    if not lacks:
        return refitter, fit
    silent = np.zeros((len(fit.data), fit.u.shape[1]), dtype=bool)
    for i, own in lacks.items():
        silent[:, fit.model.columns(i)[0]] = own
    refitter = refitter.without(silent)
    place = np.cumsum(~fit.model.shared) - 1
    for _ in range(_PASSES):
        posterior, model, mu = coefficient_posterior(fit, seed), fit.model, fit.population.mu.copy()
        for i in lacks:
            model = with_pooling(model, i, model.additions[i].pooling, medians(model, i, posterior))
            column = model.columns(i)[0]
            mu[place[column]] = posterior.central[:, column - model.n_elements].mean()
        fit = refitter.fit(model, fit.u, replace(fit.population, mu=mu))
    return refitter, fit


def mixture_of_members(refitter: Refitter, fit: Refit, seed: int) -> Refit | None:
    """The fit with what only some have from those who have it, and the evidence of the mixture of both kinds of people.

    None if everybody has everything, or different people have different effects: who has which is not summed over.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    seed : int
    """
    lacks = _lacking(fit)
    if len(lacks) != 1:
        return None
    (addition,) = lacks
    own = _of_those_who_have_it(refitter, fit, lacks, seed)[1]
    silent = np.zeros((len(fit.data), fit.u.shape[1]), dtype=bool)
    silent[:, own.model.columns(addition)[0]] = True
    with_it, without_it = (
        each.fit(own.model, own.u, own.population, hold_population=True, hold_additions=True).evidence
        for each in (refitter, refitter.without(silent))
    )
    share = float(np.mean(~lacks[addition]))
    for _ in range(_SHARE_ROUNDS):
        share = float(np.mean(expit(logit(share) + with_it - without_it)))
        share = float(np.clip(share, 1 / len(fit.data), 1 - 1 / len(fit.data)))
    evidence = np.logaddexp(np.log(share) + with_it, np.log1p(-share) + without_it)
    return replace(own, evidence=evidence, mixed=addition)


def _lacking(fit: Refit) -> dict[int, np.ndarray]:
    """Who lacks the effect, bool (N,), for each addition that only some people have."""
    lacks: dict[int, np.ndarray] = {}
    for i, addition in enumerate(fit.model.additions):
        if addition.absent_in_some:
            who = members(fit, i)
            if who.only_some and np.any(who.probability >= 0.5):
                lacks[i] = who.probability < 0.5
    return lacks
