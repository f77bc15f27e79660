r"""The hierarchical model: recordings in, population parameters out.

The steps, each in a module of its own:

1. :mod:`~bayes_impedance.population.starting_fits`: first fits of all persons, and the noise;
2. :mod:`~bayes_impedance.population.em`: a point estimate of the population, each person's mode under it, and which
   elements the recordings determine;
3. :mod:`~bayes_impedance.person.importance_draws`: importance draws of each person's elements under that estimate;
4. :mod:`~bayes_impedance.population.importance_likelihood`, :mod:`~bayes_impedance.population.sharded_likelihood` and
   :mod:`~bayes_impedance.population.posterior`: the posterior density of population parameters, from these draws;
5. :mod:`~bayes_impedance.mcmc.ensemble`: emcee over :mod:`~bayes_impedance.population.parameters`, repeated with other
   draws if these do not hold for the sampled populations (:mod:`~bayes_impedance.population.sampling`);
6. each person's own posterior, by resampling the draws with their weights under each sampled population.

If there is a checkpoint folder, first fits, iterations of the point estimate and chains are saved as they are computed.
"""

from __future__ import annotations

import os
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bayes_impedance.mcmc.ensemble import sample
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network
from bayes_impedance.network.redundancy import Combination
from bayes_impedance.person.absolute_density import deviations_of, log_constant
from bayes_impedance.person.likelihood import information_share
from bayes_impedance.person.marginal_likelihood import find_ridge, marginal_log_likelihood
from bayes_impedance.person.noise import NoiseModel
from bayes_impedance.population.calibrated import known_of, prior_of, within_rig
from bayes_impedance.population.covariate_terms import with_terms
from bayes_impedance.population.dependence import dependent
from bayes_impedance.population.diagnostics import Diagnostics, assess
from bayes_impedance.population.em import Estimate, estimate, with_groups
from bayes_impedance.population.given_start import Start, unbounded_start
from bayes_impedance.population.heavy_tails import NORMAL, STUDENT_T
from bayes_impedance.population.map_error import with_map_error, with_map_noise
from bayes_impedance.population.noise_tails import likelihoods_of, weights_kept
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.posterior import Posterior
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.recording_noise import scaled_noise
from bayes_impedance.population.requirements import (
    CheckedModel,
    checked_model,
    require_people_for_groups,
    too_few_for_correlations,
)
from bayes_impedance.population.sampling import kept_sets, sampled
from bayes_impedance.population.settings import QUICK_SETTINGS, FitSettings
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.shown_fit import ShownFit
from bayes_impedance.population.starting_fits import FirstFits, first_fits
from bayes_impedance.population.two_components import MIXTURE
from bayes_impedance.population.whole import Whole
from bayes_impedance.recordings.dataset import require_recordings
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.checkpoint import claim
from bayes_impedance.runtime.clock import Clock
from bayes_impedance.runtime.executors import executor_of, map_persons
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.user_table import whole_number_in

__all__ = ["IDENTIFIED_SD", "QUICK_SETTINGS", "FitSettings", "PopulationFit", "fit_population", "prior_for"]

IDENTIFIED_SD = 1.0
"""A central value is reported if the posterior standard deviation of its logarithm is below this: a factor e. By
choice: a higher limit reports values whose order of magnitude is uncertain."""

_POINT_ESTIMATE = "point_estimate.npz"


