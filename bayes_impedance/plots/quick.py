"""Pictures in one call, into axes that are given or new ones, for a session at the keyboard.

Each function returns the axes in which it has drawn, so that more can be drawn there. New axes belong to pyplot, and a
notebook shows them by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.plots.access import frequency, is_electrical, needed, observed
from bayes_impedance.plots.style import BLUE, INK, INNER, ORANGE, OUTER, line_alpha
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.person_curves import fitted_curve, person_band, without_number
from bayes_impedance.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CHECKED = (0.05, 0.5, 0.95)
"""Quantiles over people of a visual predictive check. By choice: the usual ones."""
_FEWEST_PEOPLE = 5
"""Fewest people for quantiles over people. By choice: of fewer, the 5 % quantile is the smallest value."""


def plot_bode(shown: Recordings | Result, ax: Sequence[Axes] | None = None, **line: Any) -> tuple[Axes, Axes]:
    """Magnitude and phase of everybody's mean recording over frequency; of a result with the predicted 90 % band.

    Parameters
    ----------
    shown : Recordings or Result
    ax : sequence of two Axes, optional
        For magnitude and phase; new ones if not given.
    **line
        Of the recordings' lines, as for ``Axes.plot``.

    Returns
    -------
    magnitude, phase : Axes
    """
    upper, lower = _pair(ax)
    style: dict[str, Any] = {"color": BLUE, "lw": 0.8, "alpha": line_alpha(len(_curves(shown)))} | line
    for f, z in _curves(shown):
        upper.plot(f, np.abs(z), **style)
        lower.plot(f, np.angle(z, deg=True), **style)
    if isinstance(shown, Result):
        f = frequency(shown)
        for axes, band, curve in zip(
            (upper, lower), needed(shown, "band_recording"), needed(shown, "network_curve"), strict=True
        ):
            axes.fill_between(f, band[0], band[-1], color=OUTER, zorder=0, label="predicted, 90 %")
            axes.plot(f, curve, color=INK, lw=1.5, label="population network")
        upper.legend()
    _name_axes(upper, lower, _unit(shown))
    return upper, lower


def plot_nyquist(shown: Recordings | Result, ax: Axes | None = None, **line: Any) -> Axes:
    """Everybody's mean recording in the complex plane; of a result with the curve of the population network.

    Of electrical recordings the imaginary part points downward, as is the custom there.

    Parameters
    ----------
    shown : Recordings or Result
    ax : Axes, optional
        New if not given.
    **line
        Of the recordings' lines, as for ``Axes.plot``.

    Returns
    -------
    Axes
    """
    axes = _new() if ax is None else ax
    unit = _unit(shown)
    sign = -1.0 if unit == "ohm" else 1.0
    style: dict[str, Any] = {"color": BLUE, "lw": 0.8, "alpha": line_alpha(len(_curves(shown)))} | line
    for _, z in _curves(shown):
        axes.plot(z.real, sign * z.imag, **style)
    if isinstance(shown, Result):
        magnitude, phase = needed(shown, "network_curve")
        z = magnitude * np.exp(1j * np.deg2rad(phase))
        axes.plot(z.real, sign * z.imag, color=INK, lw=1.5, label="population network")
        axes.legend()
    axes.set_xlabel(f"Re z ({unit})")
    axes.set_ylabel(f"{'-' if sign < 0 else ''}Im z ({unit})")
    return axes


def plot_person(
    result: Result, subject: str, recordings: Recordings | None = None, ax: Sequence[Axes] | None = None
) -> tuple[Axes, Axes]:
    """One person's recordings with the network of that person's own elements, median and 90 % band.

    Where the recordings do not determine an element, the result holds no draws of it, and the curve has no band.

    Parameters
    ----------
    result : Result
    subject : str
    recordings : Recordings, optional
        To show every repetition; the mean recording in the result if not given.
    ax : sequence of two Axes, optional
        For magnitude and phase; new ones if not given.

    Returns
    -------
    magnitude, phase : Axes

    Raises
    ------
    InputError
        If the subject is not in the result, or it is of a version that kept neither draws nor curves.
    """
    f, lost = frequency(result), without_number(result)
    if lost:
        z = fitted_curve(result, subject)
        fits = (np.abs(z)[None], np.angle(z, deg=True)[None])
        label = f"own network (no band: {', '.join(lost)} not determined)"
    else:
        band = person_band(result, subject, f)
        fits, label = (band.magnitude, band.phase_deg), "own network, 90 %"
    upper, lower = _pair(ax)
    if recordings is None:
        own = [str(name) for name in result.coords["subject"]].index(subject)
        magnitude, phase = (rows[own : own + 1] for rows in observed(result))
        grid = f
    else:
        (person,) = recordings.select([subject]).subjects
        magnitude, phase, grid = np.abs(person.z), np.angle(person.z, deg=True), person.frequency_hz
    for axes, rows, fitted in ((upper, magnitude, fits[0]), (lower, phase, fits[1])):
        for i, row in enumerate(rows):
            axes.plot(grid, row, ".", color=BLUE, ms=4, label=None if i else f"{subject}, recorded")
        if not lost:
            axes.fill_between(f, fitted[0], fitted[-1], color=ORANGE, alpha=0.35, lw=0)
        axes.plot(f, fitted[len(fitted) // 2], color=ORANGE, lw=1.5, label=label)
    upper.legend()
    _name_axes(upper, lower, _unit(result))
    return upper, lower


def plot_predictive_check(result: Result, ax: Sequence[Axes] | None = None) -> tuple[Axes, Axes]:
    """Visual predictive check: quantiles over people, recorded and as the posterior predicts them.

    At each frequency of ``posterior_predictive`` the 5 %, 50 % and 95 % quantiles over the recorded people are lines;
    the 90 % intervals of the same quantiles over equally many predicted people are areas.

    Parameters
    ----------
    result : Result
    ax : sequence of two Axes, optional
        For magnitude and phase; new ones if not given.

    Returns
    -------
    magnitude, phase : Axes

    Raises
    ------
    InputError
        If there are too few people, or the result is of a version without predictions of everybody.
    """
    predicted, seen = result.groups.get("posterior_predictive", {}), result.groups["observed_data"]
    if "log_magnitude" not in predicted:
        raise InputError("the result is of an earlier version, without predictions of all subjects; fit it again")
    if len(seen["log_magnitude"]) < _FEWEST_PEOPLE:
        raise InputError(f"a predictive check compares quantiles over subjects: give {_FEWEST_PEOPLE} subjects or more")
    upper, lower = _pair(ax)
    f = np.asarray(result.coords["predictive_frequency_hz"], dtype=float)
    for axes, name in ((upper, "log_magnitude"), (lower, "phase_deg")):
        draws = np.asarray(predicted[name], dtype=float)
        of_draws = np.nanquantile(draws.reshape(-1, *draws.shape[2:]), _CHECKED, axis=1)
        recorded = np.nanquantile(seen[name], _CHECKED, axis=0)
        low, high = np.quantile(of_draws, (_CHECKED[0], _CHECKED[-1]), axis=1)
        if name == "log_magnitude":
            low, high, recorded = np.exp(low), np.exp(high), np.exp(recorded)
        for k, quantile in enumerate(_CHECKED):
            middle = quantile == 0.5
            axes.fill_between(
                f, low[k], high[k], color=INNER if middle else OUTER, alpha=0.8, label="predicted" if middle else None
            )
            axes.plot(f, recorded[k], "-" if middle else "--", color=INK, label=f"recorded, {100 * quantile:g} %")
    upper.legend()
    _name_axes(upper, lower, _unit(result))
    return upper, lower


def _curves(shown: Recordings | Result) -> list[tuple[np.ndarray, np.ndarray]]:
    """Frequencies and complex mean recording of everybody."""
    if isinstance(shown, Recordings):
        return [(s.frequency_hz, s.mean) for s in shown.subjects]
    z = needed(shown, "observed_re") + 1j * needed(shown, "observed_im")
    return [(frequency(shown), row) for row in z]


def _unit(shown: Recordings | Result) -> str:
    if isinstance(shown, Recordings):
        return shown.unit
    return "ohm" if is_electrical(shown) else str(shown.attributes["unit"])


def _new() -> Axes:
    from matplotlib import pyplot as plt

    return plt.subplots(layout="constrained")[1]


def _pair(ax: Sequence[Axes] | None) -> tuple[Axes, Axes]:
    """The two axes that are given, or new ones with a common frequency axis."""
    if ax is None:
        from matplotlib import pyplot as plt

        _, (upper, lower) = plt.subplots(2, 1, sharex=True, layout="constrained")
        return upper, lower
    if np.size(np.asarray(ax, dtype=object)) != 2:
        raise InputError("ax must hold two axes, one for the magnitude and one for the phase")
    upper, lower = np.ravel(np.asarray(ax, dtype=object))
    return upper, lower


def _name_axes(upper: Axes, lower: Axes, unit: str) -> None:
    upper.set_xscale("log")
    lower.set_xscale("log")
    upper.set_yscale("log")
    upper.set_ylabel(f"|z| ({unit})")
    lower.set_ylabel("phase (°)")
    lower.set_xlabel("frequency (Hz)")
