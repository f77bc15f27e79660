"""Populations and people as the prior has them, before any recording is looked at but for its unit and band."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from bayes_impedance.display import heading, joined, table
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network
from bayes_impedance.network.parameters import values_of
from bayes_impedance.population.calibrated import within_rig
from bayes_impedance.population.covariate_terms import with_terms
from bayes_impedance.population.fit import FitSettings, prior_for
from bayes_impedance.population.heavy_tails import STUDENT_T
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.prior_draws import draw_prior
from bayes_impedance.population.requirements import (
    checked_model,
    require_people_for_groups,
    too_few_for_correlations,
)
from bayes_impedance.population.shapes import standard_people
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.two_components import MIXTURE
from bayes_impedance.population.whole import Whole
from bayes_impedance.recordings.files import Recordings

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class PriorSample:
    """Draws from the prior.

    Attributes
    ----------
    kernel : Kernel
        Of the network, with the order of elements.
    prior : Prior
    parameters : PopulationParameters
        W sets of population parameters.
    people : ndarray, shape (W, P)
        One person from each population, on the unbounded scales of the parameters (natural logarithms of elements).
    unit : str
        Of the impedance.
    """

    kernel: Kernel
    prior: Prior
    parameters: PopulationParameters
    people: np.ndarray
    unit: str

    def __repr__(self) -> str:
        return f"<PriorSample of {self.kernel.network}: {len(self.people)} populations>"

    def _repr_html_(self) -> str:
        quantiles = np.quantile(values_of(self.kernel.parameters, self.parameters.mu), (0.05, 0.5, 0.95), axis=0)
        rows = [(p.name, p.unit(self.unit), *quantiles[:, i].tolist()) for i, p in enumerate(self.kernel.parameters)]
        return joined(heading(repr(self).strip("<>")), table(["element", "unit", "5 %", "median", "95 %"], rows))

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each population: the central value of each element in its unit, and of one person (``_person``).

        ``attrs["units"]`` holds the units.
        """
        import pandas as pd

        parameters = self.kernel.parameters
        frames = [
            pd.DataFrame(values_of(parameters, u), columns=[p.name + ending for p in parameters])
            for u, ending in ((self.parameters.mu, ""), (self.people, "_person"))
        ]
        frame = pd.concat(frames, axis=1)
        frame.attrs["units"] = {p.name + e: p.unit(self.unit) for p in parameters for e in ("", "_person")}
        return frame

    def impedance(self, frequency_hz: npt.ArrayLike) -> np.ndarray:
        """Impedance of each person without noise, complex, shape (W, F): the prior predictive distribution."""
        with np.errstate(all="ignore"):  # a wide prior reaches where an element overflows
            return self.kernel.impedance(self.people, frequency_hz)


def sample_prior(
    recordings: Recordings,
    network: Network | str | None = None,
    *,
    settings: FitSettings | None = None,
    n: int = 1000,
    seed: int = 1,
) -> PriorSample:
    """Draw from the prior that a fit with these arguments has.

    Parameters
    ----------
    recordings : Recordings
        Their unit, band and size centre the default prior; their values are used for nothing else.
    network, settings
        As in :func:`~bayes_impedance.population.fit.fit_population`.
    n : int
        Number of populations, with one person from each.
    seed : int

    Raises
    ------
    InputError
        If there is no network, or the prior does not belong to it.
    """
    settings = settings or FitSettings()
    recordings, terms = with_terms(recordings, settings.covariates)
    settings = replace(settings, covariates=terms)
    model = checked_model(recordings, within_rig(recordings, network), settings.covariates)
    one = len(recordings.subjects) == 1
    pooling = Pooling(model.kernel) if one else Pooling.of(model.kernel)
    if settings.distribution == MIXTURE and not one:
        require_people_for_groups(len(recordings), pooling.varying.size)
    whole = Whole(pooling)
    prior = whole.prior(prior_for(model.kernel, recordings, settings))
    correlated = settings.covariance == "full" and not too_few_for_correlations(len(recordings), pooling.varying.size)
    rng = np.random.default_rng(seed)
    parameters = draw_prior(
        prior,
        n,
        rng,
        shared=np.array([name in pooling.names for name in model.kernel.elements]),
        correlated=correlated,
        n_covariates=len(settings.covariates),
        tails=settings.distribution == STUDENT_T and not one,
        groups=settings.distribution == MIXTURE and not one,
    )
    own = standard_people(rng.normal(size=parameters.mu.shape), parameters.tail, parameters.groups, rng)
    people = parameters.mu + np.einsum("wpq,wq->wp", parameters.covariance_cholesky, own)
    return PriorSample(whole.kernel, prior, parameters, parameters.mu if one else people, recordings.unit)
