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

**Members.** Who has it is first read from the fit that holds everybody to one distribution (:mod:`.spike_slab`), and
that may be so wide that it includes zero: of 40 people, 12 of whom had a layer, 31 seemed to, with a twentieth of its
compliance. With the members' own distribution each person's probability of having it follows from the two evidences,
and the distribution is estimated anew from those of more than one half, until they are the same: eight of the
twelve remained and nobody else, with a compliance that holds. A member has a coefficient that the
effect may have: one of the wrong sign would keep the distribution wide.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logit

from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.extend import has_admissible_signs, with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import medians
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.spike_slab import FEWEST_MEMBERS, Membership, members

_PASSES = 2
"""How often dispersions among members are taken over. By choice, as in :mod:`.measured`."""

_SHARE_ROUNDS = 50
"""Rounds of expectation-maximisation of the share of members. By choice: it begins near its maximum."""

_ROUNDS = 6
"""Most times that members are chosen. By choice: from 31 of 40 they were the same after four."""


@dataclass(frozen=True, kw_only=True)
class OfMembers:
    """A fit with what only some have from those who have it.

    Attributes
    ----------
    refitter : Refitter
        That knows who they are.
    fit : Refit
        Its evidence is that of people who are known to have it or not.
    who : dict of int to Membership
        Of each addition that only some have; empty if everybody has everything.
    mixture : Refit or None
        The fit with the evidence of the mixture of both kinds of people. None if there is one kind, or different people
        have different effects: who has which is not summed over.
    """

    refitter: Refitter
    fit: Refit
    who: Mapping[int, Membership]
    mixture: Refit | None = None


def of_members(refitter: Refitter, fit: Refit, seed: int) -> OfMembers:
    """The fit with what only some have from those who have it; itself, with its refitter, if everybody has everything.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    seed : int
    """
    begun = {i: members(fit, i) for i, addition in enumerate(fit.model.additions) if addition.absent_in_some}
    begun = {i: who for i, who in begun.items() if _are_some(who.probability)}
    sure = {i: who for i, who in begun.items() if who.only_some}
    if len(sure or begun) == 1:
        ((addition, who),) = (sure or begun).items()
        own = _settled(refitter, fit, addition, who.probability < 0.5, seed)
        assert own.mixture is not None
        share = 0.5 * float(np.log(len(fit.u)))  # the price of a parameter more, as in a comparison of models
        better = float(own.mixture.evidence.sum()) - share > float(fit.evidence.sum())
        return own if who.only_some or better else OfMembers(refitter=refitter, fit=fit, who={})
    if not sure:
        return OfMembers(refitter=refitter, fit=fit, who={})
    lacks = {i: who.probability < 0.5 for i, who in sure.items()}
    refitter, fit = _known(refitter, fit, lacks, seed)
    return OfMembers(refitter=refitter, fit=fit, who=sure)


def _are_some(probability: np.ndarray) -> bool:
    """Whether some people have it, more than one or two, and others lack it."""
    return bool(np.sum(probability >= 0.5) > FEWEST_MEMBERS and np.any(probability < 0.5))


def _settled(refitter: Refitter, fit: Refit, addition: int, lacks: np.ndarray, seed: int) -> OfMembers:
    """With members that are those whom their own distribution makes members; of the rounds the one of most evidence."""
    found: list[OfMembers] = []
    own = fit
    for _ in range(_ROUNDS):
        knowing, own = _known(refitter, own, {addition: lacks}, seed)
        mixed, who = _mixed(refitter, own, addition, lacks)
        found.append(OfMembers(refitter=knowing, fit=own, who={addition: who}, mixture=mixed))
        now = (who.probability < 0.5) | _of_the_wrong_sign(own, addition, lacks)
        if np.array_equal(now, lacks) or not _are_some(~now):
            break
        lacks = now
    return max(found, key=lambda each: -np.inf if each.mixture is None else float(each.mixture.evidence.sum()))


def _of_the_wrong_sign(fit: Refit, addition: int, lacks: np.ndarray) -> np.ndarray:
    """Members whose own coefficient has a sign that the effect may not have, bool (N,)."""
    wrong = [not has_admissible_signs(fit, addition, fit.owner == person) for person in range(len(fit.data))]
    return np.asarray(np.array(wrong) & ~lacks)


def _known(refitter: Refitter, fit: Refit, lacks: Mapping[int, np.ndarray], seed: int) -> tuple[Refitter, Refit]:
    """Refitter and fit with what people lack, bool (N,), out of its distribution."""
    silent = np.zeros((len(fit.data), fit.u.shape[1]), dtype=bool)
    for i, own in lacks.items():
        silent[:, fit.model.columns(i)[0]] = own
    refitter = refitter.without(silent)
    place = np.cumsum(~fit.model.shared) - 1
    for _ in range(_PASSES):
        posterior, model, mu = coefficient_posterior(fit, seed, lacks=lacks), fit.model, fit.population.mu.copy()
        for i in lacks:
            model = with_pooling(model, i, model.additions[i].pooling, medians(model, i, posterior))
            column = model.columns(i)[0]
            mu[place[column]] = posterior.central[:, column - model.n_elements].mean()
        fit = refitter.fit(model, fit.u, replace(fit.population, mu=mu))
    return refitter, fit


def _mixed(refitter: Refitter, own: Refit, addition: int, lacks: np.ndarray) -> tuple[Refit, Membership]:
    """The fit with the evidence of the mixture, and who has the effect."""
    silent = np.zeros((len(own.data), own.u.shape[1]), dtype=bool)
    silent[:, own.model.columns(addition)[0]] = True
    with_it, without_it = (
        each.fit(own.model, own.u, own.population, hold_population=True, hold_additions=True).evidence
        for each in (refitter, refitter.without(silent))
    )
    share = float(np.mean(~lacks))
    for _ in range(_SHARE_ROUNDS):
        share = float(np.mean(expit(logit(share) + with_it - without_it)))
        share = float(np.clip(share, 1 / len(own.data), 1 - 1 / len(own.data)))
    evidence = np.logaddexp(np.log(share) + with_it, np.log1p(-share) + without_it)
    probability = expit(logit(share) + with_it - without_it)
    return replace(own, evidence=evidence, mixed=addition), Membership.of(probability, share)
