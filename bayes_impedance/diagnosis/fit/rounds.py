r"""Linear algebra of one round of a fit (:mod:`.fitter`, whose names these are).

For every recording A and for every person K, from the information of the recordings and a population; and the M step of
expectation-maximisation, which makes of them the population of the elements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.normal_equations import Equations, Population, sums, weights_of
from bayes_impedance.diagnosis.fit.second_order import SecondOrder
from bayes_impedance.person.likelihood import SCALE_SHAPE
from bayes_impedance.person.small_matrices import ROUNDING, inverse
from bayes_impedance.population.em_state import PRIOR_PERSONS, SMALLEST_DISPERSION

_SHARE = 1e-5
"""Dispersion of an addition's parameter between repetitions, in its dispersions between people. There is none, but the
algebra needs one, and no recording may see it: with 0.03, each of 60 recordings that determined a damping twice as
precisely as that counted as the choice of another one, and 54 units of log evidence were lost against a rival with
which none was. Between 1e-4 and 1e-6 evidence stays the same."""


_LONGEST = 2.0
"""Longest step of a parameter: a factor of seven of an element. By choice."""

_GOOD, _POOR = 0.75, 0.25
"""Shares of the promised fall above which a step is damped less, and below which it is damped more. By choice."""

_LESS, _MORE = 3.0, 10.0
"""Factors of the damping after a good step and after a poor one, and after one that did not descend. By choice: in 78
fits of seven cases 3 and 5, and 4, 10 and 20, differed by less than which of a person's optima is met by chance."""

DAMPING, _LEAST, _MOST = 1e-3, 1e-9, 1e6
"""Of a person's first step and after one that did not descend, at least; the smallest and the largest one. Relative to
the curvature, by choice."""

_LEAST_RHO = 1e-4
"""Least dispersion of an element between repetitions. By choice: well below the standard error of one recording, beyond
which a smaller one makes no difference. A mass that is the same in all repetitions, and known to 4e-4 from one, cost 41
units of log evidence with 1e-3; an addition, which has none, took its place, and a wrong pair of effects was ahead of
the right one."""


@dataclass(frozen=True)
class Blocks:
    """Linear algebra of one round; names as in the docstring of :mod:`.fitter`."""

    inverse: np.ndarray  # A^-1, (M, V, V)
    pull: np.ndarray  # b, (M, V)
    precision: np.ndarray  # K, (N, V, V)

    def log_determinants(self, owner: np.ndarray, model: Model, population: Population) -> np.ndarray:
        """Sum of ln|A R| over a person's recordings and ln|K T|, shape (N,)."""
        log_a = -np.linalg.slogdet(self.inverse)[1] + 2 * np.sum(np.log(rho_of(model, population)))
        outer = np.linalg.slogdet(self.precision)[1] + np.linalg.slogdet(population.covariance)[1]
        return np.asarray(np.bincount(owner, log_a, minlength=len(self.precision)) + outer)


@dataclass(frozen=True)
class Layout:
    """Which recordings belong to whom.

    Attributes
    ----------
    owner : ndarray, shape (M,)
        Person of every recording.
    counts : ndarray, shape (N,)
        Number of each person's complex values.
    many : ndarray of bool, shape (M,)
        Whether the recording's person was recorded more than once.
    """

    owner: np.ndarray
    counts: np.ndarray
    many: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is fitted, and what is held; see :meth:`Refitter.fit`."""

    model: Model
    hold_population: bool
    hold_additions: bool
    tolerance: float


@dataclass(frozen=True, kw_only=True)
class State:
    """Where a fit is: parameters, persons, population, equations there, each person's damping, and S of the steps."""

    u: np.ndarray
    persons: np.ndarray
    population: Population
    equations: Equations
    damping: np.ndarray
    second_order: SecondOrder
    settled: bool = False


def rho_of(model: Model, population: Population) -> np.ndarray:
    """Standard deviations between repetitions, none of them zero; an addition is the same in all of a person's."""
    rho, n = np.maximum(population.rho, _LEAST_RHO), model.n_elements
    rho[n:] = _SHARE * np.sqrt(np.diag(population.covariance)[n:])
    return np.asarray(rho)


