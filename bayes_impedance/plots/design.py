"""Pictures of design inputs: the users' bands, the stability map, the worst user, transparency."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.design.answer import DesignAnswer
from bayes_impedance.design.loop.stability import loop_of
from bayes_impedance.design.loop.transparency import loop_gain
from bayes_impedance.design.percentiles import percentile_curves
from bayes_impedance.design.representatives import Representatives
from bayes_impedance.design.users import UserPopulation, Users
from bayes_impedance.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    INNER,
    ORANGE,
    OUTER,
    PURPLE,
    RED,
    frequency_axis,
    log_axis,
    log_limits,
    new_figure,
    phase_axis,
)
from bayes_impedance.units import INTERVAL, rounded, typeset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMED = {"median": INK, "stiff": RED, "soft": ORANGE, "heavy": PURPLE, "light": GREEN}
_BANDS = ((0.01, 0.99), (0.05, 0.95), (0.25, 0.75))
"""Quantiles over users that bound the 98 %, 90 % and 50 % bands. By choice: pairs of the exported percentiles."""


def users_band(users: Users, chosen: Representatives, frequency_hz: np.ndarray) -> Figure:
    """Magnitude and phase: bands over users, and the named representatives as lines.

    Parameters
    ----------
    users : Users
    chosen : Representatives
    frequency_hz : ndarray, shape (F,)
    """
    figure = new_figure(8.2, 7.0)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    quantiles = [p for pair in _BANDS for p in pair]
    magnitude, phase = percentile_curves(users, frequency_hz, quantiles)
    for i, colour in enumerate(("#eef4f8", OUTER, INNER)):
        share = round(100 * (_BANDS[i][1] - _BANDS[i][0]))
        for axes, rows in ((top, magnitude), (bottom, phase)):
            axes.fill_between(
                frequency_hz, rows[2 * i], rows[2 * i + 1], color=colour, lw=0, label=f"{share} % of users"
            )
    for i, name in enumerate(chosen.users.names):
        if name in _NAMED:
            z = chosen.users[[i]].impedance(frequency_hz)[0]
            for axes, row in ((top, np.abs(z)), (bottom, np.angle(z, deg=True))):
                axes.plot(frequency_hz, row, color=_NAMED[name], lw=1.3, label=name)
    log_axis(top.yaxis, *log_limits(magnitude))
    top.set_ylabel(f"|z| ({typeset(users.unit)})")
    top.legend(ncols=2)
    top.set_title(f"{len(users)} virtual users; the named ones are at the 95 % limit of one property")
    frequency_axis(top, frequency_hz, label=False)
    frequency_axis(bottom, frequency_hz)
    phase_axis(bottom)
    return figure


def stability(answer: DesignAnswer) -> Figure:
    """Share of stable users over the gains, and each user's limit at one virtual damping."""
    figure = new_figure(8.2, 7.6)
    top, bottom = figure.subplots(2, 1, height_ratios=[5, 3])
    m, limit = answer.map, answer.limit
    levels = [0.0, 0.01, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0]
    colours = ["#ffffff", "#f3d9cf", "#e8b79f", "#f0e2b0", "#cfe3f0", "#a6cbe3", "#5b9fca"]
    filled = top.contourf(m.damping, m.stiffness, m.probability.T, levels=levels, colors=colours)
    bar = figure.colorbar(filled, ax=top, label="share of users for whom the loop is stable")
    bar.set_ticks(levels)
    bar.set_ticklabels([f"{100 * level:g} %" for level in levels])
    for rows, style, label in (
        (m.low, "--", f"{100 * limit.share:g} % of users, with 95 % credibility"),
        (m.probability, "-", f"{100 * limit.share:g} % of users"),
    ):
        if rows.min() < limit.share < rows.max():
            top.contour(
                m.damping, m.stiffness, rows.T, levels=[limit.share], colors=BLUE, linestyles=style, linewidths=1.6
            )
            top.plot([], [], color=BLUE, ls=style, label=label)
    top.plot(
        m.damping, np.where(m.mean_user_limit > 0, m.mean_user_limit, np.nan), color=RED, label="the mean user alone"
    )
    log_axis(top.yaxis, float(m.stiffness[0]), float(m.stiffness[-1]))
    if m.classical.max() > m.stiffness[0]:
        good = m.classical > 0
        top.plot(m.damping[good], m.classical[good], color=INK, lw=1.2, ls=":", label="passivity: b > KT/2 + |B|")
    else:
        top.plot([], [], color="none", label=f"passivity, b > KT/2 + |B|: off the scale, K < {limit.classical:.3g} N/m")
    # The grid is quadratic, because at low damping the users influence stability most.
    top.set_xscale("function", functions=(lambda x: np.sqrt(np.maximum(x, 0.0)), np.square))
    top.set_xlim(m.damping[0], m.damping[-1])
    top.set_xlabel("virtual damping B (N s/m)")
    top.set_ylabel("virtual stiffness K (N/m)")
    top.set_title(f"{m.device.name}, T = {1e3 * m.device.period_s:g} ms, delay {1e3 * m.device.delay_s:g} ms")
    top.legend(loc="lower right", frameon=True, framealpha=0.9, edgecolor="none")
    _limits(bottom, answer)
    return figure


