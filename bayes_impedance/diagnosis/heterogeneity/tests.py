r"""All tests of the population: covariates, drift, subgroups, correlations, as entries of the verdict.

The tests are those of :mod:`bayes_impedance.diagnosis.heterogeneity.regression` and its neighbours; here each person's
quadratic likelihood is computed from a fit, and significant structures are collected.

What was added to the network and differs between people may follow a covariate as well, such as the exponent of a power
law that follows temperature. Such a parameter x enters beside the elements by its logarithm, which near the median
person is a multiple of the parameter u that is fitted:

.. math:: \ln x \approx \text{const} + u/\bar u \text{ (linear)}, \qquad
          \ln x = u \text{ (log)}, \qquad \ln x \approx \text{const} + (1 - \bar x)\,u \text{ (logit)} .
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.normal_equations import sums
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.heterogeneity.correlations import CorrelationTest, correlation_test
from bayes_impedance.diagnosis.heterogeneity.gain import gain_of_covariate, gain_within_persons
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.regression import find_covariates
from bayes_impedance.diagnosis.heterogeneity.subgroups import Subgroup, find_subgroup
from bayes_impedance.diagnosis.heterogeneity.trends import Trend, regressors_of
from bayes_impedance.diagnosis.heterogeneity.within_persons import (
    DRIFT,
    RepetitionLikelihoods,
    find_within_persons,
    indistinguishable,
)
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.recordings.files import Recordings

ALPHA = 0.003
"""Corrected level of each family of tests. There are four families; by the union bound they raise 1.2 % false alarms
together, about as many as the search for missing physics (1 %)."""

_FROM_ZERO = 2.0
"""Standard deviations between people by which a linear coefficient must differ from zero for its logarithm to be a
quantity. By choice: 2.3 % of people are then on the other side."""


@dataclass(frozen=True)
class Added:
    """A parameter of an addition that differs between people.

    Attributes
    ----------
    name, place : str
        In texts, and where it acts.
    column : int
        Among the parameters of the model.
    per_log : float
        Change of u for a change of the parameter's logarithm by one.
    """

    name: str
    place: str
    column: int
    per_log: float


def added_parameters(fit: Refit) -> tuple[Added, ...]:
    """Parameters of the additions that differ between people and whose logarithm is meaningful."""
    model, found = fit.model, []
    for i, addition in enumerate(model.additions):
        if not addition.effect.operation or addition.only_in_some:
            continue
        for coefficient, column in zip(addition.effect.coefficients, model.columns(i), strict=True):
            own = fit.u[:, column]
            centre, spread = float(own.mean()), float(own.std())
            if model.shared[column] or (coefficient.link == "linear" and abs(centre) < _FROM_ZERO * spread):
                continue
            per_log = {
                "linear": centre,
                "log": 1.0,
                "logit": 1 / (1 - float(coefficient.value(centre, model.scales))),
            }[coefficient.link]
            where = "the port" if addition.place == "port" else addition.place
            name = f"{coefficient.name.replace('_', ' ')} of {addition.effect.name} at {where}"
            found.append(Added(name, addition.place, column, per_log))
    return tuple(found)


def person_likelihoods(fit: Refit, added: Sequence[Added] = ()) -> PersonLikelihoods:
    """Each person's likelihood of the log elements, deviations between repetitions integrated out.

    Parameters
    ----------
    fit : Refit
    added : sequence of Added
        Parameters of additions whose logarithms come after those of the elements.
    """
    e = fit.model.n_elements
    h, linear = _recordings(fit, [*range(e), *(a.column for a in added)])
    per_log = np.array([1.0] * e + [a.per_log for a in added])
    h, linear = h * np.outer(per_log, per_log), linear * per_log
    rho = np.append(fit.population.rho[:e], np.zeros(len(added)))
    precision = np.maximum(rho, LEAST_RHO) ** -2.0
    pulled = np.linalg.solve(h + np.diag(precision), np.concatenate([h, linear[..., None]], axis=2))
    information = h - np.einsum("mpq,mqr->mpr", h, pulled[..., :-1])
    reduced = linear - np.einsum("mpq,mq->mp", h, pulled[..., -1])
    n = len(fit.data)
    total = sums(information, fit.owner, n)
    names = (*fit.model.network.elements, *(a.name for a in added))
    return PersonLikelihoods(names, sums(reduced, fit.owner, n), 0.5 * (total + np.swapaxes(total, 1, 2)))


def repetition_likelihoods(fit: Refit, recordings: Recordings) -> RepetitionLikelihoods:
    """Likelihoods of the deviations of every repetition from the person's elements, with its circumstances."""
    e = fit.model.n_elements
    h, linear = _recordings(fit, range(e))
    centred = linear - np.einsum("mpq,mq->mp", h, fit.persons[fit.owner][:, :e])
    rows = [np.flatnonzero(fit.owner == i) for i in range(len(fit.data))]
    return RepetitionLikelihoods(
        fit.model.network.elements,
        tuple(centred[r] for r in rows),
        tuple(h[r] for r in rows),
        tuple(np.arange(r.size) for r in rows),
        {
            name: tuple(
                np.asarray(s.circumstances.get(name, np.full(r.size, np.nan)), dtype=float)
                for s, r in zip(recordings.subjects, rows, strict=True)
            )
            for name in _noted(recordings)
        },
    )


def _noted(recordings: Recordings) -> list[str]:
    return sorted({name for s in recordings.subjects for name in s.circumstances})


