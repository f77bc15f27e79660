r"""Regression of the elements on covariates of the person, and on the number of the repetition (drift).

**Covariates.** :math:`\theta_i = \mu + B x_i + N(0, T)`, with mu, T and the slopes of all elements free: an element's
slope is then its own and not induced by a correlated element. The statistic is the restricted estimate over its
standard error, against Student's t, with Kenward and Roger's standard error and degrees of freedom: exact if every
recording determines every element, whatever N. No simulation is needed, and p values have no lower limit. Each
covariate is tested beside those already found (the best one is added as long as its p, times everything tried, is below
`alpha`): if contact force happens to grow with age, an effect of the force is not attributed to age. Corrected p values
are Holm's over all elements times all covariates.

A covariate x that is positive enters as ln x. Elements are positive and their logarithms normal, so the simplest law
between two positive quantities is a power, :math:`\text{element} \propto x^b`: stiffness and damping of a fingertip
grow with contact force as :math:`F^{0.35}`. Its exponent has no unit. Covariates that are not positive or take two
values (a code, where ln is the same test in an odd unit), and temperatures in Celsius, whose zero is arbitrary, enter
linearly.

**Drift.** The deviation of repetition j from the person's elements is

.. math:: \delta_{ij} = a_i + (\beta + \beta_i)\,c_j + N(0, \operatorname{diag}\rho^2), \qquad
          \beta_i \sim N(0, \operatorname{diag}\omega^2),\quad a_i \sim N(0, 1)

with c the repetition's number. Offsets a are left free because the person's elements are themselves estimated from
these recordings. Slopes may differ between persons (omega): otherwise, if people drift to either side without a common
trend, the standard error of the common trend would be too small. All repetitions of a person are one vector of J P
elements, so means, variances and degrees of freedom are those of :mod:`bayes_impedance.diagnosis.heterogeneity.reml`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.reml import (
    AdditiveCovariance,
    Fit,
    FullCovariance,
    centred_fit,
    fit_normal_population,
)
from bayes_impedance.diagnosis.multiple_testing import bonferroni, holm
from bayes_impedance.errors import InputError

ALPHA = 0.005
"""Corrected p-value below which a covariate is added to the model in which the others are tested. By choice."""

MINIMUM_PERSONS = 5
"""With fewer persons a slope has hardly any degrees of freedom, and nothing is tested. By choice."""

_CELSIUS = ("_c", "_degc", "_celsius")
"""Endings of the names of covariates whose zero is arbitrary: no logarithm is taken."""

_START_RHO, _START_OMEGA = 0.05, 0.01
"""Dispersion between repetitions, and of slopes per repetition, at which the fit of a drift starts. By choice."""

_OFFSET_SD = 1.0
"""Prior standard deviation of each person's offset: flat relative to deviations of some per cent."""

_LARGEST_SLOPE_SD = 1.0
"""Largest standard error with which a slope is tested, in log elements per standard deviation of the covariate (per
repetition for a drift): with an error by a factor e the element is undetermined."""

_SPARE_PERSONS = 3
"""Persons required in addition to one per covariate: for the mean, and two degrees of freedom for the variance."""
LARGEST_COVARIATE = 1e150
"""Largest value of a covariate that is not taken as its logarithm: squares and their sums must be finite."""

_COLLINEAR = 0.1
"""Smallest singular value of the standardised covariates, per root of the persons: below, a covariate is a
combination of the others to within 10 %, and their effects cannot be separated."""


@dataclass(frozen=True, kw_only=True)
class Trend:
    """The slope of one element.

    Attributes
    ----------
    element : str
    covariate : str
        ``repetition`` for a drift.
    transform : str
        ``log``: the slope is an exponent. ``linear``: it is the change of the log element per unit of the covariate.
    estimate, q05, q95 : float
        Slope and its 90 % interval.
    statistic : float
        Slope over its standard error.
    degrees_of_freedom : float
        Of Student's t.
    p_value : float
        Two-sided.
    p_corrected : float
        For all elements and covariates that were tried (Holm).
    persons : int
        Number of persons used.
    """

    element: str
    covariate: str
    transform: str
    estimate: float
    q05: float
    q95: float
    statistic: float
    degrees_of_freedom: float
    p_value: float
    p_corrected: float
    persons: int


