"""Diagnosis from start to end: fit, locate, search, confirm, and say it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from typing import Any

from bayes_impedance.diagnosis import catalogue  # noqa: F401  (fills the register of effects)
from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.claimed_simulation import Claim, claim_of
from bayes_impedance.diagnosis.fit.baseline import Fitted, fit_network
from bayes_impedance.diagnosis.fit.fitter import Refit
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.profile_posterior import from_evidence
from bayes_impedance.diagnosis.heterogeneity.compare_populations import compare_populations
from bayes_impedance.diagnosis.heterogeneity.tests import structure_entries
from bayes_impedance.diagnosis.hum.leakage import find_skirts
from bayes_impedance.diagnosis.hum.line import find_mains, without_hum
from bayes_impedance.diagnosis.residuals.locate import Location, locate
from bayes_impedance.diagnosis.residuals.missing_impedance import missing_one_ports
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.cross_validation import held_out, people_gain
from bayes_impedance.diagnosis.selection.identifiability import names_that_hold
from bayes_impedance.diagnosis.selection.restart import another_beginning
from bayes_impedance.diagnosis.selection.stepwise import Found, search
from bayes_impedance.diagnosis.selection.unnamed import Realised, stand_in_network, structure_remains
from bayes_impedance.diagnosis.types import Diagnosis, OnePort, ParameterDifference
from bayes_impedance.diagnosis.verdict.entries import aliases, physics_entry
from bayes_impedance.diagnosis.verdict.model_bands import snapshot
from bayes_impedance.diagnosis.verdict.ranking import ranking
from bayes_impedance.diagnosis.verdict.verdict import FEW_PEOPLE, Evidence, make_verdict
from bayes_impedance.network.notation import Network
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.curve_errors import on_grid
from bayes_impedance.runtime.clock import Clock
from bayes_impedance.runtime.executors import executor_of
from bayes_impedance.runtime.progress import Progress

_MAINS_ALPHA = 1e-3


@dataclass(frozen=True, kw_only=True)
class _Job:
    """What all parts of one diagnosis share."""

    effects: tuple[Effect, ...]
    diagonal: bool
    quick: bool
    seed: int
    executor: Executor
    progress: Progress


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
) -> Diagnosis:
    """Find what a network leaves out of recordings.

    Parameters
    ----------
    recordings : Recordings
        One recording or many.
    network : Network or str, optional
        The network as claimed; the dataset's own if not given.
    simulation : Recordings, optional
        A simulated population that claims to describe the recordings. What the network leaves unexplained of it is
        taken off the recordings; where it is of the same people, everybody is compared with the own simulation
        (:mod:`bayes_impedance.diagnosis.claimed_simulation`).
    effects : sequence of Effect, optional
        Candidates; all that are registered if not given.
    diagonal : bool
        The claim is that elements vary independently of each other; by default they may vary together.
    quick : bool
        Without held-out frequencies and without proposals of what would separate rivals.
    seed : int
        The same seed and data give the same verdict on one machine.
    workers : int
        Threads; the verdict does not depend on their number.
    progress : callable, optional
        Called with stage, done, total.
    executor : Executor, optional
        Does what is done person by person and recording by recording: processes, a cluster's workers, whatever has the
        standard interface. Threads of this process if not given; the verdict is the same.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        If there is no network, or somebody has fewer points than elements.
    """
    from threadpoolctl import threadpool_limits

    clock = Clock()
    candidates = tuple(registered() if effects is None else effects)
    own = executor_of(workers) if executor is None else nullcontext(executor)
    with threadpool_limits(1), own as executor:
        job = _Job(effects=candidates, diagonal=diagonal, quick=quick, seed=seed, executor=executor, progress=progress)
        claimed = None
        if simulation is not None:
            with clock.measure("simulation"):
                claimed = claim_of(simulation, network, candidates, seed, executor, progress)
        return _diagnose(recordings, network, claimed, job, clock)


def _diagnose(
    recordings: Recordings,
    network: Network | str | None,
    claimed: Claim | None,
    job: _Job,
    clock: Clock,
) -> Diagnosis:
    seed, executor, progress = job.seed, job.executor, job.progress
    given = recordings
    if claimed is not None:
        recordings = claimed.without_rest(recordings)
    with clock.measure("fit"):
        fitted = fit_network(recordings, network, seed, executor, progress)
        with_hum = person_residuals(fitted.fit, recordings.names, executor)
        hum = find_mains(with_hum, _MAINS_ALPHA) or find_skirts(with_hum, _MAINS_ALPHA)
        clean, spoilt = recordings, None
        if hum is not None:
            spoilt = snapshot("with hum", recordings, fitted.fit, with_hum, seed)
            clean = without_hum(recordings, hum)
            fitted = fit_network(clean, network, seed, executor, progress)
    base, begin = fitted.fit, None
    if claimed is not None and (claimed.found.final.model.additions or claimed.rest):
        with clock.measure("fit"):
            base, begin = claimed.start(fitted, seed)
    look = _look(fitted, base, begin, job, clock)
    if look.nameless:
        with clock.measure("search"):
            known = look.evidence - log_evidence(base)
            begin = another_beginning(fitted, look.found.steps[0], known, seed, executor, progress)
        if begin is not None:
            look = max(look, _look(fitted, base, begin, job, clock), key=lambda k: k.evidence)
    found, unknown, first, one_ports = look.found, look.unknown, look.first, look.one_ports
    final = unknown.trial.fit if unknown is not None else found.final
    with clock.measure("confirm"):
        progress("confirming", 0, 3)
        if found.posterior is not None:  # of the names that are left: it takes many refits
            found = replace(found, posterior=from_evidence(fitted.refitter, found.final, found.posterior, seed))
        entries = _entries(fitted, found, job)
        progress("confirming", 1, 3)
        structures, remarks = structure_entries(final, clean, job.diagonal, seed)
        held = None
        if final is not found.base:
            held = held_out(fitted.refitter, found.base, final, seed, blocks=not job.quick)
        progress("confirming", 2, 3)
        before = snapshot("before", clean, found.base, found.steps[0].residuals, seed)
        after = None
        if final is not found.base:
            after = snapshot("after", clean, final, person_residuals(final, recordings.names, executor), seed)
        progress("confirming", 3, 3)
    changed = None if final is found.base else final
    if not final.settled and final is not found.base:
        remarks.append("The fit with what was found did not come to rest; its numbers are rough.")
    if found.posterior is not None and not found.posterior.settled:
        remarks.append(
            "The intervals of what was found in the body did not come to rest: the recordings leave its parameters "
            "undecided along a ridge, and the intervals reach only as far as it was followed."
        )
    if claimed is not None and claimed.rest:
        remarks.append(
            "The simulation itself holds structure that the network does not describe; it was taken off the recordings."
        )
    evidence = Evidence(
        found=found,
        location=first,
        entries=entries,
        structures=structures,
        unknown=unknown,
        hum=hum,
        gain=held,
        before=before,
        after=after,
        changed=changed,
        remarks=remarks,
        spoilt=spoilt,
    )
    verdict = make_verdict(given, fitted, evidence, seed)
    differences: tuple[ParameterDifference, ...] = ()
    if claimed is not None:
        differences = compare_populations(claimed.found.final, final, recordings.unit)
        verdict["parameters_differ"] = [asdict(d) for d in differences if d.p_value < 0.05]
    return Diagnosis(
        title=recordings.title,
        unit=recordings.unit,
        subjects=recordings.names,
        repetitions=max(len(s.repetitions) for s in recordings.subjects),
        verdict=verdict,
        before=before,
        after=after,
        observed=on_grid(clean, before.frequency_hz),
        ranking=ranking(found.steps[0]),
        one_ports=one_ports,
        differences=differences,
        seconds=clock.seconds,
    )


@dataclass(frozen=True)
class _Look:
    """What one search has led to.

    Attributes
    ----------
    found : Found
        Names that hold.
    unknown : Realised or None
        What has no name.
    first : Location
        Where the network alone differs.
    one_ports : tuple of OnePort
        Missing at each place before anything was added.
    """

    found: Found
    unknown: Realised | None
    first: Location
    one_ports: tuple[OnePort, ...]

    @property
    def nameless(self) -> bool:
        """Whether all that was found has no name."""
        return self.unknown is not None and self.found.final is self.found.base

    @property
    def evidence(self) -> float:
        """Of everything found, less the price of its parameters; the network alone may have been fitted better, too."""
        final = self.found.final if self.unknown is None else self.unknown.trial.fit
        return log_evidence(final)


def _look(fitted: Fitted, base: Refit, begin: Refit | None, job: _Job, clock: Clock) -> _Look:
    """Search for names, locate what they leave, and take back those that do not hold."""
    seed, executor, progress = job.seed, job.executor, job.progress
    names = fitted.recordings.names
    with clock.measure("search"):
        found = search(fitted.refitter, base, names, job.effects, seed, executor, progress, begin)
    with clock.measure("locate"):
        progress("locating", 0, 2)
        residuals = found.steps[0].residuals
        first = locate(residuals, seed)
        progress("locating", 1, 2)
        last = first
        if found.final.model.additions:
            residuals = tuple(person_residuals(found.final, names, executor))
            last = locate(residuals, seed)
        one_ports = missing_one_ports(found.base, found.steps[0].residuals)
        progress("locating", 2, 2)
    unknown = None
    with clock.measure("unknown"):
        remains = structure_remains(found, last.p_value)
        if remains:
            progress("unknown physics", 0, 1)
            ports = missing_one_ports(found.final, residuals)
            unknown = stand_in_network(fitted.refitter, found.final, residuals, ports, seed, executor)
        found, unknown = names_that_hold(fitted.refitter, found, unknown, remains, residuals, one_ports, seed, executor)
        progress("unknown physics", 1, 1)
    return _Look(found, unknown, first, one_ports)


def _entries(fitted: Fitted, found: Found, job: _Job) -> list[dict[str, Any]]:
    model, first = found.final.model, len(found.base.model.additions)
    entries = []
    if found.posterior is None:
        return []
    few = len(fitted.recordings.subjects) < FEW_PEOPLE
    for i in range(first, len(model.additions)):
        step = found.step_of(model.additions[i])
        held = None
        if step is not None and step.chosen is not None and len(fitted.refitter.data) >= 10:
            held = people_gain(fitted.refitter, step.before, step.chosen.fit, job.seed)
        entry = physics_entry(found, i, found.posterior, held, few)
        if step is not None:
            entry["aliases"] = aliases(step, job.quick)
        entries.append(entry)
    return entries
