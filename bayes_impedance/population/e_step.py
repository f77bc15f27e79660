r"""The E step: each person's fit under a population, and the sums over persons that the M step needs.

Under the current population the posterior of person i is taken as :math:`N(m_i, C_i)` with
:math:`C_i = (H_i + T^{-1})^{-1}`, and the deviations of the repetitions are at their conditional mode. A fit stays in
the process that computed it (:class:`~bayes_impedance.runtime.sharded.Kept`). Each batch of persons returns only sums,
whose size does not depend on the number of persons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bounded_search import GROSS, bounded_search
from bayes_impedance.person.likelihood import Likelihood, repetition_equations
from bayes_impedance.person.mode import Mode, find_mode
from bayes_impedance.person.noise import contrasts
from bayes_impedance.person.small_matrices import ROUNDING, inverse
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.shared import Placed


@dataclass(frozen=True)
class PersonFit:
    """Fit of one person under a population.

    Attributes
    ----------
    mode : Mode
    deviations : ndarray, shape (J, P)
        Of the repetitions, at their conditional mode.
    expanded : ndarray, shape (J, P)
        Deviations at which the mode, the gradient and the information were computed.
    gradient : ndarray, shape (J, P)
        J^T W r of every repetition.
    information : ndarray, shape (J, P, P)
        J^T W J of every repetition.
    """

    mode: Mode
    deviations: np.ndarray
    expanded: np.ndarray
    gradient: np.ndarray
    information: np.ndarray

    @classmethod
    def between_iterations(cls, mode: Mode, deviations: np.ndarray, expanded: np.ndarray) -> PersonFit:
        """A fit from which the next iteration begins: what that computes anew is empty."""
        nothing = np.empty(0)
        return cls(mode=mode, deviations=deviations, expanded=expanded, gradient=nothing, information=nothing)

    @property
    def theta(self) -> np.ndarray:
        """Log elements at the mode, shape (P,)."""
        return self.mode.theta


def begin(likelihood: Likelihood, theta: np.ndarray) -> Placed:
    """Starting point of a person who has not been fitted yet; the deviations are those of the likelihood."""
    return Placed(theta, likelihood.deviations)


def expect(
    kernel: Kernel,
    precision: np.ndarray,
    rho: np.ndarray,
    likelihood: Likelihood,
    before: Placed | PersonFit,
    mean: np.ndarray,
    starts: np.ndarray,
) -> PersonFit:
    """One person's fit under a population.

    Parameters
    ----------
    kernel : Kernel
    precision : ndarray, shape (P, P)
        Inverse covariance of the population.
    rho : ndarray, shape (P,)
        The population's dispersion between repetitions.
    likelihood : Likelihood
    before : Placed or PersonFit
        First starting point, and the initial deviations.
    mean : ndarray, shape (P,)
        Population mean for this person's covariates.
    starts : ndarray, shape (S, P)
        Further starting points.
    """
    likelihood = likelihood.moved(before.deviations)
    mode = find_mode(kernel, likelihood, np.concatenate([before.theta[None], starts]), mean, precision)
    if len(starts) and mode.scale > GROSS:
        nearer, before_it = bounded_search(kernel, likelihood, starts, mean, precision), mode.apart
        mode = find_mode(kernel, likelihood, np.concatenate([mode.theta[None], nearer]), mean, precision)
        mode = replace(mode, apart=max(mode.apart, before_it))
    gradient, information = repetition_equations(kernel, likelihood, mode.theta)
    deviations = _realigned(likelihood, mode, gradient, information, rho)
    return PersonFit(mode, deviations, likelihood.deviations, gradient, information)


def expect_weighted(
    kernel: Kernel,
    precision: np.ndarray,
    rho: np.ndarray,
    likelihood: Likelihood,
    before: Placed | PersonFit,
    mean: np.ndarray,
    starts: np.ndarray,
    weight: float,
) -> PersonFit:
    """As :func:`expect`, under a population whose precision is multiplied by the person's weight."""
    return expect(kernel, weight * precision, rho, likelihood, before, mean, starts)


