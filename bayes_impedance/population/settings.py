"""Settings of a fit: what the population is, and how many draws and chains describe it."""

from __future__ import annotations

from dataclasses import dataclass, field

from bayes_impedance.display import Chosen
from bayes_impedance.errors import InputError
from bayes_impedance.mcmc.ensemble import QUICK, SamplerSettings
from bayes_impedance.population.given_prior import GivenPrior
from bayes_impedance.population.heavy_tails import NORMAL, STUDENT_T
from bayes_impedance.population.noise_tails import NOISE_DISTRIBUTIONS
from bayes_impedance.population.two_components import MIXTURE
from bayes_impedance.runtime.user_table import shown, whole_number_in

DISTRIBUTIONS = (NORMAL, STUDENT_T, MIXTURE)
"""Of people's log elements, the default first."""


@dataclass(frozen=True, kw_only=True, repr=False)
class FitSettings(Chosen):
    """Settings of a fit.

    Attributes
    ----------
    covariance : str
        ``full`` (elements are correlated between persons) or ``diagonal``, which is also used if the number of persons
        is less than the number of elements plus two.
    covariates : tuple of str
        Covariates, columns of text and interactions (``age_y:sex``) on which the mean log elements depend linearly.
    draws : int
        Draws for each person, a power of two. Measured with 256 (six populations of 71 people): they leave an error
        of 0.04 to 0.07 posterior standard deviations at the ends of intervals, the chains 0.05 and more.
    sampler : SamplerSettings
    prior : GivenPrior, optional
        What replaces the default prior (:mod:`~bayes_impedance.population.given_prior`).
    distribution : str
        Of people's log elements: ``normal``, ``student_t`` with degrees of freedom that are inferred
        (:mod:`~bayes_impedance.population.heavy_tails`), or ``mixture``, two groups of people
        (:mod:`~bayes_impedance.population.two_components`), which takes a full covariance. One person has none.
    noise_distribution : str
        Of the noise: ``normal``, or ``student_t`` with degrees of freedom that are estimated
        (:mod:`~bayes_impedance.population.noise_tails`): points far off then count little.
    """

    covariance: str = "full"
    covariates: tuple[str, ...] = ()
    draws: int = 256
    sampler: SamplerSettings = field(default_factory=SamplerSettings)
    prior: GivenPrior | None = None
    distribution: str = NORMAL
    noise_distribution: str = NORMAL

    def __post_init__(self) -> None:
        if self.covariance not in ("full", "diagonal"):
            raise InputError(f"covariance is '{self.covariance}': choose 'full' or 'diagonal'")
        if self.distribution not in DISTRIBUTIONS:
            raise InputError(f"distribution is '{self.distribution}': choose 'normal', 'student_t' or 'mixture'")
        if self.noise_distribution not in NOISE_DISTRIBUTIONS:
            raise InputError(f"noise_distribution is '{self.noise_distribution}': choose 'normal' or 'student_t'")
        if self.distribution == MIXTURE and self.covariance != "full":
            raise InputError(
                "two groups that differ in several elements make these correlated: a mixture takes "
                f"covariance 'full', not '{self.covariance}'"
            )
        if not isinstance(self.covariates, tuple) or not all(isinstance(name, str) for name in self.covariates):
            raise InputError("covariates must be a tuple of names, such as ('age_y',)")
        whole_number_in(self.draws, "draws", 1)
        if self.prior is not None and not isinstance(self.prior, GivenPrior):
            raise InputError(
                f"prior is {shown(self.prior)}, but must be a GivenPrior: read a file with read_prior(path)"
            )


QUICK_SETTINGS = FitSettings(sampler=QUICK)
"""By choice: shorter chains, faster but with a larger Monte-Carlo error."""
