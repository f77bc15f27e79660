"""Corner plots: the joint posterior of the elements."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.network.parameters import LOG, SIGNED, Parameter
from bayes_impedance.plots.access import (
    element_scale,
    identified,
    needed,
    prior_dispersion_sds,
    prior_sds,
    samples,
    varying,
)
from bayes_impedance.plots.style import BLUE, INK, RED
from bayes_impedance.population import prior_tails
from bayes_impedance.results.result import Result
from bayes_impedance.units import INTERVAL, with_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Density = Callable[[np.ndarray], np.ndarray]

_WIDE = 8.0
"""A posterior whose 90 % interval spans more than this factor is shown on a logarithmic scale. By choice: on a linear
one its lower part cannot be read."""


def corner_central(figure: Figure, result: Result) -> Figure:
    """Joint posterior of the central values of the identified elements, with the prior on the diagonal.

    Parameters
    ----------
    figure : Figure
        Empty and without a layout engine.
    result : Result

    Returns
    -------
    Figure
    """
    central, centre = samples(result, "central"), needed(result, "prior_centre")
    columns, labels, titles, priors = [], [], [], []
    for i in np.flatnonzero(identified(result)).tolist():
        scale, name = element_scale(result, i), result.elements[i]
        x = central[:, i] * scale.factor
        low, middle, high = np.quantile(x, INTERVAL)
        value, interval = with_interval(middle, low, high)
        titles.append(f"{name} = {value} {scale.unit}\n({interval})")
        parameter, sd = result.parameters[i], float(prior_sds(result)[i])
        if parameter.link != LOG:
            labels.append(f"{name}\n({scale.unit})" if scale.unit else name)
            columns.append(x)
            priors.append(_of_parameter(parameter, prior_density(result, i, float(centre[i]), sd), scale.factor))
            continue
        log_prior = prior_density(result, i, float(centre[i]) + math.log(scale.factor), sd)
        if high > _WIDE * low:
            labels.append(f"log10 {name}\n({scale.unit})")
            columns.append(np.log10(x))
            priors.append(_of_decimal_logarithm(log_prior))
        else:
            labels.append(f"{name}\n({scale.unit})")
            columns.append(x)
            priors.append(_of_value(log_prior))
    return _corner(figure, np.column_stack(columns), labels, titles, priors)


def corner_dispersion(figure: Figure, result: Result) -> Figure:
    """Joint posterior of the spreads between persons, as factors exp(sd), with the prior on the diagonal.

    Parameters
    ----------
    figure : Figure
        Empty and without a layout engine.
    result : Result

    Returns
    -------
    Figure
    """
    seen = np.flatnonzero(identified(result) & varying(result))
    factors = np.exp(samples(result, "dispersion_between_persons")[:, seen])
    labels, titles = [], []
    for i, x in zip(seen, factors.T, strict=True):
        low, middle, high = np.quantile(x, INTERVAL)
        labels.append(f"geometric sd\nof {result.elements[i]}")
        titles.append(f"{result.elements[i]}: ×{middle:.2f}\n({low:.2f} to {high:.2f})")
    priors = [_of_value(half_normal_density(sd)) for sd in prior_dispersion_sds(result)[seen].tolist()]
    return _corner(figure, factors, labels, titles, priors)


def prior_density(result: Result, element: int, centre: float, scale: float) -> Density:
    """Density of the prior of an element's central value, of its kind."""
    told = result.summary.get("prior", {}).get("elements", {}).get(result.elements[element], {})
    if told.get("kind") == "student_t":
        return lambda x: np.asarray(prior_tails.density((x - centre) / scale) / scale)
    return normal_density(centre, scale)


def normal_density(mean: float, sd: float) -> Density:
    """Density of a normal variable."""
    return lambda x: np.asarray(np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * math.sqrt(2 * math.pi)))


def half_normal_density(sd: float) -> Density:
    """Density of the absolute value of a normal variable with mean zero."""
    return lambda x: np.asarray(np.where(x >= 0, 2 * normal_density(0.0, sd)(x), 0.0))


def _of_parameter(parameter: Parameter, of_u: Density, factor: float) -> Density:
    """Density of a value, times a factor, of a parameter between bounds or on a signed scale from that of its u."""
    low = parameter.quantity.low

    def density(x: np.ndarray) -> np.ndarray:
        value = x / factor
        if parameter.link == SIGNED:
            return of_u(value) / factor
        inside = np.clip(value - low, 1e-9, 1 - 1e-9)
        return of_u(np.log(inside / (1 - inside))) / (inside * (1 - inside)) / factor

    return density


def _of_value(of_logarithm: Density) -> Density:
    """Density of exp(y) from that of y."""
    return lambda x: of_logarithm(np.log(x)) / x


def _of_decimal_logarithm(of_logarithm: Density) -> Density:
    """Density of y / ln 10 from that of y."""
    return lambda x: of_logarithm(x * math.log(10)) * math.log(10)


@cache
def _corner_package() -> Any:
    """The package corner without ArviZ, which it imports if it can, in seconds, to plot ArviZ's own containers."""
    if "arviz" in sys.modules:
        return import_module("corner")
    sys.modules["arviz"] = None  # type: ignore[assignment]  # Python's way to say that there is none
    try:
        return import_module("corner")
    finally:
        del sys.modules["arviz"]


def _corner(
    figure: Figure, columns: np.ndarray, labels: Sequence[str], titles: Sequence[str], priors: Sequence[Density]
) -> Figure:
    """Draw columns (S, K) against each other; contours hold 50 % and 90 %."""
    number = columns.shape[1]
    spread = np.ptp(columns, axis=0)
    # A constant column has no range.
    limits = [
        tuple(np.quantile(x, (0.002, 0.998))) if s > 0 else (x[0] - 0.5, x[0] + 0.5)
        for x, s in zip(columns.T, spread, strict=True)
    ]
    _corner_package().corner(
        columns,
        fig=figure,
        bins=28,
        range=limits,
        color=BLUE,
        smooth=1.0,
        levels=(0.5, 0.9),
        plot_datapoints=False,
        plot_density=False,
        fill_contours=True,
        labels=list(labels),
        label_kwargs={"fontsize": 9, "color": INK},
        labelpad=0.12,
        max_n_ticks=3,
        hist_kwargs={"density": True, "histtype": "stepfilled", "alpha": 0.35, "edgecolor": BLUE, "lw": 1.2},
    )
    grid = np.array(figure.axes).reshape(number, number)
    for axes in grid[np.triu_indices(number, 1)]:
        axes.set_visible(False)  # empty, but drawing it would take time
    for axes in grid[np.tril_indices(number)]:
        axes.grid(False)
        axes.tick_params(labelsize=8, length=2.5)
        axes.spines[:].set_visible(True)
        for axis in (axes.xaxis, axes.yaxis):
            # A label at the corner of a panel would overlap that of the next one.
            low, high = sorted(axis.get_view_interval())
            room = 0.1 * (high - low)
            inner = [tick for tick in axis.get_majorticklocs() if low + room < tick < high - room]
            if inner:
                axis.set_ticks(inner)
    for i, (prior, title) in enumerate(zip(priors, titles, strict=True)):
        axes = grid[i, i]
        x = np.linspace(limits[i][0], limits[i][1], 100)
        axes.plot(x, prior(x), color=RED, lw=1.2, ls="--")
        axes.set_title(title, fontsize=8.5, loc="left", pad=3)
    width, height = figure.get_size_inches()
    figure.subplots_adjust(0.95 / width, 0.9 / height, 1 - 0.75 / width, 1 - 0.45 / height)
    return figure
