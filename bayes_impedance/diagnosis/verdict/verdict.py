"""The verdict: findings collected from the search, the tests and the models before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version

import numpy as np

from bayes_impedance.diagnosis.catalogue.offered import about_direction, not_shown
from bayes_impedance.diagnosis.extended_network import ExtendedNetwork, no_networks
from bayes_impedance.diagnosis.fit.baseline import Fitted
from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.folds import FOLDS
from bayes_impedance.diagnosis.heterogeneity.gain import HELD_OUT
from bayes_impedance.diagnosis.heterogeneity.tests import Structure
from bayes_impedance.diagnosis.hum.line import Hum
from bayes_impedance.diagnosis.multiple_testing import STRUCTURE_ALPHA
from bayes_impedance.diagnosis.residuals.absolute_fit import badly_described, copies, far_off, no_impedance
from bayes_impedance.diagnosis.residuals.locate import Location
from bayes_impedance.diagnosis.selection.cross_validation import HeldOut
from bayes_impedance.diagnosis.selection.identifiability import felt
from bayes_impedance.diagnosis.selection.stepwise import Found
from bayes_impedance.diagnosis.selection.unnamed import Realised
from bayes_impedance.diagnosis.types import Snapshot
from bayes_impedance.diagnosis.verdict.absorbed import without_absorbed
from bayes_impedance.diagnosis.verdict.electrical_words import electrical
from bayes_impedance.diagnosis.verdict.entries import effect_entry, joint_of, unknown_entry, unpredicted_entry
from bayes_impedance.diagnosis.verdict.ranking import detection_limits
from bayes_impedance.diagnosis.verdict.sentence import body_of, sentence
from bayes_impedance.diagnosis.verdict.structure_entries import hum_entry, structure_entry
from bayes_impedance.diagnosis.verdict_types import (
    BlockGain,
    Improvement,
    Located,
    LocatedBand,
    Pair,
    ParameterDifference,
    Physics,
    Verdict,
    Where,
)
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.curve_errors import relative_rms

_LINE_WIDTH = 0.01
"""Smallest relative half width of a band of hum around its point: on a dense grid it would have no width. By choice."""

_SIGNIFICANT_DIFFERENCE = 0.05
"""Corrected level at which an element is reported to differ between simulation and recordings. By choice."""

FEW_PEOPLE = 3
"""With fewer people rig and body cannot be distinguished: two people hardly determine a dispersion."""


def change_of(after: Refit, residuals: Sequence[PersonResiduals]) -> tuple[str, tuple[Pair, ...]]:
    """Part in which an explanation acts, and bands where its change outside of the elements exceeds half its peak."""
    size: np.ndarray | None = None
    parts = np.zeros(2)
    start = 0
    for person in residuals:
        rows = slice(start, start + len(person.white))
        start = rows.stop
        z = after.model.kernel.impedance(after.u[rows], person.frequency_hz)
        bare = person.model
        if after.model.additions:
            without = after.u[rows].copy()
            linear = [after.model.n_elements + i for i, p in enumerate(after.model.parameters) if p.is_coefficient]
            without[:, linear] = 0.0
            bare = after.model.kernel.impedance(without, person.frequency_hz)
        relative = np.log(z / bare) * np.abs(z) / person.sd
        parts += [float(np.sum(relative.real**2)), float(np.sum(relative.imag**2))]
        change = (z - person.model) / person.sd
        outside = person.outside(np.concatenate([change.real, change.imag], axis=1))
        n = person.frequency_hz.size
        own = np.sum(outside[:, :n] ** 2 + outside[:, n:] ** 2, axis=0)
        if size is None:
            grid, size = person.frequency_hz, np.zeros(n)
        size = size + np.interp(np.log(grid), np.log(person.frequency_hz), own)
    share = parts[0] / max(parts.sum(), 1e-300)
    assert size is not None  # there is at least one person
    bands = _half_of_peak(grid, np.sqrt(size))
    return ("magnitude" if share > 0.8 else "phase" if share < 0.2 else "both"), bands


def reach_of(fit: Refit, elements: Sequence[str], residuals: Sequence[PersonResiduals]) -> tuple[Pair, ...]:
    """Bands where the recordings' sensitivity to some elements, over the noise, exceeds half of its peak."""
    columns = [fit.model.network.elements.index(e) for e in elements]
    return _half_of_peak(*felt(fit, columns, residuals))


