r"""Virtual users: new people, drawn from the posterior predictive distribution of the population.

A user's log elements are drawn in two steps: population parameters from the posterior, then a person from that
population,

.. math:: (\mu, \Sigma) \sim p(\cdot\,|\,\text{recordings}), \qquad \theta \sim N(\mu,\ \Sigma + B B^T),

so that elements are correlated as between people, and the uncertainty of the population is part of the spread. (B holds
the effects of standardised covariates, if the fit had any: a new user's covariates are not known.) With `repetitions`,
the deviation of one repetition is added: :math:`\theta + \delta`, :math:`\delta \sim N(0, \operatorname{diag}\rho^2)`.

:class:`UserPopulation` keeps the posterior's draws of :math:`(\mu, \Sigma)`. By importance weights
(:meth:`UserPopulation.weights`) one set of users serves as a sample from each of these populations. So probabilities
have credible intervals without drawing new users for each population.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.results.result import Result

if TYPE_CHECKING:
    import pandas as pd

PERCENTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
"""Percentiles of the exported curves. By choice: median, quartiles and the usual 5 % and 1 % tails."""

_MIXED = 2000
"""Most posterior draws in the mixture for the users' weights. By choice: computing time against its Monte-Carlo
error."""


@dataclass(frozen=True)
class Users:
    """Users, described by the elements of one network.

    Attributes
    ----------
    network : Network
    unit : str
        Of the impedance.
    names : tuple of str, length N
    log_elements : ndarray, shape (N, P)
        Natural logarithms of the elements, in the order of ``network.elements``.
    """

    network: Network
    unit: str
    names: tuple[str, ...]
    log_elements: np.ndarray

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, rows: slice | npt.ArrayLike) -> Users:
        chosen = np.arange(len(self))[rows if isinstance(rows, slice) else np.asarray(rows)]
        return replace(self, names=tuple(self.names[i] for i in chosen), log_elements=self.log_elements[chosen])

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the elements."""
        return self.network.elements

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Value of each element in its unit, shape (N,)."""
        return dict(zip(self.elements, np.exp(self.log_elements).T, strict=True))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each element."""
        return {e: kind_of(e).unit(self.unit) for e in self.elements}

    def of(self, row: int) -> dict[str, float]:
        """Elements of one user in their units."""
        return dict(zip(self.elements, np.exp(self.log_elements[row]).tolist(), strict=True))

    def to_dataframe(self) -> pd.DataFrame:
        """Elements of all users: one row for each, with the name as index; ``attrs["units"]`` holds units."""
        import pandas as pd

        values = np.exp(self.log_elements)
        frame = pd.DataFrame(values, index=pd.Index(self.names, name="user", dtype=object), columns=list(self.elements))
        frame.attrs["units"] = self.units
        return frame

    def impedance(self, frequency_hz: npt.ArrayLike) -> np.ndarray:
        """Impedance of each user, complex, shape (N, F)."""
        return Kernel(self.network).impedance(self.log_elements, frequency_hz)

    def __add__(self, other: Users) -> Users:
        names = (*self.names, *other.names)
        return replace(self, names=names, log_elements=np.concatenate([self.log_elements, other.log_elements]))


@dataclass(frozen=True, kw_only=True)
class UserPopulation:
    """Posterior of the population: S draws of its parameters.

    Attributes
    ----------
    network : Network
    unit : str
    mu : ndarray, shape (S, P)
        Mean log elements.
    factor : ndarray, shape (S, P, P)
        Lower Cholesky factor of the covariance between persons, effects of covariates included.
    between_repetitions : ndarray, shape (S, P)
        Standard deviations between repetitions.
    fixed : tuple of str
        Elements with an assumed value that is the same for all users.
    """

    network: Network
    unit: str
    mu: np.ndarray
    factor: np.ndarray
    between_repetitions: np.ndarray
    fixed: tuple[str, ...] = ()

    @property
    def centre(self) -> np.ndarray:
        """Posterior median of the mean log elements: the population centre, shape (P,)."""
        return np.asarray(np.median(self.mu, axis=0))

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of a new user's log elements: between persons plus posterior covariance of mu, shape (P, P)."""
        away = self.mu - self.mu.mean(axis=0)
        between = np.mean(self.factor @ np.swapaxes(self.factor, 1, 2), axis=0)
        return np.asarray(between + away.T @ away / len(away))

    def median_user(self) -> Users:
        """The population centre as a user."""
        return Users(self.network, self.unit, ("centre",), self.centre[None])

    def draw(self, number: int, seed: int, *, repetitions: bool = False) -> Users:
        """Virtual users from the posterior predictive distribution.

        Parameters
        ----------
        number : int
            How many; posterior draws are used evenly.
        seed : int
        repetitions : bool
            Add the deviation of one repetition to each user; otherwise each is the mean over many repetitions.

        Raises
        ------
        InputError
            If `number` is less than one.
        """
        if number < 1:
            raise InputError(f"{number} users cannot be drawn: ask for one at least")
        rng = np.random.default_rng(seed)
        rows = np.linspace(0, len(self.mu) - 1, number).astype(int)
        theta = self.mu[rows] + np.einsum("spq,sq->sp", self.factor[rows], rng.normal(size=(number, self.mu.shape[1])))
        if repetitions:
            theta = theta + self.between_repetitions[rows] * rng.normal(size=theta.shape)
        width = len(str(number))
        return Users(self.network, self.unit, tuple(f"user_{i + 1:0{width}d}" for i in range(number)), theta)

    def weights(self, users: Users, number: int) -> np.ndarray:
        r"""Importance weights of users from the posterior predictive, for single populations of the posterior.

        For population s the weight of user i is proportional to
        :math:`N(\theta_i; \mu_s, \Sigma_s) / \tfrac1S \sum_r N(\theta_i; \mu_r, \Sigma_r)`, with the sum over all S.

        Parameters
        ----------
        users : Users
            Drawn without repetitions.
        number : int
            Number R of populations, spread evenly over the posterior's draws.

        Returns
        -------
        ndarray, shape (R, N)
            Each row sums to one.
        """
        everything = np.unique(np.linspace(0, len(self.mu) - 1, _MIXED).astype(int))
        rows = np.unique(np.linspace(0, len(self.mu) - 1, number).astype(int))
        # The mean is over all populations from which the users were drawn, not only over the requested ones.
        drawn_from = np.full(len(users), -np.inf)
        for row in everything:
            drawn_from = np.logaddexp(drawn_from, self._log_density(users, int(row)))
        wanted = np.array([self._log_density(users, int(row)) for row in rows])
        weights = np.exp(wanted - drawn_from)
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def _log_density(self, users: Users, row: int) -> np.ndarray:
        """Log density of users in one population, up to a constant, shape (N,)."""
        free = [i for i, e in enumerate(self.network.elements) if e not in self.fixed]
        factor = self.factor[row][np.ix_(free, free)]
        white = solve_triangular(factor, (users.log_elements[:, free] - self.mu[row, free]).T, lower=True)
        return np.asarray(-0.5 * np.sum(white**2, axis=0) - np.sum(np.log(np.diag(factor))))


