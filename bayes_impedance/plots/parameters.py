"""Pictures of the elements: values, dispersions, correlations, each person's values, prior against posterior."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.network.parameters import LOG, LOGIT, SIGNED
from bayes_impedance.plots.access import (
    element_scale,
    identified,
    needed,
    prior_dispersion_sds,
    prior_sds,
    samples,
    subjects,
    variable,
    varying,
    who,
)
from bayes_impedance.plots.joint import half_normal_density, prior_density
from bayes_impedance.plots.style import (
    BLUE,
    ENSEMBLES,
    GREY,
    INK,
    LIGHT,
    MOST_DRAWN,
    ORANGE,
    RED,
    log_axis,
    log_limits,
)
from bayes_impedance.population.natural_scales import LOG_SD
from bayes_impedance.results.result import Result
from bayes_impedance.units import INTERVAL, excludes_zero, signed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MISSING = "not determined by these recordings"
_MANY = 12
"""Above this number of elements the heat map shows no numbers. By choice: there is no room for them."""


def overview(figure: Figure, result: Result) -> Figure:
    """Uncertainty of each central value, and dispersions between persons and between repetitions.

    Parameters
    ----------
    figure : Figure
        Empty; one panel, or two if there are dispersions, are put into it.
    result : Result

    Returns
    -------
    Figure
    """
    spread = variable(result, "dispersion_between_persons") is not None
    panels = np.atleast_1d(np.array(figure.subplots(1, 1 + spread, sharey=True)))
    seen, rows = identified(result), np.arange(len(result.elements))
    central = samples(result, "central")
    ratios = np.array(
        [np.quantile(c, INTERVAL) / np.median(c) if s else (1, 1, 1) for c, s in zip(central.T, seen, strict=True)]
    )
    for i in np.flatnonzero(seen & np.array([p.link == LOGIT for p in result.parameters])):
        ratios[i] = 1 + np.quantile(central[:, i], INTERVAL) - np.median(central[:, i])  # of one, not of the exponent
    near_zero = seen & (ratios[:, 0] * ratios[:, 2] < 0)
    ratios[near_zero] = 1.0
    percent = 100 * (ratios - 1)
    panels[0].hlines(rows[seen], percent[seen, 0], percent[seen, 2], color=BLUE, lw=2.4)
    known = seen & ~near_zero
    panels[0].plot(np.zeros(known.sum()), rows[known], "o", color=BLUE, ms=6)
    panels[0].axvline(0, color=GREY, lw=0.8)
    panels[0].set_xlabel("uncertainty of the central value (%)")
    panels[0].set_yticks(rows, result.elements)
    panels[0].set_ylim(len(rows) - 0.5, -0.5)
    for i in rows[~seen | near_zero]:
        told = "may be zero" if near_zero[i] else MISSING
        panels[0].text(0.5, i, told, transform=panels[0].get_yaxis_transform(), ha="center", va="center", color=GREY)
    if spread:
        _spreads(panels[1], result, rows, seen)
    return figure


def _spreads(axes: Axes, result: Result, rows: np.ndarray, seen: np.ndarray) -> None:
    persons = who(result)
    kinds = (
        ("dispersion_between_persons", f"between {persons}", BLUE, "o", -0.13),
        ("dispersion_between_repetitions", "between repetitions", ORANGE, "s", 0.13),
    )
    top = 0.0
    for name, label, colour, marker, shift in kinds:
        if variable(result, name) is None:
            continue
        seen = seen & varying(result)
        low, middle, high = np.quantile(samples(result, name)[:, seen], INTERVAL, axis=0)
        axes.hlines(rows[seen] + shift, low, high, color=colour, lw=2.4)
        axes.plot(middle, rows[seen] + shift, marker, color=colour, ms=5.5, label=label)
        top = max(top, float(np.max(high, initial=0.0)))
    factor_axis(axes, top)
    axes.set_xlabel("dispersion: geometric sd")
    axes.get_figure().legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=2)  # type: ignore[union-attr]


def factor_axis(axes: Axes, top: float) -> None:
    """Label a horizontal axis of standard deviations of logarithms, from zero, by the factors exp(sd)."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

    limit = 1.06 * top if top > 0 else 0.1
    if limit < 0.7:
        factors = np.asarray(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(1.0, math.exp(limit)))
    else:  # ticks at equal steps of the factor would be too close at the upper end
        factors = np.array([1.0, 1.5, 2, 3, 5, 8, 20, 50, 150, 500])
    factors = factors[(factors >= 1) & (factors <= math.exp(limit))]
    axes.xaxis.set_major_locator(FixedLocator(np.log(factors).tolist()))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"×{math.exp(x):.4g}"))
    axes.set_xlim(-0.02 * limit, limit)


