"""The verdict: what was found in the words and numbers of ``verdict.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from bayes_impedance.diagnosis.fit.baseline import Fitted
from bayes_impedance.diagnosis.fit.fitter import Refit
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.folds import FOLDS
from bayes_impedance.diagnosis.heterogeneity.gain import HELD_OUT
from bayes_impedance.diagnosis.hum.line import Hum
from bayes_impedance.diagnosis.residuals.locate import Location
from bayes_impedance.diagnosis.selection.cross_validation import HeldOut
from bayes_impedance.diagnosis.selection.identifiability import felt
from bayes_impedance.diagnosis.selection.stepwise import Found
from bayes_impedance.diagnosis.selection.unnamed import Realised
from bayes_impedance.diagnosis.types import Snapshot
from bayes_impedance.diagnosis.verdict.entries import hum_entry, joint, unknown_entry
from bayes_impedance.diagnosis.verdict.ranking import detection_limits
from bayes_impedance.diagnosis.verdict.sentence import sentence
from bayes_impedance.recordings.files import Recordings

SCHEMA = 1

_LINE_WIDTH = 0.01

FEW_PEOPLE = 3
"""With fewer people nobody can tell rig from body."""


def change_of(after: Refit, residuals: Sequence[PersonResiduals]) -> tuple[str, list[list[float]]]:
    """In which part an explanation acts, and where what no element can imitate of it exceeds half of its peak."""
    size: np.ndarray | None = None
    parts = np.zeros(2)
    start = 0
    for person in residuals:
        rows = slice(start, start + len(person.white))
        start = rows.stop
        z = after.model.kernel.impedance(after.u[rows], person.frequency_hz)
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


def reach_of(fit: Refit, elements: Sequence[str], residuals: Sequence[PersonResiduals]) -> list[list[float]]:
    """Where a change of some elements moves the recordings, over the noise, by half of the most that it does."""
    columns = [fit.model.network.elements.index(e) for e in elements]
    return _half_of_peak(*felt(fit, columns, residuals))


def _half_of_peak(grid: np.ndarray, size: np.ndarray) -> list[list[float]]:
    """Bands in which a smoothed size (F,) exceeds half of its largest value."""
    width = max(3, size.size // 40)
    smooth = np.sqrt(np.convolve(size**2, np.ones(width) / width, mode="same"))
    inside = np.concatenate([[False], smooth > 0.5 * smooth.max(), [False]]).astype(int)
    edges = np.diff(inside)
    ends = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    return [[float(grid[a]), float(grid[b - 1])] for a, b in ends]


def where(
    location: Location, side: str | None, subjects: Any, covariate: str | None, place: str | None
) -> dict[str, Any]:
    """Where the mismatch is."""
    bands = _merged([[float(b.low_hz), float(b.high_hz)] for b in location.bands])
    return {
        "bands_hz": bands,
        "part": location.part,
        "place": place,
        "side": side,
        "subjects": subjects,
        "covariate": covariate,
    }


def _merged(bands: list[list[float]]) -> list[list[float]]:
    result: list[list[float]] = []
    for low, high in sorted(bands):
        if result and low <= result[-1][1] * 1.0001:
            result[-1][1] = max(result[-1][1], high)
        else:
            result.append([low, high])
    return result


def improvement(before: Snapshot, after: Snapshot, gain: HeldOut | None) -> dict[str, Any]:
    """What the additions change, on what was fitted and on what was held out."""

    def pair(value: Any) -> list[float]:
        return [float(value(before)), float(value(after))]

    errors: dict[str, Any] = {
        "delta_magnitude": pair(lambda s: np.nanmean(s.delta_magnitude)),
        "delta_phase_deg": pair(lambda s: np.nanmean(s.delta_phase_deg)),
        "subject_rms_relative": pair(lambda s: np.median(s.subject_rms_relative)),
        "coverage90": pair(lambda s: np.nanmean(s.coverage90)),
    }
    if gain is None:
        return errors | {"elpd_gain": None, "elpd_gain_se": None, "held_out": "nothing: spoilt points were left out"}
    people = gain.people is not None
    return errors | {
        "elpd_gain": gain.people if people else gain.blocks,
        "elpd_gain_se": gain.people_se if people else gain.blocks_se,
        "elpd_gain_blocks": gain.blocks,
        "elpd_gain_blocks_se": gain.blocks_se,
        "held_out": gain.described,
    }


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Everything that a verdict is made of.

    Attributes
    ----------
    found : Found
    location : Location
        Of the mismatch before anything was added.
    entries, structures : list of dict
        Effects on the curves, and on how elements are distributed.
    unknown : Realised or None
    hum : Hum or None
    gain : HeldOut or None
        Of everything that was added.
    before : Snapshot
    after : Snapshot or None
    changed : Refit or None
        The model with everything that was added.
    remarks : list of str
    spoilt : Snapshot or None
        With the points that hum has spoilt, where there are any.
    """

    found: Found
    location: Location
    entries: list[dict[str, Any]]
    structures: list[dict[str, Any]]
    unknown: Realised | None
    hum: Hum | None
    gain: HeldOut | None
    before: Snapshot
    after: Snapshot | None
    changed: Refit | None
    remarks: list[str]
    spoilt: Snapshot | None