def _recordings(fit: Refit, columns: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Information (M, C, C) and linear term (M, C) of some parameters of every recording, all others held."""
    c = np.array(columns)
    w = fit.weight[fit.owner]
    h = w[:, None, None] * fit.equations.information[:, c[:, None], c]
    return h, np.einsum("mpq,mq->mp", h, fit.u[:, c]) - w[:, None] * fit.equations.gradient[:, c]


@dataclass(frozen=True)
class OtherVariable:
    """What elements may follow in place of what was found: the recordings cannot tell.

    Attributes
    ----------
    covariate : str or None
        None for the number of the repetition.
    element : str
        That follows it most significantly.
    behind : float
        Gain on held-out people by which it stands behind what was found; negative if it is ahead.
    """

    covariate: str | None
    element: str
    behind: float


@dataclass(frozen=True, kw_only=True)
class ElementTrends:
    """Elements that follow one covariate or the repetitions.

    Attributes
    ----------
    covariate : str or None
        None for the repetitions.
    trends : tuple of Trend
        The most significant first; at least one.
    gain, gain_se : float
        On held-out people, with its standard error.
    place : str
        Of the first; an element is its own place.
    within : bool
        Whether they follow it from repetition to repetition, and not from person to person.
    others : tuple of OtherVariable
        Which they may follow in its place.
    """

    covariate: str | None
    trends: tuple[Trend, ...]
    gain: float
    gain_se: float
    place: str
    within: bool = False
    others: tuple[OtherVariable, ...] = ()

    @property
    def predicts(self) -> bool:
        """Whether held-out people are described better with them: what describes only those who are there is no effect.

        Of sixteen people without a drift one element of a grown network had one with p = 0.001 and a gain of -0.2.
        """
        return self.gain > 0.0


Structure = ElementTrends | Subgroup | CorrelationTest
"""A significant structure of the population."""


def find_structures(
    fit: Refit, recordings: Recordings, diagonal: bool, seed: int
) -> tuple[tuple[Structure, ...], list[str]]:
    """Significant structures of the population, and remarks.

    Parameters
    ----------
    fit : Refit
    recordings : Recordings
    diagonal : bool
        Whether the claimed population has independent elements.
    seed : int
    """
    found: list[Structure] = []
    remarks: list[str] = []
    people = person_likelihoods(fit)
    values = covariates_of(recordings)
    if values:
        added = added_parameters(fit)
        with_added = person_likelihoods(fit, added)
        places = {a.name: a.place for a in added}
        tested = find_covariates(with_added, values)
        remarks += [f"Covariates: {text}" for text in (tested.reason, *tested.remarks) if text]
        for name in dict.fromkeys(t.covariate for t in tested.trends if t.p_corrected < ALPHA):
            rows = tuple(t for t in tested.trends if t.covariate == name and t.p_corrected < ALPHA)
            regressor = regressors_of({name: values[name]}, [])[name][0]
            gain = gain_of_covariate(with_added, regressor, [t.element for t in rows], seed)
            place = places.get(rows[0].element, rows[0].element)
            trends = ElementTrends(covariate=name, trends=rows, gain=gain[0], gain_se=gain[1], place=place)
            found += [trends] if trends.predicts else []
    if any(len(s.repetitions) > 1 for s in recordings.subjects):
        repetitions = repetition_likelihoods(fit, recordings)
        within = find_within_persons(repetitions)
        remarks += [f"Repetitions: {text}" for text in within.remarks] if repetitions.circumstances else []
        for name in dict.fromkeys(t.covariate for t in within.trends if t.p_corrected < ALPHA):
            rows = tuple(t for t in within.trends if t.covariate == name and t.p_corrected < ALPHA)
            trends = _within(repetitions, name, rows, within.beside, seed)
            found += [trends] if trends.predicts else []
    e = fit.model.n_elements
    group = find_subgroup(people, fit.population.mu[:e], fit.population.covariance[:e, :e], seed)
    if group.p_corrected < ALPHA:
        found.append(group)
    if diagonal:
        together = correlation_test(people, seed)
        if together.p_corrected < ALPHA:
            found.append(together)
    return tuple(found), remarks


def _within(
    repetitions: RepetitionLikelihoods, name: str, rows: tuple[Trend, ...], beside: Sequence[str], seed: int
) -> ElementTrends:
    """Elements that follow a variable of the repetitions, with what they may follow in its place."""
    elements = [t.element for t in rows]
    gain, se = gain_within_persons(repetitions, elements, seed, name)
    others = tuple(
        OtherVariable(
            _covariate(t.covariate),
            t.element,
            gain - gain_within_persons(repetitions, elements, seed, t.covariate)[0],
        )
        for t in indistinguishable(repetitions, name, beside)
    )
    return ElementTrends(
        covariate=_covariate(name),
        trends=rows,
        gain=gain,
        gain_se=se,
        place=rows[0].element,
        within=True,
        others=others,
    )


def _covariate(variable: str) -> str | None:
    """Name of a circumstance; None for the number of the repetition."""
    return None if variable == DRIFT else variable


def covariates_of(recordings: Recordings) -> dict[str, np.ndarray]:
    """Covariates of all people by name, each (N,), and means of what was noted of their repetitions; NaN if unknown."""
    names = sorted({name for s in recordings.subjects for name in s.covariates})
    found = {n: np.array([float(s.covariates.get(n, np.nan)) for s in recordings.subjects]) for n in names}
    for name in _noted(recordings):
        own = [np.asarray(s.circumstances.get(name, []), dtype=float) for s in recordings.subjects]
        means = np.array(
            [values[np.isfinite(values)].mean() if np.isfinite(values).any() else np.nan for values in own]
        )
        if name not in found and np.nanmax(means, initial=-np.inf) > np.nanmin(means, initial=np.inf):
            found[name] = means
    return found
