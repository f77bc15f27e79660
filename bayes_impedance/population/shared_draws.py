r"""A person's importance draws when parameters that are the same for everybody move.

Draws are made with the shared parameters at an origin :math:`\phi_0`. Elsewhere, at
:math:`\phi(t) = \phi_0 + A t`, with A the factor of an approximate posterior covariance of :math:`\phi`, the person's
posterior has moved, and the person's draws move along, by an affine map :math:`\theta \mapsto \theta'(t)` about the
mode (:mod:`bayes_impedance.population.shears`). Its Jacobian |M| is the same for all of them, so

.. math:: p(z_i\,|\,\phi(t), \mu, T) = \int L_i(\theta', \phi)\,N(\theta'; \mu, T)\,|M_i|\,d\theta
          \approx \frac{|M_i|}{K} \sum_k \frac{L_i(\theta'_k, \phi)}{q_i(\theta_k)}\, N(\theta'_k; \mu, T) :

each draw's log likelihood is a smooth function of t. The path is that of the person's mode, so that the draws stay
where the posterior is, and the log likelihood changes little: everybody's recordings together determine :math:`\phi`
more sharply than one person's. Path and changes are therefore polynomials of low degree. Their coefficients are found
by least squares from exact modes and likelihoods at points within a sphere, and what the polynomials miss is measured
at others. The sphere's radius, the reach, covers nearly all of the posterior. Beyond it a polynomial may grow without
limit: the draws stay at the edge, and the density falls off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
from scipy.special import chdtri

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.importance_draws import Draws, Reference
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import Ridge, marginal_log_likelihood
from bayes_impedance.person.mode import find_mode
from bayes_impedance.population.shared import Pooling, SharedEquations, shared_equations
from bayes_impedance.population.shears import fitted_shears, maps

_COVERED = 0.997
"""Share of the posterior within reach. By choice: three standard deviations for one shared parameter. Polynomials are
not used farther away, where they may grow without limit."""
_DEGREES = {1: 4, 2: 4, 3: 3, 4: 3, 5: 3}
"""Degree of the polynomials for one to five shared parameters; two for more. By choice: four to 55 terms; what is left
out is measured. Measured for the five of a rig (12 persons): of the log likelihood 1.1 with degree two, 0.03 with
three, in twice the time."""
_TESTED, _TESTED_AT = 4, 0.6
"""Number of points at which the polynomial is tested, and their distance in units of the reach. By choice: typical of
the posterior."""
_LINE, _LINE_TESTED = np.array([[-1.0], [-0.62], [0.62], [1.0]]), np.array([[-0.85], [-0.35], [0.35], [0.85]])
"""The same for one shared parameter: with the origin the five nodes of Chebyshev, in units of the reach, through which
a polynomial of degree four passes, and tests where a term of degree five would be missed most."""
_SMOOTH = 1.0
"""Largest distance of a mode from the path, in the person's posterior standard deviations. By choice: the draws are as
wide; a mode that is farther off has jumped to another valley."""
_NEGLIGIBLE, _LEFT_OUT = 12.0, 1e4
"""Logarithms of how much smaller than the average a draw's weight may be, and of what those that are smaller everywhere
are divided by. By choice: populations within the posterior change weights by some units; 12 leaves e^-12 of a draw."""
_HOPELESS = 24.0
"""The same at the origin alone, below which a draw's likelihood is not computed elsewhere. By choice: twice as far.
Measured: a quarter of the draws, none of which had a weight anywhere (71 fingertips with a delay)."""
_RESPONSES = 48
"""Number of a person's draws at which the response is computed. By choice: some five for each of eight elements."""
_REGULAR = 1e-6
"""Share of the reference population's covariance that is added to that of the draws, which few of them may determine.
By choice: a thousandth of its standard deviations."""
_ROUGH = 1.0
"""Largest error of a draw's polynomial. By choice: its weight is then known to a factor e, one of hundreds."""
_EXACT = 1e-3
"""Largest error of a person's log likelihood by polynomials of one degree less, with which those of the full degree
are not tested. By choice: theirs is smaller (5e-8 where these err by 1e-5), and a thousand people err by at most 1."""
_SEED = 1
"""Seed of the directions of the points. By choice: they are the same for all persons and runs."""


