"""The common style of all pictures: colours, sizes, ticks of axes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which can also be distinguished with colour vision deficiency.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, GREY, LIGHT = "#222222", "#7a7a7a", "#d4d4d4"
OUTER, INNER = "#cfe3f0", "#8dbddc"
"""Fill colours of the 90 % and of the 50 % band of a blue curve."""

MOST_DRAWN = 2000
"""Most marks, or points of lines, that are drawn as such in an SVG; more are rasterised. By choice: they cover one
another, and of many people the file would be larger than that of the results."""

ENSEMBLES = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)

_RC: Any = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that pictures are the same everywhere
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 10.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.hashsalt": "bayes_impedance",
    "path.simplify": True,
}
"""Settings of matplotlib; sizes in points. By choice, for legibility at the width of a page."""


@contextmanager
def style() -> Iterator[None]:
    """Context manager for drawing and saving: sets the common style and restores the settings afterwards."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # the user's own matplotlibrc must not change the pictures
        matplotlib.rcParams.update(_RC)
        yield


def new_figure(width: float, height: float, *, constrained: bool = True) -> Figure:
    """A figure without a window and independent of pyplot's global state; sizes in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained" if constrained else None)


def _text(value: float) -> str:
    exponent = math.log10(value) if value > 0 else 0.0
    if (exponent >= 4.5 or exponent < -3.5) and abs(exponent - round(exponent)) < 1e-6:
        return f"$10^{{{round(exponent)}}}$"
    return f"{value:.6g}"


def log_axis(axis: Axis, low: float, high: float, *, ticks: int = 6) -> None:
    """Make an axis logarithmic between two limits, with a few labelled ticks at round values for any span.

    Parameters
    ----------
    axis : Axis
    low, high : float
        Limits, both above zero.
    ticks : int
        Approximate number of labels for which there is room.
    """
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

    name = axis.axis_name  # type: ignore[attr-defined]
    getattr(axis.axes, f"set_{name}scale")("log")
    if not high > low:
        low, high = low / 1.1, high * 1.1
    getattr(axis.axes, f"set_{name}lim")(low, high)
    decades = math.log10(high / low)
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    if decades < 0.5:
        values = np.asarray(MaxNLocator(ticks, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    elif decades < 2.2:
        wanted = (1, 2, 3, 5, 7) if decades < 1.0 else (1, 2, 5) if decades * 3 <= ticks + 1 else (1, 3)
        values = np.array([m * 10.0**e for e in exponents for m in wanted])
    else:
        step = max(1, math.ceil(decades / ticks))
        values = np.array([10.0**e for e in exponents if e % step == 0])
    values = values[(values >= low * (1 - 1e-9)) & (values <= high * (1 + 1e-9)) & (values > 0)]
    axis.set_major_locator(FixedLocator(values.tolist()))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _text(value)))
    axis.set_minor_locator(
        NullLocator() if decades < 0.5 else LogLocator(subs=tuple(range(1, 10)) if decades < 6 else (1,), numticks=200)
    )
    axis.set_minor_formatter(NullFormatter())


def log_limits(*values: np.ndarray, margin: float = 0.05) -> tuple[float, float]:
    """Limits around all positive values, with a margin given as a fraction of the logarithmic span."""
    flat = np.concatenate([np.ravel(v) for v in values])
    flat = flat[np.isfinite(flat) & (flat > 0)]
    if not flat.size:
        return 0.1, 10.0
    low, high = float(np.log(flat.min())), float(np.log(flat.max()))
    room = max(margin * (high - low), 0.02)
    return math.exp(low - room), math.exp(high + room)


def frequency_axis(axes: Axes, frequency_hz: np.ndarray, *, label: bool = True) -> None:
    """Logarithmic frequency axis over the whole grid."""
    log_axis(axes.xaxis, float(frequency_hz[0]), float(frequency_hz[-1]), ticks=8)
    if label:
        axes.set_xlabel("frequency (Hz)")
    else:
        axes.tick_params(labelbottom=False)


def phase_axis(axes: Axes) -> None:
    """Phase axis in degrees, with ticks at round fractions of 90°; call after everything has been drawn."""
    from matplotlib.ticker import MultipleLocator

    low, high = axes.get_ylim()
    step = next((s for s in (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45) if high - low <= 7 * s), 90)
    axes.yaxis.set_major_locator(MultipleLocator(step))
    axes.set_ylabel("phase (°)")


def many_lines(axes: Axes, x: np.ndarray, rows: np.ndarray, **kwargs: Any) -> None:
    """One thin line for each row of (N, F), as a single artist; many lines are rasterised in an SVG."""
    from matplotlib.collections import LineCollection

    lines = [np.column_stack([x, row])[np.isfinite(row)] for row in rows]
    axes.add_collection(LineCollection(lines, rasterized=rows.size > MOST_DRAWN, **kwargs))
    # On a logarithmic axis collections are not always included in the automatic limits.
    finite = rows[np.isfinite(rows)]
    if finite.size:
        axes.update_datalim(np.array([[x[0], finite.min()], [x[-1], finite.max()]]))
        axes.autoscale_view()


def row_median(rows: np.ndarray) -> np.ndarray:
    """Median over people at every frequency: (N, F) to (F,), NaN at frequencies without data."""
    result = np.full(rows.shape[1], np.nan)
    some = np.isfinite(rows).any(axis=0)
    result[some] = np.nanmedian(rows[:, some], axis=0)
    return result


def line_alpha(number: int) -> float:
    """Opacity at which this number of overlapping lines remains readable."""
    return float(np.clip(14.0 / max(number, 1), 0.12, 0.9))