def forest(figure: Figure, result: Result) -> Figure:
    """Each person's value of each element, sorted, with the population's median and one standard deviation about it.

    Parameters
    ----------
    figure : Figure
        Empty; one panel for each element is put into it.
    result : Result

    Returns
    -------
    Figure
    """
    shown = np.flatnonzero(varying(result)).tolist() or list(range(len(result.elements)))
    panels = _grid(figure, len(shown), 2)
    draws, seen, n = samples(result, "person_log_elements"), identified(result), len(subjects(result))
    for i, axes in zip(shown, panels, strict=True):
        name = result.elements[i]
        scale = element_scale(result, i)
        axes.set_title(scale.label(name))
        axes.set_xticks([])
        if not seen[i]:
            _say_missing(axes)
            continue
        own = result.parameters[i]
        low, middle, high = own.value(np.quantile(draws[:, :, i], INTERVAL, axis=0)) * scale.factor
        order, x = np.argsort(middle), np.arange(n)
        centre = float(np.median(samples(result, "central")[:, i])) * scale.factor
        sd = float(np.median(samples(result, "dispersion_between_persons")[:, i]))
        u = float(own.u(centre / scale.factor))
        ends = own.value(np.array([u - sd, u + sd])) * scale.factor
        axes.axhspan(*ends.tolist(), color=BLUE, alpha=0.13, lw=0)
        axes.axhline(centre, color=RED, lw=1.4)
        axes.vlines(x, low[order], high[order], color=BLUE, lw=1.1, alpha=0.75, rasterized=n > MOST_DRAWN)
        axes.plot(x, middle[order], "o", color=BLUE, ms=2.8, mew=0, rasterized=n > MOST_DRAWN)
        if own.link == LOG:
            log_axis(axes.yaxis, *log_limits(low, high), ticks=5)
        axes.set_xlim(-1, n)
    figure.supxlabel(f"{n} {who(result)}, sorted in each panel", fontsize=10)
    return figure


def correlation(axes: Axes, result: Result) -> Axes:
    """Correlations between persons; those whose 90 % interval contains zero are in grey.

    Parameters
    ----------
    axes : Axes
    result : Result

    Returns
    -------
    Axes
    """
    seen = np.flatnonzero(identified(result) & varying(result))
    names = [result.elements[i] for i in seen]
    draws = samples(result, "correlation")[:, seen][:, :, seen]
    low, middle, high = np.quantile(draws, INTERVAL, axis=0)
    shown = np.ma.masked_array(middle, np.triu(np.ones_like(middle, dtype=bool)))
    rows, columns = slice(1, None), slice(None, -1)
    image = axes.imshow(shown[rows, columns], cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names) - 1), names[:-1])
    axes.set_yticks(range(len(names) - 1), names[1:])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    if len(names) <= _MANY:
        for i in range(1, len(names)):
            for j in range(i):
                sure = excludes_zero(float(low[i, j]), float(high[i, j]))
                colour = "white" if abs(middle[i, j]) > 0.6 else INK if sure else "#9a9a9a"
                axes.text(
                    j,
                    i - 1,
                    signed(middle[i, j]),
                    ha="center",
                    va="center",
                    color=colour,
                    weight="bold" if sure else "normal",
                )
    figure = axes.get_figure()
    if figure is not None:
        figure.colorbar(
            image, ax=axes, shrink=0.8, ticks=[-1, -0.5, 0, 0.5, 1], label=f"correlation between {who(result)}"
        )
    return axes


def traces(figure: Figure, result: Result) -> Figure:
    """Draws of each ensemble in the order of sampling: the centre and the dispersions of each element.

    Parameters
    ----------
    figure : Figure
        Empty; a row of panels for each element is put into it.
    result : Result

    Returns
    -------
    Figure
    """
    columns = [("mu", "central value")]
    if variable(result, "dispersion_between_persons") is not None:
        columns.append(("dispersion_between_persons", f"dispersion\nbetween {who(result)}"))
    if variable(result, "dispersion_between_repetitions") is not None:
        columns.append(("dispersion_between_repetitions", "dispersion\nbetween repetitions"))
    names, seen = result.elements, identified(result)
    panels = np.array(figure.subplots(len(names), len(columns), sharex=True, squeeze=False))
    for row, (name, known) in enumerate(zip(names, seen, strict=True)):
        scale = element_scale(result, row)
        for column, (source, title) in enumerate(columns):
            axes = panels[row, column]
            axes.tick_params(labelsize=8)
            if row == 0:
                axes.set_title(title)
            if not known:
                _say_missing(axes, size=8)
                continue
            if column and result.parameters[row].shared:
                axes.set_axis_off()
                continue
            u = needed(result, source)[:, :, row]
            values = np.exp(u) if column else result.parameters[row].value(u) * scale.factor
            for ensemble, chain in enumerate(values):
                colour = ENSEMBLES[ensemble % len(ENSEMBLES)]
                axes.plot(chain, color=colour, lw=0.6, alpha=0.75, rasterized=True)
            axes.margins(x=0)
            axes.locator_params(axis="y", nbins=3)
        panels[row, 0].set_ylabel(
            f"{name}\n({scale.unit})" if scale.unit else name, rotation=0, ha="right", va="center"
        )
    figure.supxlabel("draw (each colour is one independent ensemble)", fontsize=10)
    figure.align_ylabels(panels[:, 0])  # only this column has labels; aligning all panels takes time at every drawing
    return figure