def _half_of_peak(grid: np.ndarray, size: np.ndarray) -> tuple[Pair, ...]:
    """Bands in which a smoothed size (F,) exceeds half of its largest value."""
    width = max(3, size.size // 40)
    smooth = np.sqrt(np.convolve(size**2, np.ones(width) / width, mode="same"))
    inside = np.concatenate([[False], smooth > 0.5 * smooth.max(), [False]]).astype(int)
    edges = np.diff(inside)
    ends = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    return tuple((float(grid[a]), float(grid[b - 1])) for a, b in ends)


def _merged(bands: Sequence[Pair]) -> tuple[Pair, ...]:
    """Bands in ascending order, with touching or overlapping ones merged."""
    result: list[Pair] = []
    for low, high in sorted(bands):
        if result and low <= result[-1][1] * 1.0001:
            result[-1] = (result[-1][0], max(result[-1][1], high))
        else:
            result.append((low, high))
    return tuple(result)


def improvement(before: Snapshot, after: Snapshot, gain: HeldOut | None) -> Improvement:
    """Improvement by the additions, on fitted and on held-out data."""

    def pair(value: Callable[[Snapshot], float]) -> Pair:
        return float(value(before)), float(value(after))

    people = gain is not None and gain.people is not None
    return Improvement(
        delta_magnitude=pair(lambda s: np.nanmean(s.delta_magnitude)),
        delta_phase_deg=pair(lambda s: np.nanmean(s.delta_phase_deg)),
        subject_rms_relative=pair(lambda s: np.median(s.subject_rms_relative)),
        coverage90=pair(lambda s: np.nanmean(s.coverage90)),
        elpd_gain=None if gain is None else gain.people if people else gain.blocks,
        elpd_gain_se=None if gain is None else gain.people_se if people else gain.blocks_se,
        blocks=None if gain is None else BlockGain(gain.blocks, gain.blocks_se),
        held_out="nothing; the points affected by hum were left out of the fit" if gain is None else gain.described,
    )


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """All results from which a verdict is made.

    Attributes
    ----------
    found : Found
        Effects of the catalogue.
    gains : tuple of (float, float or None) or None
        Of each of them on held-out people, with its standard error; None where it was not computed.
    unknown : Realised or None
        Physics outside of the catalogue.
    structures : tuple of Structure
        Structures in the distribution of the elements.
    hum : Hum or None
    location : Location
        Of the mismatch before anything was added.
    gain : HeldOut or None
        Of all additions together.
    before : Snapshot
    after : Snapshot or None
    spoilt : Snapshot or None
        Fit to all points, including those affected by hum, if there are any.
    differences : tuple of ParameterDifference or None
        From a claimed simulation.
    remarks : tuple of str
    quick : bool
        Quote the catalogue's separating measurements instead of computing them.
    remaining : tuple of PersonResiduals
        Of the final model, if structure remains that no named effect explains.
    posterior : CoefficientPosterior or None
        Of all parameters that were added: the population's, or Laplace's approximation where there is none; None if
        nothing was added.
    """

    found: Found
    gains: tuple[tuple[float, float | None] | None, ...]
    unknown: Realised | None
    structures: tuple[Structure, ...]
    hum: Hum | None
    location: Location
    gain: HeldOut | None
    before: Snapshot
    after: Snapshot | None
    spoilt: Snapshot | None
    differences: tuple[ParameterDifference, ...] | None
    remarks: tuple[str, ...]
    quick: bool
    remaining: tuple[PersonResiduals, ...] = ()
    posterior: CoefficientPosterior | None = None

    @property
    def final(self) -> Refit:
        """Fit with all additions, including unknown physics."""
        return self.found.final if self.unknown is None else self.unknown.trial.fit

    @property
    def changed(self) -> bool:
        """Whether anything was added to the network."""
        return self.final is not self.found.base


def make_verdict(
    recordings: Recordings, fitted: Fitted, evidence: Evidence, extended: ExtendedNetwork | None, seed: int
) -> Verdict:
    """Make the verdict on the recordings.

    Parameters
    ----------
    recordings : Recordings
    fitted : Fitted
    evidence : Evidence
    extended : ExtendedNetwork or None
        The network with what was found, if there is anything.
    seed : int
    """
    found, before, after = evidence.found, evidence.before, evidence.after
    gross, partial = _shortcomings(recordings, evidence.final, evidence.unknown is not None)
    network, physics = found.base.model.network, _physics(recordings, evidence)
    absorbed: tuple[str, ...] = ()
    if evidence.posterior is not None and extended is not None:
        known = len(found.base.model.additions)
        physics, absorbed = without_absorbed(physics, found.final, known, evidence.posterior, extended)
    withdrawn = found.steps[0].chosen is not None and not evidence.changed
    if not physics and not gross and not partial and withdrawn and _same_in_all(evidence.location):
        physics = (unpredicted_entry(),)
    limits, hidden = detection_limits(found.base.model, found.steps[0].screening)
    effects = [entry for entry in physics if entry.kind == "effect"]
    differences = evidence.differences
    verdict = Verdict(
        summary="",
        where=_where(evidence, physics),
        located=_located(evidence.location),
        physics=physics,
        improvement=_improvement(evidence, physics),
        network=(str(network.sharing(fitted.shared)), after.network if after is not None else str(before.network)),
        detectable=limits,
        not_identifiable=("gain", *hidden, *not_shown(recordings)),
        elements_not_identified=tuple(
            e for e, known in zip(network.elements, fitted.determined, strict=True) if not known
        ),
        seed=seed,
        data_sha256=recordings.sha256,
        title=recordings.title,
        unit=recordings.unit,
        reliable=_at_rest(evidence) and not gross,
        remarks=(
            *gross,
            *partial,
            *fitted.remarks,
            *about_direction(recordings, [entry.id for entry in effects]),
            *evidence.remarks,
            *absorbed,
            *_left_out(evidence),
            *_limits_of_few(recordings),
        ),
        version=version("bayes_impedance"),
        joint=joint_of(found.final.model, evidence.posterior) if len(effects) > 1 else None,
        parameters_differ=None
        if differences is None
        else tuple(d for d in differences if d.p_value < _SIGNIFICANT_DIFFERENCE),
        shortcomings=(*gross, *partial),
        extended_network=None if extended is None else str(extended.network),
    )
    verdict = electrical(verdict)
    return replace(verdict, summary=sentence(verdict, len(recordings.subjects)))


def _same_in_all(location: Location) -> bool:
    """Whether structure that people have in common remains: a person in another optimum has some of his own."""
    return any(band.kind == "coherent" and band.p_value < STRUCTURE_ALPHA for band in location.bands)


def _at_rest(evidence: Evidence) -> bool:
    """Whether the fit that the verdict describes has converged.

    The network alone need not, if something is missing: a wrong model drives elements towards zero or infinity.
    """
    if evidence.found.base.settled:
        return True
    is_sampled = evidence.posterior is not None and evidence.posterior.is_sampled
    return evidence.changed and (evidence.final.settled or is_sampled)


def _left_out(evidence: Evidence) -> tuple[str, ...]:
    """What a fit of the extended network does not contain, in a sentence."""
    ids = no_networks(evidence.final.model) if evidence.changed else ()
    if not ids:
        return ()
    return (f"{', '.join(ids)} cannot be written as a network: 'run --with' fits the other effects only.",)


def _shortcomings(recordings: Recordings, final: Refit, remains: bool) -> tuple[list[str], list[str]]:
    """Results of the absolute checks of the final model: for all people, and for some.

    `remains` says whether there is unnamed structure.
    """
    scale = final.weight**-0.5
    error = []
    for i, s in enumerate(recordings.subjects):
        model = final.model.kernel.impedance(final.u[final.owner == i], s.frequency_hz)
        error.append(float(relative_rms(model.mean(axis=0), s.mean)))
    gross = [*copies(recordings), *far_off(np.array(error), scale, recordings.unit)]
    gross += no_impedance(recordings, str(final.model.network), remains)
    return gross, badly_described(recordings.names, scale)


def _physics(recordings: Recordings, evidence: Evidence) -> tuple[Physics, ...]:
    """All entries: effects of the catalogue, structures of the population, hum, and last unnamed physics."""
    found, names = evidence.found, recordings.names
    entries = []
    if (posterior := evidence.posterior) is not None:
        few = len(names) < FEW_PEOPLE
        first = len(found.base.model.additions)
        for i, gain in enumerate(evidence.gains, first):
            entries.append(effect_entry(found, i, posterior, gain, names, few, evidence.quick, evidence.remaining))
    elements = evidence.final.model.network.elements
    entries += [structure_entry(structure, elements, names) for structure in evidence.structures]
    if evidence.hum is not None:
        entries.append(hum_entry(evidence.hum, recordings.unit))
    if evidence.unknown is not None:
        entries.append(unknown_entry(evidence.unknown, len(found.final.model.additions)))
    return tuple(entries)


def _where(evidence: Evidence, physics: tuple[Physics, ...]) -> Where:
    """Place of the mismatch by the first entry, and its bands: those located, or else those where the entry acts."""
    location, hum, found = evidence.location, evidence.hum, evidence.found
    if not physics:
        return Where(bands_hz=(), part=location.part, place=None, side=None, subjects="all", covariate=None)
    lead, residuals = physics[0], found.steps[0].residuals
    part: str = location.part
    bands = _merged([(float(b.low_hz), float(b.high_hz)) for b in location.bands])
    if evidence.changed:
        part, acting = change_of(evidence.final, residuals)
        bands = bands or acting
    elif own := [e for e in lead.elements if e in found.base.model.network.elements]:
        bands = reach_of(found.base, own, residuals)
    if lead.kind == "hum" and hum is not None:
        near = max(hum.near, _LINE_WIDTH)
        bands = _merged([(f * (1 - near), f * (1 + near)) for f in hum.frequencies_hz])
    return Where(
        bands_hz=bands,
        part=part,
        place=lead.place,
        side=lead.side,
        subjects=location.subjects if lead.subjects == "all" else lead.subjects,
        covariate=next((entry.covariate for entry in physics if entry.covariate), None),
    )


def _located(location: Location) -> Located:
    """Structure that remained before anything was added, every band separately."""
    return Located(
        p_value=location.p_value,
        bands=tuple(
            LocatedBand(
                low_hz=band.low_hz,
                high_hz=band.high_hz,
                part=band.part,
                kind=band.kind,
                z=band.statistic,
                p_value=band.p_value,
            )
            for band in location.bands
        ),
        magnitude_share=location.magnitude_share if np.isfinite(location.magnitude_share) else None,
        subjects_p_value=location.subjects_p_value,
    )


def _improvement(evidence: Evidence, physics: tuple[Physics, ...]) -> Improvement | None:
    before, after = evidence.spoilt or evidence.before, evidence.after
    if after is not None:
        return improvement(before, after, evidence.gain)
    if evidence.spoilt is not None:
        return improvement(before, evidence.before, None)
    if not evidence.structures:
        return None
    # Only the population changes: each person's fit is the same, and predictions for new people improve.
    gains = [e.evidence.elpd_gain for e in physics if e.evidence.elpd_gain is not None]
    errors = [e.evidence.elpd_gain_se for e in physics if e.evidence.elpd_gain_se is not None]
    ratios = [entry.id for entry in physics if entry.id not in HELD_OUT]
    held_out = f"{FOLDS} subject folds" + (f"; a likelihood ratio for {' and '.join(ratios)}" if ratios else "")
    return replace(
        improvement(before, before, None),
        elpd_gain=sum(gains),
        elpd_gain_se=float(np.sqrt(sum(se**2 for se in errors))),
        held_out=held_out,
    )


def _limits_of_few(recordings: Recordings) -> list[str]:
    if len(recordings.subjects) >= FEW_PEOPLE:
        return []
    texts = [
        f"With so few subjects, effects of the rig and of the {body_of(recordings.unit)} cannot be distinguished, nor "
        "can the dispersion between subjects be estimated."
    ]
    if all(len(s.repetitions) == 1 for s in recordings.subjects):
        texts.append(
            "With one repetition the noise is estimated from the roughness of the curves only, so that smooth errors "
            "of measurement look like missing physics."
        )
    return texts