def blocks_of(
    layout: Layout,
    model: Model,
    equations: Equations,
    u: np.ndarray,
    persons: np.ndarray,
    population: Population,
    damping: np.ndarray,
    second_order: SecondOrder | None = None,
) -> Blocks:
    """From equations at u (M, P), everybody's v (N, V), the damping of each person's step (N,), and their curvature."""
    owner, n = layout.owner, layout.counts.size
    varying = ~model.shared
    w = weights_of(owner, layout.counts, equations.chi)[owner]
    h = w[:, None, None] * equations.information[:, varying][:, :, varying]
    r = rho_of(model, population) ** -2.0
    diagonal = np.einsum("mpp->mp", h).copy()
    h[:, np.arange(r.size), np.arange(r.size)] += (damping[owner, None] + ROUNDING) * diagonal
    if second_order is not None:
        h += second_order.beside(h + np.diag(r), owner, w, varying)
    inverses = inverse(h + np.diag(r))
    pull = -w[:, None] * equations.gradient[:, varying] - r * (u[:, varying] - persons[owner])
    kept = r[:, None] * inverses @ h  # R - R A^-1 R, without the difference of large numbers
    precision = np.linalg.inv(population.covariance) + sums(0.5 * (kept + np.swapaxes(kept, 1, 2)), owner, n)
    return Blocks(inverses, pull, precision)


@dataclass(frozen=True)
class PersonSteps:
    """Steps of some people, by :func:`person_steps`.

    Attributes
    ----------
    u : ndarray, shape (M', V)
        Of their recordings.
    v : ndarray, shape (N', V)
        Of the people.
    promised : ndarray, shape (N',)
        By how much the expansion says that the objective falls.
    length : ndarray, shape (N',)
        Of the step to the expansion's minimum, in standard deviations: the root of twice of what it promises. That
        counts the recordings as well, which move around a person's mean that stays.
    """

    u: np.ndarray
    v: np.ndarray
    promised: np.ndarray
    length: np.ndarray


def person_steps(layout: Layout, model: Model, state: State, people: np.ndarray) -> PersonSteps:
    r"""Damped Gauss-Newton steps of some people (bool, (N,)), none longer than :data:`_LONGEST`.

    With b the pull on a recording, :math:`\delta_{ij} = A_{ij}^{-1}(b_{ij} + R^{-1}\delta_i)` where
    :math:`K_i\delta_i = \sum_j R^{-1}(u_{ij} - v_i + A_{ij}^{-1}b_{ij}) - T^{-1}(v_i - \mu)`.
    """
    rows, n = people[layout.owner], int(people.sum())
    owner = (np.cumsum(people) - 1)[layout.owner[rows]]
    part = Layout(owner, layout.counts[people], layout.many[rows])
    equations, second_order = state.equations.only(rows), state.second_order.only(rows, people)
    u, persons, population = state.u[rows], state.persons[people], state.population
    blocks = blocks_of(part, model, equations, u, persons, population, state.damping[people], second_order)
    r = rho_of(model, population) ** -2.0
    apart = r * (u[:, ~model.shared] - persons[owner])
    between = np.linalg.solve(population.covariance, (persons - population.mu).T).T
    alone = np.einsum("mpq,mq->mp", blocks.inverse, blocks.pull)
    right = sums(apart + r * alone, owner, n) - between
    step_v = np.linalg.solve(blocks.precision, right[..., None])[..., 0]
    step_u = alone + np.einsum("mpq,mq->mp", blocks.inverse, r * step_v[owner])
    on_recordings = np.bincount(owner, np.sum(blocks.pull * step_u, axis=1), minlength=n)
    slope = on_recordings + np.sum((sums(apart, owner, n) - between) * step_v, axis=1)
    share = np.minimum(1.0, _LONGEST / np.maximum(largest_of(np.abs(step_u).max(axis=1), owner, n), 1e-12))
    return PersonSteps(
        u=share[owner, None] * step_u,
        v=share[:, None] * step_v,
        promised=share * (1 - 0.5 * share) * slope,
        length=np.sqrt(np.maximum(slope, 0.0)),
    )


