r"""The population's parameters: what they are, their priors, and the coordinates in which they are sampled.

A person's log elements and the deviation of one repetition from them are

.. math:: \theta_i \sim N(\mu + B x_i,\ \Sigma), \qquad \delta_{ij} \sim N(0,\ \operatorname{diag}\rho^2),
          \qquad \Sigma = \operatorname{diag}(\tau)\, C \operatorname{diag}(\tau),

with covariates x standardised. The default priors need no knowledge of unit or body part:

* :math:`\mu_p \sim N(c_p, 3^2)`, where :math:`c_p` is the value at which the element's impedance meets the data's
  magnitude in the middle of the band (:func:`bayes_impedance.network.elements.band_scale`);
* :math:`\tau_p, \rho_p \sim` half-normal(1); slopes :math:`B_{pq} \sim N(0, 1)`;
* correlations C ~ LKJ(2), through partial correlations (Lewandowski, Kurowicka and Joe 2009): in a P-dimensional
  C-vine the partial correlation of level j is Beta(b, b) on (-1, 1) with :math:`b = \eta + (P - 2 - j)/2`.

In a population with heavier tails theta follows a multivariate t with scale matrix :math:`\Sigma`, whose degrees of
freedom are one parameter more (:mod:`bayes_impedance.population.heavy_tails`). A population of two groups has the same
moments, and a share and a separation more (:mod:`bayes_impedance.population.two_components`).

**Coordinates.** The sampled distribution should be close to normal. Centres are standardised, or have
a distance from the one below (:mod:`bayes_impedance.population.ordered_centres`). A dispersion with a
half-normal prior is the absolute value of a normal variable, which is sampled with its sign: the posterior density is
an even, smooth function of it. Where the data cannot distinguish a dispersion from zero it is close to a normal
distribution about zero, of the width to which the data limit the dispersion; a logarithm, or the probit of the prior
probability, has a tail without end there. Where the data determine a dispersion the density has two equal peaks, of
which a chain sees one; their distance does not matter, because the sign has no meaning. The dispersion of few people
is skewed, and its logarithm less so: with a bend :math:`s_0` the coordinate is :math:`u = \operatorname{asinh}(s/s_0)`,
linear below the bend and logarithmic above. Partial correlations are transformed by atanh.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.population.heavy_tails import coordinate_of, tail_of
from bayes_impedance.population.ordered_centres import Centres
from bayes_impedance.population.partial_correlations import cholesky_from_partial, log_cosh, partial_from_cholesky
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.two_components import SEPARATION, Groups, share_coordinate, share_of

_SMALLEST = 1e-9
"""Least absolute value of a dispersion's coordinate: covariances stay invertible, and nothing that small is resolved by
any recording."""


@dataclass(frozen=True, kw_only=True, repr=False)
class PopulationParameters(Brief):
    """W sets of population parameters.

    Attributes
    ----------
    mu : ndarray, shape (W, P)
        Mean log elements.
    between_persons : ndarray, shape (W, P)
        Standard deviations of the log elements between persons.
    correlation_cholesky : ndarray, shape (W, P, P)
        Lower Cholesky factor of their correlation matrix.
    between_repetitions : ndarray, shape (W, P)
        Standard deviations between repetitions; zero where there are none.
    slopes : ndarray, shape (W, P, Q)
        Effects of the standardised covariates.
    shared : ndarray, shape (W, S), optional
        Parameters that are the same for everybody; the P others differ.
    tail : ndarray, shape (W,), optional
        Reciprocal degrees of freedom of a Student t population, whose scales are `between_persons`; a normal population
        if not given.
    groups : Groups, optional
        Of a population of two groups, whose mean and covariance are those of all people.
    """

    mu: np.ndarray
    between_persons: np.ndarray
    correlation_cholesky: np.ndarray
    between_repetitions: np.ndarray
    slopes: np.ndarray
    shared: np.ndarray | None = None
    tail: np.ndarray | None = None
    groups: Groups | None = None

    @property
    def mixed(self) -> bool:
        """Whether the populations are mixtures of normal ones."""
        return self.tail is not None or self.groups is not None

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrices, shape (W, P, P)."""
        return np.asarray(self.correlation_cholesky @ np.swapaxes(self.correlation_cholesky, -1, -2))

    @property
    def covariance_cholesky(self) -> np.ndarray:
        """Lower Cholesky factors of the covariance between persons, shape (W, P, P)."""
        return np.asarray(self.between_persons[..., :, None] * self.correlation_cholesky)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance between persons, shape (W, P, P)."""
        factor = self.covariance_cholesky
        return np.asarray(factor @ np.swapaxes(factor, -1, -2))

    def __getitem__(self, rows: slice | np.ndarray) -> PopulationParameters:
        return PopulationParameters(
            mu=self.mu[rows],
            between_persons=self.between_persons[rows],
            correlation_cholesky=self.correlation_cholesky[rows],
            between_repetitions=self.between_repetitions[rows],
            slopes=self.slopes[rows],
            shared=None if self.shared is None else self.shared[rows],
            tail=None if self.tail is None else self.tail[rows],
            groups=None if self.groups is None else self.groups[rows],
        )


@dataclass(frozen=True, kw_only=True)
class Coordinates:
    """The map between population parameters and the real vector that is sampled.

    The vector holds, in this order: centres (P), dispersions between persons (P), those between repetitions (P,
    if `repetitions`), slopes (P Q), partial correlations (P (P - 1) / 2, if `correlated`), the degrees of freedom (1,
    if `tails`), separation and share (P and 1, if `groups`), parameters that are the same for everybody (S). Elements
    that are not `free` keep the given population parameters and have no coordinates: the data hold no information on
    them.

    Attributes
    ----------
    prior : Prior
    correlated : bool
        Full covariance, or diagonal.
    repetitions : bool
        Whether there is a dispersion between repetitions.
    n_covariates : int
    free : tuple of int
        Elements that have coordinates.
    held_mu, held_dispersion : ndarray, shape (P,)
        Population parameters of the others (both dispersions are held at the same value).
    shared_prior : Prior, optional
        Of parameters that are the same for everybody.
    shared_free : tuple of int
        Those of them that have coordinates.
    held_shared : ndarray, shape (S,), optional
        Values of the others.
    bend_persons, bend_repetitions : ndarray, shape (P,), optional
        Where the coordinate of a dispersion bends from linear to logarithmic, in units of the prior's scale; linear
        everywhere if not given.
    tails : bool
        Whether the population is a Student t whose degrees of freedom are sampled.
    groups : bool
        Whether it has two groups.
    """

    prior: Prior
    correlated: bool
    repetitions: bool
    n_covariates: int
    free: tuple[int, ...]
    held_mu: np.ndarray
    held_dispersion: np.ndarray
    shared_prior: Prior | None = None
    shared_free: tuple[int, ...] = ()
    held_shared: np.ndarray | None = None
    bend_persons: np.ndarray | None = None
    bend_repetitions: np.ndarray | None = None
    tails: bool = False
    groups: bool = False

    @property
    def n_elements(self) -> int:
        """Number P of elements."""
        return int(self.prior.centre.size)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of coordinates of each block."""
        n = len(self.free)
        return (
            n,
            n,
            n if self.repetitions else 0,
            n * self.n_covariates,
            n * (n - 1) // 2 if self.correlated else 0,
            1 if self.tails else 0,
            n if self.groups else 0,
            1 if self.groups else 0,
            len(self.shared_free),
        )

    @cached_property
    def centres(self) -> Centres:
        """The map of the free centres to their coordinates."""
        return Centres(self.prior.of(np.array(self.free, dtype=int)))

    @property
    def n_dimensions(self) -> int:
        """Length D of the vector."""
        return sum(self.sizes)

    def blocks(self, vector: np.ndarray) -> list[np.ndarray]:
        """The parts of the vector, in their order."""
        return np.split(vector, np.cumsum(self.sizes)[:-1], axis=-1)

    def unpack(self, vector: np.ndarray) -> PopulationParameters:
        """Population parameters of sampled vectors, shape (W, D)."""
        centre, persons, repetitions, slopes, partial, tail, separation, share, shared = self.blocks(vector)
        w, p, free = vector.shape[0], self.n_elements, list(self.free)
        mu = np.tile(self.held_mu, (w, 1))
        mu[:, free] = self.centres.values(centre)
        tau = np.tile(self.held_dispersion, (w, 1))
        tau[:, free] = self._dispersion(persons, self.bend_persons)
        rho = np.zeros((w, p))
        if self.repetitions:
            rho[:] = self.held_dispersion
            rho[:, free] = self._dispersion(repetitions, self.bend_repetitions)
        b = np.zeros((w, p, self.n_covariates))
        b[:, free] = self.prior.slope_sd * slopes.reshape(w, len(free), self.n_covariates)
        cholesky = np.tile(np.eye(p), (w, 1, 1))
        if self.correlated:
            chosen = np.array(free)
            cholesky[:, chosen[:, None], chosen] = cholesky_from_partial(np.tanh(partial), len(free))
        return PopulationParameters(
            mu=mu,
            between_persons=tau,
            correlation_cholesky=cholesky,
            between_repetitions=rho,
            slopes=b,
            shared=self._shared(shared),
            tail=tail_of(tail[:, 0]) if self.tails else None,
            groups=self._groups(separation, share) if self.groups else None,
        )

    def _groups(self, separation: np.ndarray, share: np.ndarray) -> Groups:
        own = np.zeros((len(share), self.n_elements))
        own[:, list(self.free)] = self.separation_unit * separation
        return Groups(share_of(share[:, 0]), own)

    @property
    def separation_unit(self) -> float:
        """Prior standard deviation of the separation in each free element."""
        return float(SEPARATION / np.sqrt(len(self.free)))

    @property
    def mirrored(self) -> np.ndarray:
        """Coordinates whose signs may change together, for groups can be exchanged: bool, shape (D,)."""
        result = np.zeros(self.n_dimensions, dtype=bool)
        end = self.n_dimensions - self.sizes[-1]
        result[end - sum(self.sizes[-3:-1]) : end] = True
        return result

    def _shared(self, coordinates: np.ndarray) -> np.ndarray | None:
        if self.shared_prior is None or self.held_shared is None:
            return None
        free = list(self.shared_free)
        phi = np.tile(self.held_shared, (len(coordinates), 1))
        phi[:, free] = self.common_prior.from_standard(coordinates)
        return phi

    @cached_property
    def common_prior(self) -> Prior:
        """Of the free shared parameters, which may be correlated under it."""
        assert self.shared_prior is not None  # there are shared parameters
        return self.shared_prior.of(np.array(self.shared_free, dtype=int))

    def shared_slope(self, coordinates: np.ndarray) -> np.ndarray:
        """Derivative of the free shared parameters with respect to their coordinates (..., S'): (..., S', S')."""
        return np.asarray(self.common_prior.factor * self.common_prior.stretch(coordinates)[..., None, :])

    def shared_moments(self, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (S',) and covariance (S', S') of the free shared parameters for those of their coordinates."""
        slope = self.shared_slope(mean)
        return self.common_prior.from_standard(mean), slope @ covariance @ slope.T

    def shared_scale(self, shared: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Standard deviations (S',) of the coordinates, for a covariance (S', S') of the free of these (S,)."""
        standard = self.common_prior.to_standard(shared[list(self.shared_free)])
        inverse = np.linalg.inv(self.shared_slope(standard))
        return np.asarray(np.sqrt(np.diag(inverse @ covariance @ inverse.T)))

    def log_prior(self, vector: np.ndarray) -> np.ndarray:
        """Log prior density of sampled vectors, shape (W, D), up to a constant: shape (W,)."""
        centre, persons, repetitions, slopes, partial, tail, separation, share, shared = self.blocks(vector)
        value = self.centres.log_prior(centre)
        more = ((tail,) if self.tails else ()) + ((separation, share) if self.groups else ())
        for block in (slopes, *more, shared):
            value = value - 0.5 * np.sum(block**2, axis=-1)
        value = value + self._log_prior_of(persons, self.bend_persons)
        if self.repetitions:
            value = value + self._log_prior_of(repetitions, self.bend_repetitions)
        if self.correlated:
            # In u = atanh(r) the density (1 - r^2)^(b - 1) becomes (1 - r^2)^b = sech(u)^(2 b).
            value = value - 2 * np.sum(self.levels() * log_cosh(partial), axis=-1)
        return np.asarray(value)

    def pack(
        self,
        mu: np.ndarray,
        covariance: np.ndarray,
        between_repetitions: np.ndarray,
        slopes: np.ndarray,
        shared: np.ndarray | None = None,
        tail: float | None = None,
        groups: Groups | None = None,
    ) -> np.ndarray:
        """Vector of one set of parameters.

        Parameters
        ----------
        mu : ndarray, shape (P,)
        covariance : ndarray, shape (P, P)
        between_repetitions : ndarray, shape (P,)
        slopes : ndarray, shape (P, Q)
        shared : ndarray, shape (S,), optional
        tail : float, optional
            Reciprocal degrees of freedom.
        groups : Groups, optional
            One.
        """
        free = list(self.free)
        tau = np.sqrt(np.diag(covariance))[free]
        parts = [
            self.centres.coordinates(mu[free]),
            self._coordinate(tau, self.bend_persons),
        ]
        if self.repetitions:
            parts.append(self._coordinate(between_repetitions[free], self.bend_repetitions))
        parts.append(slopes[free].ravel() / self.prior.slope_sd)
        if self.correlated:
            correlation = covariance[np.ix_(free, free)] / np.outer(tau, tau)
            parts.append(np.arctanh(partial_from_cholesky(np.linalg.cholesky(correlation))))
        if self.tails and tail is not None:
            parts.append(np.array([coordinate_of(tail)]))
        if self.groups and groups is not None:
            parts += [groups.separation[0, free] / self.separation_unit, share_coordinate(groups.share)]
        if self.shared_prior is not None and shared is not None:
            parts.append(self.common_prior.to_standard(shared[list(self.shared_free)]))
        return np.concatenate(parts)

    @property
    def even(self) -> np.ndarray:
        """Coordinates whose sign has no meaning, of dispersions and of ordered centres: bool, shape (D,)."""
        centre, persons, repetitions, *_ = self.sizes
        result = np.zeros(self.n_dimensions, dtype=bool)
        result[:centre] = self.centres.even
        result[centre : centre + persons + repetitions] = True
        return result

    def _dispersion(self, u: np.ndarray, bend: np.ndarray | None) -> np.ndarray:
        s = np.abs(u) if bend is None else bend[list(self.free)] * np.sinh(np.abs(u))
        return np.asarray(self.prior.dispersion_sds[list(self.free)] * np.maximum(s, _SMALLEST))

    def _coordinate(self, dispersion: np.ndarray, bend: np.ndarray | None) -> np.ndarray:
        s = np.asarray(dispersion) / self.prior.dispersion_sds[list(self.free)]
        return np.asarray(s if bend is None else np.arcsinh(s / bend[list(self.free)]))

    def dispersion_slope(self, u: np.ndarray, bend: np.ndarray | None) -> np.ndarray:
        """Derivative of dispersions with respect to their coordinates, (W, n)."""
        own = np.sign(u) if bend is None else bend[list(self.free)] * np.cosh(u) * np.sign(u)
        return np.asarray(self.prior.dispersion_sds[list(self.free)] * own)

    def dispersion_prior_slope(self, u: np.ndarray, bend: np.ndarray | None) -> np.ndarray:
        """Derivative of the log prior density of dispersions with respect to their coordinates, (W, n)."""
        if bend is None:
            return -u
        return np.asarray(np.tanh(u) - bend[list(self.free)] ** 2 * np.sinh(u) * np.cosh(u))

    def _log_prior_of(self, u: np.ndarray, bend: np.ndarray | None) -> np.ndarray:
        """Normal in s, with the Jacobian of s(u)."""
        if bend is None:
            return np.asarray(-0.5 * np.sum(u**2, axis=-1))
        s = bend[list(self.free)] * np.sinh(u)
        return np.asarray(np.sum(log_cosh(u) - 0.5 * s**2, axis=-1))

    def levels(self) -> np.ndarray:
        """Parameter b of the Beta(b, b) prior of each partial correlation, by rows of the lower triangle."""
        n = len(self.free)
        _, column = np.tril_indices(n, -1)
        return np.asarray(self.prior.concentration + (n - 2 - column) / 2)
