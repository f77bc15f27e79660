r"""Virtual users: new people, drawn from the posterior predictive distribution of the population.

A user is drawn in two steps, on the unbounded scales of the parameters (:mod:`bayes_impedance.network.parameters`; the
logarithm of an element): population parameters from the posterior, then a person from that population,

.. math:: (\mu, \Sigma) \sim p(\cdot\,|\,\text{recordings}), \qquad \theta \sim N(\mu,\ \Sigma + B B^T),

so that elements are correlated as between people, and the uncertainty of the population is part of the spread. (B holds
the effects of standardised covariates, if the fit had any: a new user's covariates are not known. Where categories or
interactions are among them, their correlations C in the measured people enter, :math:`B C B^T`.) With `repetitions`,
the deviation of one repetition is added: :math:`\theta + \delta`, :math:`\delta \sim N(0, \operatorname{diag}\rho^2)`.

A user is the body alone (:mod:`bayes_impedance.design.body`): what belongs to the rig is taken out of the network, and
its columns out of the posterior, which integrates over them. A parameter of the body that is the same for everybody,
such as the exponent ``a1*`` of a power law, has no spread in a population but may differ between populations.

In a population with heavier tails theta follows the multivariate t distribution with scale matrix
:math:`\Sigma + B B^T` and the degrees of freedom of the posterior draw (:mod:`bayes_impedance.population.heavy_tails`);
in one of two groups a user belongs to one of them (:mod:`bayes_impedance.population.two_components`).

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

from bayes_impedance.design.body import body_of
from bayes_impedance.display import MOST_ROWS, Brief, heading, joined, lines, table
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.parameters import Parameter
from bayes_impedance.population.shapes import log_standard_density, standard_people
from bayes_impedance.population.two_components import Groups, groups_of
from bayes_impedance.results.meanings import DIFFERENCE, SHARE, TAIL
from bayes_impedance.results.result import Result
from bayes_impedance.runtime.user_table import whole_number_in

if TYPE_CHECKING:
    import pandas as pd

_MIXED = 2000
"""Most posterior draws in the mixture for the users' weights. By choice: computing time against its Monte-Carlo
error."""


_NOT_NORMAL = (
    "The population that is drawn from {}; representatives and the random draws of circuits are those of the normal "
    "distribution with {}."
)
_TAILS = _NOT_NORMAL.format("follows a Student t distribution", "its scales as standard deviations")
_GROUPS = _NOT_NORMAL.format("is of two groups", "the same mean and covariance")


@dataclass(frozen=True)
class Users:
    """Users, described by the parameters of one network.

    Attributes
    ----------
    network : Network
    unit : str
        Of the impedance.
    names : tuple of str, length N
    u : ndarray, shape (N, P)
        The parameters on their unbounded scales (natural logarithms of elements), in the order of ``network.elements``.
    band_hz : (float, float), optional
        Band of the recordings: where ladders that replace power laws and lines are accurate.
    """

    network: Network
    unit: str
    names: tuple[str, ...]
    u: np.ndarray
    band_hz: tuple[float, float] | None = None

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        return f"<Users of {self.network}: {len(self)}, impedance in {self.unit}>"

    def _repr_html_(self) -> str:
        rows = [(self.names[i], *self.of(i).values()) for i in range(min(len(self), MOST_ROWS))]
        units = self.units
        columns = ["user", *(f"{e} in {units[e]}" if units[e] else e for e in self.elements)]
        more = [f"and {len(self) - len(rows)} more"] if len(self) > len(rows) else []
        return joined(heading(repr(self).strip("<>")), table(columns, rows), lines(more))

    def __getitem__(self, rows: slice | npt.ArrayLike) -> Users:
        chosen = np.arange(len(self))[rows if isinstance(rows, slice) else np.asarray(rows)]
        return replace(self, names=tuple(self.names[i] for i in chosen), u=self.u[chosen])

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the parameters that are not held: elements, exponents, and those of wrappers."""
        return self.network.elements

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Value of each parameter in its unit, shape (N,)."""
        return dict(zip(self.elements, values_of(self.network, self.u).T, strict=True))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter; empty for a pure number."""
        return {p.name: p.unit(self.unit) for p in free_parameters(self.network)}

    def of(self, row: int) -> dict[str, float]:
        """Parameters of one user in their units."""
        return dict(zip(self.elements, values_of(self.network, self.u[row]).tolist(), strict=True))

    def to_dataframe(self) -> pd.DataFrame:
        """Parameters of all users: one row for each, with the name as index; ``attrs["units"]`` holds units."""
        import pandas as pd

        values = values_of(self.network, self.u)
        frame = pd.DataFrame(values, index=pd.Index(self.names, name="user", dtype=object), columns=list(self.elements))
        frame.attrs["units"] = self.units
        return frame

    def impedance(self, frequency_hz: npt.ArrayLike) -> np.ndarray:
        """Impedance of each user, complex, shape (N, F).

        Raises
        ------
        InputError
            If a frequency is not above zero and finite.
        """
        frequency_hz = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        wrong = frequency_hz[~((frequency_hz > 0) & np.isfinite(frequency_hz))]
        if wrong.size:
            raise InputError(f"a frequency is {wrong[0]:g} Hz, but all must be above zero and finite")
        return Kernel(self.network).impedance(self.u, frequency_hz)

    def __add__(self, other: Users) -> Users:
        names = (*self.names, *other.names)
        return replace(self, names=names, u=np.concatenate([self.u, other.u]))