def _realigned(
    likelihood: Likelihood, mode: Mode, gradient: np.ndarray, information: np.ndarray, rho: np.ndarray
) -> np.ndarray:
    """Deviations at their conditional mode, by one Gauss-Newton step with a Lagrange multiplier for their sum."""
    n_repetitions = likelihood.z.shape[0]
    if n_repetitions == 1:
        return likelihood.deviations
    w = mode.scale**-2
    curvature = w * information + np.diag(1 / np.maximum(rho, 1e-3) ** 2)
    curvature += ROUNDING * np.eye(rho.size) * curvature
    inverses = inverse(curvature)
    pull = -w * gradient - likelihood.deviations / np.maximum(rho, 1e-3) ** 2
    free = np.einsum("jpq,jq->jp", inverses, pull)
    multiplier = -np.linalg.solve(inverses.sum(axis=0), (likelihood.deviations + free).sum(axis=0))
    step = free + inverses @ multiplier
    longest = np.abs(step).max()
    if longest > 0.5:
        step = step * (0.5 / longest)
    return np.ascontiguousarray(likelihood.deviations + step)


def contrasts_of(fits: Sequence[PersonFit]) -> dict[int, Contrasts]:
    """Curvature and gradient of the contrasts at zero deviation, by number of repetitions, ascending."""
    repetitions = np.array([len(f.deviations) for f in fits])
    found = {}
    for j in np.unique(repetitions[repetitions > 1]):
        rows, group = contrasts(int(j)), [f for f in fits if len(f.deviations) == j]
        w = np.array([f.mode.scale**-2 for f in group])
        g, h = np.array([f.gradient for f in group]), np.array([f.information for f in group])
        expanded = np.array([f.expanded for f in group])
        size = rows.shape[0] * h.shape[-1]
        # Each repetition keeps its own curvature. With equal curvatures the contrasts would be independent, but using
        # the mean curvature for all makes the dispersion of weakly determined elements 3 % too small.
        pairs = np.einsum("cj,dj->cdj", rows, rows)
        information = np.einsum("n,cdj,njpq->cpdqn", w, pairs, h).reshape(size, size, -1)
        pull = np.einsum("njpq,njq->njp", h, expanded) - g
        gradient = np.einsum("n,cj,njp->cpn", w, rows, pull).reshape(size, -1)
        found[int(j)] = Contrasts(np.ascontiguousarray(information), np.ascontiguousarray(gradient))
    return found


@dataclass(frozen=True)
class Sums:
    """Sums over some persons that the M step needs.

    Attributes
    ----------
    design : ndarray, shape (1 + Q, 1 + Q)
        X^T X of the regression, where X holds a column of ones and the covariates.
    target : ndarray, shape (P, 1 + Q)
        Products of the log elements, relative to the prior's centre, with the columns of X.
    uncertainty : ndarray, shape (P, P)
        Sum of the persons' posterior covariances C.
    squares : dict
        By number of repetitions: expected sum of squares of the contrasts, shape (P,), and the number of contrasts.
    """

    design: np.ndarray
    target: np.ndarray
    uncertainty: np.ndarray
    squares: dict[int, tuple[np.ndarray, int]]


def sums(
    fits: Sequence[PersonFit],
    covariates: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    centre: np.ndarray,
    rho: np.ndarray,
) -> Sums:
    """Sums over persons, weighted (n,) if weights are given.

    The fits were computed with the dispersion rho (P,) between repetitions.
    """
    theta, design = _stacked(fits), np.hstack([np.ones((len(fits), 1)), covariates])
    own = inverse(np.array([f.mode.precision for f in fits]))
    counted = design
    if weights is not None:
        counted, own = weights[:, None] * design, weights[:, None, None] * own
    target = np.array([counted.T @ (theta[:, e] - centre[e]) for e in range(centre.size)])
    uncertainty = own.sum(axis=0)
    inverse_square = 1 / np.maximum(rho, 1e-3) ** 2
    squares = {}
    for j, group in contrasts_of(fits).items():
        size, n = group.gradient.shape
        precision = np.moveaxis(group.information, -1, 0) + np.diag(np.tile(inverse_square, j - 1))
        posterior = inverse(precision)
        mean = np.einsum("npq,qn->np", posterior, group.gradient)
        square = mean**2 + np.diagonal(posterior, axis1=1, axis2=2)
        squares[j] = square.reshape(n, -1, rho.size).sum(axis=(0, 1)), n * size // rho.size
    return Sums(counted.T @ design, target, uncertainty, squares)