def population_of(
    result: Result, assume: Mapping[str, float] | None = None, unreliable: bool = False
) -> UserPopulation:
    """The population that a finished fit describes.

    Parameters
    ----------
    result : Result
    assume : mapping of str to float, optional
        Values for elements that the recordings do not determine, in their units.
    unreliable : bool
        Accept a fit that must not be used; the outputs made from it must say so.

    Raises
    ------
    InputError
        If the fit must not be used, is of one person, or leaves an element without a value.
    """
    if result.problems and not unreliable:
        raise InputError(
            f"the fit is not reliable ({result.problems[0]}); design with a fit that is, or say --unreliable: every "
            "file then carries the warning"
        )
    posterior = result.groups["posterior"]
    if "dispersion_between_persons" not in posterior:
        raise InputError("the fit is of one subject: there is no population to draw users from; fit more recordings")
    network, assume = parse(str(result.attributes["network"])), dict(assume or {})
    unknown = sorted(set(assume) - set(network.elements))
    if unknown or any(not value > 0 for value in assume.values()):
        raise InputError(f"assumed values must be positive and of elements among {', '.join(network.elements)}")

    mu, tau, rho = (
        _flat(posterior, name) for name in ("mu", "dispersion_between_persons", "dispersion_between_repetitions")
    )
    correlation = _flat(posterior, "correlation")
    undetermined = [e for e, v in zip(network.elements, mu[0], strict=True) if not np.isfinite(v) and e not in assume]
    if undetermined:
        raise InputError(
            f"the recordings do not determine {', '.join(undetermined)}: assume a value (element=value in its unit), "
            "or fit a network without"
        )
    covariance = tau[:, :, None] * correlation * tau[:, None, :]
    if "slope" in posterior:
        slope = _flat(posterior, "slope")
        covariance = covariance + slope @ np.swapaxes(slope, 1, 2)
    for name, value in assume.items():
        i = network.elements.index(name)
        mu[:, i], rho[:, i] = np.log(value), 0.0
        covariance[:, i, :] = covariance[:, :, i] = 0.0
        covariance[:, i, i] = 1.0  # for the factorisation only
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise InputError("the fit's elements have a covariance that is not positive definite: fit again") from None
    for name in assume:
        factor[:, network.elements.index(name), :] = 0.0
    return UserPopulation(
        network=network,
        unit=str(result.attributes["unit"]),
        mu=mu,
        factor=factor,
        between_repetitions=rho,
        fixed=tuple(assume),
    )


def _flat(posterior: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """Draws of all ensembles along one axis; zeros for a dispersion that the fit does not have."""
    values = np.array(posterior[name] if name in posterior else np.zeros_like(posterior["mu"]), dtype=float)
    return values.reshape(-1, *values.shape[2:])


def percentile_curves(
    users: Users, frequency_hz: npt.ArrayLike, probabilities: Sequence[float] = PERCENTILES
) -> tuple[np.ndarray, np.ndarray]:
    """Pointwise percentiles of magnitude and of phase in degrees over users, each of shape (len(probabilities), F)."""
    z = users.impedance(frequency_hz)
    magnitude = np.quantile(np.abs(z), probabilities, axis=0)
    return np.asarray(magnitude), np.asarray(np.quantile(np.angle(z, deg=True), probabilities, axis=0))
