"""Diagnostics of a fit: their limits, and the messages when a limit is exceeded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.mcmc.ensemble import QUICK, Chains
from bayes_impedance.population.draw_error import ERROR_WANTED, DrawError, noise_within
from bayes_impedance.population.em import Estimate
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.posterior import RARELY
from bayes_impedance.population.sharded_likelihood import KeptDraws
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.units import counted

MISSED_LIMIT = 1.0
"""Largest error of the log likelihood from moving draws with shared parameters. By choice: as for its noise, below."""

VARIANCE_LIMIT = 1.0
"""Above this Monte-Carlo variance of the log likelihood, the posterior is refused: the noise is then as large as the
differences in log likelihood, about one, that determine the width of an interval."""

RHAT_LIMIT = 1.05
"""Above this R-hat between ensembles, the posterior is refused. The sampler aims at 1.01 (Vehtari et al. 2021); between
the two the result is shown with its R-hat. By choice: a higher limit shows results of less converged chains."""

SHORTEST_CHAIN = 2.0
"""Least length of an ensemble's chain in autocorrelation times. By choice: in shorter chains the autocorrelation time
itself cannot be estimated."""

FEWEST_EFFECTIVE = 200.0
"""Below this effective sample size the 5 % quantile is not determined well: of 200 samples only ten lie below it."""

CLOSE_RIVAL = 10.0
"""A remark is made if another mode of the population's posterior has a log evidence within this difference of the best
one. A difference of five is already strong evidence (Kass and Raftery 1995); the limit is larger because the evidences
are computed from thinned data with normal approximations."""

FEWEST_DRAWS_BELIEVED = 5.0
"""Least effective number of importance draws at the 5 % quantile over persons and sampled populations. Below it the
estimated likelihood depends on where the few draws happen to lie. Measured with curved posteriors: with 9 and more,
central values agreed with an independent integration."""

ERROR_LIMIT = 0.2
"""Above this standard error of the ends of 90 % intervals by the draws, in posterior standard deviations, the posterior
is refused. An interval whose ends are off by 0.2 (one sigma) covers 89 %. The error is of first order: in a band of 100
to 101 Hz, where it was found as 0.4 and 0.3, lower ends were off by 0.5 and 0.9; where it was 0.1, by 0.3 at most.
With fewer draws for somebody than are believed (:data:`FEWEST_DRAWS_BELIEVED`), the limit is the error that draws are
made to meet (:data:`~bayes_impedance.population.draw_error.ERROR_WANTED`)."""

BEYOND_LIMIT = 0.05
"""Above this share of a dispersion's draws beyond one end of the range in which likelihoods are known, the posterior is
refused: an end of a 90 % interval lies there too."""

PARETO_LIMIT = 0.7
"""Above this Pareto k (tail index) of a person's importance weights, the effective number of draws is not reliable
(Vehtari et al. 2024)."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Diagnostics(Brief):
    """Diagnostics of the sampler and of the importance draws.

    Attributes
    ----------
    rhat_max, effective_min, autocorrelation_max, acceptance : float
        Of the worst population coordinate.
    ensembles, steps, walkers : int
    log_likelihood_variance : float
        Monte-Carlo variance of differences of the population's log likelihood within the posterior, summed over
        persons (:func:`~bayes_impedance.population.draw_error.noise_within`); mean over the posterior.
    pareto_k, effective_draws : ndarray, shape (N,)
        Pareto tail index of each person's importance weights under the posterior's centre, and the smallest effective
        number of draws under population parameters sampled from the posterior.
    effective_draws_rarely : float
        5 % quantile of the effective number of draws over persons and sampled population parameters.
    unconverged : tuple of str
        Persons whose mode failed the gradient test.
    redrawn : int
        How often the reference population was moved.
    missed : float
        Largest error of the log likelihood, at test points, from moving the draws with the parameters that are the same
        for everybody; zero if there are none.
    rivals : tuple of float
        Differences in log evidence between the chosen mode of the population and the other modes found.
    draw_error : DrawError
        Error of the population's intervals by the finite number of draws.
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
    missed: float
    rivals: tuple[float, ...]
    draw_error: DrawError

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons not to report numbers, one sentence each; empty if there are none."""
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
                f"the likelihood of {counted(poor, 'subject')} rests on {self.effective_draws.min():.1f} draws or so: "
                "the recordings leave elements undetermined along more than one direction, or a subject is far from "
                "the others; use a smaller network, a wider band, or leave the subject out"
            )
        limit = ERROR_LIMIT if self.draw_error.least_effective >= FEWEST_DRAWS_BELIEVED else ERROR_WANTED
        if not self.draw_error.interval_end <= limit:
            found.append(
                f"the importance draws do not hold for all populations that are possible (they leave an error of "
                f"{self.draw_error.interval_end:.2g} standard deviations in the intervals, limit {limit:g}): the "
                "recordings leave elements nearly undetermined; use a smaller network or a wider band"
            )
        if not self.draw_error.beyond <= BEYOND_LIMIT:
            found.append(
                f"a dispersion between repetitions lies where the draws' likelihoods are not known "
                f"({self.draw_error.beyond:.0%} of its draws, limit {BEYOND_LIMIT:.0%}): the recordings leave its "
                "element nearly undetermined; use a smaller network or a wider band"
            )
        if not self.missed <= MISSED_LIMIT:
            found.append(
                f"the likelihood is uncertain where parameters that are the same for all (*) change (error "
                f"{self.missed:.2g}, limit {MISSED_LIMIT:g}): elements of some are undetermined or have "
                "two solutions; use a smaller network or a wider band, or hold the parameter at a known value"
            )
        if self.unconverged:
            n, some = len(self.unconverged), ", ".join(self.unconverged[:5])
            found.append(
                f"the fit of {n} subject{'s' if n > 1 else ''} did not converge ({some}): check the recordings"
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
        """Remarks that a reader should know but that do not invalidate the result."""
        found = []
        if self.rivals and min(self.rivals) < CLOSE_RIVAL:
            found.append(
                "Another solution for all subjects is nearly as good (its log evidence is only "
                f"{min(self.rivals):.1f} lower): the elements may be those of the other; a wider band would tell."
            )
        bad = int(np.sum(self.pareto_k > PARETO_LIMIT))
        if bad:
            found.append(
                f"the importance weights of {counted(bad, 'subject')} have a heavy tail (Pareto k up to "
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
    error: DrawError | None = None,
) -> Diagnostics:
    """Collect the diagnostics of a fit. With one person there is no marginal likelihood: no weights are assessed."""
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
        missed=0.0 if marginal is None else marginal.missed(),
        rivals=point.rivals,
        draw_error=error or DrawError(interval_end=0.0, least_effective=samples),
    )