def spread(fits: Sequence[PersonFit], means: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Sum of outer products of the persons' deviations from their population means (n, P), weighted (n,): (P, P)."""
    offset = _stacked(fits) - means
    return np.asarray((offset if weights is None else weights[:, None] * offset).T @ offset)


def squared_distances(fits: Sequence[PersonFit], means: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Expected squared distances of persons from their population means (n, P), for a population's precision: (n,)."""
    offset = _stacked(fits) - means
    uncertain = np.einsum("pq,nqp->n", precision, inverse(np.array([f.mode.precision for f in fits])))
    return np.asarray(np.einsum("np,pq,nq->n", offset, precision, offset) + uncertain)


def evidence(fits: Sequence[PersonFit], rho: np.ndarray) -> float:
    """Laplace approximation of the persons' log marginal likelihood, without the population's determinant."""
    objective = sum(f.mode.objective for f in fits)
    determinants = np.linalg.slogdet([f.mode.precision for f in fits])[1].sum()
    of_contrasts = sum(float(group.log_likelihood(rho[None])[0]) for group in contrasts_of(fits).values())
    # The contrasts' likelihood is relative to deviations of zero, the objective is that of the deviations it is at.
    return float(of_contrasts - sum(map(_gain_of_deviations, fits)) - objective - 0.5 * determinants)


def _gain_of_deviations(fit: PersonFit) -> float:
    """Log likelihood at a person's deviations less that without any, by the expansion that the contrasts use."""
    pull = np.einsum("jpq,jq->jp", fit.information, fit.expanded) / 2 - fit.gradient
    return float(fit.mode.scale**-2 * np.sum(pull * fit.expanded))


def information_of_means(fits: Sequence[PersonFit], precision: np.ndarray, begun: np.ndarray) -> np.ndarray:
    """Information (P, P) on the population mean, given the population's precision (P, P), added to `begun` (P, P)."""
    inverses = inverse(np.array([f.mode.information for f in fits]) + precision)
    return np.asarray(np.concatenate([begun[None], precision - precision @ inverses @ precision]).sum(axis=0))


def information_of_elements(fits: Sequence[PersonFit], precision: np.ndarray) -> np.ndarray:
    """Information of the recordings alone on each log element, the others free within the population, shape (P,)."""
    return information_on_each(np.array([f.mode.information for f in fits]), precision)


def information_on_each(h: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Information on each log element, summed over persons, the others free within the population.

    Parameters
    ----------
    h : ndarray, shape (N, P, P)
        Information of each person's recordings.
    precision : ndarray, shape (P, P)
        Of the population.

    Returns
    -------
    ndarray, shape (P,)
    """
    result = np.empty(len(precision))
    for p in range(result.size):
        others = np.arange(result.size) != p
        rest = h[:, others][:, :, others] + precision[np.ix_(others, others)]
        column = h[:, others, p]
        left = np.linalg.solve(rest, column[..., None])[..., 0]
        result[p] = np.sum(h[:, p, p] - np.einsum("nq,nq->n", column, left))
    return result


def standard_errors(information: np.ndarray) -> np.ndarray:
    """Standard errors (P,) from information (P,); infinite without information, of which rounding can leave a trace."""
    return np.array([total**-0.5 if total > 0 else np.inf for total in information])


def _stacked(fits: Sequence[PersonFit]) -> np.ndarray:
    return np.array([f.theta for f in fits])
