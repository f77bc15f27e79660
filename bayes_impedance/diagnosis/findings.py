"""What a search finds: named effects that hold, a network for what has no name, and what remains.

The steps in their order: search for effects of the catalogue, keep those that improve predictions, locate what is left,
find a network for it, or the element that changes where people were swept once, take back names that are not
identified, and try one network instead of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.baseline import LAST_ROUNDS, Fitted
from bayes_impedance.diagnosis.fit.evidence_surface import GAIN
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.grown_network import grown_network
from bayes_impedance.diagnosis.residuals.locate import Location, locate
from bayes_impedance.diagnosis.residuals.missing_impedance import missing_one_ports
from bayes_impedance.diagnosis.selection.compare import SCATTERS, compare, log_evidence
from bayes_impedance.diagnosis.selection.cross_validation import clearly_gains, people_gain
from bayes_impedance.diagnosis.selection.exchange import Way
from bayes_impedance.diagnosis.selection.identifiability import names_that_hold
from bayes_impedance.diagnosis.selection.names_of_a_size import names_of_a_size
from bayes_impedance.diagnosis.selection.predictive_gain import Gain, names_that_predict
from bayes_impedance.diagnosis.selection.stepwise import Found, search
from bayes_impedance.diagnosis.selection.trial import Trial
from bayes_impedance.diagnosis.selection.unnamed import (
    Realised,
    along_the_sweep,
    branch_effects,
    stand_in_network,
    structure_remains,
)
from bayes_impedance.diagnosis.types import OnePort
from bayes_impedance.runtime.clock import Clock
from bayes_impedance.runtime.progress import Progress


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Result of one search.

    Attributes
    ----------
    found : Found
        Named effects that are identified.
    unknown : Realised or None
        Network for the unnamed physics.
    first : Location
        Mismatch of the network alone.
    one_ports : tuple of OnePort
        Missing one-port at each place before anything was added.
    gain_of : dict
        Gain on held-out people with its standard error, by the key of a named effect.
    remains : bool
        Whether structure remained beside the named effects.
    """

    found: Found
    unknown: Realised | None
    first: Location
    one_ports: tuple[OnePort, ...]
    gain_of: dict[tuple[str, str, str], Gain]
    remains: bool

    @property
    def gains(self) -> tuple[Gain | None, ...]:
        """Gain of each named effect on held-out people; None with too few people."""
        own = self.found.final.model.additions[len(self.found.base.model.additions) :]
        return tuple(self.gain_of.get(addition.key) for addition in own)

    @property
    def nameless(self) -> bool:
        """Whether only unnamed physics was found."""
        return self.unknown is not None and self.found.final is self.found.base

    @property
    def final(self) -> Refit:
        """Fit with all additions, including unknown physics."""
        return self.found.final if self.unknown is None else self.unknown.trial.fit

    def with_final(self, fit: Refit) -> Findings:
        """The same findings with another fit of the final model."""
        if self.unknown is not None:
            unknown = replace(self.unknown, trial=replace(self.unknown.trial, fit=fit))
            return replace(self, unknown=unknown)
        if self.found.final is self.found.base:
            return replace(self, found=replace(self.found, base=fit, final=fit))
        return replace(self, found=replace(self.found, final=fit))

    @property
    def evidence(self) -> float:
        """Log evidence of the final model, which also counts a better fit of the network itself."""
        return log_evidence(self.final)