@dataclass(frozen=True, kw_only=True, repr=False)
class PopulationFit(ShownFit):
    """Posterior of a population.

    Attributes
    ----------
    recordings : Recordings
    kernel : Kernel
        With the network and the order of elements.
    written : Network
        The network as given. It has adjacent elements of one kind if there are `combinations`.
    combinations : tuple of Combination
        Adjacent elements of one kind that were replaced by one equivalent element in the fitted network.
    prior : Prior
    settings : FitSettings
    seed : int
    parameters : PopulationParameters
        E S sets, ensemble by ensemble. For one person: that person's log elements in `mu`, dispersions NaN.
    n_ensembles : int
    log_probability : ndarray, shape (E, S)
    person_draws : ndarray, shape (E, S, N, P)
        Each person's log elements: the mean over the person's repetitions. Of more people than one in single
        precision: it is the largest array.
    person_log_likelihood : ndarray, shape (E, S, N)
        Log density of each person's recordings under the population draws, with everything of the person integrated
        out (:mod:`~bayes_impedance.population.person_densities`); of one person alone, under that person's elements.
    deviations : tuple of ndarray, shape (J, P)
        Estimated deviations of the repetitions.
    noise : tuple of ndarray, shape (J, F)
        Standard deviation of the noise of each recording, the person's scale included.
    noise_model : NoiseModel or None
        From which this noise was made; None if all recordings came with theirs.
    noise_scale : ndarray, shape (N,)
        Ratio of the residuals to the noise estimate: near one if the network describes the person.
    identified : ndarray of bool, shape (P,)
    diagnostics : Diagnostics
    seconds : dict
        Time of each step.
    noise_tail : ndarray, shape (3,), or None
        Reciprocal degrees of freedom of the noise, if they were asked for: the most probable, and the ends of their
        90 % interval. `noise` then holds the scales of the t distribution.
    noise_weights : tuple of ndarray, shape (J, F), or None
        Weights of the points; None if the noise is normal.
    """

    recordings: Recordings
    kernel: Kernel
    written: Network
    combinations: tuple[Combination, ...]
    prior: Prior
    settings: FitSettings
    seed: int
    parameters: PopulationParameters
    n_ensembles: int
    log_probability: np.ndarray
    person_draws: np.ndarray
    person_log_likelihood: np.ndarray
    deviations: tuple[np.ndarray, ...]
    noise: tuple[np.ndarray, ...]
    noise_model: NoiseModel | None
    noise_scale: np.ndarray
    identified: np.ndarray
    diagnostics: Diagnostics
    seconds: dict[str, float]
    noise_tail: np.ndarray | None = None
    noise_weights: tuple[np.ndarray, ...] | None = None

    @property
    def one_person(self) -> bool:
        """Whether there is only one person, and so no dispersion."""
        return len(self.recordings.subjects) == 1

    @property
    def person_means(self) -> np.ndarray:
        """Mean of each person's draws, (N, P)."""
        return np.asarray(self.person_draws.mean(axis=(0, 1), dtype=float))

    @property
    def repeated(self) -> bool:
        """Whether at least one person was recorded more than once."""
        return any(len(s.repetitions) > 1 for s in self.recordings.subjects)


