"""Charts of a fit, as :mod:`.spectra` draws them."""

from __future__ import annotations

import numpy as np

from bayes_impedance.plots.access import needed, observed, subjects, variable, who
from bayes_impedance.plots.charts import Chart, Line, Panel, People, Ribbon
from bayes_impedance.plots.style import row_median
from bayes_impedance.results.misfit import range_by_chance
from bayes_impedance.results.result import Result
from bayes_impedance.units import Scale, scale_for

NINETY_SD = 1.645
"""Half the width of a normal variable's 90 % interval in standard deviations."""

BEFORE = "the network before"
"""How charts call the network to which something was added."""


def magnitude_scale(result: Result) -> Scale:
    """Prefix and unit of |z| on all charts of a result."""
    return scale_for(float(np.nanmedian(observed(result)[0])), result.attributes["unit"])


def has_before(result: Result) -> bool:
    """Whether the result holds what the network described before something was added to it."""
    return variable(result, "before_band_recording") is not None


def people_curves(result: Result) -> dict[str, np.ndarray]:
    """Curves of each person, (N, F) each: recording, fitted network and noise, in the units of the charts.

    The fitted network is missing in results of earlier versions.
    """
    factor = magnitude_scale(result).factor
    magnitude, phase = observed(result)
    relative = 100 * needed(result, "noise_relative")
    curves = {"magnitude": factor * magnitude, "phase": phase, "noise": relative}
    real = variable(result, "person_curve_re")
    if real is not None:
        fitted = real + 1j * needed(result, "person_curve_im")
        measured = needed(result, "observed_re") + 1j * needed(result, "observed_im")
        curves |= fit_and_residual(fitted, measured, factor)
        if has_before(result):
            earlier = needed(result, "before_person_curve_re") + 1j * needed(result, "before_person_curve_im")
            curves |= fit_and_residual(earlier, measured, factor, "_before")
        # Of a mean over repetitions, in each of two directions.
        curves["noise_limit"] = NINETY_SD * relative / np.sqrt(needed(result, "repetitions"))[:, None]
    return curves


def fit_and_residual(
    fitted: np.ndarray, measured: np.ndarray, factor: float, suffix: str = ""
) -> dict[str, np.ndarray]:
    """Magnitude and phase of fitted curves, and the residual of the recordings in % of the fitted |z|.

    Parameters
    ----------
    fitted, measured : ndarray, complex, shape (N, F)
    factor : float
        From the unit of `fitted` to that of the charts.
    suffix : str
        Of the names: which model it is.

    Returns
    -------
    dict of str to ndarray
        ``residual_along`` is the part in the direction of z, a difference of the magnitude; ``residual_across`` the
        part at a right angle to it, a difference of the phase (1 % is 0.57 degrees).
    """
    with np.errstate(invalid="ignore"):  # NaN where there is no recording
        rest = 100 * (measured / fitted - 1)
    return {
        f"fit_magnitude{suffix}": factor * np.abs(fitted),
        f"fit_phase{suffix}": degrees(fitted),
        f"residual_along{suffix}": rest.real,
        f"residual_across{suffix}": rest.imag,
    }


def degrees(z: np.ndarray) -> np.ndarray:
    """Phase in degrees, NaN where there is no value."""
    return np.where(np.isfinite(z), np.angle(z, deg=True), np.nan)


def fit_charts(result: Result) -> list[Chart]:
    """All charts of a result; those of estimates only if its numbers may be used."""
    charts = [curves(result), noise(result)]
    if result.problems:
        return charts
    return [*charts, bands(result), errors(result), *([coverage(result)] if len(subjects(result)) > 1 else [])]


def curves(result: Result) -> Chart:
    """Each person's mean recording, with the pointwise median."""
    magnitude, phase = observed(result)
    scale, several = magnitude_scale(result), len(subjects(result)) > 1
    panels = []
    for values, rows, label in (
        ("magnitude", scale.factor * magnitude, scale.label("|z|")),
        ("phase", phase, "phase (°)"),
    ):
        median = (Line(name="median", y=row_median(rows), colour="ink"),) if several else ()
        panels.append(
            Panel(
                label=label,
                logarithmic=values == "magnitude",
                lines=median,
                people=People(values=values, name=_each(result), colour="blue"),
            )
        )
    return Chart(name="curves", panels=tuple(panels))


