r"""Regression of the elements on what differs between the repetitions of a person: their number (drift), circumstances.

The deviation of repetition j from the elements of person i is

.. math:: \delta_{ij} = a_i + \sum_k (\beta_k + \beta_{ik})\,c_{ijk} + N(0, \operatorname{diag}\rho^2), \qquad
          \beta_{ik} \sim N(0, \operatorname{diag}\omega_k^2),\quad a_i \sim N(0, 1)

with :math:`c_k` the number of the repetition or a circumstance noted of it, such as its contact force. Offsets a are
left free because the person's elements are themselves estimated from these recordings; differences *between* persons in
a circumstance are therefore not used here. Slopes may differ between persons (omega): otherwise, if people drift to
either side without a common trend, the standard error of the common trend would be too small.

The coordinates of a person are its slopes :math:`s_{ik} = \beta_k + \beta_{ik}` and the rest
:math:`d_{ij} = a_i + N(0, \operatorname{diag}\rho^2)` of each repetition, whose means and covariances are the same for
all persons, whatever values of c a person has. As delta is a linear function of both, the quadratic likelihood of
delta is one of them:

.. math:: \ell(\delta) = b^T\delta - \tfrac12\delta^T H\delta,\quad \delta = A\,(s, d) \;\Rightarrow\;
          b \to A^T b,\quad H \to A^T H A .

Means, variances and degrees of freedom are those of :mod:`bayes_impedance.diagnosis.heterogeneity.reml`. Each variable
is tested beside those already found, as covariates are: a temperature that rises from repetition to repetition is not
taken for a drift if it alone explains the elements, and a variable that is proportional to another one is not tested
beside it. Where two of them went together, as drive levels that rise from one repetition to the next, neither is
significant beside the other, and which of them the elements follow is not known: :func:`indistinguishable`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.reml import AdditiveCovariance, fit_normal_population
from bayes_impedance.diagnosis.heterogeneity.trends import (
    ALPHA,
    COLLINEAR,
    LARGEST_SLOPE_SD,
    MINIMUM_PERSONS,
    Trend,
    Trends,
    corrected,
    others,
    regressors_of,
    trends_of,
)
from bayes_impedance.diagnosis.multiple_testing import bonferroni
from bayes_impedance.errors import InputError
from bayes_impedance.units import counted

DRIFT = "repetition"
"""Name of the number of the repetition among the variables."""

_START_RHO, _START_OMEGA = 0.05, 0.01
"""Dispersion between repetitions, and of slopes, at which the fit starts. By choice."""

_OFFSET_SD = 1.0
"""Prior standard deviation of each person's offset: flat relative to deviations of some per cent."""