def free_parameters(network: Network) -> tuple[Parameter, ...]:
    """Parameters that are not held, in the order of ``network.elements``."""
    return tuple(p for p in network.parameters if not p.held)


def values_of(network: Network, u: np.ndarray) -> np.ndarray:
    """Values of the parameters in their units from their unbounded scales, both (..., P)."""
    columns = [p.value(u[..., i]) for i, p in enumerate(free_parameters(network))]
    return np.stack(columns, axis=-1)


@dataclass(frozen=True, kw_only=True, repr=False)
class UserPopulation(Brief):
    """Posterior of the population: S draws of its parameters, on their unbounded scales.

    Attributes
    ----------
    network : Network
    unit : str
    mu : ndarray, shape (S, P)
        Means.
    factor : ndarray, shape (S, P, P)
        Lower Cholesky factor of the covariance between persons, effects of covariates included.
    between_repetitions : ndarray, shape (S, P)
        Standard deviations between repetitions.
    fixed : tuple of str
        Parameters with an assumed value that is the same for all users.
    band_hz : (float, float), optional
        Band of the recordings.
    removed : tuple of str
        What was taken out of the fitted network because it belongs to the rig.
    note : str
        The same as a sentence, and what is to be known of heavier tails; empty if nothing is to be said.
    tail : ndarray, shape (S,), optional
        Reciprocal degrees of freedom of a Student t population; normal if not given.
    groups : Groups, optional
        Of a population of two groups.
    """

    network: Network
    unit: str
    mu: np.ndarray
    factor: np.ndarray
    between_repetitions: np.ndarray
    fixed: tuple[str, ...] = ()
    band_hz: tuple[float, float] | None = None
    removed: tuple[str, ...] = ()
    note: str = ""
    tail: np.ndarray | None = None
    groups: Groups | None = None

    def __repr__(self) -> str:
        return f"<UserPopulation {self.network}: {len(self.mu)} posterior draws, impedance in {self.unit}>"

    @property
    def shared(self) -> tuple[str, ...]:
        """Parameters of the body that are the same for everybody in a population."""
        return tuple(p.name for p in free_parameters(self.network) if p.shared)

    def users(self, names: Sequence[str], u: np.ndarray) -> Users:
        """Users of this network with given parameters on their unbounded scales, shape (N, P)."""
        return Users(self.network, self.unit, tuple(names), u, self.band_hz)

    @property
    def centre(self) -> np.ndarray:
        """Posterior median of the means: the population centre, shape (P,)."""
        return np.asarray(np.median(self.mu, axis=0))

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of a new user's u: between persons plus posterior covariance of mu, shape (P, P).

        Of a Student t population: with its scale matrix in place of the covariance, which may be infinite.
        """
        away = self.mu - self.mu.mean(axis=0)
        between = np.mean(self.factor @ np.swapaxes(self.factor, 1, 2), axis=0)
        return np.asarray(between + away.T @ away / len(away))

    def median_user(self) -> Users:
        """The population centre as a user."""
        return self.users(("centre",), self.centre[None])

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
            raise InputError(f"{number} users cannot be drawn: ask for at least one")
        whole_number_in(number, "the number of users", 1)
        whole_number_in(seed, "seed", 0)
        rng = np.random.default_rng(seed)
        rows = np.linspace(0, len(self.mu) - 1, number).astype(int)
        tail = None if self.tail is None else self.tail[rows]
        groups = None if self.groups is None else self.groups[rows]
        own = standard_people(rng.normal(size=(number, self.mu.shape[1])), tail, groups, rng)
        theta = self.mu[rows] + np.einsum("spq,sq->sp", self.factor[rows], own)
        if repetitions:
            theta = theta + self.between_repetitions[rows] * rng.normal(size=theta.shape)
        width = len(str(number))
        return self.users([f"user_{i + 1:0{width}d}" for i in range(number)], theta)

    def weights(self, users: Users, number: int) -> np.ndarray:
        r"""Importance weights of users from the posterior predictive, for single populations of the posterior.

        For population s the weight of user i is proportional to
        :math:`N(\theta_i; \mu_s, \Sigma_s) / \tfrac1S \sum_r N(\theta_i; \mu_r, \Sigma_r)`, with the sum over all S.
        The densities are of what differs between people. What they share is taken as the users have it: its posterior
        adds to the spread of the users, not to the differences between populations.

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
        same = {*self.fixed, *self.shared}
        free = [i for i, e in enumerate(self.network.elements) if e not in same]
        factor = self.factor[row][np.ix_(free, free)]
        white = solve_triangular(factor, (users.u[:, free] - self.mu[row, free]).T, lower=True).T
        tail, groups = None if self.tail is None else self.tail[row], self.groups
        if groups is not None:
            groups = Groups(groups.share[[row]], groups.separation[[row]][:, free])
        return np.asarray(log_standard_density(white, tail, groups) - np.sum(np.log(np.diag(factor))))