def fit_population(
    recordings: Recordings,
    network: Network | str | None = None,
    *,
    settings: FitSettings | None = None,
    seed: int = 1,
    workers: int = 2,
    progress: Progress = lambda *_: None,
    checkpoint: str | os.PathLike[str] | None = None,
    executor: Executor | None = None,
    start: Start | None = None,
) -> PopulationFit:
    """Estimate the elements of a population from its recordings.

    Parameters
    ----------
    recordings : Recordings
        One person or more. With one, the result is that person's posterior under the broad prior, without dispersions.
    network : Network or str, optional
        The network that describes each person; the dataset's own if not given.
    settings : FitSettings, optional
    seed : int
        The same seed and data give the same numbers on one machine.
    workers : int
        Number of threads of this process; the result does not depend on it. They always sample the ensembles.
    progress : callable, optional
        Called with stage, done, total.
    checkpoint : path, optional
        Folder where first fits, point estimate and chains are saved as they are computed; an interrupted fit with the
        same arguments continues from there.
    executor : Executor, optional
        Runs the computations for single persons: processes, a cluster's workers, or any standard executor. Threads of
        this process if not given; the result is the same.
    start : mapping of str to float or ndarray, optional
        Values of all parameters of the network in their units, one for all people or one for each, (N,): a population
        from which the fit begins too (:mod:`~bayes_impedance.population.given_start`).

    Returns
    -------
    PopulationFit
        Look at ``diagnostics.problems`` first.

    Raises
    ------
    InputError
        If there is no network, a covariate is unknown, incomplete or collinear with others, a person has fewer points
        than elements, `checkpoint` belongs to another fit, or `start` does not suit the network.
    """
    from threadpoolctl import threadpool_limits

    require_recordings(recordings)
    whole_number_in(seed, "seed", 0)
    whole_number_in(workers, "workers", 1)
    checkpoint = None if checkpoint is None else Path(checkpoint)
    settings = settings or FitSettings()
    recordings, terms = with_terms(recordings, settings.covariates)
    recordings = with_map_noise(recordings)
    settings = replace(settings, covariates=terms, sampler=replace(settings.sampler, workers=workers))
    model = checked_model(recordings, within_rig(recordings, network), settings.covariates)
    kernel, covariates = model.kernel, model.covariates
    one = len(recordings.subjects) == 1
    if one:
        settings = replace(settings, distribution=NORMAL)
    pooling = Pooling(kernel) if one else Pooling.of(kernel)  # one person's own and the same for all: no difference
    whole = Whole(pooling)
    if settings.distribution == MIXTURE:
        require_people_for_groups(len(recordings.subjects), pooling.varying.size)
    if too_few_for_correlations(len(recordings.subjects), pooling.varying.size):
        settings = replace(settings, covariance="diagonal")
    prior = prior_for(kernel, recordings, settings)
    rig = () if recordings.calibration is None else recordings.calibration.parameters
    begin = None if start is None else unbounded_start(start, kernel, len(recordings.subjects), prior, rig)
    seeds = np.random.SeedSequence(seed).spawn(6)
    if checkpoint is not None:
        same_for_any = replace(settings, sampler=replace(settings.sampler, workers=0))
        taken = covariates.tolist(), *known_of(recordings), *(() if begin is None else begin.tolist())
        others = version("bayes_impedance"), str(kernel.network), same_for_any, seed, *taken
        claim(checkpoint, (s.digest for s in recordings.subjects), *others)
    clock = Clock()
    # The linear algebra library must not start its own threads inside ours.
    own = executor_of(workers) if executor is None else nullcontext(executor)
    with threadpool_limits(1), own as executor:
        with clock.measure("modes"):
            tails = settings.noise_distribution == STUDENT_T
            first = first_fits(kernel, recordings, prior, seeds[0], executor, progress, checkpoint, tails, begin)
            point = estimate(
                pooling,
                likelihoods_of(kernel, recordings, first, pooling.varying.size, executor),
                first,
                prior,
                covariates,
                settings.covariance == "full",
                seeds[1],
                progress,
                one_person=one,
                checkpoint=None if checkpoint is None else checkpoint / _POINT_ESTIMATE,
                tails=settings.distribution == STUDENT_T,
            )
            point = with_groups(point, covariates) if settings.distribution == MIXTURE else point
        if one:
            alone = _one_person(
                recordings, whole, model, prior, settings, seed, point, first, seeds[2], clock, progress, checkpoint
            )
            return with_map_error(alone, seeds[5], IDENTIFIED_SD)
        repetitions = np.array([len(s.repetitions) for s in recordings.subjects])
        full = settings.covariance == "full"
        posterior = Posterior(repetitions, prior, full, settings.draws, point, covariates)
        posterior, chains, error = sampled(
            posterior, settings.sampler, seeds[3], seeds[2], executor, clock, progress, checkpoint
        )
        with clock.measure("persons"):
            kept = kept_sets(chains, len(recordings.subjects) * len(kernel.elements))
            flat = chains.coordinates[:, kept].reshape(-1, chains.coordinates.shape[-1])
            parameters = posterior.coordinates.unpack(flat)
            known = point.determined & (parameters.mu.std(axis=0) < IDENTIFIED_SD)
            shared_spread = np.zeros(0) if parameters.shared is None else parameters.shared.std(axis=0)
            known_shared = point.shared_determined & (shared_spread < IDENTIFIED_SD)
            depends, shared_depends = dependent(point, parameters, known, known_shared, prior)
            identified = pooling.whole(known & ~depends, known_shared & ~shared_depends).astype(bool)
            weights = weights_kept(first.degrees, point)
            point.forget()
            person_draws, person_likelihood = posterior.marginal.persons(parameters, seeds[4])
            diagnostics = assess(recordings, point, chains, posterior.marginal, parameters, posterior.redrawn, error)
            scale = point.scale * np.sqrt(information_share(first.degrees))
            noise = tuple(map_persons(executor, partial(scaled_noise, first.model), recordings.subjects, scale))
    shape = (settings.sampler.ensembles, -1, len(recordings.subjects))
    fit = PopulationFit(
        recordings=recordings,
        kernel=whole.kernel,
        written=model.written,
        combinations=model.combinations,
        prior=whole.prior(prior),
        settings=settings,
        seed=seed,
        parameters=whole.parameters(parameters),
        n_ensembles=settings.sampler.ensembles,
        log_probability=chains.log_probability[:, kept],
        person_draws=whole.persons(person_draws, parameters.shared).reshape(*shape, len(kernel.elements)),
        person_log_likelihood=person_likelihood.reshape(*shape),
        deviations=tuple(whole.without(own) for own in point.deviations),
        noise=noise,
        noise_model=first.model,
        noise_scale=scale,
        identified=identified,
        diagnostics=diagnostics,
        seconds=clock.seconds,
        noise_tail=first.tail,
        noise_weights=weights,
    )
    return with_map_error(fit, seeds[5], IDENTIFIED_SD)