@dataclass(frozen=True)
class Trends:
    """All slopes that were tested.

    Attributes
    ----------
    trends : tuple of Trend
        Smallest p first.
    tried : int
        How many were tested, for which p is corrected.
    beside : tuple of str
        Covariates in the model in which the others were tested, in the order in which they were found.
    reason : str
        Why nothing was tested; empty if something was.
    remarks : tuple of str
        What was left out, and why.
    """

    trends: tuple[Trend, ...]
    tried: int
    beside: tuple[str, ...] = ()
    reason: str = ""
    remarks: tuple[str, ...] = ()


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
    """

    elements: tuple[str, ...]
    linear: tuple[np.ndarray, ...]
    information: tuple[np.ndarray, ...]
    order: tuple[np.ndarray, ...]

    def __post_init__(self) -> None:
        p = len(self.elements)
        for i, (b, h, order) in enumerate(zip(self.linear, self.information, self.order, strict=True)):
            j = len(order)
            if b.shape != (j, p) or h.shape != (j, p, p) or np.unique(order).size != j:
                raise InputError(
                    f"repetitions of person {i}: {j} numbers, linear {b.shape}, information {h.shape}; give each "
                    f"repetition its own number and {p} elements"
                )

    def stacked(self) -> tuple[PersonLikelihoods, np.ndarray]:
        """Persons with at least two repetitions as likelihoods of U P elements, and the U numbers of repetitions.

        A repetition that a person lacks has no information.
        """
        chosen = [i for i, order in enumerate(self.order) if len(order) > 1]
        numbers = np.unique(np.concatenate([self.order[i] for i in chosen])) if chosen else np.empty(0, dtype=int)
        n, u, p = len(chosen), numbers.size, len(self.elements)
        linear, information = np.zeros((n, u, p)), np.zeros((n, u, p, u, p))
        for k, i in enumerate(chosen):
            rows = np.searchsorted(numbers, self.order[i])
            linear[k, rows] = self.linear[i]
            for row, h in zip(rows, self.information[i], strict=True):
                information[k, row, :, row, :] = h
        names = tuple(f"{e} {j}" for j in numbers for e in self.elements)
        return PersonLikelihoods(names, linear.reshape(n, u * p), information.reshape(n, u * p, u * p)), numbers


def find_covariates(
    likelihoods: PersonLikelihoods, covariates: Mapping[str, np.ndarray], *, alpha: float = ALPHA
) -> Trends:
    """Test every element against every covariate.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
        Of N persons.
    covariates : mapping of str to ndarray, shape (N,)
        NaN where unknown; the person is then left out of that covariate's tests.
    alpha : float
        Corrected p below which a covariate is added to the model in which the others are tested.

    Returns
    -------
    Trends
    """
    n = len(likelihoods)
    for name, values in covariates.items():
        if np.shape(values) != (n,):
            raise InputError(
                f"covariate '{name}' has shape {np.shape(values)}: give one number for each of {n} persons"
            )
    if n < MINIMUM_PERSONS:
        return Trends((), 0, reason=f"only {n} persons; at least {MINIMUM_PERSONS} are needed")
    if not covariates:
        return Trends((), 0, reason="there are no covariates")
    remarks: list[str] = []
    regressors = regressors_of(covariates, remarks)
    centre, null = centred_fit(likelihoods)
    kept = np.flatnonzero(null.determined)
    remarks += [f"{e} is not determined by the recordings" for e in _others(likelihoods.elements, kept)]
    if not regressors or not kept.size:
        return Trends((), 0, reason="no covariate varies, or no element is determined", remarks=tuple(remarks))
    search = _Search(likelihoods.around(centre), null.covariance, regressors, kept)
    beside: list[str] = []
    while True:
        rows = {q: search.slopes([b for b in beside if b != q], q) for q in regressors}
        tried = sum(len(r) for r in rows.values())
        best = {q: min((t.p_value for t in r), default=1.0) for q, r in rows.items() if q not in beside}
        if not best or bonferroni(min(best.values()), tried) > alpha:
            break
        beside.append(min(best, key=lambda q: best[q]))
    remarks += [
        f"covariate '{q}' is known for too few persons, or is determined by the other covariates"
        for q in rows
        if not rows[q]
    ]
    found = [t for r in rows.values() for t in r]
    return Trends(_corrected(found), tried, tuple(beside), "" if found else "no slope is determined", tuple(remarks))


def find_drift(repetitions: RepetitionLikelihoods) -> Trends:
    """Test every element for a common linear trend over the repetitions.

    Parameters
    ----------
    repetitions : RepetitionLikelihoods

    Returns
    -------
    Trends
        Slopes in log change per repetition.
    """
    n = sum(len(order) > 1 for order in repetitions.order)
    if n < MINIMUM_PERSONS:
        return Trends((), 0, reason=f"only {n} persons have repetitions; at least {MINIMUM_PERSONS} are needed")
    fit = fit_normal_population(*drift_model(repetitions))
    kept = np.flatnonzero(np.sqrt(np.diag(fit.variance)) < _LARGEST_SLOPE_SD)
    remarks = tuple(f"{e} is not determined by the repetitions" for e in _others(repetitions.elements, kept))
    found = _trends(fit, {int(e): repetitions.elements[e] for e in kept}, "repetition", "linear", 1.0)
    return Trends(_corrected(found), len(found), (), "" if found else "no element is determined", remarks)


def drift_model(repetitions: RepetitionLikelihoods) -> tuple[PersonLikelihoods, np.ndarray, AdditiveCovariance]:
    """Likelihoods of persons with repetitions, design of a slope for every element, and start values of variances."""
    stacked, numbers = repetitions.stacked()
    n, p = len(stacked), len(repetitions.elements)
    c = numbers - numbers.mean()
    unit = np.eye(p)[:, :, None] * np.eye(p)[:, None, :]
    rho = np.array([np.kron(np.eye(c.size), e) for e in unit])
    omega = np.array([np.kron(np.outer(c, c), e) for e in unit])
    offsets = _OFFSET_SD**2 * np.kron(np.ones((c.size, c.size)), np.eye(p))
    variances = np.repeat([_START_RHO**2, _START_OMEGA**2], p)
    design = np.broadcast_to(np.kron(c[:, None], np.eye(p)), (n, c.size * p, p))
    return stacked, design, AdditiveCovariance(offsets, np.concatenate([rho, omega]), variances)


@dataclass(frozen=True)
class _Search:
    """What all fits of covariates have in common."""

    likelihoods: PersonLikelihoods
    covariance: np.ndarray
    regressors: Mapping[str, tuple[np.ndarray, str]]
    kept: np.ndarray

    def slopes(self, beside: list[str], name: str) -> list[Trend]:
        """Slopes of all elements on one covariate, with others in the model; empty if they cannot be estimated."""
        columns = np.array([self.regressors[q][0] for q in [*beside, name]]).T
        rows = np.all(np.isfinite(columns), axis=1)
        n, k = int(rows.sum()), columns.shape[1]
        if n < max(MINIMUM_PERSONS, k + _SPARE_PERSONS):
            return []
        x = columns[rows]
        sd = x.std(axis=0)
        if not np.all(sd > 0):
            return []
        z = np.hstack([np.ones((n, 1)), (x - x.mean(axis=0)) / sd])
        if np.linalg.svd(z, compute_uv=False)[-1] < _COLLINEAR * np.sqrt(n):
            return []
        p = len(self.likelihoods.elements)
        design = np.einsum("nk,pq->npkq", z, np.eye(p)).reshape(n, p, -1)
        fit = fit_normal_population(self.likelihoods.persons(rows), design, FullCovariance(self.covariance))
        wanted = {k * p + int(e): self.likelihoods.elements[e] for e in self.kept}
        wanted = {c: e for c, e in wanted.items() if fit.variance[c, c] < _LARGEST_SLOPE_SD**2}
        return _trends(fit, wanted, name, self.regressors[name][1], float(sd[-1]))


def regressors_of(covariates: Mapping[str, np.ndarray], remarks: list[str]) -> dict[str, tuple[np.ndarray, str]]:
    """Covariates as they enter the model, with the name of the transform; unusable ones are listed in `remarks`."""
    found = {}
    for name, raw in covariates.items():
        values = np.where(np.isfinite(np.asarray(raw, dtype=float)), raw, np.nan)
        known = values[np.isfinite(values)]
        if known.size < MINIMUM_PERSONS:
            remarks.append(f"covariate '{name}' is known for {known.size} persons only")
        elif np.ptp(known) <= 1e-9 * np.abs(known).max():
            remarks.append(f"covariate '{name}' is the same for everybody")
        elif known.min() > 0 and np.unique(known).size > 2 and not name.lower().endswith(_CELSIUS):
            found[name] = np.log(values), "log"
        elif np.abs(known).max() > LARGEST_COVARIATE:
            remarks.append(f"covariate '{name}' has a value of {known[np.argmax(np.abs(known))]:g}: correct it")
        else:
            found[name] = values, "linear"
        if name in found and known.size < values.size:
            remarks.append(f"covariate '{name}' is unknown for {values.size - known.size} persons, who were left out")
    return found


def _trends(fit: Fit, wanted: Mapping[int, str], covariate: str, transform: str, unit: float) -> list[Trend]:
    """Trends of some coefficients (number: element), with `unit` of the covariate to one of the regressor."""
    from scipy.stats import t as student

    variances, freedom = fit.small_sample()
    found = []
    for c, element in wanted.items():
        sd, df = float(np.sqrt(variances[c])), float(freedom[c])
        statistic = float(fit.coefficients[c]) / sd
        half = float(student.ppf(0.95, df)) * sd / unit
        estimate = float(fit.coefficients[c]) / unit
        p_value = float(2 * student.sf(abs(statistic), df))
        found.append(
            Trend(
                element=element,
                covariate=covariate,
                transform=transform,
                estimate=estimate,
                q05=estimate - half,
                q95=estimate + half,
                statistic=statistic,
                degrees_of_freedom=df,
                p_value=p_value,
                p_corrected=p_value,
                persons=fit.pull.shape[0],
            )
        )
    return found


def _corrected(found: list[Trend]) -> tuple[Trend, ...]:
    from dataclasses import replace

    corrected = holm(np.array([t.p_value for t in found]))
    pairs = [replace(t, p_corrected=float(p)) for t, p in zip(found, corrected, strict=True)]
    return tuple(sorted(pairs, key=lambda t: (t.p_value, -abs(t.statistic))))


def _others(elements: tuple[str, ...], kept: np.ndarray) -> list[str]:
    return [e for k, e in enumerate(elements) if k not in kept]
