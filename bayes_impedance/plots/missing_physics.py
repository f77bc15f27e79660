r"""Pictures of a diagnosis: differences between model and recordings, before and after the missing physics is added.

Whitened residuals :math:`r_{if}` of N people have unit variance if nothing is missing, and so has the pooled residual

.. math:: R_f = \frac{1}{\sqrt{N_f}} \sum_i r_{if} ,

which is their mean times the square root of their number :math:`N_f`. It shows effects far below one person's noise.

Each function draws one picture of one diagnosis, and returns None if there is nothing to show. Call inside
:func:`~bayes_impedance.plots.style`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.plots.style import (
    BLUE,
    GREY,
    INK,
    INNER,
    LIGHT,
    ORANGE,
    OUTER,
    RED,
    frequency_axis,
    line_alpha,
    log_axis,
    log_limits,
    many_lines,
    new_figure,
    phase_axis,
)
from bayes_impedance.units import scale_for, who

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayes_impedance.diagnosis.types import Diagnosis, Snapshot

_WIDTH = 8.2
"""Width of a figure in inches. By choice: about the width of a page."""
_LIMIT = 4.0
"""End of the colour scale in standard deviations. By choice: larger residuals have the same colour."""
_NAMED = 25
"""Most people whose names are shown. By choice: for more there is no room."""
_PLACES = 4
"""Most one-ports that are shown. By choice: completeness against the figure's height."""
_WIDE = 4.0
"""A ribbon this many times wider than the median width may be cut at the axis. By choice: otherwise poorly known
frequencies would determine the axis."""
_BAND = "#f7d99a"
_PARTS = ("magnitude", "phase")
_COLOURS = (RED, BLUE)
"""Colours of before and after."""


def people(diagnosis: Diagnosis, number: int = 2) -> str:
    """Word for the subjects: recordings of batteries, for example, are not of people."""
    return who(diagnosis.unit, number)


def residual_map(diagnosis: Diagnosis) -> Figure | None:
    """Map of the residuals of all people over frequency, before and after; None for one person.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Figure or None
    """
    n = len(diagnosis.subjects)
    if n < 2:
        return None
    snapshots = _snapshots(diagnosis)
    order = pattern_order(np.hstack([diagnosis.before.residual_magnitude, diagnosis.before.residual_phase]))
    figure = _columns(1.5 + 2 * float(np.clip(0.17 * n, 1.3, 3.2)))
    panels = figure.subplots(2, len(snapshots), sharex=True, sharey=True, squeeze=False)
    for column, snapshot in zip(panels.T, snapshots, strict=True):
        f = snapshot.frequency_hz
        for axes, rows in zip(column, _residuals(snapshot), strict=True):
            cells = np.ma.masked_invalid(rows[order])
            mesh = axes.pcolormesh(_edges(f), np.arange(n + 1), cells, cmap="RdBu_r", rasterized=True)
            mesh.set_clim(-_LIMIT, _LIMIT)
            axes.set_facecolor(LIGHT)
            axes.grid(visible=False)
            frequency_axis(axes, f, label=axes is column[1])
            _mark_bands_above(axes, diagnosis, f)
            axes.tick_params(axis="y", length=0)
        column[0].set_title(_heading(diagnosis, snapshot), pad=9)
    for axes, part in zip(panels[:, 0], _PARTS, strict=True):
        axes.set_ylim(n, 0)
        axes.set_yticks([])
        if n <= _NAMED:
            names = [_drawable(diagnosis.subjects[i]) for i in order]
            axes.set_yticks(np.arange(n) + 0.5, names, fontsize=7.5, parse_math=False)
            axes.set_ylabel(part)
        else:
            axes.set_ylabel(f"{part}: {n} {people(diagnosis)}")
    bar = figure.colorbar(mesh, ax=panels, extend="both", aspect=32, pad=0.015)
    bar.set_label("residual / standard deviation")
    bar.outline.set_visible(False)
    return figure