def _one_person(
    recordings: Recordings,
    whole: Whole,
    model: CheckedModel,
    prior: Prior,
    settings: FitSettings,
    seed: int,
    point: Estimate,
    first: FirstFits,
    sampler_seed: np.random.SeedSequence,
    clock: Clock,
    progress: Progress,
    checkpoint: Path | None,
) -> PopulationFit:
    """Posterior of the only person's elements under the broad prior, sampled directly."""
    kernel = whole.pooling.kernel
    mode, likelihood = point.modes[0], point.likelihoods[0]
    ridge = find_ridge(kernel, likelihood, mode.theta, mode.scale, point.between_repetitions)
    sd = np.sqrt(np.diag(np.linalg.inv(mode.precision)))
    scale = mode.scale * float(np.sqrt(information_share(first.degrees)))

    def log_probability(u: np.ndarray) -> np.ndarray:
        theta = mode.theta + sd * u
        value = marginal_log_likelihood(kernel, likelihood, ridge, theta) + prior.log_density(theta)
        return np.where(prior.order.obeyed(theta), value, -np.inf)

    with clock.measure("population"):
        chains = sample(
            log_probability,
            (prior.order.nearest(mode.theta, sd) - mode.theta) / sd,
            0.5 * np.ones(sd.size),
            settings.sampler,
            sampler_seed,
            progress,
            checkpoint,
        )
    theta = mode.theta + sd * chains.coordinates.reshape(-1, sd.size)
    constant = log_constant(likelihood, ridge, deviations_of(kernel, likelihood, ridge.theta))
    log_density = marginal_log_likelihood(kernel, likelihood, ridge, theta) + constant
    n, p = theta.shape
    nothing = np.full((n, p), np.nan)
    parameters = PopulationParameters(
        mu=theta,
        between_persons=nothing,
        correlation_cholesky=np.tile(np.eye(p), (n, 1, 1)),
        between_repetitions=nothing,
        slopes=np.zeros((n, p, 0)),
    )
    ensembles = settings.sampler.ensembles
    return PopulationFit(
        recordings=recordings,
        kernel=whole.kernel,
        written=model.written,
        combinations=model.combinations,
        prior=whole.prior(prior),
        settings=settings,
        seed=seed,
        parameters=whole.parameters(parameters),
        n_ensembles=ensembles,
        log_probability=chains.log_probability,
        person_draws=whole.persons(theta[:, None], None).reshape(ensembles, -1, 1, p),
        person_log_likelihood=log_density.reshape(ensembles, -1, 1),
        deviations=(likelihood.deviations,),
        noise=(scaled_noise(first.model, recordings.subjects[0], scale),),
        noise_model=first.model,
        noise_scale=np.array([scale]),
        identified=(point.determined | prior.known) & (theta.std(axis=0) < IDENTIFIED_SD),
        diagnostics=assess(recordings, point, chains, None, parameters, 0),
        seconds=clock.seconds,
        noise_tail=first.tail,
        noise_weights=weights_kept(first.degrees, point),
    )


def prior_for(kernel: Kernel, recordings: Recordings, settings: FitSettings) -> Prior:
    """The default prior, with what a calibration and the settings say."""
    prior = prior_of(kernel, recordings)
    return prior if settings.prior is None else settings.prior.applied(prior, kernel, recordings.unit)
