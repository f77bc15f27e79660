"""How far a fit can be trusted: limits, and what is said when one is passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.mcmc.ensemble import QUICK, Chains
from bayes_impedance.population.em import Estimate
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.posterior import RARELY, noise_within
from bayes_impedance.population.sharded_likelihood import KeptDraws
from bayes_impedance.recordings.files import Recordings

VARIANCE_LIMIT = 1.0
"""Above this Monte-Carlo variance of the log likelihood, the posterior is refused: its noise is then as large as the
differences of about one that make an interval."""

RHAT_LIMIT = 1.05
"""Above this disagreement between ensembles, the posterior is refused. The sampler aims at 1.01 (Vehtari et al. 2021);
between the two a result is shown with its R-hat."""

SHORTEST_CHAIN = 2.0
"""Ensembles of fewer autocorrelation times than this say little, not even how long their memory is."""

FEWEST_EFFECTIVE = 200.0
"""Fewer effective samples than this give no 5 % quantile worth the name: ten of two hundred lie below it."""

CLOSE_RIVAL = 10.0
"""A solution for the whole population whose log evidence is less than this behind is worth a remark: the evidences are
of thinned data and normal approximations, and a difference of five is already strong (Kass and Raftery 1995)."""

FEWEST_DRAWS_BELIEVED = 5.0
"""Effective draws below which, in one of twenty cases, a likelihood is preferred for where its draws happen to lie.
Measured with curved posteriors: with 9 and more, central values agreed with an independent integration."""

PARETO_LIMIT = 0.7
"""Above this tail of a person's weights, the effective number of draws means little (Vehtari et al. 2024)."""


@dataclass(frozen=True, kw_only=True)
class Diagnostics:
    """How far the result can be trusted.

    Attributes
    ----------
    rhat_max, effective_min, autocorrelation_max, acceptance : float
        Of the worst population coordinate.
    ensembles, steps, walkers : int
    log_likelihood_variance : float
        Monte-Carlo variance of the population's log likelihood, summed over persons, as far as it differs between
        populations of the posterior (:func:`~bayes_impedance.population.posterior.noise_within`); mean over the
        posterior.
    pareto_k, effective_draws : ndarray, shape (N,)
        Tail of each person's importance weights under the posterior's centre, and the smallest number of draws that
        they are worth under its populations.
    effective_draws_rarely : float
        Number that is fallen below in one of twenty cases, of persons and populations of the posterior.
    unconverged : tuple of str
        Persons whose mode failed the gradient test.
    redrawn : int
        How often the reference population was moved.
    rivals : tuple of float
        By how much other solutions for the whole population fall short in log evidence.
    """

    rhat_max: float
    effective_min: float
    autocorrelation_max: float
    acceptance: float
    ensembles: int
    steps: int
    walkers: int
    log_likelihood_variance: float
    pareto_k: np.ndarray
    effective_draws: np.ndarray
    effective_draws_rarely: float
    unconverged: tuple[str, ...]
    redrawn: int
    rivals: tuple[float, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons not to report numbers, one sentence each; empty if all is well."""
        found = []
        if not self.rhat_max <= RHAT_LIMIT:
            found.append(
                f"the ensembles disagree (R-hat {self.rhat_max:.3f}, limit {RHAT_LIMIT}): {self._remedy}, or the "
                "posterior has several modes"
            )
        if not self.steps >= SHORTEST_CHAIN * self.autocorrelation_max:
            found.append(
                f"the chains are too short ({self.steps} steps, autocorrelation time {self.autocorrelation_max:.0f}): "
                f"{self._remedy}"
            )
        if not self.effective_min >= FEWEST_EFFECTIVE:
            found.append(f"there are only {self.effective_min:.0f} effective samples of some parameter: {self._remedy}")
        if not self.log_likelihood_variance <= VARIANCE_LIMIT:
            found.append(
                f"the population likelihood is too noisy (variance {self.log_likelihood_variance:.2g}, limit "
                f"{VARIANCE_LIMIT}): {self._remedy}"
            )
        if not self.effective_draws_rarely >= FEWEST_DRAWS_BELIEVED:
            poor = int(np.sum(self.effective_draws < FEWEST_DRAWS_BELIEVED))
            found.append(
                f"the likelihood of {poor} subject(s) rests on {self.effective_draws.min():.1f} draws or so: "
                "the recordings leave elements undetermined along more than one direction, or a subject is far from "
                "the others; use a smaller network, a wider band, or leave the subject out"
            )
        if self.unconverged:
            some = ", ".join(self.unconverged[:5])
            found.append(
                f"the fit of {len(self.unconverged)} person(s) did not converge ({some}): check their recordings"
            )
        return tuple(found)

    @property
    def _remedy(self) -> str:
        """What the user can do about chains that are too short or draws that are too few."""
        if self.ensembles <= QUICK.ensembles:
            return "repeat the fit without --quick, which samples longer and from more draws"
        return "take a network with fewer elements, or --covariance diagonal"

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader should know although it does not spoil the result."""
        found = []
        if self.rivals and min(self.rivals) < CLOSE_RIVAL:
            found.append(
                "Another solution for all subjects is nearly as good (its log evidence is only "
                f"{min(self.rivals):.1f} lower): the elements may be those of the other; a wider band would tell."
            )
        bad = int(np.sum(self.pareto_k > PARETO_LIMIT))
        if bad:
            found.append(
                f"{bad} subject(s) have importance weights with a heavy tail (Pareto k up to "
                f"{self.pareto_k.max():.2f}): "
                "their own posteriors are less certain than they look."
            )
        return tuple(found)


def assess(
    recordings: Recordings,
    point: Estimate,
    chains: Chains,
    marginal: KeptDraws | None,
    parameters: PopulationParameters,
    redrawn: int,
) -> Diagnostics:
    """Collect the diagnostics of a fit; without a marginal likelihood (one person) there are no weights to judge."""
    n = len(recordings.subjects)
    samples = float(chains.log_probability.size)
    tail, effective, rarely, noise = np.zeros(n), np.full(n, samples), samples, 0.0
    if marginal is not None:
        some = parameters[np.linspace(0, parameters.mu.shape[0] - 1, 16).astype(int)]
        each = marginal.effective(some)
        tail, effective, rarely = marginal.pareto_k(some), each.min(axis=0), float(np.quantile(each, RARELY))
        noise = noise_within(float(np.mean(marginal.variance(some))), n, chains.coordinates.shape[-1])
    return Diagnostics(
        rhat_max=float(chains.rhat.max()),
        effective_min=float(chains.effective.min()),
        autocorrelation_max=float(chains.autocorrelation_time.max()),
        acceptance=chains.acceptance,
        ensembles=chains.coordinates.shape[0],
        steps=chains.steps,
        walkers=chains.walkers,
        log_likelihood_variance=noise,
        pareto_k=tail,
        effective_draws=effective,
        effective_draws_rarely=rarely,
        unconverged=tuple(s.name for s, well in zip(recordings.subjects, point.converged, strict=True) if not well),
        redrawn=redrawn,
        rivals=point.rivals,
    )