def damped_anew(damping: np.ndarray, fall: np.ndarray, promised: np.ndarray, worse: np.ndarray) -> np.ndarray:
    """Damping of each person's next step, by how much of what was promised the last one brought; all of shape (K,).

    It grows where the objective did not fall, and where it fell by much less than promised; it shrinks where the
    expansion is good (Marquardt 1963, J. Soc. Indust. Appl. Math. 11, 431).
    """
    good, poor = fall > _GOOD * promised, fall < _POOR * promised
    follows = np.where(good, damping / _LESS, np.where(poor, damping * _LESS, damping))
    return np.asarray(np.clip(np.where(worse, np.maximum(_MORE * damping, DAMPING), follows), _LEAST, _MOST))


def maximised(
    layout: Layout, model: Model, v: np.ndarray, persons: np.ndarray, blocks: Blocks, population: Population
) -> tuple[Population, float]:
    """One M step from v (M, V), and the change of the population in standard deviations.

    No prior keeps dispersions between repetitions from zero. Where two recordings' worth of 5 % did, elements that do
    not change cost the right explanation of 29 people 340 units of log evidence, and a second path in place of one of
    them was ahead of it.
    """
    n, size = persons.shape
    posterior = np.linalg.inv(blocks.precision)
    elements = np.arange(size) < model.n_elements
    mu = np.where(elements, persons.mean(axis=0), population.mu)
    offset = persons - mu
    variance = np.clip(np.diag(population.covariance), SMALLEST_DISPERSION**2, 1.0)
    covariance = (offset.T @ offset + posterior.sum(axis=0) + PRIOR_PERSONS * np.diag(variance)) / (n + PRIOR_PERSONS)
    floor = np.maximum(np.diag(covariance), SMALLEST_DISPERSION**2)
    covariance = covariance + np.diag(floor - np.diag(covariance))
    if n < size + 2:  # a full sample covariance would be singular
        covariance = np.diag(floor)
    covariance[~elements] = population.covariance[~elements]
    covariance[:, ~elements] = population.covariance[:, ~elements]
    rho = population.rho
    if layout.many.any():
        r = rho_of(model, population) ** -2.0
        follow = blocks.inverse * r - np.eye(size)
        spread = blocks.inverse + follow @ posterior[layout.owner] @ np.swapaxes(follow, 1, 2)
        square = (v - persons[layout.owner]) ** 2 + np.einsum("mpp->mp", spread)
        many = layout.many
        rho = np.sqrt(square[many].sum(axis=0) / many.sum())
        rho = np.where(elements, np.clip(rho, _LEAST_RHO, 1.0), _LEAST_RHO)
    sd = np.sqrt(np.diag(population.covariance) / n)
    shift = np.abs(mu - population.mu) / sd
    stretch = np.abs(np.log(np.diag(covariance) / np.diag(population.covariance))) * 0.5
    return Population(mu, covariance, rho), float(max(shift.max(), stretch.max()))


def log_misfit(layout: Layout, chi: np.ndarray) -> np.ndarray:
    """Negative log likelihood of each person from the recordings' chi-squares, shape (N,)."""
    total = np.bincount(layout.owner, chi, minlength=layout.counts.size)
    return np.asarray((SCALE_SHAPE + layout.counts) * np.log(SCALE_SHAPE + 0.5 * total))


def objective(
    layout: Layout, model: Model, chi: np.ndarray, v: np.ndarray, persons: np.ndarray, population: Population
) -> np.ndarray:
    """Negative log posterior of each person, shape (N,)."""
    delta = (v - persons[layout.owner]) / rho_of(model, population)
    within = 0.5 * np.bincount(layout.owner, np.sum(delta**2, axis=1), minlength=layout.counts.size)
    offset = persons - population.mu
    between = 0.5 * np.sum(offset * np.linalg.solve(population.covariance, offset.T).T, axis=1)
    return np.asarray(log_misfit(layout, chi) + within + between)


def means_of(values: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """Mean over the recordings of each person: (M, ...) to (N, ...)."""
    return np.asarray(sums(values, owner, n) / np.bincount(owner, minlength=n)[:, None])


def largest_of(values: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """Largest of the recordings of each person, and at least zero: (M,) to (N,)."""
    largest = np.zeros(n)
    np.maximum.at(largest, owner, values)
    return largest
