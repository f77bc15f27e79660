"""Charts of a diagnosis, as :mod:`.missing_physics` draws them, with both models in one chart for a switch."""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.types import Diagnosis, Snapshot
from bayes_impedance.plots.charts import Chart, Line, Panel, People, Ribbon
from bayes_impedance.plots.fit_charts import degrees, fit_and_residual
from bayes_impedance.plots.missing_physics import inner_limits, mismatch_bands, pattern_order, people, pooled
from bayes_impedance.units import Scale, scale_for

_PLACES = 4
"""Most one-ports in a chart. By choice: as in the picture."""


def magnitude_scale(diagnosis: Diagnosis) -> Scale:
    """Prefix and unit of |z| on all charts of a diagnosis."""
    size = np.abs(diagnosis.observed)
    finite = size[np.isfinite(size)]
    return scale_for(float(np.median(finite)) if finite.size else np.nan, diagnosis.unit)


def models(diagnosis: Diagnosis) -> list[tuple[str, Snapshot]]:
    """The models that are compared, by the names under which charts show them."""
    both = [("before", diagnosis.before), ("after", diagnosis.after)]
    return [(name, snapshot) for name, snapshot in both if snapshot is not None]


def people_curves(diagnosis: Diagnosis) -> dict[str, np.ndarray]:
    """Curves of each person, (N, F) each: recording, and fit and residual of each model, in the charts' units."""
    z, factor = diagnosis.observed, magnitude_scale(diagnosis).factor
    curves = {"magnitude": factor * np.abs(z), "phase": degrees(z)}
    for name, snapshot in models(diagnosis):
        curves |= fit_and_residual(snapshot.person_curve, z, factor, f"_{name}")
    return curves


def diagnosis_charts(diagnosis: Diagnosis) -> list[Chart]:
    """All charts of a diagnosis."""
    charts = [bands(diagnosis), pooled_residual(diagnosis)]
    if len(diagnosis.subjects) > 1:
        charts.append(residual_map(diagnosis))
    if diagnosis.one_ports:
        charts.append(one_ports(diagnosis))
    if diagnosis.after is not None:
        charts.append(improvement(diagnosis))
    return charts


def residual_map(diagnosis: Diagnosis) -> Chart:
    """Whitened residual of each person at each frequency, as colour."""
    own = diagnosis.before
    order = pattern_order(np.hstack([own.residual_magnitude, own.residual_phase]))
    shaded = tuple(mismatch_bands(diagnosis, own.frequency_hz))
    panels = tuple(
        Panel(label=part, cells={name: getattr(s, f"residual_{part}") for name, s in models(diagnosis)}, shaded=shaded)
        for part in ("magnitude", "phase")
    )
    return Chart(name="diagnosis_residuals", panels=panels, order=tuple(order.tolist()))


def bands(diagnosis: Diagnosis) -> Chart:
    """Predicted 90 % bands of each model with the recordings."""
    scale = magnitude_scale(diagnosis)
    panels = []
    for label, values in (
        (scale.label("|z|"), "magnitude"),
        ("|z| / model's median", "magnitude"),
        ("phase (°)", "phase"),
    ):
        ribbons, lines, over = [], [], {}
        for name, snapshot in models(diagnosis):
            band = snapshot.phase_deg if values == "phase" else scale.factor * snapshot.magnitude
            if "median" in label:
                over[name] = band[1]
                band = band / band[1]
            ribbons.append(Ribbon(name="90 % of recordings", low=band[0], high=band[2], colour="outer", when=name))
            lines.append(Line(name="model, median", y=band[1], colour="blue", when=name))
        panels.append(
            Panel(
                label=label,
                logarithmic=values == "magnitude",
                lines=tuple(lines),
                ribbons=tuple(ribbons),
                people=People(values=values, name=_each(diagnosis), over=over),
            )
        )
    return Chart(name="diagnosis_bands", panels=tuple(panels))


def pooled_residual(diagnosis: Diagnosis) -> Chart:
    """Residual pooled over people, before and after together."""
    shaded = tuple(mismatch_bands(diagnosis, diagnosis.before.frequency_hz))
    both, panels = models(diagnosis), []
    for part in ("magnitude", "phase"):
        lines = []
        for (name, snapshot), colour in zip(both, ("red", "blue") if len(both) > 1 else ("blue",), strict=True):
            said = name if len(both) > 1 else "residual"
            lines.append(Line(name=said, y=pooled(getattr(snapshot, f"residual_{part}")), colour=colour))
        ends = np.full(diagnosis.before.frequency_hz.size, 2.0)
        chance = Ribbon(name="95 % range by chance", low=-ends, high=ends, colour="grey")
        panels.append(Panel(label=f"{part}: pooled residual", lines=tuple(lines), ribbons=(chance,), shaded=shaded))
    return Chart(name="diagnosis_pooled", panels=tuple(panels))


def one_ports(diagnosis: Diagnosis) -> Chart:
    """The missing one-port at the best places; the first is shown, the others on request."""
    first, panels = diagnosis.one_ports[0], []
    shown = [port for port in diagnosis.one_ports[:_PLACES] if np.array_equal(port.frequency_hz, first.frequency_hz)]
    for part in ("real", "imag"):
        lines, ribbons = [], []
        for port, colour in zip(shown, ("blue", "orange", "green", "red"), strict=False):
            values, own = getattr(port.ratio, part), port is first
            # Without a mismatch there is no share of it to explain.
            known = diagnosis.verdict.mismatch and np.isfinite(port.share)
            name = f"at {port.place}{f' (explains {100 * port.share:.0f} %)' if known else ''}"
            lines.append(Line(name=name, y=values, colour=colour, shown=own))
            low, high = values - 2 * port.sd, values + 2 * port.sd
            ribbons.append(Ribbon(name=f"at {port.place}, ± 2 se", low=low, high=high, colour="inner", shown=own))
        label = f"{'real' if part == 'real' else 'imaginary'} part, relative"
        limits = inner_limits(first.ratio, first.sd)
        panels.append(Panel(label=label, lines=tuple(lines), ribbons=tuple(ribbons), limits=limits))
    return Chart(name="diagnosis_one_ports", panels=tuple(panels), frequency_hz=first.frequency_hz)


def improvement(diagnosis: Diagnosis) -> Chart:
    """Eq. 5 and the coverage of the bands, before and after together."""
    both = models(diagnosis)
    size = diagnosis.before.delta_magnitude[np.isfinite(diagnosis.before.delta_magnitude)]
    scale = scale_for(float(np.median(size)) if size.size else np.nan, diagnosis.unit)
    rows = [
        (scale.label("magnitude error"), [scale.factor * s.delta_magnitude for _, s in both], True),
        ("phase error (°)", [s.delta_phase_deg for _, s in both], False),
    ]
    if len(diagnosis.subjects) > 1:
        rows.append(("in the 90 % band (%)", [100 * s.coverage90.mean(axis=0) for _, s in both], False))
    panels = tuple(
        Panel(
            label=label,
            logarithmic=logarithmic,
            zero=not logarithmic,
            lines=tuple(
                Line(name=name, y=y, colour=colour)
                for (name, _), y, colour in zip(both, curves, ("red", "blue"), strict=True)
            ),
        )
        for label, curves, logarithmic in rows
    )
    return Chart(name="diagnosis_improvement", panels=panels)


def _each(diagnosis: Diagnosis) -> str:
    return f"each {people(diagnosis, 1)}" if len(diagnosis.subjects) > 1 else "the recording"
