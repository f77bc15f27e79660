r"""A proposal for curved posteriors: a multivariate t along a surface of degree two.

Where the recordings determine some combinations of elements precisely and others hardly, a person's posterior is thin
and bent: its mean in the determined directions depends on where it is along the others, and already a bend of a few
per cent of its length is several times its width. A t around its mean then covers it only if it is as thick as the bend
is high, and most of its draws count for nothing. From weighted draws, such as those of earlier rounds, follow their
mean m and covariance C. With R the covariance of the reference population the axes are

.. math:: C a_j = \lambda_j R a_j, \qquad v_j = a_j^T (\theta - m) / \sqrt{\lambda_j}, \qquad
          \lambda_1 \ge \lambda_2 \ge \dots ,

so that the first ones are the least determined, relative to how far people differ. The others are regressed on products
of the first ones, :math:`v_j = \sum_{a \ge b} \beta_{jab} (v_a v_b - \delta_{ab}) + r_j`, and r follows a t. The map
from r to :math:`\theta` is triangular with ones on its diagonal, so that its Jacobian is constant and the density has a
closed form: it is the quadratic case of a transport map (Marzouk, Moselhy, Parno and Spantini 2016,
arXiv:1602.05023). It bends along several directions at once, for as far as one parabola holds; longer valleys are
followed step by step (:mod:`bayes_impedance.person.valley`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.special import gammaincinv, gammaln, ndtri

from bayes_impedance.person.shifted_sobol import uniform_points

DEGREES_OF_FREEDOM = 10.0
"""Degrees of freedom of the t. By choice: tails clearly heavier than a normal target's at little loss of effective
draws."""

_LONG = 3
"""Directions along which the posterior may be bent. Measured (71 virtual fingertips from 20 to 800 Hz, eight elements,
512 draws, median of twelve people): 125 effective draws of a t, 157 with two directions, 229 with three; cubic terms in
the longest one added nothing."""

_UNCERTAIN = 3.0
"""Part of a coefficient's variance, in units of one over the effective draws, that is added to the diagonal of the
regression. By choice: coefficients smaller than 1.7 of their standard errors count by less than half."""

_LEAST = 1e-12
"""Least variance along an axis relative to the largest: rounding of an inverse must not make it negative."""


@dataclass(frozen=True, kw_only=True)
class BentT:
    """A t along a surface of degree two.

    Attributes
    ----------
    centre : ndarray, shape (P,)
        Mean of log elements.
    axes, into : ndarray, shape (P, P)
        From v to differences from the centre, and back.
    bend : ndarray, shape (m, P)
        Coefficients of the products; zero for the directions of which they are products.
    middle, factor : ndarray, shape (P,) and (P, P)
        Location of the t of r, and triangular factor of its scale matrix.
    """

    centre: np.ndarray
    axes: np.ndarray
    into: np.ndarray
    bend: np.ndarray
    middle: np.ndarray
    factor: np.ndarray

    @classmethod
    def straight(cls, centre: np.ndarray, covariance: np.ndarray) -> BentT:
        """A t around a centre (P,) with a scale matrix (P, P)."""
        n = centre.size
        return cls(
            centre=centre,
            axes=np.eye(n),
            into=np.eye(n),
            bend=np.empty((0, n)),
            middle=np.zeros(n),
            factor=np.linalg.cholesky(covariance),
        )

    @classmethod
    def fitted(
        cls, theta: np.ndarray, log_weight: np.ndarray, reference: np.ndarray, least: np.ndarray, bent: bool
    ) -> BentT:
        """Fitted to weighted draws.

        Parameters
        ----------
        theta : ndarray, shape (K, P)
        log_weight : ndarray, shape (K,)
            Normalised to sum to one.
        reference : ndarray, shape (P, P)
            Covariance of the reference population.
        least : ndarray, shape (P, P)
            Added to the covariance: few draws may lie in a plane.
        bent : bool
            Or straight.
        """
        weight = np.exp(log_weight)
        centre = weight @ theta
        offset = theta - centre
        covariance = (offset * weight[:, None]).T @ offset + least
        if not bent or centre.size < 2:
            return cls.straight(centre, covariance)
        axes, into = axes_of(covariance, reference)
        v, long = offset @ into.T, long_directions(centre.size)
        products = _products(v, long)
        weighted = products * weight[:, None]
        moments = weighted.T @ products
        moments += np.diag(_UNCERTAIN * np.sum(weight**2) * np.diag(moments))
        bend = np.linalg.solve(moments, weighted.T @ v)
        bend[:, :long] = 0
        rest = v - products @ bend
        middle = weight @ rest
        rest -= middle
        spread = (rest * weight[:, None]).T @ rest + into @ least @ into.T
        factor = np.linalg.cholesky(spread)
        return cls(centre=centre, axes=axes, into=into, bend=bend, middle=middle, factor=factor)

    def drawn(self, n: int, seed: np.random.SeedSequence) -> np.ndarray:
        """Log elements (n, P) of evenly spread draws."""
        uniform = uniform_points(n, self.centre.size + 1, seed)
        return self.points(ndtri(uniform[:, :-1]) * stretched(uniform[:, -1])[:, None])

    def points(self, t: np.ndarray) -> np.ndarray:
        """Log elements (n, P) of draws of a standard t (n, P)."""
        rest = self.middle + t @ self.factor.T
        return np.asarray(self.centre + (rest + self._bent(rest)) @ self.axes.T)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Log density at log elements (n, P), shape (n,)."""
        v = (theta - self.centre) @ self.into.T
        own = log_t(v - self._bent(v), self.middle, self.factor)
        return np.asarray(own - np.linalg.slogdet(self.axes)[1])

    def _bent(self, v: np.ndarray) -> np.ndarray:
        """How far the surface is from the plane; of `v` or `rest`, which agree in the directions that count."""
        if not len(self.bend):
            return np.zeros_like(v)
        return np.asarray(_products(v, long_directions(v.shape[1])) @ self.bend)