def find(
    fitted: Fitted,
    base: Refit,
    begin: Refit | None,
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
    progress: Progress,
    clock: Clock,
    way: Way | None = None,
) -> Findings:
    """Find what is missing.

    Parameters
    ----------
    fitted : Fitted
    base : Refit
        The network alone, or with additions that are known.
    begin : Refit or None
        Another fit of the same model, at which the search starts.
    effects : sequence of Effect
        Candidates.
    seed : int
    executor : Executor
    progress : callable
    clock : Clock
        Measures the stages.
    way : Way, optional
        The first step of the search, if it is made already.
    """
    names = fitted.recordings.names
    with clock.measure("search"):
        found = search(fitted.refitter, base, names, effects, seed, executor, progress, begin, way)
        found, gains = names_that_predict(fitted.refitter, found, seed)
        found = names_of_a_size(fitted.refitter, found, seed)
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
        unshown = _unshown(fitted.refitter, found, seed) if remains else None
        if unshown is not None:
            unknown = unshown
        elif remains:
            progress("unknown physics", 0, 1)
            ports = missing_one_ports(found.final, residuals)
            unknown = stand_in_network(fitted.refitter, found.final, residuals, ports, seed, executor)
        if unshown is None or found.final is not found.base:
            found, unknown = names_that_hold(
                fitted.refitter, found, unknown, remains, residuals, one_ports, seed, executor
            )
        if remains and unshown is None:
            found, unknown = _one_network(fitted.refitter, found, unknown, names, seed, executor)
        progress("unknown physics", 1, 1)
    look = Findings(found=found, unknown=unknown, first=first, one_ports=one_ports, gain_of=gains, remains=remains)
    return look if look.final is found.base else look.with_final(at_rest(fitted.refitter, look.final))


def _unshown(refitter: Refitter, found: Found, seed: int) -> Realised | None:
    """What stands for a change that only repeated sweeps can show, if the search ended at one and it predicts people.

    It stands for the recordings better than a network that is made of more elements, and says where the change is.
    """
    trial = found.steps[-1].unshown
    before = None if trial is None else found.steps[-1].before.model.additions
    if trial is None or before != found.final.model.additions:  # names were withdrawn since
        return None
    total, se = people_gain(refitter, found.final, trial.fit, seed)
    return Realised(along_the_sweep(trial), total, se) if clearly_gains(total, se) else None


def at_rest(refitter: Refitter, fit: Refit) -> Refit:
    """The fit, or where it comes to rest if that is no worse.

    Fits of the search end after some dozens of rounds. That decides between explanations, but one that was a few rounds
    from its rest was said not to have converged, and its verdict not to be relied on.
    """
    if fit.settled:
        return fit
    rest = refitter.fit(fit.model, fit.u, fit.population, LAST_ROUNDS)
    return rest if rest.settled and rest.evidence.sum() > fit.evidence.sum() - GAIN else fit


def _one_network(
    refitter: Refitter, found: Found, unknown: Realised | None, names: Sequence[str], seed: int, executor: Executor
) -> tuple[Found, Realised | None]:
    """What was found, or one network of elements in its place.

    The network is preferred if it is better than the claimed one by the criterion of all explanations, and predicts
    held-out people better than what was found; to a sum of several effects also if it predicts them as well. In place
    of names it must not be larger than they are: with enough relaxations a network comes as near to any distributed
    element, such as a power law, as the recordings can tell.
    """
    final = found.final if unknown is None else unknown.trial.fit
    named = found.final is not found.base
    most = len(final.model.kernel.elements) - len(found.base.model.kernel.elements) if named else None
    grown = grown_network(refitter, found.base, names, seed, executor, most)
    if grown is None or not compare(grown, found.base).decided:
        return found, unknown
    several = len(final.model.additions) - len(found.base.model.additions) > 1
    more, se = people_gain(refitter, final, grown, seed)
    least = SCATTERS * (se or 0.0)
    if not more > (-least if several else least):
        return found, unknown
    total, total_se = people_gain(refitter, found.base, grown, seed)
    whole = Candidate(branch_effects()[0], "port", {})
    trial = Trial(
        candidate=whole,
        pooling="varying",
        fit=grown,
        gain=log_evidence(grown) - log_evidence(found.base),
        physical=True,
    )
    return Found(found.base, found.base, found.steps[:1]), Realised(trial, total, total_se)
