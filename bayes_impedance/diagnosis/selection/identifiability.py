"""Whether the effects that a search has found are identified, or together imitate physics outside the catalogue.

A search over a catalogue can compose any smooth curve from enough effects: by Foster and Prony every passive one-port
is a sum of resonances or of relaxations. Five signs of this are tested:

- structure remains, and is a large part of the median person's mismatch and larger than the noise;
- structure remains beside as many effects as a search may add: what needs more than these is no list of effects;
- the effects leave much unexplained relative to their gain, and a small unnamed network explains more than they do;
- several relaxations or resonances are found that act at the same frequencies, and structure remains nevertheless;
- two different effects of the body act at the same frequencies, and the recordings allow both at the same place: tissue
  that neither describes.

Then the verdict says ``unknown``, and the fitted network stands in for it. Remaining structure is not sufficient by
itself: with recordings precise enough every model is rejected, and effects that explain most of the misfit are useful.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import combinations

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.extend import rebuilt, shrunk
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.diagnosis.fit.normal_equations import counts
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.missing_impedance import missing_one_ports
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, compare, log_evidence
from bayes_impedance.diagnosis.selection.cross_validation import people_gain
from bayes_impedance.diagnosis.selection.stepwise import MOST_ADDITIONS, Found, rivals
from bayes_impedance.diagnosis.selection.unnamed import Realised, stand_in_network
from bayes_impedance.diagnosis.types import OnePort
from bayes_impedance.network.operations import TRAITS

_NAMED_SHARE = 0.9
"""Share of the total gain above which named effects are kept: an unnamed network then adds less than a tenth. By
choice."""

_NOISE = 2.0
"""Misfit of a described point in units of its noise: a real and an imaginary part."""

_SAME_BAND = 0.5
"""Overlap (Bhattacharyya coefficient) from which two effects count as acting at the same frequencies: that of two
normal distributions over log frequency that are 2.4 standard deviations apart. By choice."""


def names_that_hold(
    refitter: Refitter,
    found: Found,
    rest: Realised | None,
    remains: bool,
    residuals: Sequence[PersonResiduals],
    one_ports: Sequence[OnePort],
    seed: int,
    executor: Executor,
) -> tuple[Found, Realised | None]:
    """What was found, with named effects removed if they are not identified.

    Parameters
    ----------
    refitter : Refitter
    found : Found
    rest : Realised or None
        Small network for the structure that no effect explains.
    remains : bool
        Whether structure remains beside the named effects.
    residuals : sequence of PersonResiduals
        Of the fit with the named effects.
    one_ports : sequence of OnePort
        Missing one-port at each place before anything was added, best place first.
    seed : int
    executor : Executor

    Returns
    -------
    found : Found
        Without named effects, if they are not identified.
    unknown : Realised or None
        Network for the unnamed physics: for all that is missing if no named effect is identified, and for the part of
        those that may be one with an earlier one.
    """
    own = found.final.model.additions[len(found.base.model.additions) :]
    named = log_evidence(found.final) - log_evidence(found.base)
    if rest is not None and named < _NAMED_SHARE * (named + rest.trial.gain):
        alone = stand_in_network(refitter, found.base, found.steps[0].residuals, one_ports, seed, executor)
        if alone is not None and compare(alone.trial.fit, found.final).decided:
            return _without_names(found), alone
    if len(refitter.data) < FEWEST_PEOPLE:
        return found, rest
    if own and remains and (len(own) >= MOST_ADDITIONS or not _mostly_explained(found)):
        return _unnamed(refitter, found, rest, seed)
    doubtful = _of_one_thing(found, own, residuals, remains)
    if doubtful:
        fewer = without(refitter, found, doubtful)
        if log_evidence(fewer.final) - log_evidence(found.base) >= _NAMED_SHARE * named:
            # The later one of two that cannot be told apart adds little: the earlier one keeps its name.
            remaining = tuple(person_residuals(fewer.final, [r.name for r in residuals], executor))
            ports = missing_one_ports(fewer.final, remaining)
            return fewer, stand_in_network(refitter, fewer.final, remaining, ports, seed, executor)
        return _unnamed(refitter, found, rest, seed)
    return found, rest


def _mostly_explained(found: Found) -> bool:
    """Whether what was found leaves little of the median person's mismatch, or less than the noise."""
    before, after = (
        float(np.median(np.bincount(fit.owner, fit.equations.chi) / counts(fit.data))) - _NOISE
        for fit in (found.base, found.final)
    )
    return after <= max(_NOISE, (1.0 - _NAMED_SHARE) * before)