def stretched(uniform: np.ndarray) -> np.ndarray:
    """Factors (n,) by which normal draws become draws of a t, from points (n,) between zero and one."""
    return np.asarray(np.sqrt(DEGREES_OF_FREEDOM / (2 * gammaincinv(DEGREES_OF_FREEDOM / 2, uniform))))


def axes_of(covariance: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (P, P) from v to differences of log elements, and back, for two covariances (P, P); the longest comes first.

    Longest relative to the reference population.
    """
    variances, vectors = eigh(covariance, reference)
    variances, vectors = np.maximum(variances[::-1], _LEAST * variances[-1]), vectors[:, ::-1]
    return reference @ vectors * np.sqrt(variances), vectors.T / np.sqrt(variances)[:, None]


def long_directions(n_elements: int) -> int:
    """Number of directions along which the surface is bent."""
    return min(_LONG, n_elements - 1)


def _products(v: np.ndarray, long: int) -> np.ndarray:
    """Products of the first directions, (n, m), each of mean zero under a standard normal distribution."""
    a, b = np.tril_indices(long)
    return np.asarray(v[:, a] * v[:, b] - (a == b))


def log_t(theta: np.ndarray, centre: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Log density of the multivariate t at theta (n, P), shape (n,), from a factor of its scale matrix."""
    dimension, nu = centre.size, DEGREES_OF_FREEDOM
    square = np.sum(np.linalg.solve(factor, (theta - centre).T) ** 2, axis=0)
    return np.asarray(
        gammaln((nu + dimension) / 2)
        - gammaln(nu / 2)
        - 0.5 * dimension * np.log(nu * np.pi)
        - np.sum(np.log(np.diag(factor)))
        - 0.5 * (nu + dimension) * np.log1p(square / nu)
    )
