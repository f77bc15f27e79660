"""Converged fit of the network alone to all people, so that residuals are not convergence error."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.majority import gathered
from bayes_impedance.diagnosis.fit.model import build, scales_of
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.recordings_alone import recordings_alone
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network
from bayes_impedance.population.em import Estimate, estimate
from bayes_impedance.population.given_prior import GivenPrior
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.recording_noise import initial_likelihoods
from bayes_impedance.population.requirements import checked_model
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.starting_fits import first_fits
from bayes_impedance.population.whole import Whole
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.checkpoint import claim
from bayes_impedance.runtime.progress import Progress

ROUNDS = 80
"""Largest number of rounds of the first fit. By choice: one not at rest then is continued after restarts."""

LAST_ROUNDS = 200
"""Largest number of rounds of a fit that has not come to rest after all restarts. By choice: five times as many as
before."""


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """The network fitted to a dataset, before anything is added.

    Attributes
    ----------
    recordings : Recordings
    fit : Refit
    refitter : Refitter
    determined : ndarray of bool, shape (P,)
    remarks : tuple of str
    shared : mapping of str to float
        Estimates of the network's parameters that are the same for everybody, at which the search holds them.
    """

    recordings: Recordings
    fit: Refit
    refitter: Refitter
    determined: np.ndarray
    remarks: tuple[str, ...]
    shared: Mapping[str, float] = field(default_factory=dict)


def fit_network(
    recordings: Recordings,
    network: Network | str | None,
    seed: int,
    executor: Executor,
    progress: Progress,
    checkpoint: Path | None = None,
    given: GivenPrior | None = None,
) -> Fitted:
    """Fit the network to all people, each from many starts: an unconverged fit looks like missing physics.

    With a `checkpoint` folder, first fits and point estimate are saved there and resumed from it. A given prior centres
    the starts and holds in the point estimate; in the refits that follow elements are free, except those of one person.
    """
    kernel = checked_model(recordings, network).kernel
    tree, one = kernel.network, len(recordings.subjects) == 1
    prior = default_prior(kernel, recordings)
    if given is not None:
        prior = given.applied(prior, kernel, recordings.unit)
    if checkpoint is not None:
        said = () if given is None else (given.text(),)
        claim(checkpoint, (s.digest for s in recordings.subjects), version("bayes_impedance"), str(tree), seed, *said)
    point = point_estimate(recordings, kernel, prior, seed, executor, progress, checkpoint)
    refitter = Refitter(point.likelihoods, executor, one)
    held = shared_values(point)
    model = build(tree.holding(held), (), scales_of(recordings), ())
    u = np.concatenate([m.theta + d.deviations for m, d in zip(point.modes, point.likelihoods, strict=True)])
    fit = refitter.fit(model, u, Population(point.mu, point.covariance, point.between_repetitions), ROUNDS)
    fit = gathered(refitter, recordings_alone(refitter, refitter.settle(fit, seed)))
    if not fit.settled:  # along an element that the recordings hardly determine, rounds are many and small
        fit = refitter.fit(model, fit.u, fit.population, LAST_ROUNDS)
    return Fitted(
        recordings=recordings,
        fit=fit,
        refitter=refitter,
        determined=point.determined,
        remarks=_trust(fit, point),
        shared=held,
    )


def point_estimate(
    recordings: Recordings,
    kernel: Kernel,
    prior: Prior,
    seed: int,
    executor: Executor,
    progress: Progress,
    checkpoint: Path | None = None,
) -> Estimate:
    """The most probable population of a network, from many starts for everybody."""
    seeds = np.random.SeedSequence(seed).spawn(2)
    one = len(recordings.subjects) == 1
    pooling = Pooling(kernel) if one else Pooling.of(kernel)
    first = first_fits(kernel, recordings, prior, seeds[0], executor, progress, checkpoint)
    likelihoods = initial_likelihoods(recordings, first.model, pooling.varying.size, executor)
    return estimate(
        pooling,
        likelihoods,
        first,
        prior,
        np.zeros((len(recordings.subjects), 0)),  # no covariates
        True,
        seeds[1],
        progress,
        one_person=one,
        checkpoint=None if checkpoint is None else checkpoint / "point_estimate.npz",
    )


def shared_values(point: Estimate) -> dict[str, float]:
    """Estimates of the parameters that are the same for everybody, in their units."""
    pooling = point.pooling
    if not pooling.names:
        return {}
    whole = Whole(pooling)
    u = pooling.whole(point.mu, point.shared) * whole.unit
    by_name = dict(zip(whole.kernel.parameters, u.tolist(), strict=True))
    return {p.name: float(p.value(np.array(value))) for p, value in by_name.items() if p.name in pooling.names}


def _trust(fit: Refit, point: Estimate) -> tuple[str, ...]:
    remarks = []
    if not fit.settled:
        remarks.append("The fit of the network did not converge; an unconverged fit looks like missing physics.")
    if point.rivals and min(point.rivals) < 6:
        remarks.append("Another solution for the whole population fits nearly as well; the network may be ambiguous.")
    return tuple(remarks)
