"""How objects show themselves in a notebook: small tables and curves as HTML, without a plotting library."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields
from html import escape
from typing import Any

_WIDTH, _HEIGHT, _MARGIN = 300.0, 150.0, 8.0
"""Size of a picture of curves and its margin, in pixels. By choice: two of them fit beside each other in a notebook."""
MOST_CURVES, _MOST_POINTS = 12, 60
"""Most curves of a picture, and most points of a curve. By choice: a page with many such pictures stays small."""
MOST_ROWS = 10
"""Most rows of a table that is a preview. By choice: what pandas shows of the ends of a long table."""
_LONGEST = 120
"""Most characters of one text in the line of an object. By choice: the line then fits a screen."""
_CELL = "text-align:left;padding:2px 8px;vertical-align:top"


def number(value: object) -> str:
    """A number with three significant digits, text as it is, and a dash for what is missing."""
    if isinstance(value, bool) or not isinstance(value, float | int):
        return "–" if value is None else str(value)
    if isinstance(value, int):
        return str(value)
    return f"{value:.3g}" if math.isfinite(value) else "–"


def short(text: str) -> str:
    """Text for a line that says what an object is: its beginning, if it is long."""
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def interval(entry: Mapping[str, Any]) -> str:
    """A median with its 90 % interval, of a mapping with keys median, q05 and q95."""
    if entry["median"] is None:
        return "–"
    return f"{number(entry['median'])} ({number(entry['q05'])} to {number(entry['q95'])})"


def table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Rows of cells below a head; numbers with three digits."""
    head = "".join(f'<th style="{_CELL}">{escape(str(name))}</th>' for name in columns)
    body = "".join(
        "<tr>" + "".join(f'<td style="{_CELL}">{escape(number(cell))}</td>' for cell in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def heading(text: str) -> str:
    """The first line of an object."""
    return f"<p><b>{escape(text)}</b></p>"


def lines(sentences: Iterable[str]) -> str:
    """Sentences, one a line."""
    return "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)


def joined(*parts: str) -> str:
    """Parts below each other."""
    return "<div>" + "".join(parts) + "</div>"


def curves(x: Sequence[Sequence[float]], y: Sequence[Sequence[float]], what: str, *, logarithmic: bool = True) -> str:
    """Curves as a small picture, x always on a logarithmic scale.

    Parameters
    ----------
    x, y : sequence of sequences of float
        One for each curve, of which the first :data:`MOST_CURVES` are drawn; what is not finite, or not above zero on a
        logarithmic scale, is left out.
    what : str
        Said below the picture, and to those who do not see it.
    logarithmic : bool
        Whether y is on a logarithmic scale.
    """
    drawn = []
    for own_x, own_y in list(zip(x, y, strict=True))[:MOST_CURVES]:
        points = [
            (math.log(a), math.log(b) if logarithmic else b)
            for a, b in zip(own_x, own_y, strict=True)
            if a > 0 and math.isfinite(b) and (b > 0 or not logarithmic)
        ]
        step = max(1, -(-len(points) // _MOST_POINTS))
        drawn.append(points[::step])
    every = [point for points in drawn for point in points]
    if not every:
        return ""
    (left, right), (low, high) = _range(a for a, _ in every), _range(b for _, b in every)

    def place(a: float, b: float) -> str:
        across = _MARGIN + (_WIDTH - 2 * _MARGIN) * (a - left) / (right - left)
        up = _HEIGHT - _MARGIN - (_HEIGHT - 2 * _MARGIN) * (b - low) / (high - low)
        return f"{across:.1f},{up:.1f}"

    paths = "".join(
        f'<polyline points="{" ".join(place(a, b) for a, b in points)}" fill="none" stroke="#0b5a8f" '
        'stroke-opacity="0.6"/>'
        for points in drawn
    )
    size = f'width="{_WIDTH:.0f}" height="{_HEIGHT:.0f}"'
    return (
        f'<figure style="display:inline-block;margin:4px"><svg {size} role="img" aria-label="{escape(what)}" '
        f'style="border:1px solid #bbb">{paths}</svg><figcaption>{escape(what)}</figcaption></figure>'
    )


def _range(values: Iterable[float]) -> tuple[float, float]:
    found = list(values)
    low, high = min(found), max(found)
    return (low, high) if high > low else (low - 1.0, high + 1.0)


class Brief:
    """Base of dataclasses with ``repr=False``: fields as a line, in a notebook as a table; arrays by their shape."""

    def _told(self) -> list[tuple[str, str]]:
        return [(field.name, _in_words(getattr(self, field.name))) for field in fields(self)]  # type: ignore[arg-type]

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {short(', '.join(f'{name} {told}' for name, told in self._told()))}>"

    def _repr_html_(self) -> str:
        return joined(heading(type(self).__name__), table(["field", "value"], self._told()))


class Chosen:
    """Base of dataclasses of settings with ``repr=False``: as Python, without what is the default; as a table, all."""

    def __repr__(self) -> str:
        told = [
            f"{f.name}={getattr(self, f.name)!r}"
            for f in fields(self)  # type: ignore[arg-type]
            if f.repr and getattr(self, f.name) != _default(f)
        ]
        return f"{type(self).__name__}({', '.join(told)})"

    def _repr_html_(self) -> str:
        told = [(f.name, _in_words(getattr(self, f.name))) for f in fields(self) if f.repr]  # type: ignore[arg-type]
        return joined(heading(type(self).__name__), table(["field", "value"], told))


def _default(field: Field[Any]) -> object:
    """A value that equals the field's default; of a field without one, nothing that a value equals."""
    return field.default_factory() if field.default_factory is not MISSING else field.default


def _in_words(value: object) -> str:
    """A field in a few words: numbers and short text as they are, all else by its kind and size."""
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple) and shape:
        return f"array {' x '.join(map(str, shape))}"
    if isinstance(value, str):
        return short(value)
    if isinstance(value, Mapping | Sequence):
        return f"{len(value)} entries" if len(value) != 1 else "1 entry"
    if value is None or isinstance(value, bool | int | float):
        return number(float(value) if isinstance(value, float) else value)
    if isinstance(value, complex):
        return f"{value:.3g}"
    if shape == ():  # a number of NumPy
        return _in_words(value.item())  # type: ignore[attr-defined]
    return type(value).__name__
