"""Prior of the population's parameters: where their means may be, and how far people may differ.

The default is derived in :mod:`bayes_impedance.population.parameters` and
:mod:`bayes_impedance.population.natural_scales`. Of some parameters more may be known, such as of the rig after a
calibration: their means are then correlated, and their prior is narrow.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.population import prior_tails
from bayes_impedance.population.order import Order
from bayes_impedance.runtime.user_table import number_in

DEFAULT_SD = 3.0
"""Standard deviation of a log element's default prior: :mod:`.natural_scales`."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Prior(Brief):
    """Scales of the prior.

    Attributes
    ----------
    centre : ndarray, shape (P,)
        Prior mean of the population's mean log elements.
    centre_sd : float or ndarray, shape (P,)
        Its standard deviation, in natural logarithms.
    dispersion_sd : float or ndarray, shape (P,)
        Scale of the half-normal priors of both dispersions.
    concentration : float
        LKJ concentration eta of the correlations.
    slope_sd : float
        Standard deviation of the effect of one standard deviation of a covariate on a log element.
    correlation : ndarray, shape (P, P), optional
        Of the prior means; none if not given.
    informed : ndarray of bool, shape (P,), optional
        Parameters of which the prior is knowledge from other recordings, such as calibration runs: they are estimated
        whatever these recordings say of them. None if not given.
    heavy : ndarray of bool, shape (P,), optional
        Parameters whose prior mean has a Student t distribution (:mod:`.prior_tails`), with `centre_sd` as its scale.
        None if not given: all are normal.
    order : Order
        Which prior means are below which others: where they are not, the density is zero.
    """

    centre: np.ndarray
    centre_sd: float | np.ndarray = DEFAULT_SD
    dispersion_sd: float | np.ndarray = 1.0
    concentration: float = 2.0
    slope_sd: float = 1.0
    correlation: np.ndarray | None = None
    informed: np.ndarray | None = None
    heavy: np.ndarray | None = None
    order: Order = field(default_factory=Order)

    def __post_init__(self) -> None:
        centre = np.asarray(self.centre)
        if centre.ndim != 1 or centre.dtype.kind not in "fiu" or not np.all(np.isfinite(centre)):
            raise InputError("prior: centre must be a one-dimensional array of finite numbers, one for each element")
        for name in ("concentration", "slope_sd"):
            number_in(getattr(self, name), f"prior: {name}", above=0)
        for name in ("centre_sd", "dispersion_sd"):
            own = getattr(self, name)
            for sd in own.tolist() if isinstance(own, np.ndarray) else [own]:
                number_in(sd, f"prior: {name}", above=0)

    @property
    def centre_sds(self) -> np.ndarray:
        """Standard deviation of each prior mean, shape (P,)."""
        return np.broadcast_to(np.asarray(self.centre_sd, dtype=float), self.centre.shape)

    @property
    def dispersion_sds(self) -> np.ndarray:
        """Scale of the half-normal priors of each parameter's dispersions, shape (P,)."""
        return np.broadcast_to(np.asarray(self.dispersion_sd, dtype=float), self.centre.shape)

    def of(self, columns: np.ndarray) -> Prior:
        """The prior of some of the parameters, whatever the others are."""
        return replace(
            self,
            centre=self.centre[columns],
            centre_sd=self.centre_sds[columns],
            dispersion_sd=self.dispersion_sds[columns],
            correlation=None if self.correlation is None else self.correlation[np.ix_(columns, columns)],
            informed=None if self.informed is None else self.informed[columns],
            heavy=None if self.heavy is None else self.heavy[columns],
            order=self.order.of(columns),
        )

    @property
    def known(self) -> np.ndarray:
        """Which parameters are informed, shape (P,)."""
        return np.zeros(self.centre.size, dtype=bool) if self.informed is None else self.informed

    @property
    def covariance(self) -> np.ndarray:
        """Of the prior means, shape (P, P)."""
        sds = self.centre_sds
        return np.diag(sds**2) if self.correlation is None else self.correlation * np.outer(sds, sds)

    @property
    def factor(self) -> np.ndarray:
        """Lower Cholesky factor of the covariance, shape (P, P)."""
        sds = self.centre_sds
        return np.diag(sds) if self.correlation is None else sds[:, None] * np.linalg.cholesky(self.correlation)

    @property
    def precision(self) -> np.ndarray:
        """Inverse of the covariance, shape (P, P)."""
        sds = self.centre_sds
        return np.diag(sds**-2.0) if self.correlation is None else np.linalg.inv(self.correlation) / np.outer(sds, sds)

    @property
    def tailed(self) -> np.ndarray:
        """Which parameters have a Student t prior, shape (P,)."""
        return np.zeros(self.centre.size, dtype=bool) if self.heavy is None else self.heavy

    @property
    def starting_sds(self) -> np.ndarray:
        """Standard deviations (P,) for first fits: a Student t is as wide as the default, which recordings overrule."""
        return np.where(self.tailed, np.maximum(self.centre_sds, DEFAULT_SD), self.centre_sds)

    def local_sds(self, centre: np.ndarray) -> np.ndarray:
        """Standard deviations (P,) of the normal prior that draws as this one does at centres (P,)."""
        z = (centre - self.centre) / self.centre_sds
        return np.where(self.tailed, self.centre_sds / np.sqrt(prior_tails.weight(z)), self.centre_sds)

    def local_precision(self, centre: np.ndarray) -> np.ndarray:
        """Inverse covariance (P, P) of the normal prior that draws as this one does at centres (P,)."""
        root = self.centre_sds / self.local_sds(centre)
        return self.precision * np.outer(root, root)

    def from_standard(self, u: np.ndarray) -> np.ndarray:
        """Centres of coordinates that are independent and standard normal under the prior, both (..., P).

        Parameters with a Student t prior are independent of all others.
        """
        return np.asarray(self.centre + prior_tails.changed(u, self.tailed, prior_tails.from_standard) @ self.factor.T)

    def to_standard(self, centre: np.ndarray) -> np.ndarray:
        """The coordinates of centres, both (..., P)."""
        z = np.linalg.solve(self.factor, (centre - self.centre)[..., None])[..., 0]
        return prior_tails.changed(z, self.tailed, prior_tails.to_standard)

    def stretch(self, u: np.ndarray) -> np.ndarray:
        """What :meth:`from_standard` adds to the slope of a normal prior at coordinates (..., P), same shape."""
        return np.where(self.tailed, prior_tails.slope(u), 1.0) if self.tailed.any() else np.ones(np.shape(u))

    def log_density(self, centre: np.ndarray) -> np.ndarray:
        """Log density of centres (W, P), whatever their order, up to a constant: shape (W,)."""
        offset = np.linalg.solve(self.factor, (centre - self.centre).T)
        terms = -0.5 * offset**2
        if self.heavy is not None:
            terms[self.heavy] = prior_tails.log_density(offset[self.heavy])
        return np.asarray(np.sum(terms, axis=0))

    def misfit(self, centre: np.ndarray) -> float:
        """Negative log density of centres (P,): of normal ones half the squared distance in standard deviations."""
        if self.heavy is not None:
            return -float(self.log_density(centre[None])[0])
        offset = centre - self.centre
        return 0.5 * float(offset @ self.precision @ offset)
