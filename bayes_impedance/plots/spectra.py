"""Pictures over frequency: recordings, predictions, errors, coverage and noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.plots.access import frequency, needed, observed, subjects, variable, who
from bayes_impedance.plots.fit_charts import BEFORE
from bayes_impedance.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    INNER,
    MOST_DRAWN,
    ORANGE,
    OUTER,
    RED,
    SKY,
    frequency_axis,
    line_alpha,
    log_axis,
    log_limits,
    many_lines,
    phase_axis,
    row_median,
)
from bayes_impedance.results.misfit import MISFIT_SCALE, range_by_chance
from bayes_impedance.results.result import Result
from bayes_impedance.units import scale_for

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def curves(figure: Figure, result: Result) -> Figure:
    """Each person's mean recording, with the pointwise median.

    Parameters
    ----------
    figure : Figure
        Empty; two panels are put into it.
    result : Result

    Returns
    -------
    Figure
    """
    f, n = frequency(result), len(subjects(result))
    magnitude, phase = observed(result)
    scale = scale_for(float(np.nanmedian(magnitude)), result.attributes["unit"])
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.15, 1))
    name = "the recording" if n == 1 else f"{n} {who(result)}"
    for axes, rows in ((upper, magnitude * scale.factor), (lower, phase)):
        many_lines(axes, f, rows, colors=BLUE, linewidths=0.7 if n > 1 else 1.6, alpha=line_alpha(n))
        axes.plot([], [], color=BLUE, lw=1.0, alpha=0.6 if n > 1 else 0.9, label=name)
        if n > 1:
            axes.plot(f, row_median(rows), color=INK, lw=1.8, label="median")
    upper.set_ylabel(scale.label("|z|"))
    log_axis(upper.yaxis, *log_limits(magnitude * scale.factor))
    phase_axis(lower)
    frequency_axis(upper, f, label=False)
    frequency_axis(lower, f)
    _legend_above(upper)
    return figure


def bands(figure: Figure, result: Result) -> Figure:
    """Predicted bands of a new recording with the measured recordings, and the population centre.

    The middle panel is the magnitude divided by the centre's: over several decades a factor of 1.5 is not visible.

    Parameters
    ----------
    figure : Figure
        Empty; three panels are put into it.
    result : Result

    Returns
    -------
    Figure
    """
    f, n = frequency(result), len(subjects(result))
    magnitude, phase = observed(result)
    recording, centre = needed(result, "band_recording"), needed(result, "band_centre")
    scale = scale_for(float(np.nanmedian(magnitude)), result.attributes["unit"])
    middle = centre[0, 2]
    panels = figure.subplots(3, 1, sharex=True, height_ratios=(1.1, 1, 1))
    rows = (
        (magnitude * scale.factor, recording[0] * scale.factor, centre[0] * scale.factor),
        (magnitude / middle, recording[0] / middle, centre[0] / middle),
        (phase, recording[1], centre[1]),
    )
    name = "new recording" if n > 1 else "repeated recording"
    earlier = variable(result, "before_band_recording")
    factors = (scale.factor, 1 / middle, 1.0)
    for k, (axes, (data, band, own)) in enumerate(zip(panels, rows, strict=True)):
        axes.fill_between(f, band[0], band[4], color=OUTER, lw=0, label=f"90 % of {name}s")
        axes.fill_between(f, band[1], band[3], color=INNER, lw=0, label=f"50 % of {name}s")
        many_lines(axes, f, data, colors=INK, linewidths=0.6 if n > 1 else 1.4, alpha=line_alpha(n))
        axes.plot([], [], color=INK, lw=0.8, alpha=0.7, label="measured")
        axes.fill_between(f, own[0], own[4], color=RED, alpha=0.5, lw=0, label="its 90 % interval")
        axes.plot(f, own[2], color=RED, lw=1.4, label="population centre" if n > 1 else "network")
        if earlier is not None:
            low, _, high = earlier[k // 2] * factors[k]
            axes.plot(f, low, color=GREEN, lw=1.2, ls=":", label=f"90 % of {BEFORE}")
            axes.plot(f, high, color=GREEN, lw=1.2, ls=":")
    panels[0].set_ylabel(scale.label("|z|"))
    panels[1].set_ylabel("|z| / centre")
    for axes, (data, band, _), factor, ticks in zip(panels, rows, factors[:2], ({}, {"ticks": 5}), strict=False):
        log_axis(axes.yaxis, *log_limits(data, band, *(() if earlier is None else (earlier[0] * factor,))), **ticks)
    phase_axis(panels[2])
    for axes in panels:
        frequency_axis(axes, f, label=axes is panels[2])
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def errors(figure: Figure, result: Result) -> Figure:
    """Eq. 5 over frequency: the population network, the look-up tables, and replicated populations.

    Parameters
    ----------
    figure : Figure
        Empty; two panels are put into it.
    result : Result

    Returns
    -------
    Figure
    """
    f, n = frequency(result), len(subjects(result))
    replicated, network = needed(result, "replicated_error"), needed(result, "error_population_network")
    scale = scale_for(float(np.nanmedian(network[0])), result.attributes["unit"])
    panels = figure.subplots(2, 1, sharex=True)
    kind = "populations" if n > 1 else "recordings"
    tables = [needed(result, f"error_lookup_{statistic}") for statistic in ("mean", "median")]
    earlier = variable(result, "before_error")
    for part, (axes, factor) in enumerate(zip(panels, (scale.factor, 1.0), strict=True)):
        shown = replicated[part] * factor
        axes.fill_between(f, shown[0], shown[2], color=SKY, alpha=0.45, lw=0, label=f"replicated {kind}, 5–95 %")
        if n > 1:  # with one recording the look-up table is that recording
            axes.plot(f, tables[0][part] * factor, color=ORANGE, lw=1.4, ls="--", label="look-up table, mean")
            axes.plot(f, tables[1][part] * factor, color=GREEN, lw=1.4, ls="-.", label="look-up table, median")
        axes.plot(f, network[part] * factor, color=BLUE, lw=1.6, label="population network" if n > 1 else "network")
        if earlier is not None:
            axes.plot(f, earlier[part] * factor, color=RED, lw=1.4, ls=":", label=BEFORE)
        frequency_axis(axes, f, label=part == 1)
    shown_too = [network, *(replicated[:, i] for i in (0, 2)), *(tables if n > 1 else ())]
    shown_too += [] if earlier is None else [earlier]
    panels[0].set_ylabel(scale.label("magnitude error"))
    log_axis(panels[0].yaxis, *log_limits(*(scale.factor * rows[0] for rows in shown_too)))
    panels[1].set_ylabel("phase error (°)")
    panels[1].set_ylim(bottom=0)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def coverage(figure: Figure, result: Result) -> Figure:
    """Share of people inside the predicted bands, and its range by chance alone.

    Parameters
    ----------
    figure : Figure
        Empty; two panels are put into it.
    result : Result

    Returns
    -------
    Figure
    """
    f = frequency(result)
    present = np.isfinite(observed(result)[0]).sum(axis=0)
    earlier = variable(result, "before_coverage_90")
    panels = figure.subplots(2, 1, sharex=True, sharey=True)
    for part, (axes, title) in enumerate(zip(panels, ("magnitude", "phase"), strict=True)):
        for nominal, colour in ((0.9, BLUE), (0.5, ORANGE)):
            low, high = range_by_chance(nominal, present)
            axes.fill_between(f, 100 * low, 100 * high, color=colour, alpha=0.15, lw=0)
            axes.axhline(100 * nominal, color=colour, lw=1.0, ls=(0, (4, 3)))
            share = 100 * needed(result, f"coverage_{100 * nominal:.0f}")[part]
            axes.plot(f, share, color=colour, lw=1.5, label=f"inside the {100 * nominal:.0f} % band")
        if earlier is not None:
            axes.plot(f, 100 * earlier[part], color=RED, lw=1.4, ls=":", label=f"inside the 90 % band of {BEFORE}")
        axes.set_ylim(0, 103)
        axes.set_yticks([0, 25, 50, 75, 100])
        axes.set_ylabel(f"{title}: {who(result)} (%)")
        frequency_axis(axes, f, label=part == 1)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def noise(figure: Figure, result: Result) -> Figure:
    """Relative noise over frequency; below it, each person's noise scale and residual.

    Parameters
    ----------
    figure : Figure
        Empty; one panel, or three if there are several people, are put into it.
    result : Result

    Returns
    -------
    Figure
    """
    f, n = frequency(result), len(subjects(result))
    relative = 100 * needed(result, "noise_relative")
    if n == 1:
        _noise_curves(figure.subplots(), f, relative, "this recording")
        return figure
    grid = figure.add_gridspec(2, 2, height_ratios=(1.25, 1))
    _noise_curves(figure.add_subplot(grid[0, :]), f, relative, f"{n} {who(result)}")
    left, right = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    ranked(left, needed(result, "noise_scale"), f"{who(result)}, sorted")
    left.set_ylabel("residual / noise")
    left.axhline(1.0, color=GREY, lw=1.0)
    if np.max(needed(result, "noise_scale")) > 0.8 * MISFIT_SCALE:
        left.axhline(MISFIT_SCALE, color=RED, lw=1.0, ls="--", label="above: not described by the network")
        left.legend(loc="lower right")
    ranked(right, 100 * needed(result, "person_relative_rms"), f"{who(result)}, sorted")
    right.set_ylabel("error of the individual fit (%)")
    return figure


def _noise_curves(axes: Axes, f: np.ndarray, relative: np.ndarray, name: str) -> None:
    n = relative.shape[0]
    many_lines(axes, f, relative, colors=BLUE, linewidths=0.7 if n > 1 else 1.5, alpha=line_alpha(n))
    axes.plot([], [], color=BLUE, lw=1.0, alpha=0.7, label=name)
    if n > 1:
        axes.plot(f, row_median(relative), color=INK, lw=1.8, label="median")
    axes.set_ylabel("noise, relative to |z| (%)")
    log_axis(axes.yaxis, *log_limits(relative))
    frequency_axis(axes, f)
    _legend_above(axes)


def _legend_above(axes: Axes) -> None:
    """Put the legend outside the axes, because curves may be anywhere inside."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)


def ranked(axes: Axes, values: np.ndarray, label: str) -> Axes:
    """One dot for each person, in ascending order.

    Parameters
    ----------
    axes : Axes
    values : ndarray, shape (N,)
    label : str
        Of the horizontal axis.

    Returns
    -------
    Axes
    """
    n = values.size
    axes.plot(np.arange(n), np.sort(values), "o", ms=3.5, color=BLUE, mew=0, rasterized=n > MOST_DRAWN)
    axes.set_xlabel(label)
    axes.set_xticks([])
    axes.set_ylim(0, 1.15 * float(np.max(values)))
    return axes