def make_verdict(recordings: Recordings, fitted: Fitted, evidence: Evidence, seed: int) -> dict[str, Any]:
    """Content of ``verdict.json``.

    Parameters
    ----------
    recordings : Recordings
    fitted : Fitted
    evidence : Evidence
    seed : int
    """
    found, location, hum, after = evidence.found, evidence.location, evidence.hum, evidence.after
    unknown, before = evidence.unknown, evidence.before
    physics = list(evidence.entries)
    unexplained = None
    if unknown is not None:
        unexplained = unknown_entry(unknown, len(found.final.model.additions))
        physics.append(unexplained)
    physics += evidence.structures
    if hum is not None:
        physics.append(hum_entry(hum, recordings.unit))
    physics.sort(key=lambda e: e["id"] == "unknown" and len(physics) > 1)
    mismatch = bool(physics)
    lead = physics[0] if physics else None
    limits, hidden = detection_limits(found.base.model, found.steps[0].screening)
    people: Any = "all" if location.subjects == "all" else list(location.subjects)
    if lead is not None and lead.get("subjects", "all") != "all":
        people = [recordings.names[i] for i in lead["subjects"]]
    for entry in physics:
        if entry.get("subjects", "all") != "all":
            entry["subjects"] = [recordings.names[i] for i in entry["subjects"]]
    covariate = next((e["covariate"] for e in physics if e.get("covariate")), None)
    place = lead["place"] if lead else None
    spot = where(location, lead["side"] if lead else None, people, covariate, place)
    if evidence.changed is not None:
        spot["part"], bands = change_of(evidence.changed, found.steps[0].residuals)
        spot["bands_hz"] = spot["bands_hz"] or bands
    elif lead is not None and lead.get("elements"):
        spot["bands_hz"] = reach_of(found.base, lead["elements"], found.steps[0].residuals)
    if lead is not None and lead["id"] == "rig.mains" and hum is not None:
        near = max(hum.near, _LINE_WIDTH)
        spot["bands_hz"] = _merged([[f * (1 - near), f * (1 + near)] for f in hum.frequencies_hz])
    determined = fitted.determined
    notes = [*fitted.remarks, *evidence.remarks, *_limits_of_few(recordings)]
    verdict: dict[str, Any] = {
        "schema": SCHEMA,
        "mismatch": mismatch,
        "summary": "",
        "where": spot if mismatch else where(location, None, "all", None, None) | {"bands_hz": []},
        "located": _located(location),
        "physics": physics,
        "improvement": _improvement(evidence),
        "network": [str(found.base.model.network), after.network if after is not None else str(before.network)],
        "unexplained": unexplained,
        "detectable": limits,
        "not_identifiable": ["gain", *hidden],
        "elements_not_identified": [
            e for e, d in zip(found.base.model.network.elements, determined, strict=True) if not d
        ],
        "seed": seed,
        "data_sha256": recordings.sha256,
        "title": recordings.title,
        "unit": recordings.unit,
        "reliable": bool(found.base.settled),
        "remarks": notes,
        "version": version("bayes_impedance"),
    }
    if found.posterior is not None and len(evidence.entries) > 1:
        verdict["joint"] = joint(found)
    verdict["summary"] = sentence(verdict, len(recordings.subjects))
    return verdict


def _located(location: Location) -> dict[str, Any]:
    """Where structure was left before anything was added: every band by itself."""
    return {
        "p_value": location.p_value,
        "bands": [
            {
                "low_hz": band.low_hz,
                "high_hz": band.high_hz,
                "part": band.part,
                "kind": band.kind,
                "z": band.statistic,
                "p_value": band.p_value,
            }
            for band in location.bands
        ],
        "magnitude_share": location.magnitude_share if np.isfinite(location.magnitude_share) else None,
        "subjects_p_value": location.subjects_p_value,
    }


def _improvement(evidence: Evidence) -> dict[str, Any] | None:
    before, after = evidence.spoilt or evidence.before, evidence.after
    if after is not None:
        return improvement(before, after, evidence.gain)
    if evidence.spoilt is not None:
        return improvement(before, evidence.before, None)
    gains = [(e["evidence"]["elpd_gain"], e["evidence"]["elpd_gain_se"]) for e in evidence.structures]
    if not gains:
        return None
    # What people have in common changes: everybody's own fit is what it was, and new people are predicted better.
    total, se = sum(g for g, _ in gains), float(np.sqrt(sum(s**2 for _, s in gains)))
    same = improvement(before, before, None)
    ratios = [e["id"] for e in evidence.structures if e["id"] not in HELD_OUT]
    held_out = f"{FOLDS} subject folds" + (f"; a likelihood ratio for {' and '.join(ratios)}" if ratios else "")
    return same | {"elpd_gain": total, "elpd_gain_se": se, "held_out": held_out}


def _limits_of_few(recordings: Recordings) -> list[str]:
    if len(recordings.subjects) >= FEW_PEOPLE:
        return []
    texts = [
        "So few people cannot tell what belongs to the rig from what belongs to the body, nor how much people differ."
    ]
    if all(len(s.repetitions) == 1 for s in recordings.subjects):
        texts.append(
            "With one repetition the noise is known only from the roughness of the curve, so that smooth errors of "
            "measurement look like physics."
        )
    return texts
