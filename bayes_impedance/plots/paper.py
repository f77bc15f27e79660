"""The paper's figures 3, 4 and 5: measured curves, the errors of several methods, and models over the data.

They take arrays, not a result, because most of the models that they compare do not come from a run. Each draws into one
Axes; a magnitude and a phase side by side, or one above the other, are two calls::

    with style():
        figure = new_figure(8.2, 6)
        upper, lower = figure.subplots(2, 1, sharex=True)
        bode(upper, frequency_hz, models, z, "N s/m", "magnitude")
        bode(lower, frequency_hz, models, z, "N s/m", "phase", legend=False)
        save_figure(figure, folder, "bode")
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIGHT,
    ORANGE,
    PURPLE,
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
from bayes_impedance.units import Scale, scale_for, significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PARTS = ("magnitude", "phase")

_COLOURS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
_DASHES: tuple[object, ...] = ("-", (0, (6, 2)), (0, (2, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
"""Line styles, lengths in line widths. By choice: curves of good models coincide, and through dashes the curve below
remains visible."""
_DEGREES = ("°", "deg")
_CLIPPED = 5.0
"""Bars longer than this multiple of the median bar are cut. By choice: the other bars then remain comparable."""
_BEYOND = 10.0
"""Factor outside the data's range up to which a model's magnitude is shown. By choice: further out, the data would
take too little of the axis."""


def all_curves(axes: Axes, frequency_hz: np.ndarray, z: np.ndarray, unit: str, part: str) -> Axes:
    """Each subject's curve, as in the paper's fig. 3.

    Parameters
    ----------
    axes : Axes
    frequency_hz : ndarray, shape (F,)
    z : ndarray, complex, shape (N, F)
        NaN where a subject has no data.
    unit : str
        Of `z`.
    part : str
        ``magnitude`` or ``phase``.

    Returns
    -------
    Axes

    Raises
    ------
    InputError
        If there is no such part.
    """
    scale = _scale(z, unit)
    rows = _rows(z, part, scale)
    many_lines(axes, frequency_hz, rows, colors=BLUE, linewidths=0.8, alpha=max(0.3, line_alpha(len(rows))))
    _value_axis(axes, part, scale, *log_limits(rows))
    frequency_axis(axes, frequency_hz, label=_is_lowest(axes))
    return axes


def bode(
    axes: Axes,
    frequency_hz: np.ndarray,
    curves: Mapping[str, np.ndarray],
    observed: np.ndarray,
    unit: str,
    part: str,
    *,
    legend: bool = True,
) -> Axes:
    """Models and the central 90 % range of people's curves, as in the paper's fig. 5.

    Parameters
    ----------
    axes : Axes
    frequency_hz : ndarray, shape (F,)
    curves : mapping of str to ndarray, complex, shape (F,)
        Label to model, NaN where it has no value; drawn in this order.
    observed : ndarray, complex, shape (N, F)
        Measured curves, NaN where a subject has no data.
    unit : str
        Of all impedances.
    part : str
        ``magnitude`` or ``phase``.
    legend : bool
        Whether to put a legend above the axes; otherwise the caller can make one from the labelled artists.

    Returns
    -------
    Axes

    Raises
    ------
    InputError
        If there is no such part.
    """
    scale = _scale(observed, unit)
    rows = _rows(observed, part, scale)
    low, high = _quantile(rows, 5), _quantile(rows, 95)
    median = row_median(rows)
    axes.fill_between(frequency_hz, low, high, color=LIGHT, lw=0, label="data, 5–95 %")
    axes.plot(frequency_hz, median, color=GREY, lw=3.0, label="data, median")
    shown = []
    for i, (label, curve) in enumerate(curves.items()):
        row = _rows(np.asarray(curve)[None], part, scale)[0]
        if part == "phase":
            row = _continuous(row, median)
        dashes = _DASHES[i % len(_DASHES)]
        axes.plot(frequency_hz, row, color=_COLOURS[i % len(_COLOURS)], lw=1.6, ls=dashes, label=label)
        shown.append(row)
    bottom, top = log_limits(low, high)
    lowest, highest = log_limits(low, high, *shown)
    _value_axis(axes, part, scale, max(lowest, bottom / _BEYOND), min(highest, top * _BEYOND))
    frequency_axis(axes, frequency_hz, label=_is_lowest(axes))
    if legend:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
    return axes


def error_bars(
    axes: Axes,
    labels: Sequence[str],
    mean: Sequence[float] | np.ndarray,
    sd: Sequence[float] | np.ndarray,
    *,
    families: Sequence[str] | None = None,
    unit: str = "N s/m",
    legend: bool = True,
) -> Axes:
    """Mean errors of several methods with their standard deviation over frequency, as in the paper's fig. 4.

    The first method is on top, and the numbers are to the right of the axes. A bar much longer than most is cut and
    marked, because a logarithmic axis would hide the differences between the good methods; so is an error bar that
    leaves the axes. Error bars end at zero, because errors are not negative.

    Parameters
    ----------
    axes : Axes
    labels : sequence of str, length M
    mean, sd : sequence of float or ndarray, shape (M,)
        In `unit`. A mean that is not finite is shown as missing; a standard deviation that is not finite is not shown.
    families : sequence of str, length M, optional
        Kind of every method; methods of one kind share a colour.
    unit : str
        Of an impedance, or ``°`` (``deg``) for a phase.
    legend : bool
        Whether to put a legend of the families above the axes; otherwise the caller can make one from the bars.

    Returns
    -------
    Axes

    Raises
    ------
    InputError
        If the lengths differ or an error is negative.
    """
    values, deviations = np.asarray(mean, dtype=float), np.asarray(sd, dtype=float)
    kinds = [""] * len(labels) if families is None else list(families)
    if not len(labels) == values.size == deviations.size == len(kinds):
        raise InputError(
            f"{len(labels)} labels, {values.size} means, {deviations.size} deviations and {len(kinds)} families do "
            "not belong together: give one of each for every method."
        )
    if np.any(values < 0) or np.any(deviations < 0):
        raise InputError("A mean error or its standard deviation is negative: give absolute errors.")
    scale = _error_scale(values, unit)
    values, deviations = values * scale.factor, deviations * scale.factor
    limit = _limit(values, deviations)
    colours = {kind: _COLOURS[i % len(_COLOURS)] for i, kind in enumerate(dict.fromkeys(kinds))}
    for kind, colour in colours.items():
        rows = [i for i, own in enumerate(kinds) if own == kind]
        lengths = np.nan_to_num(np.minimum(values[rows], limit), nan=0.0)
        axes.barh(rows, lengths, height=0.66, color=colour, alpha=0.55, lw=0, label=kind)
    for i, (value, deviation) in enumerate(zip(values.tolist(), deviations.tolist(), strict=True)):
        _decorate(axes, i, value, deviation, limit)
    axes.set_yticks(range(len(labels)), list(labels))
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlim(0, limit)
    axes.set_xlabel(scale.label("phase error" if unit in _DEGREES else "magnitude error"))
    if legend and families is not None:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
    return axes


def _decorate(axes: Axes, row: int, value: float, deviation: float, limit: float) -> None:
    """Draw the standard deviation, the mark of a cut and the numbers of one bar."""
    if not math.isfinite(value):
        axes.text(0.01, row, "no value", transform=axes.get_yaxis_transform(), va="center", color=GREY, fontsize=8.5)
        return
    if value > limit:
        for x in (0.93, 0.955):
            axes.plot(
                [x - 0.008, x + 0.008],
                [row + 0.42, row - 0.42],
                transform=axes.get_yaxis_transform(),
                color="white",
                lw=1.6,
                solid_capstyle="butt",
            )
    elif math.isfinite(deviation):
        low, high = max(value - deviation, 0.0), value + deviation
        axes.plot([low, min(high, limit)], [row, row], color=INK, lw=1.1, solid_capstyle="butt")
        ends = [x for x in (low, high) if 0.0 < x <= limit]
        axes.plot(ends, [row] * len(ends), "|", color=INK, ms=6, mew=1.1)
        if high > limit:
            axes.plot(limit, row, ">", color=INK, ms=4, mew=0, clip_on=False)
    axes.text(
        1.03,
        row,
        _numbers(value, deviation),
        transform=axes.get_yaxis_transform(),
        va="center",
        color=INK,
        fontsize=8.5,
    )


def _numbers(value: float, deviation: float) -> str:
    """Mean and standard deviation with the same number of decimals."""
    if not math.isfinite(deviation):
        return significant(value)
    if max(value, deviation) >= 1e5 or value < 1e-3:
        return f"{significant(value, 2)} ± {significant(deviation, 2)}"
    places = max(0, 2 - math.floor(math.log10(value)))
    return f"{value:.{places}f} ± {deviation:.{places}f}"


def _limit(values: np.ndarray, deviations: np.ndarray) -> float:
    """Right end of the axis: room for all bars and error bars except those much longer than most bars."""
    finite = np.isfinite(values)
    if not np.any(values[finite] > 0):
        return 1.0
    longest = _CLIPPED * float(np.median(values[finite]))
    deviations = np.where(np.isfinite(deviations), deviations, 0.0)
    ends = np.concatenate([values[finite], (values + deviations)[finite]])
    return 1.1 * float(ends.max() if longest == 0 else ends[ends <= longest].max())


def _error_scale(values: np.ndarray, unit: str) -> Scale:
    finite = values[np.isfinite(values)]
    if unit in _DEGREES:
        return Scale(1.0, "°")
    return scale_for(float(np.median(finite)) if finite.size else math.nan, unit)


def _scale(z: np.ndarray, unit: str) -> Scale:
    magnitude = np.abs(z[np.isfinite(z)])
    return scale_for(float(np.median(magnitude)) if magnitude.size else math.nan, unit)


def _rows(z: np.ndarray, part: str, scale: Scale) -> np.ndarray:
    """Magnitude in the unit of the scale, or phase in degrees; NaN where there are no data."""
    if part not in PARTS:
        raise InputError(f"An impedance has no part '{part}': choose 'magnitude' or 'phase'.")
    rows = np.abs(z) * scale.factor if part == "magnitude" else np.angle(z, deg=True)
    return np.where(np.isfinite(z), rows, np.nan)


def _is_lowest(axes: Axes) -> bool:
    """Whether no panel below shares the frequency axis."""
    place = axes.get_subplotspec()
    return place is None or place.is_last_row() or len(axes.get_shared_x_axes().get_siblings(axes)) == 1


def _value_axis(axes: Axes, part: str, scale: Scale, low: float, high: float) -> None:
    if part == "phase":
        phase_axis(axes)
        return
    log_axis(axes.yaxis, low, high)
    axes.set_ylabel(scale.label("|z|"))


def _quantile(rows: np.ndarray, percent: float) -> np.ndarray:
    """Quantile over people, NaN at frequencies without data: (N, F) to (F,)."""
    result = np.full(rows.shape[1], np.nan)
    some = np.isfinite(rows).any(axis=0)
    result[some] = np.nanpercentile(rows[:, some], percent, axis=0)
    return result


def _continuous(phase_deg: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Phase unwrapped (without jumps at ±180°) and shifted by multiples of 360° to lie near a reference."""
    result = phase_deg.copy()
    present = np.isfinite(phase_deg)
    result[present] = np.unwrap(phase_deg[present], period=360.0)
    difference = (result - reference)[np.isfinite(result) & np.isfinite(reference)]
    return result - 360.0 * round(float(np.median(difference)) / 360.0) if difference.size else result
