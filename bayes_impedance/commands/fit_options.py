"""What a user can choose of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayes_impedance.population.fit import FitSettings
    from bayes_impedance.population.given_prior import GivenPrior

_THREADS = 2
"""Default number of threads of this process. By choice: most machines have at least two cores, and for the shipped
dataset starting processes takes longer than it saves."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """Options of a fit.

    Attributes
    ----------
    network : str or None
        Notation; None for the dataset's own.
    start : mapping of str to float, or None
        Values of all parameters of the network, near which the fit begins too.
    covariance : str
        ``full`` or ``diagonal``.
    covariates : tuple of str
    subjects : tuple of str
        Names of the subjects to use; empty for all.
    seed : int
    quick : bool
        Fewer draws and shorter chains: for a first look.
    exact_calibration : bool
        Take the recordings' calibration as exact, instead of estimating its error along.
    workers : int or None
        Number of processes of this machine for the computations of single persons, and of threads of this process for
        sampling; None for two threads that do both. Does not change the result.
    scheduler : str or None
        Address of a Dask scheduler whose workers run the computations of single persons; does not change the result.
    overwrite : bool
        Replace files with the names of the results that this package did not write.
    plain : str or None
        The network to which a diagnosis added what was missing.
    with_before : bool
        Describe that network too, or the dataset's own if `network` extends it, for the report.
    prior : GivenPrior or None
        What replaces the default prior.
    beside : tuple of str
        Published sets (:func:`bayes_impedance.datasets.published_values`) that are laid beside the fit.
    distribution, noise_distribution : str
        As in :class:`~bayes_impedance.population.settings.FitSettings`.
    """

    network: str | None = None
    start: Mapping[str, float] | None = None
    covariance: str = "full"
    covariates: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    seed: int = 1
    quick: bool = False
    exact_calibration: bool = False
    workers: int | None = None
    scheduler: str | None = None
    overwrite: bool = False
    plain: str | None = None
    with_before: bool = True
    prior: GivenPrior | None = None
    beside: tuple[str, ...] = ()
    distribution: str = "normal"
    noise_distribution: str = "normal"

    @property
    def threads(self) -> int:
        """Number of threads of this process for sampling: ensembles share its memory."""
        return _THREADS if self.workers is None else self.workers

    def settings(self) -> FitSettings:
        """Settings of the fit."""
        from bayes_impedance.population.fit import QUICK_SETTINGS, FitSettings

        names = ("covariance", "covariates", "prior", "distribution", "noise_distribution")
        return replace(QUICK_SETTINGS if self.quick else FitSettings(), **{n: getattr(self, n) for n in names})