def priors(figure: Figure, result: Result) -> Figure:
    """Prior against posterior: the information that the recordings add.

    Central values whose order is known have no normal prior: theirs is drawn from its draws.

    Parameters
    ----------
    figure : Figure
        Empty; one panel, or two if there are dispersions, are put into it.
    result : Result

    Returns
    -------
    Figure
    """
    spread = variable(result, "dispersion_between_persons") is not None
    panels = np.atleast_1d(np.array(figure.subplots(1, 1 + spread, sharey=True)))
    names, seen, centre = result.elements, identified(result), needed(result, "prior_centre")
    reach = 2.6 * LOG_SD
    grid = np.linspace(-reach, reach, 300)
    sds = prior_sds(result) / LOG_SD
    ordered = {name for own in result.summary.get("prior", {}).get("order", ()) for name in own}
    drawn = result.groups.get("prior", {}).get("mu")  # missing in results of earlier versions
    for row, name in enumerate(names):
        if name in ordered and seen[row] and drawn is not None:
            own = drawn.reshape(-1, len(names))[:, row]
            density, edges = np.histogram((own - centre[row]) / sds[row], bins=25)
            _ridge(panels[0], row, np.exp((edges[1:] + edges[:-1]) / 2), density, LIGHT, "prior")
        else:
            density = prior_density(result, row, 0.0, LOG_SD)(grid)
            _ridge(panels[0], row, np.exp(grid), density, LIGHT, "prior")
        if seen[row]:
            density, edges = np.histogram((samples(result, "mu")[:, row] - centre[row]) / sds[row], bins=25)
            _ridge(panels[0], row, np.exp((edges[1:] + edges[:-1]) / 2), density, BLUE, "posterior")
        else:
            panels[0].text(
                0.98,
                row - 0.35,
                f"{name} is {MISSING}",
                color=GREY,
                fontsize=8.5,
                ha="right",
                va="center",
                transform=panels[0].get_yaxis_transform(),
            )
    log_axis(panels[0].xaxis, math.exp(-reach), math.exp(reach), ticks=7)
    wide = "central value / prior centre" if np.all(sds == 1) else "exp(3 (value - prior centre) / prior sd)"
    panels[0].set_xlabel(wide)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(len(names) - 0.6, -1.0)
    if spread:
        scales = prior_dispersion_sds(result)
        # What may be negative is the same for all, and the scale in its place has a unit: a stiffness' is 1000 N/m.
        factors = np.array([p.link != SIGNED for p in result.parameters], dtype=bool)
        grid = np.linspace(0, 2.2 * float(scales[factors].max(initial=0.0) or 1.0), 200)
        for row in np.flatnonzero(factors).tolist():
            _ridge(panels[1], row, grid, half_normal_density(float(scales[row]))(grid), LIGHT, "prior")
            if seen[row] and not result.parameters[row].shared:
                density, edges = np.histogram(samples(result, "dispersion_between_persons")[:, row], bins=25)
                _ridge(panels[1], row, (edges[1:] + edges[:-1]) / 2, density, BLUE, "posterior")
        panels[1].set_xlabel(f"dispersion between {who(result)}: geometric sd")
        factor_axis(panels[1], float(grid[-1]))
        panels[1].set_xlim(0, grid[-1])
    handles = dict(zip(*reversed(panels[0].get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles.keys(), loc="outside upper right", ncols=2)
    return figure


def _ridge(axes: Axes, row: int, x: np.ndarray, density: np.ndarray, colour: str, label: str) -> None:
    """A density drawn upwards from its row and scaled to the row's height: widths are compared, not heights."""
    height = row - 0.85 * density / density.max()
    lw = 0.0 if colour == LIGHT else 0.8  # a posterior may be narrower than a pixel
    axes.fill_between(x, row, height, facecolor=colour, edgecolor=colour, alpha=0.9, lw=lw, label=label)


def _grid(figure: Figure, number: int, columns: int) -> list[Axes]:
    """Panels in rows, without those that would be empty."""
    columns = min(columns, number)
    rows = math.ceil(number / columns)
    panels = list(np.array(figure.subplots(rows, columns, squeeze=False)).flat)
    for axes in panels[number:]:
        axes.remove()
    return panels[:number]


def _say_missing(axes: Axes, size: float = 9) -> None:
    axes.set_yticks([])
    axes.grid(False)
    axes.text(0.5, 0.5, MISSING, transform=axes.transAxes, ha="center", va="center", color=GREY, fontsize=size)