def bands(diagnosis: Diagnosis) -> Figure:
    """Predicted 90 % bands, before and after, with the recordings of all people.

    The middle row is the magnitude divided by the model's median: over several decades a factor of 1.5 is not visible.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Figure
    """
    snapshots, n = _snapshots(diagnosis), len(diagnosis.subjects)
    magnitude, phase = np.abs(diagnosis.observed), np.angle(diagnosis.observed, deg=True)
    phase[~np.isfinite(diagnosis.observed)] = np.nan
    finite = magnitude[np.isfinite(magnitude)]
    scale = scale_for(float(np.median(finite)) if finite.size else np.nan, diagnosis.unit)
    figure = _columns(7.6)
    panels = figure.subplots(3, len(snapshots), sharex=True, sharey="row", squeeze=False, height_ratios=(1.1, 1, 1))
    shown: list[list[np.ndarray]] = [[], [], []]
    for column, snapshot in zip(panels.T, snapshots, strict=True):
        middle = snapshot.magnitude[1]
        rows = (
            (magnitude * scale.factor, snapshot.magnitude * scale.factor),
            (magnitude / middle, snapshot.magnitude / middle),
            (phase, snapshot.phase_deg),
        )
        for i, (axes, (data, band)) in enumerate(zip(column, rows, strict=True)):
            axes.fill_between(snapshot.frequency_hz, band[0], band[2], color=OUTER, lw=0, label="90 % of recordings")
            width = 0.6 if n > 1 else 1.4
            many_lines(axes, snapshot.frequency_hz, data, colors=INK, linewidths=width, alpha=line_alpha(n))
            axes.plot([], [], color=INK, lw=0.8, alpha=0.7, label="measured")
            axes.plot(snapshot.frequency_hz, band[1], color=BLUE, lw=1.4, label="model, median")
            shown[i] += [data, band]
        column[0].set_title(_heading(diagnosis, snapshot))
    labels = (scale.label("|z|"), "|z| / model's median", "")
    for i, label in enumerate(labels[:2]):
        for axes in panels[i]:
            log_axis(axes.yaxis, *log_limits(*shown[i]), ticks=5)
        panels[i, 0].set_ylabel(label)
    phase_axis(panels[2, 0])
    for i, axes in enumerate(panels.flat):
        frequency_axis(axes, diagnosis.before.frequency_hz, label=i >= 2 * len(snapshots))
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def pooled_residual(diagnosis: Diagnosis) -> Figure:
    """Residual pooled over people, as a function of frequency, before and after.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Figure
    """
    figure = new_figure(_WIDTH, 5.2)
    panels = figure.subplots(2, 1, sharex=True)
    f = diagnosis.before.frequency_hz
    for i, (axes, part) in enumerate(zip(panels, _PARTS, strict=True)):
        _shade_bands(axes, diagnosis, f)
        axes.axhspan(-2, 2, color=GREY, alpha=0.18, lw=0, label="95 % range by chance if nothing is missing")
        axes.axhline(0, color=GREY, lw=0.8)
        for snapshot, colour in zip(_snapshots(diagnosis), _COLOURS if diagnosis.after else (BLUE,), strict=True):
            label = "residual" if diagnosis.after is None else snapshot.label
            shown = pooled(_residuals(snapshot)[i])
            axes.plot(snapshot.frequency_hz, shown, "o-", color=colour, ms=2.5, mew=0, label=label)
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, -3.5), max(high, 3.5))
        axes.set_ylabel(f"{part}: pooled residual")
        frequency_axis(axes, f, label=i == 1)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def one_ports(diagnosis: Diagnosis) -> Figure | None:
    """The missing one-port at the best places, relative to the impedance of the part at that place.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Figure or None
    """
    shown = diagnosis.one_ports[:_PLACES]
    if not shown:
        return None
    figure = new_figure(_WIDTH, 0.7 + 1.75 * len(shown))
    panels = figure.subplots(len(shown), 2, sharex="col", sharey="row", squeeze=False)
    f = diagnosis.before.frequency_hz
    for i, (row, port) in enumerate(zip(panels, shown, strict=True)):
        for axes, values in zip(row, (port.ratio.real, port.ratio.imag), strict=True):
            low, high = values - 2 * port.sd, values + 2 * port.sd
            axes.axhline(0, color=GREY, lw=0.8)
            axes.fill_between(port.frequency_hz, low, high, color=INNER, alpha=0.8, lw=0)
            axes.plot(port.frequency_hz, values, color=BLUE, lw=1.4)
            frequency_axis(axes, f, label=i == len(shown) - 1)
        row[0].set_ylim(*inner_limits(port.ratio, port.sd))
        # Without a mismatch there is no share of it to explain.
        known = diagnosis.verdict.mismatch and np.isfinite(port.share)
        share = f": explains {100 * port.share:.0f} %" if known else ""
        row[0].set_title(f"at {_drawable(port.place, 60)}{share}", parse_math=False)
        row[0].set_ylabel("missing / present")
    panels[0, 1].set_title("imaginary part", loc="right", color=GREY)
    panels[0, 0].set_title("real part", loc="right", color=GREY)
    return figure