def population_of(
    result: Result, assume: Mapping[str, float] | None = None, unreliable: bool = False
) -> UserPopulation:
    """The population that a finished fit describes, without what belongs to the rig.

    Parameters
    ----------
    result : Result
    assume : mapping of str to float, optional
        Values for parameters that the recordings do not determine, in their units.
    unreliable : bool
        Accept a fit that must not be used; the outputs made from it must say so.

    Raises
    ------
    InputError
        If the fit must not be used, is of one person, leaves an element without a value, or describes the rig only.
    """
    if result.problems and not unreliable:
        raise InputError(
            f"the fit is not reliable ({result.problems[0]}); use a fit that is, or give --unreliable: every "
            "file then carries the warning"
        )
    posterior = result.groups["posterior"]
    if "dispersion_between_persons" not in posterior:
        raise InputError("the fit is of one subject: there is no population to draw from; fit more recordings")
    body = body_of(parse(str(result.attributes["network"])))
    network, columns, assume = body.network, body.columns, dict(assume or {})
    wrong = sorted(name for name, value in assume.items() if name not in network.elements or not value > 0)
    if wrong:
        raise InputError(
            f"assumed {wrong[0]} = {assume[wrong[0]]:g}: assumed values must be positive and of elements among "
            f"{', '.join(network.elements)}"
        )

    mu, tau, rho = (
        _flat(posterior, name)[:, columns]
        for name in ("mu", "dispersion_between_persons", "dispersion_between_repetitions")
    )
    correlation = _flat(posterior, "correlation")[:, columns[:, None], columns]
    undetermined = [e for e, v in zip(network.elements, mu[0], strict=True) if not np.isfinite(v) and e not in assume]
    determined = [e for e, v in zip(network.elements, mu[0], strict=True) if np.isfinite(v) and e in assume]
    if determined:
        raise InputError(
            f"the recordings determine {', '.join(determined)}, and how much it differs: leave the assumption out"
        )
    if undetermined:
        raise InputError(
            f"the recordings do not determine {', '.join(undetermined)}: give a value with --assume (element=value in "
            "SI units), or fit a network without"
        )
    covariance = tau[:, :, None] * correlation * tau[:, None, :]
    if "slope" in posterior:
        slope = _flat(posterior, "slope")[:, columns]
        known = result.groups["constant_data"].get("covariate_correlation")
        together = np.eye(slope.shape[2]) if known is None else known
        covariance = covariance + slope @ together @ np.swapaxes(slope, 1, 2)
    free = free_parameters(network)
    for i, parameter in enumerate(free):
        if parameter.name in assume:
            mu[:, i], rho[:, i] = parameter.u(assume[parameter.name]), 0.0
    same = [i for i, parameter in enumerate(free) if parameter.shared or parameter.name in assume]
    covariance[:, same, :] = covariance[:, :, same] = 0.0
    covariance[:, same, same] = 1.0  # for the factorisation only
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise InputError("the fit's elements have a covariance that is not positive definite: fit again") from None
    factor[:, same, :] = 0.0
    frequency = np.asarray(result.coords["frequency_hz"], dtype=float)
    tail, groups = posterior.get(TAIL), None
    if SHARE in posterior:
        difference = _flat(posterior, DIFFERENCE)[:, columns]
        difference[:, same] = 0.0
        groups = groups_of(difference, _flat(posterior, SHARE), factor)
    note = "" if tail is None and groups is None else _TAILS if groups is None else _GROUPS
    return UserPopulation(
        network=network,
        unit=str(result.attributes["unit"]),
        mu=mu,
        factor=factor,
        between_repetitions=rho,
        fixed=tuple(assume),
        band_hz=(float(frequency[0]), float(frequency[-1])),
        removed=body.removed,
        note=" ".join(filter(None, (body.note, note))),
        tail=None if tail is None else np.asarray(tail).reshape(-1),
        groups=groups,
    )


def _flat(posterior: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """Draws of all ensembles along one axis; zeros for a dispersion that the fit does not have."""
    values = np.array(posterior[name] if name in posterior else np.zeros_like(posterior["mu"]), dtype=float)
    return values.reshape(-1, *values.shape[2:])
