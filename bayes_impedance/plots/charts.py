"""Charts that a page draws itself, so that a reader can ask them for values: what to draw, as plain data.

A chart is a column of panels over one horizontal axis. A panel has *people* (a curve for each, whose values the page
holds once for all charts), *lines* and *ribbons*. What a chart shows is decided here; how it looks on paper or on a
dark screen is decided by the page. Colours are named by their role.

Numbers are rounded to what a screen can show, and frequencies are thinned where there are more than pixels; the
pictures of this room are drawn from all of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

DIGITS = 4
"""Significant digits of a number on a page. By choice: a screen of a thousand pixels shows three."""
_NUMBERS = 240_000
"""Most numbers of people's curves on a page: about 1.5 MB of text. By choice: a page is to stay below 6 MB with the
plotting library and the pictures."""
_FEWEST, _MOST = 40, 800
"""Frequencies of a curve on a page, at least and at most. By choice: below the first a curve of three decades has
corners, above the second it has more points than a screen."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A curve of the model or of a statistic; `when` is ``before`` or ``after`` if it belongs to one of two models."""

    name: str
    y: np.ndarray
    colour: str
    dash: str = "solid"
    when: str = ""
    shown: bool = True


@dataclass(frozen=True, kw_only=True)
class Ribbon:
    """The area between two curves; fields as in :class:`Line`."""

    name: str
    low: np.ndarray
    high: np.ndarray
    colour: str
    when: str = ""
    shown: bool = True


@dataclass(frozen=True, kw_only=True)
class People:
    """A curve for each person: the name of the values that the page holds, optionally over a curve of the model."""

    values: str
    name: str
    colour: str = "people"
    over: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Own:
    """A curve of the person whom the reader has chosen.

    Attributes
    ----------
    values : str
        Name of the values that the page holds.
    name, colour, when : str
        As in :class:`Line`.
    points : bool
        Drawn as points.
    mirrored : bool
        The area between minus and plus the values.
    """

    values: str
    name: str
    colour: str
    when: str = ""
    points: bool = False
    mirrored: bool = False


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One panel.

    Attributes
    ----------
    label : str
        Of the vertical axis, with its unit.
    logarithmic : bool
    lines, ribbons : tuple
    people : People or None
    own : tuple of Own
    zero : bool
        Whether the axis begins at zero.
    shaded : tuple of (float, float)
        Frequency bands that are shaded.
    limits : (float, float), optional
        Ends of the axis at first.
    cells : mapping of str to ndarray, optional
        Values of each person at each frequency, shown by colour; by ``before`` and ``after``.
    """

    label: str
    logarithmic: bool = False
    lines: tuple[Line, ...] = ()
    ribbons: tuple[Ribbon, ...] = ()
    people: People | None = None
    own: tuple[Own, ...] = ()
    zero: bool = False
    shaded: tuple[tuple[float, float], ...] = ()
    limits: tuple[float, float] | None = None
    cells: dict[str, np.ndarray] | None = None


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A chart.

    Attributes
    ----------
    name : str
        That of the picture it stands for.
    panels : tuple of Panel
    order : tuple of int
        Order of people in panels with cells.
    frequency_hz : ndarray, shape (G,), optional
        If it is another grid than that of people's curves.
    """

    name: str
    panels: tuple[Panel, ...]
    order: tuple[int, ...] = ()
    frequency_hz: np.ndarray | None = None


def kept_frequencies(people: int, points: int, curves: int) -> np.ndarray:
    """Indices of the frequencies that a page holds.

    Parameters
    ----------
    people, points : int
    curves : int
        Values of each person at each frequency.

    Returns
    -------
    ndarray of int
        The first and the last are always among them.
    """
    most = int(np.clip(_NUMBERS // max(people * curves, 1), _FEWEST, _MOST))
    if points <= most:
        return np.arange(points)
    return np.unique(np.linspace(0, points - 1, most).round().astype(int))


def kept_people(people: int, curves: int, first: Sequence[int] = ()) -> list[int]:
    """Indices of the people whose curves a page holds: all, or `first` and as many others as there is room for."""
    most = max(_NUMBERS // (curves * _FEWEST), 1)
    if people <= most:
        return list(range(people))
    others = np.linspace(0, people - 1, most).round().astype(int).tolist()
    return sorted(list(dict.fromkeys([*first, *others]))[:most])


def rounded(values: np.ndarray, digits: int = DIGITS) -> Any:
    """Values as nested lists of numbers with few digits, None in place of NaN and of infinities."""
    if values.ndim > 1:
        return [rounded(row, digits) for row in values]
    return [_number(x, digits) for x in values.tolist()]


def _number(x: float, digits: int) -> float | int | None:
    if not math.isfinite(x):
        return None
    short = float(f"{x:.{digits}g}")
    return int(short) if short == int(short) and abs(short) < 1e6 else short


def as_data(chart: Chart, kept: np.ndarray, people: Sequence[int]) -> dict[str, Any]:
    """A chart as data for JSON, at the frequencies and of the people that the page holds."""
    data: dict[str, Any] = {"name": chart.name}
    if chart.frequency_hz is not None:
        kept = kept_frequencies(1, chart.frequency_hz.size, 1)
        data["x"] = rounded(chart.frequency_hz[kept], 6)
    place = {person: row for row, person in enumerate(people)}
    order = [place[i] for i in chart.order if i in place]
    return data | {"order": order, "panels": [_panel(p, kept, people) for p in chart.panels]}


def _panel(panel: Panel, kept: np.ndarray, people: Sequence[int]) -> dict[str, Any]:
    data: dict[str, Any] = {"label": panel.label, "log": panel.logarithmic, "zero": panel.zero}
    data["shaded"] = [rounded(np.array(band)) for band in panel.shaded]
    data["lines"] = [_common(line) | {"dash": line.dash, "y": rounded(line.y[kept])} for line in panel.lines]
    data["ribbons"] = [
        _common(band) | {"low": rounded(band.low[kept]), "high": rounded(band.high[kept])} for band in panel.ribbons
    ]
    if panel.people is not None:
        own = panel.people
        over = {when: rounded(curve[kept]) for when, curve in own.over.items()}
        data["people"] = {"values": own.values, "name": own.name, "colour": own.colour, "over": over}
    if panel.limits is not None:
        data["limits"] = rounded(np.array(panel.limits))
    if panel.own:
        data["own"] = [asdict(own) for own in panel.own]
    if panel.cells is not None:
        rows = list(people)
        data["cells"] = {when: rounded(cells[rows][:, kept], 2) for when, cells in panel.cells.items()}
    return data


def _common(item: Line | Ribbon) -> dict[str, Any]:
    return {"name": item.name, "colour": item.colour, "when": item.when, "shown": item.shown}