@dataclass(frozen=True)
class RepetitionLikelihoods:
    """Log likelihoods of the deviations of every repetition from the person's elements.

    Attributes
    ----------
    elements : tuple of str
    linear : tuple of ndarray, shape (J_i, P)
        One for each person, as in
        :class:`~bayes_impedance.diagnosis.heterogeneity.person_likelihoods.PersonLikelihoods`.
    information : tuple of ndarray, shape (J_i, P, P)
    order : tuple of ndarray, shape (J_i,)
        Number of each repetition, from 0; numbers of missing repetitions are left out.
    circumstances : mapping of str to tuple of ndarray, shape (J_i,)
        What was noted of each repetition; NaN where unknown.
    """

    elements: tuple[str, ...]
    linear: tuple[np.ndarray, ...]
    information: tuple[np.ndarray, ...]
    order: tuple[np.ndarray, ...]
    circumstances: Mapping[str, tuple[np.ndarray, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        p = len(self.elements)
        for i, (b, h, order) in enumerate(zip(self.linear, self.information, self.order, strict=True)):
            j = len(order)
            if b.shape != (j, p) or h.shape != (j, p, p) or np.unique(order).size != j:
                raise InputError(
                    f"repetitions of subject {i}: {j} numbers, linear {b.shape}, information {h.shape}; give each "
                    f"repetition its own number and {p} elements"
                )
            for name, values in self.circumstances.items():
                if np.shape(values[i]) != (j,):
                    raise InputError(
                        f"repetitions of subject {i}: '{name}' has shape {np.shape(values[i])}; give one number for "
                        f"each of {j} repetitions"
                    )

    def along(self, variables: Sequence[Sequence[np.ndarray]]) -> tuple[PersonLikelihoods, np.ndarray]:
        """Likelihoods of slopes and rests of persons who have at least two repetitions with all variables known.

        Parameters
        ----------
        variables : sequence of K sequences of ndarray, shape (J_i,)
            Values of each variable in each repetition of each person.

        Returns
        -------
        likelihoods : PersonLikelihoods
            Of (K + U) P elements: P slopes for each variable, P rests for each number of a repetition. A repetition
            that a person lacks has no information.
        numbers : ndarray, shape (U,)
        """
        seen = [np.all([np.isfinite(v[i]) for v in variables], axis=0) for i in range(len(self.order))]
        chosen = [i for i, known in enumerate(seen) if known.sum() > 1]
        numbers = np.unique(np.concatenate([self.order[i][seen[i]] for i in chosen])) if chosen else np.empty(0, int)
        n, u, p, k = len(chosen), numbers.size, len(self.elements), len(variables)
        linear, information = np.zeros((n, k + u, p)), np.zeros((n, k + u, p, k + u, p))
        for row, i in enumerate(chosen):
            known = seen[i]
            a = np.zeros((int(known.sum()), k + u))
            a[:, :k] = np.array([v[i][known] for v in variables]).T
            a[np.arange(len(a)), k + np.searchsorted(numbers, self.order[i][known])] = 1.0
            linear[row] = a.T @ self.linear[i][known]
            information[row] = np.einsum("ja,jpq,jb->apbq", a, self.information[i][known], a)
        names = tuple(f"{e} {j}" for j in range(k + u) for e in self.elements)
        return PersonLikelihoods(names, linear.reshape(n, -1), information.reshape(n, (k + u) * p, -1)), numbers


def within_persons_model(
    repetitions: RepetitionLikelihoods, variables: Sequence[Sequence[np.ndarray]]
) -> tuple[PersonLikelihoods, np.ndarray, AdditiveCovariance]:
    """Likelihoods of persons, design of a slope for every variable and element, and start values of variances."""
    likelihoods, numbers = repetitions.along(variables)
    n, p, k, u = len(likelihoods), len(repetitions.elements), len(variables), numbers.size
    unit = np.eye(p)[:, :, None] * np.eye(p)[:, None, :]
    rest = np.diag(np.repeat([0.0, 1.0], [k, u]))
    rho = np.array([np.kron(rest, e) for e in unit])
    omega = np.array([np.kron(np.diag(np.arange(k + u) == own), e) for own in range(k) for e in unit])
    together = np.zeros((k + u, k + u))
    together[k:, k:] = _OFFSET_SD**2
    variances = np.repeat([_START_RHO**2, _START_OMEGA**2], [p, k * p])
    design = np.broadcast_to(np.eye((k + u) * p)[:, : k * p], (n, (k + u) * p, k * p))
    structure = AdditiveCovariance(np.kron(together, np.eye(p)), np.concatenate([rho, omega]), variances)
    return likelihoods, design, structure


def find_within_persons(repetitions: RepetitionLikelihoods, *, alpha: float = ALPHA) -> Trends:
    """Test every element for a common slope over the number of the repetition and over each circumstance.

    Parameters
    ----------
    repetitions : RepetitionLikelihoods
    alpha : float
        Corrected p below which a variable is added to the model in which the others are tested.

    Returns
    -------
    Trends
        Slopes in log change per repetition, per unit of a circumstance, or per change of its logarithm by one.
    """
    n = sum(len(order) > 1 for order in repetitions.order)
    if n < MINIMUM_PERSONS:
        have = f"{counted(n, 'subject')} {'has' if n == 1 else 'have'}"
        return Trends((), 0, reason=f"only {have} repetitions; at least {MINIMUM_PERSONS} are needed")
    remarks: list[str] = []
    variables = variables_of(repetitions, remarks)
    beside: list[str] = []
    while True:
        rows = {q: _slopes(repetitions, variables, [b for b in beside if b != q], q) for q in variables}
        tried = sum(len(r) for r in rows.values())
        best = {q: min((t.p_value for t in r), default=1.0) for q, r in rows.items() if q not in beside}
        if not best or bonferroni(min(best.values()), max(tried, 1)) > alpha:
            break
        beside.append(min(best, key=lambda q: best[q]))
    seen = {t.element for r in rows.values() for t in r}
    kept = np.array([e for e, name in enumerate(repetitions.elements) if name in seen])
    remarks += [f"{e} is not determined by the repetitions" for e in others(repetitions.elements, kept)]
    remarks += [
        f"'{q}' differs within too few subjects, or is determined by other variables of the repetitions"
        for q in rows
        if not rows[q] and q != DRIFT
    ]
    found = [t for r in rows.values() for t in r]
    reason = "" if found else "no element is determined"
    return Trends(corrected(found), tried, tuple(beside), reason, tuple(remarks))


def indistinguishable(
    repetitions: RepetitionLikelihoods, claimed: str, beside: Sequence[str], *, alpha: float = ALPHA
) -> tuple[Trend, ...]:
    """Other variables that the elements may follow in place of one that was found.

    Parameters
    ----------
    repetitions : RepetitionLikelihoods
    claimed : str
        The variable that was found.
    beside : sequence of str
        All variables in the model, as in :class:`~bayes_impedance.diagnosis.heterogeneity.trends.Trends`.
    alpha : float
        Level at which the other one must be significant in its place, and at which it is not beside the other one.

    Returns
    -------
    tuple of Trend
        The most significant slope on each of them, smallest p first.
    """
    variables = variables_of(repetitions, [])
    rest = [q for q in beside if q != claimed]
    found = []
    for other in variables:
        if other == claimed or other in rest:
            continue
        instead = _slopes(repetitions, variables, rest, other)
        if _least(instead) < alpha and _least(_slopes(repetitions, variables, [*rest, other], claimed)) >= alpha:
            found.append(min(instead, key=lambda t: t.p_value))
    return tuple(sorted(found, key=lambda t: t.p_value))


def _least(rows: Sequence[Trend]) -> float:
    """Smallest p-value of some slopes, corrected for their number; 1 if there are none."""
    return bonferroni(min((t.p_value for t in rows), default=1.0), max(len(rows), 1))


def variables_of(
    repetitions: RepetitionLikelihoods, remarks: list[str]
) -> dict[str, tuple[tuple[np.ndarray, ...], str, float]]:
    """Variables with the name of their transform, each person's mean subtracted and in units of what they vary by.

    Returns
    -------
    dict of str to (values, transform, unit)
        Values of each person, and the change of the transformed variable that is a change of them by one.
    """
    found = {
        DRIFT: (tuple(order - order.mean() if order.size else order for order in repetitions.order), "linear", 1.0)
    }
    ends = np.cumsum([order.size for order in repetitions.order])[:-1]
    stacked = {name: np.concatenate(values) for name, values in repetitions.circumstances.items()}
    for name, (values, transform) in regressors_of(stacked, remarks, "repetitions").items():
        centred = [own - np.nanmean(own) if np.isfinite(own).any() else own for own in np.split(values, ends)]
        unit = float(np.sqrt(np.nanmean(np.concatenate(centred) ** 2)))
        if unit > 0:
            found[name] = tuple(own / unit for own in centred), transform, unit
    return found


def _slopes(
    repetitions: RepetitionLikelihoods,
    variables: Mapping[str, tuple[tuple[np.ndarray, ...], str, float]],
    beside: list[str],
    name: str,
) -> list[Trend]:
    """Slopes of all elements on one variable, with others in the model; empty if they cannot be estimated."""
    own = [variables[q][0] for q in [*beside, name]]
    usable = [np.all([np.isfinite(v[i]) for v in own], axis=0) for i in range(len(repetitions.order))]
    columns = [
        np.array([v[i][known] - v[i][known].mean() for v in own]) for i, known in enumerate(usable) if known.sum() > 1
    ]
    if sum(bool(np.ptp(c[-1]) > 0) for c in columns) < MINIMUM_PERSONS:
        return []
    together = np.concatenate(columns, axis=1)
    together = together / np.sqrt(np.sum(together**2, axis=1, keepdims=True))
    if np.linalg.svd(together, compute_uv=False)[-1] < COLLINEAR:
        return []
    fit = fit_normal_population(*within_persons_model(repetitions, own))
    k, p = len(beside), len(repetitions.elements)
    wanted = {k * p + e: element for e, element in enumerate(repetitions.elements)}
    wanted = {c: e for c, e in wanted.items() if fit.variance[c, c] < LARGEST_SLOPE_SD**2}
    _, transform, unit = variables[name]
    return trends_of(fit, wanted, name, transform, unit)