def bands(result: Result) -> Chart:
    """Predicted bands of a new recording with the measured ones, and the population's centre."""
    scale, several = magnitude_scale(result), len(subjects(result)) > 1
    recording, centre = needed(result, "band_recording"), needed(result, "band_centre")
    middle, earlier = scale.factor * centre[0, 2], variable(result, "before_band_recording")
    when = "" if earlier is None else "after"
    kind = "new recordings" if several else "repeated recordings"
    panels = []
    for label, part, by, values in (
        (scale.label("|z|"), 0, 1 / scale.factor, "magnitude"),
        ("|z| / centre", 0, centre[0, 2], "magnitude"),
        ("phase (°)", 1, 1.0, "phase"),
    ):
        band, own = recording[part] / by, centre[part] / by
        divided = {"": middle} if label == "|z| / centre" else {}
        before_bands: tuple[Ribbon, ...] = ()
        before_lines: tuple[Line, ...] = ()
        if earlier is not None:
            low, median, high = earlier[part] / by
            before_bands = (Ribbon(name=f"90 % of {kind}", low=low, high=high, colour="outer", when="before"),)
            before_lines = (Line(name=f"median of {BEFORE}", y=median, colour="red", when="before"),)
        panels.append(
            Panel(
                label=label,
                logarithmic=part == 0,
                ribbons=(
                    Ribbon(name=f"90 % of {kind}", low=band[0], high=band[4], colour="outer", when=when),
                    Ribbon(name=f"50 % of {kind}", low=band[1], high=band[3], colour="inner", when=when),
                    Ribbon(name="90 % interval of the centre", low=own[0], high=own[4], colour="warm", when=when),
                    *before_bands,
                ),
                lines=(
                    Line(name="population centre" if several else "network", y=own[2], colour="red", when=when),
                    *before_lines,
                ),
                people=People(values=values, name=_each(result), over=divided),
            )
        )
    return Chart(name="bands", panels=tuple(panels))


def errors(result: Result) -> Chart:
    """Eq. 5 over frequency: the population network, the look-up tables, and replicated populations."""
    several = len(subjects(result)) > 1
    replicated, network = needed(result, "replicated_error"), needed(result, "error_population_network")
    earlier = variable(result, "before_error")
    scale = scale_for(float(np.nanmedian(network[0])), result.attributes["unit"])
    kind = "populations" if several else "recordings"
    panels = []
    for part, (label, factor) in enumerate(((scale.label("magnitude error"), scale.factor), ("phase error (°)", 1.0))):
        lines = [
            Line(name="population network" if several else "network", y=factor * network[part], colour="blue"),
        ]
        if several:  # with one recording the look-up table is that recording
            for statistic, colour, dash in (("mean", "orange", "dash"), ("median", "green", "dashdot")):
                table = needed(result, f"error_lookup_{statistic}")[part]
                lines.append(Line(name=f"look-up table, {statistic}", y=factor * table, colour=colour, dash=dash))
        if earlier is not None:
            lines.append(Line(name=BEFORE, y=factor * earlier[part], colour="red", dash="dot"))
        shown = factor * replicated[part]
        band = Ribbon(name=f"replicated {kind}, 5–95 %", low=shown[0], high=shown[2], colour="sky")
        panels.append(Panel(label=label, logarithmic=part == 0, zero=part == 1, lines=tuple(lines), ribbons=(band,)))
    return Chart(name="errors", panels=tuple(panels))


def coverage(result: Result) -> Chart:
    """Share of people inside the predicted bands, and its range by chance alone."""
    present, earlier = np.isfinite(observed(result)[0]).sum(axis=0), variable(result, "before_coverage_90")
    panels = []
    for part, title in enumerate(("magnitude", "phase")):
        lines, ribbons = [], []
        for nominal, colour, fill in ((0.9, "blue", "outer"), (0.5, "orange", "amber")):
            low, high = range_by_chance(nominal, present)
            name = f"{100 * nominal:.0f} % band"
            share = 100 * needed(result, f"coverage_{100 * nominal:.0f}")[part]
            ribbons.append(Ribbon(name=f"{name}, by chance", low=100 * low, high=100 * high, colour=fill))
            lines.append(Line(name=f"inside the {name}", y=share, colour=colour))
        if earlier is not None:
            name = f"inside the 90 % band of {BEFORE}"
            lines.append(Line(name=name, y=100 * earlier[part], colour="red", dash="dot"))
        label = f"{title}: {who(result)} (%)"
        panels.append(Panel(label=label, zero=True, lines=tuple(lines), ribbons=tuple(ribbons)))
    return Chart(name="coverage", panels=tuple(panels))


def noise(result: Result) -> Chart:
    """Residuals relative to the impedance over frequency, of each person."""
    relative = 100 * needed(result, "noise_relative")
    several = len(subjects(result)) > 1
    median = (Line(name="median", y=row_median(relative), colour="ink"),) if several else ()
    panel = Panel(
        label="noise, relative to |z| (%)",
        logarithmic=True,
        lines=median,
        people=People(values="noise", name=_each(result), colour="blue"),
    )
    return Chart(name="noise", panels=(panel,))


def _each(result: Result) -> str:
    return f"each {who(result, 1)}" if len(subjects(result)) > 1 else "the recording"
