r"""Test of a subgroup: two normal populations with a common covariance against one.

One population :math:`\theta_i \sim N(\mu, T)` is compared with two of the same covariance,

.. math:: \theta_i \sim (1-\pi)\,N(\mu, T) + \pi\,N(\mu + \delta, T),

where delta is a change of one element, or of all of them in any proportion. These are two searches, each with its own
largest likelihood ratio (:mod:`bayes_impedance.diagnosis.heterogeneity.two_groups`); the result is twice the smaller p.
Likelihood ratios of mixtures have no chi-square distribution, so p comes from replicates of one population to which
the whole search is applied (:mod:`bayes_impedance.diagnosis.heterogeneity.bootstrap`). Replicates are made in
batches, and stopped once p is clearly not significant.

The covariance of the single population is full, whatever the fitted one: correlated elements, persons with little
information and undetermined elements are therefore not mistaken for groups. A distribution of the log elements with
heavy tails or a skew is not normal either, and two groups may describe it best: `separation` below two means that the
groups overlap so much that there need not be two.

What is reported is the maximum of the whole likelihood, found from there by expectation-maximisation: the change of one
element unless the change of all is significantly more likely. Standard errors of mean, shift and share are from the
observed information (Louis, J. R. Statist. Soc. B 44, 226-233, 1982) at the covariance found; those of the shift are
enlarged for the degrees of freedom that the covariance took.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.two_group_mixture import log_mixture, membership, share_of
from bayes_impedance.diagnosis.heterogeneity.bootstrap import Residuals, replicates, tail_probability
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods, log_marginal
from bayes_impedance.diagnosis.heterogeneity.reml import Fit, centred_fit
from bayes_impedance.diagnosis.heterogeneity.two_groups import (
    SMALLEST_GROUP,
    SMALLEST_SHARE,
    Mixture,
    along_any,
    along_elements,
)
from bayes_impedance.diagnosis.multiple_testing import bonferroni
from bayes_impedance.population.em_state import PRIOR_PERSONS
from bayes_impedance.units import NORMAL_Q95, counted

REPLICATES = 200
"""Twenty replicates lie in the highest tenth, from which the tail is extrapolated
(:func:`~bayes_impedance.diagnosis.heterogeneity.bootstrap.tail_probability`)."""

MINIMUM_PERSONS = 12
"""With fewer persons, two groups of at least three differ by chance too often for a shift to be significant. By
choice."""

_BATCH = 40
"""Replicates at a time: after each batch it is decided whether more are needed. By choice."""

_ENOUGH_ABOVE = 6
"""Replicates of each batch with a larger statistic at which sampling stops: p is then above 0.1."""

_ROUNDS = 60
"""Rounds of expectation-maximisation of the reported groups, from the best mixture of the search. By choice."""

_AXIS_LEVEL = 0.01
"""Level at which a change of all elements must fit better than that of one element to be reported. By choice."""


@dataclass(frozen=True, kw_only=True)
class Subgroup:
    """The group that differs most from the others, and its significance.

    Attributes
    ----------
    element : str
        The element that differs; empty if all elements do.
    shift, shift_q05, shift_q95 : ndarray, shape (P,)
        Change of the log elements in the group, with 90 % intervals; zero for elements that do not change.
    share, share_q05, share_q95 : float
        Fraction of the population in the group, which is the smaller of the two.
    separation : float
        Distance between the groups in standard deviations within a group.
    statistic : float
        Twice the log likelihood ratio in the better search.
    p_value : float
        Of that search.
    p_corrected : float
        For both searches, each of which counts its directions through its replicates.
    tried : int
        Directions tried: the elements, and any.
    persons : int
    membership : ndarray, shape (N,)
        Probability of belonging to the group.
    reason : str
        Why nothing was tested; empty if it was.
    remarks : tuple of str
        What was left out.
    """

    element: str
    shift: np.ndarray
    shift_q05: np.ndarray
    shift_q95: np.ndarray
    share: float
    share_q05: float
    share_q95: float
    separation: float
    statistic: float
    p_value: float
    p_corrected: float
    tried: int
    persons: int
    membership: np.ndarray
    reason: str = ""
    remarks: tuple[str, ...] = ()


def find_subgroup(
    likelihoods: PersonLikelihoods, mu: np.ndarray, covariance: np.ndarray, seed: int, count: int = REPLICATES
) -> Subgroup:
    """Look for a group of people with different elements.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
    mu : ndarray, shape (P,) or (N, P)
        Mean of the population, at each person if it follows covariates. A common correction is fitted.
    covariance : ndarray, shape (P, P)
        Between persons: start value for the fit of the single population.
    seed : int
        Of the replicates.
    count : int
        Largest number of replicates.

    Returns
    -------
    Subgroup
    """
    from scipy.stats import chi2

    n, elements = len(likelihoods), likelihoods.elements
    if n < MINIMUM_PERSONS:
        return _nothing(n, len(elements), f"only {counted(n, 'subject')}; at least {MINIMUM_PERSONS} are needed")
    _, fit = centred_fit(likelihoods.around(mu), covariance + 1e-6 * np.eye(len(elements)))
    kept = np.flatnonzero(fit.determined)
    remarks = tuple(f"{e} is not determined by the recordings" for k, e in enumerate(elements) if k not in kept)
    if not kept.size:
        return _nothing(n, len(elements), "no element is determined", remarks)
    one, anything = _search(Residuals.of(fit), kept)
    real = np.array([one.statistic.max(), anything.statistic[0, 0]])
    null = np.empty((0, 2))
    for batch in replicates(fit, count, _BATCH, seed):
        rivals = _search(batch, kept)
        null = np.vstack([null, np.array([m.statistic.max(axis=1) for m in rivals]).T])
        if np.all(np.sum(null >= real, axis=0) >= _ENOUGH_ABOVE * len(null) / _BATCH):
            break
    p = [tail_probability(float(s), column) for s, column in zip(real, null.T, strict=True)]
    element = int(kept[np.argmax(one.statistic[0]) % kept.size])
    every = np.eye(len(elements))
    shape = every[:, [element]]
    groups, free = _Groups.of(fit, one.best(1)).maximised(shape), _Groups.of(fit, anything).maximised(every)
    # If only one element differs, freeing the others raises twice the log likelihood by chi-square(P - 1).
    axis = 2 * (free.log_likelihood() - groups.log_likelihood()) < chi2.isf(_AXIS_LEVEL, max(len(elements) - 1, 1))
    groups, shape = (groups, shape) if axis else (free, every)
    shift, sd, share_sd = groups.shift, *groups.errors(shape)
    logit = np.log(groups.share / (1 - groups.share)) + NORMAL_Q95 * min(share_sd, 400.0) * np.array([-1, 0, 1])
    share, belongs = 1 / (1 + np.exp(-logit)), groups.membership()
    if groups.share > 0.5:
        shift, share, belongs = -shift, 1 - share[::-1], 1 - belongs
    return Subgroup(
        element=elements[element] if axis else "",
        shift=shift,
        shift_q05=shift - NORMAL_Q95 * sd,
        shift_q95=shift + NORMAL_Q95 * sd,
        share=float(share[1]),
        share_q05=float(share[0]),
        share_q95=float(share[2]),
        separation=float(np.sqrt(shift @ np.linalg.solve(groups.covariance, shift))),
        statistic=float(real[int(np.argmin(p))]),
        p_value=min(p),
        p_corrected=bonferroni(min(p), 2),
        tried=kept.size + 1,
        persons=n,
        membership=belongs,
        reason="",
        remarks=remarks,
    )


def _search(residuals: Residuals, elements: np.ndarray) -> tuple[Mixture, Mixture]:
    one = along_elements(residuals, elements)
    return one, along_any(residuals, one)


@dataclass(frozen=True)
class _Groups:
    """Two groups with means (P,) and mean + shift, a common covariance (P, P), and the share of the second."""

    likelihoods: PersonLikelihoods
    mean: np.ndarray
    shift: np.ndarray
    covariance: np.ndarray
    share: float

    @classmethod
    def of(cls, fit: Fit, mixture: Mixture) -> _Groups:
        """Groups from a mixture along one direction, the spread within the groups being less than that of all."""
        middle, shift, spread = (float(v[0, 0]) for v in (mixture.middle, mixture.shift, mixture.spread))
        along = fit.factor @ mixture.direction[0, 0]
        covariance = fit.covariance + (spread - 1) * np.outer(along, along)
        mean = fit.coefficients + middle * along
        return cls(fit.problem.likelihoods, mean, shift * along, covariance, float(mixture.share[0, 0]))

    def both(self) -> tuple[np.ndarray, np.ndarray]:
        """Log likelihood of each person as a member of either group, both shape (N,)."""
        first = log_marginal(self.likelihoods, self.mean, self.covariance)
        return first, log_marginal(self.likelihoods, self.mean + self.shift, self.covariance)

    def log_likelihood(self) -> float:
        """Log likelihood of all persons."""
        first, second = self.both()
        return float(np.sum(first + log_mixture(second - first, self.share)))

    def membership(self) -> np.ndarray:
        """Probability of the second group, shape (N,)."""
        first, second = self.both()
        return membership(second - first, self.share)

    def maximised(self, shape: np.ndarray) -> _Groups:
        """Groups after rounds of expectation-maximisation, the shift being a linear combination of `shape` (P, K)."""
        groups = self
        n, p = self.likelihoods.linear.shape
        h = self.likelihoods.information
        least = max(SMALLEST_SHARE, SMALLEST_GROUP / n)
        for _ in range(_ROUNDS):
            r = groups.membership()
            weight, free = groups.weights()
            own, second = weight.sum(axis=0), np.tensordot(r, weight, 1)
            normal = np.block([[own, second @ shape], [shape.T @ second, shape.T @ second @ shape]])
            right = np.concatenate([free.sum(axis=0), shape.T @ (r @ free)])
            # A shift that no data determine stays zero.
            solution = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
            mean, shift = solution[:p], shape @ solution[p:]
            covariance = groups.covariance
            rest = np.linalg.inv(np.eye(p) + covariance @ h) @ covariance
            total = rest.sum(axis=0)
            for centre, part in ((mean, 1 - r), (mean + shift, r)):
                away = np.einsum("npq,nq->np", rest, self.likelihoods.around(centre).linear)
                total = total + (part[:, None] * away).T @ away
            total = 0.5 * (total + total.T) + PRIOR_PERSONS * np.diag(np.diag(covariance))
            share = float(share_of(r, least))
            groups = _Groups(self.likelihoods, mean, shift, total / (n + PRIOR_PERSONS), share)
        return groups

    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """Weight W of each person, (N, P, P), and the pull towards it from zero, (N, P)."""
        factor = np.linalg.cholesky(self.covariance)
        inverse = np.linalg.inv(factor)
        p = factor.shape[0]
        shrink = np.linalg.inv(np.eye(p) + factor.T @ self.likelihoods.information @ factor)
        free = np.einsum("npq,nq->np", shrink, self.likelihoods.linear @ factor) @ inverse
        return inverse.T @ (np.eye(p) - shrink) @ inverse, free

    def errors(self, shape: np.ndarray) -> tuple[np.ndarray, float]:
        """Standard errors of the shift, (P,), and of the share's logit; infinite where undetermined."""
        p, k = shape.shape
        r = self.membership()
        weight, free = self.weights()
        second = np.concatenate([np.eye(p), shape], axis=1)
        first = np.concatenate([np.eye(p), np.zeros((p, k))], axis=1)
        # Difference of the scores that a person has as a member of either group, for mean, shift and logit.
        pulls = [free - weight @ m for m in (self.mean, self.mean + self.shift)]
        difference = np.hstack([pulls[1] @ second - pulls[0] @ first, np.ones((len(r), 1))])
        information = np.zeros((p + k + 1, p + k + 1))
        for design, part in ((first, 1 - r), (second, r)):
            information[:-1, :-1] += design.T @ np.tensordot(part, weight, 1) @ design
        information[-1, -1] = len(r) * self.share * (1 - self.share)
        information -= (difference * (r * (1 - r))[:, None]).T @ difference
        values, vectors = np.linalg.eigh(0.5 * (information + information.T))
        if values[0] <= 1e-9 * values[-1]:
            return np.where(np.any(shape != 0, axis=1), np.inf, 0.0), np.inf
        variance = (vectors / values) @ vectors.T
        # As in an analysis of covariance: the regression on the unchanged elements has been estimated too.
        n, others = len(r), p - k
        larger = n / max(n - 2 - others, 1) * (1 + others / max(n - others - 3, 1))
        return np.sqrt(larger * np.diag(shape @ variance[p:-1, p:-1] @ shape.T)), float(np.sqrt(variance[-1, -1]))


def _nothing(n: int, p: int, reason: str, remarks: tuple[str, ...] = ()) -> Subgroup:
    none = np.zeros(p)
    return Subgroup(
        element="",
        shift=none,
        shift_q05=none,
        shift_q95=none,
        share=0.0,
        share_q05=0.0,
        share_q95=0.0,
        separation=0.0,
        statistic=0.0,
        p_value=1.0,
        p_corrected=1.0,
        tried=0,
        persons=n,
        membership=np.zeros(n),
        reason=reason,
        remarks=remarks,
    )
