"""What a picture shows, in words for those who do not see it: its axes, and what a reader would take from it.

A caption says how to read a picture; its alternative says what is seen there. All numbers are those of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.plots import diagnosis_charts, fit_charts
from bayes_impedance.plots.access import frequency, identified, needed, observed, subjects, variable, varying, who
from bayes_impedance.plots.missing_physics import people, pooled
from bayes_impedance.plots.style import row_median
from bayes_impedance.report.findings import number_text
from bayes_impedance.results.result import Result
from bayes_impedance.units import hertz, significant

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.types import Diagnosis


def of_fit(result: Result) -> dict[str, str]:
    """Alternative of each picture of a run, by its name."""
    n, f = len(subjects(result)), frequency(result)
    several, whom, band = n > 1, who(result, n), _band(f)
    magnitude, phase = observed(result)
    scale = fit_charts.magnitude_scale(result)
    seen = [name for name, known in zip(result.elements, identified(result), strict=True) if known]
    each = f"of {n} {whom}" if several else "of the recording"
    size = _course(row_median(scale.factor * magnitude), f, f" {scale.unit}")
    angle = _course(row_median(phase), f, "°")
    middle = "Their median" if several else "It"
    noise = row_median(100 * needed(result, "noise_relative"))
    texts = {
        "curves": f"Magnitude and phase {each} {band}. {middle} has a magnitude of {size}, and a phase of {angle}.",
        "noise": f"Residuals relative to the magnitude {each} {band}: typically {_course(noise, f, ' %')}.",
        "person": f"Magnitude, phase and residual of one {who(result, 1)} {band}.",
        "elements": f"Elements {', '.join(seen)} of {n} {whom}, as distances from the population's centre; the values "
        "of the one chosen are in the table above it.",
        "traces": f"Draws of {_number(seen, 'element')} in the order of sampling, one colour for each ensemble.",
        "priors": f"Prior and posterior of {_number(result.elements, 'element')}, one above the other; the table of "
        "elements has the intervals.",
    }
    if result.problems:
        return texts
    texts |= _of_estimates(result, seen, band)
    return texts


def _of_estimates(result: Result, seen: Sequence[str], band: str) -> dict[str, str]:
    n, f, summary = len(subjects(result)), frequency(result), result.summary
    whom = who(result, n)
    scale = fit_charts.magnitude_scale(result)
    recording = needed(result, "band_recording")
    width = recording[0, 4] / recording[0, 0]
    errors = needed(result, "error_population_network")
    widest, narrowest = int(np.nanargmax(width)), int(np.nanargmin(width))
    inside = f"{100 * summary['coverage']['90']:.0f} %"
    texts = {
        "bands": f"Predicted bands with the recordings {band}: the 90 % band spans a factor of "
        f"{significant(width[narrowest], 2)} at {hertz(f[narrowest])}, where it is narrowest, and of "
        f"{significant(width[widest], 2)} at {hertz(f[widest])}, where it is widest, and holds {inside} of the "
        "recordings.",
        "errors": f"Error of the network {band}: in magnitude "
        f"{_course(scale.factor * errors[0], f, f' {scale.unit}')}; in phase {_course(errors[1], f, '°')}.",
        "coverage": f"Share of {whom} inside the predicted bands {band}: on average {inside} in the 90 % band and "
        f"{100 * summary['coverage']['50']:.0f} % in the 50 % band.",
    }
    earlier = variable(result, "before_error")
    if earlier is not None:
        texts["errors"] += (
            f" Of the network before: in magnitude {_course(scale.factor * earlier[0], f, f' {scale.unit}')}; in phase "
            f"{_course(earlier[1], f, '°')}."
        )
        share = 100 * float(np.nanmean(needed(result, "before_coverage_90")))
        texts["coverage"] += f" That of the network before holds {share:.0f} % on average."
    if not seen:
        return texts
    texts["corner_central"] = (
        f"A triangle of panels, the joint posterior of each pair of the central values of {_and(seen)}; the table of "
        "elements has their intervals."
    )
    entries = {name: summary["elements"][name] for name in seen}
    known = {name: e["central"] for name, e in entries.items() if e["central"]["median"]}
    spans = {name: abs((c["q95"] - c["q05"]) / c["median"]) for name, c in known.items()}
    if spans:
        best, worst = min(spans, key=lambda name: spans[name]), max(spans, key=lambda name: spans[name])
        texts["overview"] = (
            f"Uncertainty and dispersion of {_number(seen, 'element')}. Best known is {best}, to ±{_half(spans[best])};"
            f" least well {worst}, to ±{_half(spans[worst])}."
        )
    spreads = {name: e["dispersion_between_persons"]["median"] for name, e in entries.items()}
    spreads = {name: s for name, s in spreads.items() if s is not None}
    if variable(result, "dispersion_between_persons") is not None and spreads:
        least, most = min(spreads, key=lambda name: spreads[name]), max(spreads, key=lambda name: spreads[name])
        varied = [n for n, v in zip(result.elements, varying(result), strict=True) if v and n in seen]
        texts["corner_dispersion"] = (
            f"A triangle of panels, the joint posterior of each pair of the dispersions of {_and(varied)}."
        )
        texts["forest"] = (
            f"Values of {_number(varied, 'element')} of {n} {whom}, sorted in each panel. They differ most in {most}, "
            f"by ×{math.exp(spreads[most]):.2f}, and least in {least}, by ×{math.exp(spreads[least]):.2f}."
        )
        rows = [row for row in summary["correlation"] if set(row[:2]) <= set(seen)]
        told = ""
        if rows:
            a, b, value, *_ = max(rows, key=lambda row: abs(row[2]))
            told = f" The strongest is {number_text(value, 2)}, between {a} and {b}."
        texts["correlation"] = f"Triangle of the correlations between {_and(varied)}, as colours.{told}"
    return texts


def of_diagnosis(diagnosis: Diagnosis) -> dict[str, str]:
    """Alternative of each picture of a diagnosis, by its name."""
    before, after, f = diagnosis.before, diagnosis.after, diagnosis.before.frequency_hz
    n, band = len(diagnosis.subjects), _band(f)
    whom, models = people(diagnosis, n), " before and after" if after is not None else ""
    scale = diagnosis_charts.magnitude_scale(diagnosis)
    pools = [pooled(rows) for rows in (before.residual_magnitude, before.residual_phase)]
    told = [f"in {part} {_extreme(pool, f)}" for part, pool in zip(("magnitude", "phase"), pools, strict=True)]
    texts = {
        "diagnosis_bands": f"Predicted bands with the recordings of {n} {whom} {band}{models}. The model's median has "
        f"a magnitude of {_course(scale.factor * before.magnitude[1], f, f' {scale.unit}')}.",
        "diagnosis_pooled": f"Pooled residual {band}{models}. Before anything is added it is largest "
        f"{' and '.join(told)}{_then(diagnosis)}; 95 % of noise lies between −2 and 2.",
        "diagnosis_residuals": f"Residuals of {n} {whom} {band} as colours, one row for each{models}. Beyond two "
        f"standard deviations {_beyond(diagnosis)}; noise alone leaves 5 % there.",
        "person": f"Magnitude, phase and residual of one {people(diagnosis, 1)} {band}{models}.",
        "elements": "",
    }
    if diagnosis.one_ports:
        port = diagnosis.one_ports[0]
        texts["diagnosis_one_ports"] = (
            f"Missing impedance relative to the present one {band}, real and imaginary part, at "
            f"{_and([p.place for p in diagnosis.one_ports[:4]])}. At {port.place} it is largest "
            f"{_extreme(np.abs(port.ratio), port.frequency_hz)}."
        )
    if after is not None:
        pairs = [
            (f"{_mean(s.delta_phase_deg)}°", f"{_mean(scale.factor * s.delta_magnitude)} {scale.unit}")
            for s in (before, after)
        ]
        texts["diagnosis_improvement"] = (
            f"Errors {band} before and after. Averages over frequency: magnitude {pairs[0][1]} before, {pairs[1][1]} "
            f"after; phase {pairs[0][0]} before, {pairs[1][0]} after."
        )
    return texts


def _then(diagnosis: Diagnosis) -> str:
    if diagnosis.after is None:
        return ""
    rest = [pooled(rows) for rows in (diagnosis.after.residual_magnitude, diagnosis.after.residual_phase)]
    sizes = [float(np.nanmax(np.abs(r))) for r in rest if np.isfinite(r).any()]
    return f"; after, nowhere more than {significant(max(sizes), 2)}" if sizes else ""


def _beyond(diagnosis: Diagnosis) -> str:
    said = []
    for name, snapshot in diagnosis_charts.models(diagnosis):
        both = np.stack([snapshot.residual_magnitude, snapshot.residual_phase])
        finite = both[np.isfinite(both)]
        if finite.size:
            said.append(f"lie {100 * np.mean(np.abs(finite) > 2):.0f} % {name}")
    return " and ".join(said) if said else "lies nothing that was measured"


def _band(f: np.ndarray) -> str:
    return f"from {hertz(f[0])} to {hertz(f[-1])}"


def _course(y: np.ndarray, f: np.ndarray, unit: str) -> str:
    """A curve's ends, and its extremes if they lie inside."""
    at = np.flatnonzero(np.isfinite(y))
    if not at.size:
        return "no known value"
    first, last = int(at[0]), int(at[-1])
    text = (
        f"{number_text(y[first], 2)}{unit} at {hertz(f[first])} and {number_text(y[last], 2)}{unit} at {hertz(f[last])}"
    )
    for word, i in (("least", int(np.nanargmin(y))), ("most", int(np.nanargmax(y)))):
        if i not in (first, last):
            text += f", at {word} {number_text(y[i], 2)}{unit} at {hertz(f[i])}"
    return text


def _extreme(y: np.ndarray, f: np.ndarray) -> str:
    if not np.isfinite(y).any():
        return "nowhere, for it is not known"
    i = int(np.nanargmax(np.abs(y)))
    return f"at {hertz(f[i])} ({number_text(y[i], 2)})"


def _mean(y: np.ndarray) -> str:
    finite = y[np.isfinite(y)]
    return number_text(float(finite.mean()) if finite.size else math.nan, 3)


def _half(span: float) -> str:
    return f"{significant(50 * span, 2)} %"


def _number(names: Sequence[str], noun: str) -> str:
    return f"{len(names)} {noun}{'' if len(names) == 1 else 's'}"


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