def _limits(axes: Axes, answer: DesignAnswer) -> None:
    """Share of users over the stiffness at one virtual damping."""
    limit = answer.limit
    each = np.sort(limit.each)
    axes.plot(each, 100 * (1 - (np.arange(each.size) + 0.5) / each.size), color=BLUE, drawstyle="steps-post", lw=1.5)
    axes.axvspan(limit.low, limit.high, color=OUTER, lw=0)
    axes.axvline(
        limit.stiffness,
        color=BLUE,
        lw=1.2,
        ls="--",
        label=f"{100 * limit.share:g} % of users: {rounded(limit.stiffness)} N/m",
    )
    axes.axvline(limit.mean_user, color=RED, lw=1.2, label=f"the mean user alone: {rounded(limit.mean_user)} N/m")
    if limit.each.max() > 0:
        log_axis(axes.xaxis, *log_limits(limit.each, np.array([limit.low, limit.mean_user]), margin=0.08))
    axes.set_ylim(0, 103)
    axes.set_xlabel(f"virtual stiffness K (N/m) at B = {limit.damping:g} N s/m")
    axes.set_ylabel("stable users (%)")
    share = 100 * np.mean(limit.each >= limit.mean_user)
    axes.set_title(f"at the mean user's limit {share:.0f} % of users are stable")
    axes.legend()


def worst_user(answer: DesignAnswer, population: UserPopulation) -> Figure:
    """Bode plot of the open loop for the worst user and the centre at the worst user's limit, and the causes of it."""
    figure = new_figure(8.2, 8.2)
    top, middle, bottom = figure.subplots(3, 1, height_ratios=[3, 3, 2.2])
    m, limit = answer.map, answer.limit
    stiffness = max(float(limit.each[limit.worst]), float(m.stiffness[0]))
    frequency = np.geomspace(1.0, 0.49 / m.device.period_s, 600)
    for people, colour, label in (
        (population.median_user(), INK, "population centre"),
        (m.users[[limit.worst]], RED, f"worst user ({m.users.names[limit.worst]})"),
    ):
        controller, pulse = loop_gain(loop_of(m.device, people), stiffness, limit.damping, frequency)
        gain = controller * pulse[0]
        top.plot(frequency, np.abs(gain), color=colour, label=label)
        middle.plot(frequency, np.angle(gain, deg=True) % -360, color=colour)
    top.axhline(1.0, color=GREY, lw=0.9)
    middle.axhline(-180.0, color=GREY, lw=0.9)
    hertz = limit.each_hz[limit.worst]
    for axes in (top, middle):
        frequency_axis(axes, frequency, label=axes is middle)
        if np.isfinite(hertz):
            axes.axvline(hertz, color=RED, lw=0.9, ls=":")
    low, high = top.get_ylim()
    log_axis(top.yaxis, max(low, 1e-4), max(high, 2.0) * 1.5)
    top.set_ylabel("loop gain")
    top.set_title(f"open loop at the worst user's limit, K = {rounded(stiffness)} N/m, B = {limit.damping:g} N s/m")
    top.legend()
    phase_axis(middle)
    why = answer.reason
    share = 100 * np.expm1(why.part)
    places = np.arange(len(why.elements))
    bottom.barh(places, share, color=[RED if x < 0 else GREEN for x in share], height=0.65)
    for place, x, change in zip(places, share, why.change, strict=True):
        text = f"{round(x) + 0:+d} %   (element {np.exp(change):.2f} times that of the centre)"
        bottom.annotate(
            text, (max(x, 0.0), place), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.5
        )
    bottom.set_yticks(places, why.elements)
    bottom.invert_yaxis()
    bottom.axvline(0, color=INK, lw=0.8)
    bottom.set_xlim(min(share.min() * 1.1, -1.0), max(share.max(), 0.0) + 0.9 * abs(share).max())
    bottom.grid(axis="y", visible=False)
    bottom.set_xlabel("change of the limit due to the element (%)")
    bottom.set_title(f"causes: the limit is {np.exp(why.difference):.2f} times that of the centre")
    return figure


def felt(answer: DesignAnswer) -> Figure | None:
    """Transmitted against desired impedance, and the error of the user's velocity; None if nothing is stable."""
    found = answer.transparency
    if found is None:
        return None
    figure = new_figure(8.2, 6.6)
    top, bottom = figure.subplots(2, 1, sharex=True)
    frequency = found.frequency_hz
    top.plot(frequency, np.abs(found.desired), color=INK, ls="--", label="desired: K/s + B")
    rows = np.quantile(np.abs(found.transmitted), INTERVAL, axis=0)
    top.fill_between(frequency, rows[0], rows[2], color=INNER, lw=0)
    top.plot(frequency, rows[1], color=BLUE, label="transmitted (median and 90 % of users)")
    log_axis(top.yaxis, *log_limits(np.abs(found.desired), rows))
    top.set_ylabel("impedance (N s/m)")
    top.set_title(f"transmitted impedance at K = {rounded(found.stiffness)} N/m, B = {found.damping:g} N s/m")
    top.legend()
    error = 100 * np.quantile(found.velocity_error, (0.05, 0.25, 0.5, 0.75, 0.95), axis=0)
    bottom.fill_between(frequency, error[0], error[4], color=OUTER, lw=0, label="90 % of users")
    bottom.fill_between(frequency, error[1], error[3], color=INNER, lw=0, label="50 % of users")
    bottom.plot(frequency, error[2], color=BLUE, label="median")
    log_axis(bottom.yaxis, *log_limits(error))
    bottom.set_ylabel("velocity error (%)")
    bottom.set_title("difference of the user's motion from that against the desired wall")
    bottom.legend(loc="lower right")
    frequency_axis(top, frequency, label=False)
    frequency_axis(bottom, frequency)
    return figure