def _unnamed(refitter: Refitter, found: Found, rest: Realised | None, seed: int) -> tuple[Found, Realised]:
    """What was found, without names: its fit stands for unknown physics."""
    trial = rest.trial if rest is not None else next(s.chosen for s in reversed(found.steps) if s.chosen)
    whole = rest.trial.fit if rest is not None else found.final
    total, se = people_gain(refitter, found.base, whole, seed)
    gain = log_evidence(whole) - log_evidence(found.base)
    return _without_names(found), Realised(replace(trial, fit=whole, gain=gain, mixture=None), total, se)


def _of_one_thing(
    found: Found, own: Sequence[Addition], residuals: Sequence[PersonResiduals], remains: bool
) -> tuple[Addition, ...]:
    """Effects that may be one with an earlier one.

    They overlap in frequency, and both are series terms with structure left, or both may be at one place.
    """
    model, later = found.final.model, dict[int, Addition]()
    power = [felt(found.final, model.columns(model.additions.index(a)), residuals)[1] ** 2 for a in own]
    for i, k in combinations(range(len(own)), 2):
        one, other = own[i], own[k]
        if _overlap(power[i], power[k]) < _SAME_BAND:
            continue
        if remains and _is_series_term(one.effect) and _is_series_term(other.effect):
            later[k] = other
        both = _is_one_port(one.effect) and _is_one_port(other.effect) and one.effect.id != other.effect.id
        if both and _possible_places(found, one) & _possible_places(found, other):
            later[k] = other
    return tuple(later.values())


def _is_series_term(effect: Effect) -> bool:
    return not effect.operation or TRAITS[effect.operation].sums_to_any


def _is_one_port(effect: Effect) -> bool:
    """Whether an effect describes the tissue of all people at one place as a one-port."""
    return (
        effect.side == "body"
        and effect.pooling != "some"
        and (not effect.operation or TRAITS[effect.operation].one_port)
    )


def felt(fit: Refit, columns: Sequence[int], residuals: Sequence[PersonResiduals]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) and root-sum-square sensitivity, over the noise, of all recordings to some parameters (F,)."""
    grid, power = residuals[0].frequency_hz, np.zeros(residuals[0].frequency_hz.size)
    start = 0
    for person in residuals:
        rows = slice(start, start + len(person.white))
        start = rows.stop
        slope = fit.model.kernel.derivative(fit.u[rows], person.frequency_hz)[1][:, list(columns)]
        own = np.sum(np.abs(slope / person.sd[:, None]) ** 2, axis=(0, 1))
        power = power + np.interp(np.log(grid), np.log(person.frequency_hz), own)
    return grid, np.sqrt(power)


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Bhattacharyya coefficient of two distributions over frequency: 1 if they are equal, 0 if they are disjoint."""
    return float(np.sum(np.sqrt(one * other)) / np.sqrt(one.sum() * other.sum()))


def _possible_places(found: Found, addition: Addition) -> set[str]:
    """Its place, and the places of all alternatives that the recordings cannot separate from it."""
    step = found.step_of(addition)
    others = [] if step is None else rivals(step)
    return {addition.place} | {trial.candidate.place for trial, _, separated in others if not separated}


def without(refitter: Refitter, found: Found, additions: Sequence[Addition]) -> Found:
    """What was found without some of the named effects."""
    model = found.final.model
    kept = [i for i, addition in enumerate(model.additions) if addition not in additions]
    smaller = rebuilt(model, [model.additions[i] for i in kept], kept)
    final = shrunk(refitter, found.final, smaller, kept)
    if not kept:
        return _without_names(found)
    return replace(found, final=final)


def _without_names(found: Found) -> Found:
    return Found(found.base, found.base, found.steps[:1])
