"""The paper's three figures for a comparison of methods, made with functions that draw into one axes each."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from bayes_impedance.plots.paper import all_curves, bode, error_bars
from bayes_impedance.plots.style import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayes_impedance.classical.methods import MethodComparison

BODE_METHODS = ("sit", "vector_fitting_mean", "vector_fitting_median", "population_network")
"""Methods of fig. 5: the paper's models, and the population network that the paper could not determine."""


def recordings_figure(comparison: MethodComparison) -> Figure:
    """Fig. 3: each subject's curve; call inside :func:`~bayes_impedance.plots.style`."""
    figure = new_figure(8.2, 6.0)
    for axes, part in zip(figure.subplots(2, 1, sharex=True), ("magnitude", "phase"), strict=True):
        all_curves(axes, comparison.frequency_hz, comparison.observed, comparison.unit, part)
    return figure


def errors_figure(comparison: MethodComparison) -> Figure:
    """Fig. 4: eq. 5 of every method, mean over frequency with its standard deviation."""
    methods = comparison.methods
    errors = [m.errors.summary() for m in methods]
    figure = new_figure(8.2, 1.4 + 0.36 * 2 * len(methods))
    families = [m.family for m in methods]
    for axes, key, unit in zip(
        figure.subplots(2, 1), ("delta_magnitude", "delta_phase_deg"), (comparison.unit, "°"), strict=True
    ):
        mean, sd = [e[key] for e in errors], [e[f"{key}_sd"] for e in errors]
        error_bars(axes, [m.label for m in methods], mean, sd, families=families, unit=unit, legend=False)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def bode_figure(comparison: MethodComparison) -> Figure:
    """Fig. 5: the models over the data."""
    curves = {comparison.method(id).label: comparison.method(id).curve for id in BODE_METHODS}
    figure = new_figure(8.2, 7.0)
    for axes, part in zip(figure.subplots(2, 1, sharex=True), ("magnitude", "phase"), strict=True):
        bode(axes, comparison.frequency_hz, curves, comparison.observed, comparison.unit, part, legend=False)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


COMPARISON_PICTURES: dict[str, Callable[[MethodComparison], Figure]] = {
    "comparison": errors_figure,
    "recordings": recordings_figure,
    "bode": bode_figure,
}
"""Name of each file and the function that draws it."""
