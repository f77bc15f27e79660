"""Diagnosis from start to end: fit, locate, search, confirm, and report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from bayes_impedance.diagnosis import catalogue  # noqa: F401  (fills the register of effects)
from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.catalogue.offered import offered
from bayes_impedance.diagnosis.claimed_simulation import Claim, claim_of
from bayes_impedance.diagnosis.extended_network import ExtendedNetwork, extended_network, no_networks
from bayes_impedance.diagnosis.extended_posterior import extended_posterior
from bayes_impedance.diagnosis.extended_start import extended_start, medians
from bayes_impedance.diagnosis.findings import Findings, find
from bayes_impedance.diagnosis.first_fit import FirstFit, fit_without_hum
from bayes_impedance.diagnosis.fit.baseline import Fitted
from bayes_impedance.diagnosis.fit.calibration_error import Corrected, without_calibration_error
from bayes_impedance.diagnosis.fit.evidence_posterior import evidence_posterior
from bayes_impedance.diagnosis.fit.majority import joined
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.heterogeneity.compare_populations import compare_populations
from bayes_impedance.diagnosis.heterogeneity.correlations import CorrelationTest
from bayes_impedance.diagnosis.heterogeneity.subgroups import Subgroup
from bayes_impedance.diagnosis.heterogeneity.tests import find_structures
from bayes_impedance.diagnosis.rig_instead import beyond_calibration, rig_instead, without_rig
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.cross_validation import held_out
from bayes_impedance.diagnosis.selection.restart import another_beginning
from bayes_impedance.diagnosis.selection.stepwise import first_step
from bayes_impedance.diagnosis.types import Diagnosis
from bayes_impedance.diagnosis.verdict.model_bands import snapshot
from bayes_impedance.diagnosis.verdict.ranking import ranking
from bayes_impedance.diagnosis.verdict.verdict import Evidence, make_verdict
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Network
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.given_prior import GivenPrior
from bayes_impedance.population.given_start import Start
from bayes_impedance.recordings.dataset import require_recordings
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.curve_errors import on_grid
from bayes_impedance.runtime.clock import Clock
from bayes_impedance.runtime.executors import executor_of
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.user_table import whole_number_in

_SEARCHES = 3
"""Largest number of searches in recordings whose calibration has an error: the second is with an error that what the
first has found no longer moves. By choice."""

_OF_THE_SHAPE = (Subgroup, CorrelationTest)
"""Findings about the shape of the population's distribution. The elements of an unnamed network only approximate the
physics, and their distribution is another one: a covariate or a drift still shifts them, but groups and correlations
may be artefacts of the network."""

_SHAPE_UNKNOWN = (
    "The elements are not distributed as the population's distribution says; whether subjects form groups cannot be "
    "known while elements without a name describe them."
)

_QUICK_IS_EXACT = (
    "Without the population's posterior (--quick) the intervals of what was found take the calibration as exact."
)

_NO_POSTERIOR = (
    "The posterior of the network with what was found is not reliable, and the intervals of what was found are those "
    "of Laplace's approximation"
)
_WITH_PRIOR = (
    "The given prior holds in the first estimate and in the posterior of the network with what was found; the search "
    "for effects leaves the elements free."
)
_COMBINED = (
    "elements of what was found and of the network together: the intervals of what was found are those of "
    "Laplace's approximation."
)
_IN_SOME = (
    "is in some subjects only, and the population of a network has it in all: the intervals of what was found are "
    "those of Laplace's approximation"
)
_NOT_IN_NETWORK = (
    "cannot be written as a network, and without it the posterior of a network does not describe the recordings: the "
    "intervals of what was found are those of Laplace's approximation"
)


@dataclass(frozen=True, kw_only=True)
class _Job:
    """Arguments and resources shared by all parts of one diagnosis."""

    effects: tuple[Effect, ...]
    diagonal: bool
    quick: bool
    seed: int
    executor: Executor
    progress: Progress
    checkpoint: Path | None
    prior: GivenPrior | None


def diagnose(
    recordings: Recordings,
    network: Network | str | None = None,
    *,
    simulation: Recordings | None = None,
    effects: Sequence[Effect] | None = None,
    diagonal: bool = False,
    quick: bool = False,
    seed: int = 1,
    workers: int = 2,
    progress: Progress = lambda *_: None,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    prior: GivenPrior | None = None,
) -> Diagnosis:
    """Find effects in recordings that a network lacks.

    Parameters
    ----------
    recordings : Recordings
        One recording or many.
    network : Network or str, optional
        The claimed network; that of the dataset if not given.
    simulation : Recordings, optional
        A simulated population that claims to describe the recordings. The part of it that the network does not explain
        is removed from the recordings. If it is of the same people, each person is compared with the own simulation
        (:mod:`bayes_impedance.diagnosis.claimed_simulation`).
    effects : sequence of Effect, optional
        Candidates; all that are registered if not given.
    diagonal : bool
        Whether the claimed population has independent elements; by default they may be correlated.
    quick : bool
        Without held-out frequencies, without proposals of measurements to separate rivals, and without the population's
        posterior of the network with what was found: intervals are then those of Laplace's approximation.
    seed : int
        The same seed and data give the same verdict on one machine.
    workers : int
        Threads; the verdict does not depend on their number.
    progress : callable, optional
        Called with stage, done, total.
    executor : Executor, optional
        Runs the work that is done person by person and recording by recording: processes, workers of a cluster, or any
        other with the standard interface. Threads of this process if not given; the verdict is the same.
    checkpoint : path, optional
        Folder in which the first fit of the network is saved as it progresses; an interrupted diagnosis with the same
        arguments resumes from it. The later search is not saved.
    prior : GivenPrior, optional
        Knowledge of the network's elements: it centres the starts, and holds in the first estimate of the population
        and in the posterior of the network with what was found. The search leaves the elements free, as an effect must
        not be found because a prior was wrong; of one person the prior holds there too.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        If there is no network, or a person has fewer points than elements.
    """
    from threadpoolctl import threadpool_limits

    require_recordings(recordings)
    whole_number_in(seed, "seed", 0)
    whole_number_in(workers, "workers", 1)
    clock = Clock()
    candidates = registered() if effects is None else effects
    own = executor_of(workers) if executor is None else nullcontext(executor)
    with threadpool_limits(1), own as executor:
        job = _Job(
            effects=offered(candidates, recordings),
            diagonal=diagonal,
            quick=quick,
            seed=seed,
            executor=executor,
            progress=progress,
            checkpoint=None if checkpoint is None else Path(checkpoint),
            prior=prior,
        )
        with clock.measure("fit"):
            inside = without_calibration_error(recordings, network, seed, executor, progress)
        claimed = None
        if simulation is not None:
            with clock.measure("simulation"):
                claimed = claim_of(simulation, network, offered(candidates, simulation), seed, executor, progress)
        return _diagnose(inside, claimed, job, clock)


def _diagnose(inside: Corrected, claimed: Claim | None, job: _Job, clock: Clock) -> Diagnosis:
    """The steps in their order: fit, search, confirm, report."""
    for k in range(_SEARCHES):
        compared = inside.recordings if claimed is None else claimed.without_rest(inside.recordings)
        first, look = _found(compared, inside.network, claimed, job, clock)
        larger = without_rig(look.final.model, inside)
        if inside.given.calibration is None or not larger.additions or k == _SEARCHES - 1:
            break
        with clock.measure("fit"):
            network = extended_network(larger, first.fitted.shared).network
            before, inside = inside, inside.with_found(network, job.seed, job.executor, job.progress)
        if inside.recordings is before.recordings:
            break
    with clock.measure("confirm"):
        evidence = _confirm(first, look, claimed, job)
        instead = rig_instead(inside, first.fitted, evidence.final, evidence.remaining)
        evidence = replace(evidence, remarks=(*inside.remarks, *instead, *evidence.remarks))
        if instead and job.quick:
            evidence = replace(evidence, remarks=(*evidence.remarks, _QUICK_IS_EXACT))
    extended = extended_network(evidence.final.model, first.fitted.shared) if evidence.changed else None
    fit, start = None, None
    if extended is not None:
        measured = inside.as_given(first.clean)
        start = extended_start(evidence.final, extended, measured, first.fitted.shared)
        if not job.quick:
            with clock.measure("posterior"):
                evidence, fit = _measured(evidence, extended, measured, start, job)
    if evidence.posterior is None and evidence.found.final.model.additions:
        with clock.measure("posterior"):
            near = evidence_posterior(first.fitted.refitter, evidence.found.final, job.seed)
            evidence = replace(evidence, posterior=near)
    with clock.measure("verdict"):
        verdict = make_verdict(inside.recordings, first.fitted, evidence, extended, job.seed)
        verdict = verdict if start is None else replace(verdict, start=medians(start))
        verdict = replace(verdict, detectable=beyond_calibration(inside, verdict.detectable))
    return Diagnosis(
        title=compared.title,
        unit=compared.unit,
        subjects=compared.names,
        repetitions=max(len(s.repetitions) for s in compared.subjects),
        verdict=verdict,
        before=evidence.before,
        after=evidence.after,
        observed=on_grid(first.clean, evidence.before.frequency_hz),
        ranking=ranking(look.found.steps[0], evidence.remaining),
        one_ports=look.one_ports,
        differences=evidence.differences or (),
        fit=fit,
        seconds=clock.seconds,
    )


def _found(
    compared: Recordings, network: Network | str | None, claimed: Claim | None, job: _Job, clock: Clock
) -> tuple[FirstFit, Findings]:
    """The fit of the network, and what it lacks."""
    with clock.measure("fit"):
        first = fit_without_hum(compared, network, job.seed, job.executor, job.progress, job.checkpoint, job.prior)
        base, begin = _start(claimed, first.fitted, job)
    way = None
    if first.hum is not None:  # what looked like it may be gone with the first name, and the search begins anew
        with clock.measure("search"):
            own = first.fitted
            names = own.recordings.names
            way = first_step(own.refitter, base, names, job.effects, job.seed, job.executor, job.progress, begin)
        if way.fit.model.additions and first.imagined(way.fit, job.executor):
            first, way = first.of_everything(), None
            base, begin = _start(claimed, first.fitted, job)
    look = find(first.fitted, base, begin, job.effects, job.seed, job.executor, job.progress, clock, way)
    if look.final.model.additions and first.imagined(look.final, job.executor):
        first = first.of_everything()
        base, begin = _start(claimed, first.fitted, job)
        look = find(first.fitted, base, begin, job.effects, job.seed, job.executor, job.progress, clock)
    return first, _look_again(look, first.fitted, base, job, clock) if look.nameless else look


def _start(claimed: Claim | None, fitted: Fitted, job: _Job) -> tuple[Refit, Refit | None]:
    """The model to which effects are added, and another fit of it at which the search starts, if there is a claim."""
    if claimed is None or not (claimed.found.final.model.additions or claimed.rest):
        return fitted.fit, None
    return claimed.start(fitted, job.seed)


def _look_again(look: Findings, fitted: Fitted, base: Refit, job: _Job, clock: Clock) -> Findings:
    """The better of this search and one from a second start, if all that was found is unnamed."""
    with clock.measure("search"):
        known = look.evidence - log_evidence(base)
        begin = another_beginning(fitted, look.found.steps[0], known, job.seed, job.executor, job.progress)
    if begin is None:
        return look
    again = find(fitted, base, begin, job.effects, job.seed, job.executor, job.progress, clock)
    return max(look, again, key=lambda k: k.evidence)


def _confirm(first: FirstFit, look: Findings, claimed: Claim | None, job: _Job) -> Evidence:
    """Evidence for the findings from held-out recordings and from tests of the population."""
    seed, clean, fitted = job.seed, first.clean, first.fitted
    job.progress("confirming", 0, 3)
    structures, remarks = find_structures(look.final, clean, job.diagonal, seed)
    group = next((s for s in structures if isinstance(s, Subgroup)), None)
    if group is not None:
        again = joined(fitted.refitter, look.final, group.membership > 0.5)
        if again is not look.final:  # they were in another optimum, or some of them were
            look = look.with_final(again)
            structures, remarks = find_structures(again, clean, job.diagonal, seed)
    if look.unknown is not None and any(isinstance(s, _OF_THE_SHAPE) for s in structures):
        structures = tuple(s for s in structures if not isinstance(s, _OF_THE_SHAPE))
        remarks = [*remarks, _SHAPE_UNKNOWN]
    found, final = look.found, look.final
    changed = final is not found.base
    job.progress("confirming", 1, 3)
    gain = held_out(fitted.refitter, found.base, final, seed, blocks=not job.quick) if changed else None
    job.progress("confirming", 2, 3)
    before = snapshot("before", clean, found.base, found.steps[0].residuals, seed)
    after, remaining = None, tuple(found.steps[0].residuals)
    if changed:
        remaining = tuple(person_residuals(final, clean.names, job.executor))
        after = snapshot("after", clean, final, remaining, seed)
    job.progress("confirming", 3, 3)
    return Evidence(
        found=found,
        gains=look.gains,
        unknown=look.unknown,
        remaining=remaining if look.remains else (),
        structures=structures,
        hum=first.hum,
        location=look.first,
        gain=gain,
        before=before,
        after=after,
        spoilt=first.spoilt,
        differences=None if claimed is None else compare_populations(claimed.found.final, final, clean.unit),
        remarks=(*remarks, *_remarks(look, claimed), *([_WITH_PRIOR] if job.prior is not None else [])),
        quick=job.quick,
    )


def _measured(
    evidence: Evidence, extended: ExtendedNetwork, recordings: Recordings, start: Start | None, job: _Job
) -> tuple[Evidence, PopulationFit | None]:
    """Evidence with parameters from the posterior of the population of the extended network; and that posterior."""
    known = None if job.prior is None else job.prior.only(extended.network.elements)
    settings = FitSettings(covariance="diagonal" if job.diagonal else "full", prior=known)
    if without := no_networks(evidence.final.model):
        because = f"{', '.join(without)} {_NOT_IN_NETWORK}."
        return replace(evidence, remarks=(*evidence.remarks, because)), None
    if some := sorted({a.effect.id for a in evidence.final.model.additions if a.only_in_some}):
        because = f"{', '.join(some)} {_IN_SOME}."
        return replace(evidence, remarks=(*evidence.remarks, because)), None
    try:
        fit = fit_population(
            recordings,
            extended.network,
            start=start,
            settings=settings,
            seed=job.seed,
            progress=job.progress,
            executor=job.executor,
        )
    except InputError as error:  # a network whose parameters no recordings determine, for example
        return replace(evidence, remarks=(*evidence.remarks, f"{_NO_POSTERIOR}: {error}")), None
    if fit.diagnostics.problems:
        because = f"{_NO_POSTERIOR}: {fit.diagnostics.problems[0]}"
        return replace(evidence, remarks=(*evidence.remarks, because)), fit
    named = evidence.found.final.model
    if not named.additions:  # only physics without a name
        return evidence, fit
    symbols = {name for own in extended.symbols for name in own.values()}
    if alike := [c.expression for c in fit.combinations if symbols & set(c.elements)]:
        because = f"Recordings can determine only {', '.join(alike)}, {_COMBINED}"
        return replace(evidence, remarks=(*evidence.remarks, because)), fit
    return replace(evidence, posterior=extended_posterior(named, extended, fit)), fit


def _remarks(look: Findings, claimed: Claim | None) -> list[str]:
    """Caveats that a reader must know before relying on the numbers."""
    remarks = []
    changed = look.final is not look.found.base
    if changed and look.remains and look.unknown is None:
        remarks.append(
            "Something else is missing: structure remains in the residuals that nothing named here describes. Points "
            "that go up and down together count as one where explanations are compared."
        )
    if changed and not look.final.settled:
        remarks.append("The fit with the missing effects did not converge; its numbers are approximate.")
    if claimed is not None and claimed.rest:
        remarks.append(
            "The simulation itself holds structure that the network does not describe, which was subtracted from the "
            "recordings."
        )
    return remarks