def improvement(diagnosis: Diagnosis) -> Figure | None:
    """Eq. 5, each person's error and the coverage of the bands, before and after; None if there is no model after.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Figure or None
    """
    if diagnosis.after is None:
        return None
    before, after = diagnosis.before, diagnosis.after
    several = len(diagnosis.subjects) > 1
    figure = new_figure(_WIDTH, 5.4 if several else 2.9)
    panels = figure.subplots(2 if several else 1, 2, squeeze=False)
    errors = before.delta_magnitude[np.isfinite(before.delta_magnitude)]
    scale = scale_for(float(np.median(errors)) if errors.size else np.nan, diagnosis.unit)
    for snapshot, colour in zip((before, after), _COLOURS, strict=True):
        f = snapshot.frequency_hz
        panels[0, 0].plot(f, snapshot.delta_magnitude * scale.factor, color=colour, label=snapshot.label)
        panels[0, 1].plot(f, snapshot.delta_phase_deg, color=colour)
        if several:
            panels[1, 1].plot(f, 100 * snapshot.coverage90.mean(axis=0), color=colour)
    log_axis(
        panels[0, 0].yaxis,
        *log_limits(before.delta_magnitude * scale.factor, after.delta_magnitude * scale.factor),
    )
    panels[0, 0].set_ylabel(scale.label("magnitude error"))
    panels[0, 1].set_ylabel("phase error (°)")
    panels[0, 1].set_ylim(bottom=0)
    over_frequency = [panels[0, 0], panels[0, 1]]
    if several:
        _own_errors(panels[1, 0], diagnosis, before, after)
        panels[1, 1].axhline(90, color=GREY, lw=1.0, ls=(0, (4, 3)))
        panels[1, 1].set_ylim(0, 103)
        panels[1, 1].set_ylabel("in the 90 % band (%)")
        over_frequency.append(panels[1, 1])
    for axes in over_frequency:
        frequency_axis(axes, before.frequency_hz)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


DIAGNOSIS_PICTURES: dict[str, Callable[[Diagnosis], Figure | None]] = {
    "diagnosis_residuals": residual_map,
    "diagnosis_bands": bands,
    "diagnosis_pooled": pooled_residual,
    "diagnosis_one_ports": one_ports,
    "diagnosis_improvement": improvement,
}
"""Name of each file and the function that draws it."""


# -------------------------------------------------------------------- arrangement


def pooled(residual: np.ndarray) -> np.ndarray:
    """Mean over people times the square root of their number: (N, F) to (F,), NaN at frequencies without data."""
    present = np.isfinite(residual)
    number = present.sum(axis=0)
    total = np.where(present, residual, 0.0).sum(axis=0)
    return np.where(number > 0, total / np.sqrt(np.maximum(number, 1)), np.nan)


def pattern_order(rows: np.ndarray) -> np.ndarray:
    """Order of people along the first principal component of their rows.

    Parameters
    ----------
    rows : ndarray, shape (N, G)
        NaN for missing values, which count as zero.

    Returns
    -------
    ndarray of int, shape (N,)
    """
    filled = np.where(np.isfinite(rows), rows, 0.0)
    left, size, right = np.linalg.svd(filled - filled.mean(axis=0), full_matrices=False)
    if size[0] <= 1e-12:
        return np.arange(len(rows))
    # The sign of a component is arbitrary: the largest loading is made positive.
    sign = np.sign(right[0, np.argmax(np.abs(right[0]))])
    return np.argsort(-sign * left[:, 0], kind="stable")