@dataclass(frozen=True, kw_only=True)
class Sharing:
    """Where draws are made, and where their likelihoods are computed.

    Attributes
    ----------
    pooling : Pooling
    origin : ndarray, shape (S,)
        The shared parameters of the draws.
    free : tuple of int
        Which S' of them move; the others are held at the origin.
    factor : ndarray, shape (S', S')
        A: lower Cholesky factor of the approximate posterior covariance of those that move.
    points : ndarray, shape (D + T, S')
        Values of t at which likelihoods are computed; the last T test the polynomial.
    kernels : tuple of Kernel
        Of the varying parameters, one for each point.
    """

    pooling: Pooling
    origin: np.ndarray
    free: tuple[int, ...]
    factor: np.ndarray
    points: np.ndarray
    kernels: tuple[Kernel, ...]

    @classmethod
    def around(cls, pooling: Pooling, origin: np.ndarray, covariance: np.ndarray, free: Sequence[int]) -> Sharing:
        """Around an estimate (S,), with the approximate posterior covariance (S', S') of those that move."""
        factor = np.linalg.cholesky(covariance)
        points = _points(len(free))
        kernels = tuple(pooling.at(_at(origin, free, factor @ t)) for t in points)
        return cls(pooling=pooling, origin=origin, free=tuple(free), factor=factor, points=points, kernels=kernels)

    @property
    def kernel(self) -> Kernel:
        """Of the varying parameters, at the origin."""
        return self.pooling.at(self.origin)

    @property
    def reach(self) -> float:
        """Radius in t within which the draws may be moved."""
        return reach_of(len(self.free))

    def responses(self, all_shared: np.ndarray) -> np.ndarray:
        """Derivatives with respect to t, (..., S'), from those with respect to the shared parameters, (..., S)."""
        return np.asarray(all_shared[..., list(self.free)] @ self.factor)

    def standardised(self, phi: np.ndarray) -> np.ndarray:
        """Coordinates t (W, S') of shared parameters (W, S); at the edge for those out of reach."""
        t, distance = self._away(phi)
        return np.asarray(t * np.minimum(1.0, self.reach / np.maximum(distance, self.reach)))

    def beyond(self, phi: np.ndarray) -> np.ndarray:
        """Distance in t of shared parameters (W, S) from the edge of the reach; zero within, (W,)."""
        return np.asarray(np.maximum(self._away(phi)[1][:, 0] - self.reach, 0.0))

    def beyond_slope(self, phi: np.ndarray, factor: float) -> np.ndarray:
        """Derivative of factor times the square of :meth:`beyond`, (W, S)."""
        t, distance = self._away(phi)
        outside = np.maximum(distance - self.reach, 0.0)
        return self.slopes(2 * factor * outside * t / np.maximum(distance, 1e-300))

    def spread(self, mean: np.ndarray, covariance: np.ndarray) -> float:
        """Largest spread in t of parameters with this mean (S',) and covariance (S', S'), about the origin."""
        away = mean - self.origin[list(self.free)]
        whitened = np.linalg.solve(self.factor, np.linalg.solve(self.factor, covariance + np.outer(away, away)).T)
        return float(np.sqrt(np.linalg.eigvalsh(whitened).max()))

    def slopes(self, on_t: np.ndarray) -> np.ndarray:
        """Derivatives with respect to the shared parameters (W, S), from those with respect to t, (W, S')."""
        own = np.zeros((len(on_t), self.origin.size))
        own[:, list(self.free)] = np.linalg.solve(self.factor.T, on_t.T).T
        return own

    def _away(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates t (W, S') and their length (W, 1)."""
        t = np.linalg.solve(self.factor, (phi - self.origin)[:, list(self.free)].T).T
        return t, np.linalg.norm(t, axis=1, keepdims=True)


def _at(origin: np.ndarray, free: Sequence[int], step: np.ndarray) -> np.ndarray:
    """Shared parameters (S,) of which some (S',) have made a step."""
    phi = origin.copy()
    phi[list(free)] += step
    return phi


@dataclass(frozen=True)
class Moved:
    """How one person's draws move with the shared parameters.

    Attributes
    ----------
    path : ndarray, shape (M, V)
        Of the polynomial in t: shift of log elements at the mean of the reference population.
    shears : ndarray, shape (S', V, V)
        How the shift differs elsewhere: that of theta is larger by the sum of t R times its distance from the mean.
    coefficients : ndarray, shape (M, K)
        Of the polynomial in t, for each draw: change of the log likelihood.
    missed : ndarray, shape (T,)
        Error of the person's log likelihood at the test points.
    """

    path: np.ndarray
    shears: np.ndarray
    coefficients: np.ndarray
    missed: np.ndarray


def monomials(t: np.ndarray, less: int = 0) -> np.ndarray:
    """Monomials of degree one and more in t (W, S), shape (W, M); fewer if the highest degree is `less` than usual."""
    size = t.shape[1]
    degree = _DEGREES.get(size, 2) - less
    columns = [
        np.prod(t[:, list(chosen)], axis=1)
        for d in range(1, degree + 1)
        for chosen in combinations_with_replacement(range(size), d)
    ]
    return np.stack(columns, axis=1)


def monomial_slopes(t: np.ndarray) -> np.ndarray:
    """Derivatives of :func:`monomials` with respect to t (W, S), shape (W, M, S)."""
    size = t.shape[1]
    slopes = []
    for d in range(1, _DEGREES.get(size, 2) + 1):
        for chosen in combinations_with_replacement(range(size), d):
            own = np.zeros(t.shape)
            for left_out, s in enumerate(chosen):
                own[:, s] += np.prod(t[:, list(chosen[:left_out] + chosen[left_out + 1 :])], axis=1)
            slopes.append(own)
    return np.stack(slopes, axis=1)


def reach_of(size: int) -> float:
    """Radius in t within which the draws may be moved, for a number of shared parameters."""
    return float(np.sqrt(chdtri(size, 1 - _COVERED)))


def _points(size: int) -> np.ndarray:
    """Points of the fit, on spheres of half and of the whole reach, and points of the test."""
    reach = reach_of(size)
    if size == 1:
        return reach * np.vstack([_LINE, _LINE_TESTED])
    rng = np.random.default_rng(_SEED)
    terms = monomials(np.zeros((1, size))).shape[1]

    def directions(n: int) -> np.ndarray:
        normal = rng.normal(size=(n, size))
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    axes = np.vstack([np.eye(size), -np.eye(size)])
    more = directions(max(terms + terms // 2 - len(axes), 0))
    radius = np.where(np.arange(len(more)) % 2, 1.0, 0.5)[:, None]
    return np.vstack([reach * axes, reach * radius * more, _TESTED_AT * reach * directions(_TESTED)])


def moved(
    sharing: Sharing,
    equations: SharedEquations,
    likelihood: Likelihood,
    ridge: Ridge,
    reference: Reference,
    draws: Draws,
) -> tuple[Draws, Moved]:
    """Move a person's draws; those that have no weight anywhere are left out of the draws that are returned.

    Parameters
    ----------
    sharing : Sharing
    equations : SharedEquations
        With the person's response.
    likelihood : Likelihood
        With the deviations of the repetitions at the origin.
    ridge : Ridge
        At the origin.
    reference : Reference
        The population under which the draws were made.
    draws : Draws
        K of them.
    """
    size = sharing.origin.size
    response, drift = sharing.responses(equations.response[:, :size]), sharing.responses(equations.drift[..., :size])
    fitted = len(sharing.points) - _TESTED
    terms = monomials(sharing.points)
    there = [likelihood.moved(likelihood.deviations + drift @ t) for t in sharing.points]
    path, scale = _path(sharing, likelihood, there, ridge.theta, response, reference)
    shears = _shears(sharing, likelihood, ridge, reference, draws, scale)
    turned = maps(sharing.points, shears)
    hopeful = np.flatnonzero(draws.log_weight >= -np.log(len(draws.theta)) - _HOPELESS)
    theta, away = draws.theta[hopeful], draws.theta[hopeful] - ridge.theta
    at_origin = marginal_log_likelihood(sharing.kernel, likelihood, ridge, theta)
    changes = np.zeros((len(sharing.points), len(draws.theta)))
    # Log weights at each point, without the changes of the likelihood.
    weights = np.tile(draws.log_weight - reference.log_density(draws.theta), (len(changes), 1))

    def compute(rows: range) -> np.ndarray:
        """Fill in the changes at some points; which draws have no weight at any point until there."""
        for row in rows:
            centre = ridge.theta + terms[row] @ path
            along = Ridge(centre, ridge.slope, ridge.rho, ridge.precision)
            moved_theta = centre + away @ turned[row].T
            moved_there = marginal_log_likelihood(sharing.kernels[row], there[row], along, moved_theta)
            changes[row, hopeful] = moved_there - at_origin
            weights[row] += reference.log_density(centre + (draws.theta - ridge.theta) @ turned[row].T)
        # Draws that have no weight anywhere within reach are left out: their likelihoods, far from the recordings,
        # change by more than a polynomial can follow, which might give them a weight.
        every = np.vstack([draws.log_weight, weights[: rows.stop] + changes[: rows.stop]])
        every -= np.logaddexp.reduce(every, axis=1, keepdims=True)
        none = ~(every.max(axis=0) >= -np.log(len(draws.theta)) - _NEGLIGIBLE)
        changes[: rows.stop, none] = 0.0
        return np.asarray(none)

    without = compute(range(fitted))
    # What polynomials of one degree less miss at these points bounds what these miss between them.
    lower = terms[:, : monomials(sharing.points[:1], 1).shape[1]]
    fit = lower[:fitted] @ np.linalg.lstsq(lower[:fitted], changes[:fitted], rcond=None)[0]
    missed = _missed(weights[:fitted], changes[:fitted], fit)
    smooth = np.abs(fit - changes[:fitted]).max() < _ROUGH and np.abs(missed).max() < _EXACT
    if not smooth:
        without = compute(range(fitted, len(sharing.points))) & without
    coefficients = np.linalg.lstsq(terms[:fitted], changes[:fitted], rcond=None)[0]
    path[: len(shears)] += (reference.mean - ridge.theta) @ shears.swapaxes(1, 2)  # from the mode to the mean
    if smooth:
        draws = replace(draws, log_ratio=draws.log_ratio - _LEFT_OUT * without)
        return draws, Moved(path, shears, coefficients, missed[:_TESTED])
    # Elsewhere in a second valley a likelihood may turn sharply. Such draws get the smallest value that they have.
    rough = ~without & ~(np.abs(terms @ coefficients - changes).max(axis=0) < _ROUGH)
    coefficients[:, rough] = 0.0
    lowest = np.minimum(changes.min(axis=0), 0.0)
    predicted = terms[fitted:] @ coefficients - _LEFT_OUT * without + np.where(rough, lowest, 0.0)
    missed = _missed(weights[fitted:], changes[fitted:], predicted)
    draws = replace(draws, log_ratio=draws.log_ratio - _LEFT_OUT * without + np.where(rough, lowest, 0.0))
    return draws, Moved(path, shears, coefficients, missed)


def _shears(
    sharing: Sharing, likelihood: Likelihood, ridge: Ridge, reference: Reference, draws: Draws, scale: float
) -> np.ndarray:
    """The person's shears (S', V, V)."""
    precision, size = np.linalg.inv(reference.covariance), sharing.origin.size
    # Draws of little weight too, which have more of it elsewhere: as chosen with the root of their weights.
    chance = np.exp(0.5 * (draws.log_weight - draws.log_weight.max()))
    ticks = (np.arange(_RESPONSES) + 0.5) / _RESPONSES * chance.sum()
    some = np.unique(np.searchsorted(np.cumsum(chance), ticks).clip(0, len(chance) - 1))
    responses = [
        shared_equations(
            sharing.pooling,
            sharing.origin,
            precision,
            ridge.rho,
            likelihood,
            draws.theta[k],
            scale,
            likelihood.deviations + ridge.slope @ (draws.theta[k] - ridge.theta),
        ).response[:, :size]
        for k in some
    ]
    covariance = np.cov(draws.theta.T, aweights=np.exp(draws.log_weight - draws.log_weight.max()), ddof=0)
    covariance = np.atleast_2d(covariance) + _REGULAR * reference.covariance
    return fitted_shears(draws.theta[some], sharing.responses(np.array(responses)), covariance, sharing.reach)


def _missed(log_weight: np.ndarray, exact: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Error (T,) of a person's log likelihood, for log weights and changes (T, K) of the draws' log likelihoods."""
    return np.asarray(
        np.logaddexp.reduce(log_weight + exact, axis=1) - np.logaddexp.reduce(log_weight + predicted, axis=1)
    )


def _path(
    sharing: Sharing,
    likelihood: Likelihood,
    there: Sequence[Likelihood],
    theta: np.ndarray,
    response: np.ndarray,
    reference: Reference,
) -> tuple[np.ndarray, float]:
    """Coefficients (M, V) of the path of the person's mode, or straight where that leaves its valley; noise scale."""
    fitted = len(sharing.points) - _TESTED
    terms = monomials(sharing.points)
    mean, precision = reference.mean, np.linalg.inv(reference.covariance)
    origin = find_mode(sharing.kernel, likelihood, theta[None], mean, precision)
    straight = sharing.points @ response.T
    modes = [
        find_mode(kernel, own, (origin.theta + step)[None], mean, precision).theta
        for kernel, own, step in zip(sharing.kernels, there, straight, strict=True)
    ]
    offsets = np.array(modes) - origin.theta
    path = np.asarray(np.linalg.lstsq(terms[:fitted], offsets[:fitted], rcond=None)[0])
    rest = offsets - terms @ path
    if np.einsum("np,pq,nq->n", rest, origin.precision, rest).max() < _SMOOTH**2:
        return path, origin.scale
    return np.vstack([response.T, np.zeros((len(path) - len(response.T), len(theta)))]), origin.scale


def stacked(all_moved: Sequence[Moved]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Paths (n, M, V) and shears (n, S', V, V) of some persons, and the sum of what their polynomials miss, (T,)."""
    missed = np.array([m.missed for m in all_moved]).sum(axis=0)
    return np.array([m.path for m in all_moved]), np.array([m.shears for m in all_moved]), np.asarray(missed)