def _columns(height: float) -> Figure:
    """A figure whose columns leave room for the labels at the ends of frequency axes."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = new_figure(_WIDTH, height)
    figure.set_layout_engine(ConstrainedLayoutEngine(w_pad=0.09))
    return figure


def _snapshots(diagnosis: Diagnosis) -> list[Snapshot]:
    return [diagnosis.before] if diagnosis.after is None else [diagnosis.before, diagnosis.after]


def _residuals(snapshot: Snapshot) -> tuple[np.ndarray, np.ndarray]:
    return snapshot.residual_magnitude, snapshot.residual_phase


def _heading(diagnosis: Diagnosis, snapshot: Snapshot) -> str:
    """Heading that says whether a snapshot is before or after; empty if there is only one."""
    return "" if diagnosis.after is None else _drawable(snapshot.label, 60).capitalize()


def _drawable(text: str, longest: int = 14) -> str:
    """A name that the pictures' font can draw: characters that it lacks become question marks."""
    plain = "".join(c if c.isprintable() else " " for c in text).encode("latin-1", "replace").decode("latin-1")
    return plain if len(plain) <= longest else plain[: longest - 3] + "..."


def _edges(f: np.ndarray) -> np.ndarray:
    """Boundaries of cells around frequencies on a logarithmic axis: (F,) to (F + 1,)."""
    if f.size == 1:
        return np.array([f[0] / 1.1, f[0] * 1.1])
    inner = np.sqrt(f[1:] * f[:-1])
    return np.concatenate([[f[0] ** 2 / inner[0]], inner, [f[-1] ** 2 / inner[-1]]])


def mismatch_bands(diagnosis: Diagnosis, f: np.ndarray) -> list[tuple[float, float]]:
    """Frequency bands of the mismatch, clipped to the grid."""
    found = diagnosis.verdict.where.bands_hz
    inside = [(max(low, float(f[0])), min(high, float(f[-1]))) for low, high in found]
    return [(low, high) for low, high in inside if high > low]


def _shade_bands(axes: Axes, diagnosis: Diagnosis, f: np.ndarray) -> None:
    for i, (low, high) in enumerate(mismatch_bands(diagnosis, f)):
        axes.axvspan(low, high, color=_BAND, alpha=0.5, lw=0, label=None if i else "mismatch")


def _mark_bands_above(axes: Axes, diagnosis: Diagnosis, f: np.ndarray) -> None:
    """Mark the bands by bars above the map: shading would hide it."""
    for low, high in mismatch_bands(diagnosis, f):
        (bar,) = axes.plot([low, high], [1.025, 1.025], color=ORANGE, lw=3.5, transform=axes.get_xaxis_transform())
        bar.set(clip_on=False, solid_capstyle="butt")


def inner_limits(ratio: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """Limits of an axis around a ratio and its ribbon, without the frequencies at which the ribbon is much wider."""
    parts = np.stack([ratio.real, ratio.imag])
    known = np.isfinite(parts).all(axis=0) & np.isfinite(sd)
    known &= sd <= _WIDE * np.median(sd[known]) if known.any() else known
    if not known.any():
        return -1.0, 1.0
    low, high = (parts - 2 * sd)[:, known], (parts + 2 * sd)[:, known]
    bottom, top = min(float(low.min()), 0.0), max(float(high.max()), 0.0)
    room = 0.06 * (top - bottom) or 1.0
    return bottom - room, top + room


def _own_errors(axes: Axes, diagnosis: Diagnosis, before: Snapshot, after: Snapshot) -> None:
    """Each person's error before and after, in ascending order of the error before."""
    order = np.argsort(before.subject_rms_relative)
    first, second = 100 * before.subject_rms_relative[order], 100 * after.subject_rms_relative[order]
    x = np.arange(order.size)
    axes.vlines(x, first, second, color=LIGHT, lw=1.0)
    for values, colour in zip((first, second), _COLOURS, strict=True):
        axes.plot(x, values, "o", ms=3.0, color=colour, mew=0)
    axes.set_xticks([])
    axes.set_xlabel(f"{people(diagnosis)}, sorted")
    axes.set_ylabel("individual error (%)")
    axes.set_ylim(bottom=0)
