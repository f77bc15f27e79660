"""The network as a drawing: self-contained SVG text for a page.

A tree of series and parallel groups is drawn by two rules. A *chain* puts its parts one after the other on a line; a
*stack* puts them one above the other between two nodes. In a mechanical drawing the parts that pass on one force
(``-``) form a chain and those that share one velocity (``|``) a stack. In a circuit diagram of the same tree it is the
other way round, because voltage takes the place of force: impedances that add are drawn in a row.

A wrapper is a box around the part whose impedance it changes, with its word and its parameters on top. A parameter that
is the same for everybody has its ``*``, one that is held its value.

The size of each part is computed first (its width, and its height above and below its own line). It is painted when its
position is known; wires fill the remaining width.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from bayes_impedance.network.notation import Element, Network, Parallel, Place, PowerLaw, Wrapped
from bayes_impedance.network.parameters import Symbol
from bayes_impedance.network.schematic_symbols import ELECTRICAL, MECHANICAL, SYMBOL, line, wire
from bayes_impedance.units import hertz

_WIDTH, _ABOVE, _BELOW = 112.0, 34.0, 36.0
"""Least width of an element and its extent above and below its line, in pixels: the name is above the symbol and the
value below. By choice, for legibility."""
_LEAD, _GAP = 20.0, 6.0
"""Length of the wires at either end of a stack, and the gap between its parts, in pixels. By choice, for legibility."""
_PAD, _HEAD = 9.0, 22.0
"""Distance of a frame from the part inside it, and the height for its label, in pixels. By choice, for legibility."""

_WIDE, _RAISED = 12.0, 9.0
"""Width of a letter of a name and of an exponent in pixels. By choice: that of wide fonts."""
_TITLE = 27.0
"""Height of a wrapper's title in pixels. By choice, for legibility."""

_STYLE = (
    ".w{stroke:#333;stroke-width:1.8;fill:none;stroke-linecap:round;stroke-linejoin:round}"
    ".d{stroke-dasharray:2 5}.b{fill:#e3eef6}.t{fill:#333;stroke:none}"
    ".g{stroke:#b9c4cd;stroke-width:1.2;fill:#9fb4c4;fill-opacity:.07;stroke-dasharray:5 4}"
    "text{font-family:system-ui,'Segoe UI',Roboto,Helvetica,Arial,sans-serif;fill:#222}"
    ".n{font-size:16px;font-weight:600}.v{font-size:13px;fill:#0b5a8f}.l{font-size:13px;fill:#5b6b78;font-style:italic}"
    ".p{font-size:13px;fill:#444}"
    ".o{stroke:#7b6aa3;stroke-width:1.2;fill:#8f7fb8;fill-opacity:.06}.h{font-size:13px;fill:#5b4a85}"
    ".x{font-size:12px;font-weight:600}"
    ".q{font-size:14px;font-weight:600;fill:#222}.u{fill:#0b5a8f}"
)
_MARKED = (  # included only if something is marked
    ".k{stroke:#c77700;stroke-width:2;fill:#f6a623;fill-opacity:.16}.kb{fill:#c77700}"
    ".kt{font-size:13px;font-weight:700;fill:#fff}"
)

Path = tuple[int, ...]
Paint = Callable[[float, float, float], list[str]]


@dataclass(frozen=True)
class _Block:
    """A part of the drawing.

    Attributes
    ----------
    width, above, below : float
        Least width, and extent above and below the line on which the part is connected.
    paint : callable
        Function of the left end x, the line's y, and the width to be filled.
    open_right : bool
        Whether the right wire is dashed: it is the connection to the inertial frame, not a rod.
    """

    width: float
    above: float
    below: float
    paint: Paint
    open_right: bool = False


def schematic(
    network: Network,
    values: Mapping[str, str] | None = None,
    *,
    electrical: bool = False,
    mark: Place | Path | Mapping[Path, str] | None = None,
) -> str:
    """Draw a network.

    Parameters
    ----------
    network : Network
    values : mapping of str to str, optional
        Text below an element, for instance its central value.
    electrical : bool
        Draw coils, capacitors and resistors, by the force-voltage analogy.
    mark : Place, path, or mapping of path to str, optional
        Draw a box around the part at this place, with a short text if one is given. The port (the empty path) is
        marked at its end of the drawing. A place is given as such or by its path.

    Returns
    -------
    str
        An ``<svg>`` element for an HTML page. Each name of a parameter has the attribute ``data-element``.
    """
    marks = _marks(mark)
    block = _build(network, values or {}, electrical, {path: text for path, text in marks.items() if path})
    margin, port = 12.0, 62.0
    end = 26.0 if not electrical else 62.0
    height = block.above + block.below + 2 * margin
    width = port + block.width + end + 2 * margin
    y = margin + block.above
    x = margin + port
    parts = block.paint(x, y, block.width)
    parts += _port(margin + 8, x, y, "V, i" if electrical else "F, v")
    if () in marks:
        parts += _highlight(margin - 3, y - 38, port - 5, 54, marks[()])
    right = x + block.width
    parts += (
        _terminal(right, right + end - 8, y) if electrical else _ground(right, right + end - 8, y, block.open_right)
    )
    return (
        f'<svg class="schematic" role="img" aria-label="Drawing of the network {escape(str(network), quote=True)}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}">'
        f"<style>{_STYLE}{_MARKED if marks else ''}</style>{''.join(parts)}</svg>"
    )


def _marks(mark: Place | Path | Mapping[Path, str] | None) -> dict[Path, str]:
    if mark is None:
        return {}
    if isinstance(mark, Place):
        return {mark.path: ""}
    return dict(mark) if isinstance(mark, Mapping) else {tuple(mark): ""}


def _build(
    node: Network, values: Mapping[str, str], electrical: bool, marks: Mapping[Path, str], path: Path = ()
) -> _Block:
    if isinstance(node, Element):
        block = _element(node.symbol, values.get(node.name, ""), electrical)
    elif isinstance(node, PowerLaw):
        block = _power_law(node, values, electrical)
    elif isinstance(node, Wrapped):
        block = _boxed(_build(node.part, values, electrical, marks, (*path, 0)), node, values)
    else:
        parts = list(enumerate(node.parts))
        chained = isinstance(node, Parallel) == electrical
        if chained and not electrical:
            # The other end of a mass is the inertial frame, so parts that contain a mass are drawn last; the order in
            # a chain does not change its impedance.
            parts.sort(key=lambda part: _inertia(part[1]))
        blocks = [_build(part, values, electrical, marks, (*path, i)) for i, part in parts]
        block = _chain(blocks) if chained else _stack(blocks)
    block = block if node.label is None else _frame(block, node.label)
    return _marked(block, marks[path]) if path in marks else block


def _inertia(node: Network) -> int:
    """0 without a mass, 1 for a part with one, 2 for a mass."""
    if isinstance(node, Element):
        return 2 if node.name.startswith("m") else 0
    return int(any(p.letter == "m" for p in node.parameters))


def _dot(x: float, y: float) -> str:
    return f'<circle class="t" cx="{x:.1f}" cy="{y:.1f}" r="3"/>'


def _text(x: float, y: float, text: str, kind: str, anchor: str = "middle") -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


# -------------------------------------------------------------------- parts


def _element(symbol: Symbol, value: str, electrical: bool) -> _Block:
    def title(x: float, y: float) -> list[str]:
        return [_text(x, y, str(symbol), "n")]

    return _leaf(symbol, title, _WIDE * len(str(symbol)), [value] if value else [], electrical)


def _power_law(node: PowerLaw, values: Mapping[str, str], electrical: bool) -> _Block:
    """Its exponent stands as a superscript, its value below that of the size."""
    size, exponent = node.size, node.exponent
    wide, raised = _WIDE * len(str(size)), _RAISED * len(str(exponent))
    at = "" if node.reference_hz is None else f"at {hertz(node.reference_hz)}"
    below = [" ".join(part for part in (values.get(size.name, ""), at) if part)]
    if values.get(exponent.name):
        below.append(f"{exponent.name} = {values[exponent.name]}")

    def title(x: float, y: float) -> list[str]:
        end = x + (wide - raised) / 2  # of the size, so that both together are centred
        above = [_text(end + 1, y - 7, str(exponent), "x", "start")]
        return [_text(end, y, str(size), "n", "end"), *(_group(exponent.name, above) if exponent.name else above)]

    return _leaf(size, title, wide + raised, [text for text in below if text], electrical)


def _group(name: str, parts: Sequence[str]) -> list[str]:
    """Parts of the drawing that can be found by the name of their parameter."""
    return [f'<g data-element="{escape(name, quote=True)}">', *parts, "</g>"]


def _leaf(
    symbol: Symbol, title: Callable[[float, float], list[str]], wide: float, below: Sequence[str], electrical: bool
) -> _Block:
    """A symbol with a title above, so many pixels wide, and lines of text below."""
    kind = symbol.name[0]
    drawn = (ELECTRICAL if electrical else MECHANICAL)[kind]
    to_frame = kind == "m" and not electrical

    def paint(x: float, y: float, width: float) -> list[str]:
        left = x + (width - SYMBOL) / 2
        middle, right = left + SYMBOL / 2, left + SYMBOL
        parts = [
            *wire(x, left, y),
            *drawn(left, y),
            *wire(right, x + width, y, dashed=to_frame),
            *title(middle, y - 21),
            *(_text(middle, y + 30 + 16 * i, text, "v") for i, text in enumerate(below)),
        ]
        return _group(symbol.name, parts)

    # A long name or value is wider than a symbol.
    width = max(_WIDTH, wide + 16, *(7.6 * len(text) + 16 for text in below))
    return _Block(width, _ABOVE + 6, _BELOW + 16 * (len(below) - 1) if below else 22.0, paint, open_right=to_frame)


def _chain(blocks: Sequence[_Block]) -> _Block:
    width = sum(b.width for b in blocks)

    def paint(x: float, y: float, room: float) -> list[str]:
        parts: list[str] = []
        for i, block in enumerate(blocks):
            share = block.width * room / width
            parts += block.paint(x, y, share)
            x += share
            if i < len(blocks) - 1:
                parts.append(_dot(x, y))
        return parts

    above, below = max(b.above for b in blocks), max(b.below for b in blocks)
    return _Block(width, above, below, paint, blocks[-1].open_right)


def _stack(blocks: Sequence[_Block]) -> _Block:
    inner = max(b.width for b in blocks)
    lines, top = [], 0.0
    for block in blocks:
        lines.append(top + block.above)
        top += block.above + block.below + _GAP
    total = top - _GAP
    middle = (lines[0] + lines[-1]) / 2  # the wires leave halfway between the first and the last line

    def paint(x: float, y: float, room: float) -> list[str]:
        left, right = x + _LEAD, x + room - _LEAD
        first, last = y + lines[0] - middle, y + lines[-1] - middle
        parts = [*wire(x, left, y), *wire(right, x + room, y)]
        parts += [
            line((left, first), (left, last)),
            line((right, first), (right, last)),
            _dot(left, y),
            _dot(right, y),
        ]
        for block, own in zip(blocks, lines, strict=True):
            parts += block.paint(left, y + own - middle, right - left)
        return parts

    return _Block(inner + 2 * _LEAD, middle, total - middle, paint)


def _frame(block: _Block, label: str) -> _Block:
    """A dashed frame with a name around a part."""

    def paint(x: float, y: float, room: float) -> list[str]:
        left, right = x + _PAD, x + room - _PAD
        top, bottom = y - block.above - _HEAD, y + block.below + _PAD
        return [
            f'<rect class="g" x="{left:.1f}" y="{top + 2:.1f}" width="{right - left:.1f}" '
            f'height="{bottom - top - 4:.1f}" rx="8"/>',
            _text(left + 10, top + 19, label, "l", "start"),
            *wire(x, left + _PAD, y),
            *block.paint(left + _PAD, y, right - left - 2 * _PAD),
            *wire(right - _PAD, x + room, y, dashed=block.open_right),
        ]

    width = max(block.width, 8.0 * len(label) + 20) + 4 * _PAD
    return _Block(width, block.above + _HEAD, block.below + _PAD, paint, block.open_right)


def _boxed(block: _Block, node: Wrapped, values: Mapping[str, str]) -> _Block:
    """A box with a wrapper's word and parameters around what it wraps."""
    word, shown, letters = node.construct.word, [], len(node.construct.word)
    for symbol in node.symbols:
        value = f" = {values[symbol.name]}" if values.get(symbol.name) else ""
        name = f'<tspan class="q" data-element="{escape(symbol.name, quote=True)}">{escape(str(symbol))}</tspan>'
        shown.append(f'{name}<tspan class="u">{escape(value)}</tspan>')
        letters += len(str(symbol)) + len(value) + 3

    def paint(x: float, y: float, room: float) -> list[str]:
        left, right = x + _PAD, x + room - _PAD
        top, bottom = y - block.above - _TITLE, y + block.below + _PAD
        return [
            f'<rect class="o" x="{left:.1f}" y="{top + 2:.1f}" width="{right - left:.1f}" '
            f'height="{bottom - top - 4:.1f}" rx="3"/>',
            line((left, top + _TITLE), (right, top + _TITLE), kind="o"),
            f'<text class="h" x="{left + 9:.1f}" y="{top + 19:.1f}">{escape(word)} &#160;{", ".join(shown)}</text>',
            *wire(x, left + _PAD, y),
            *block.paint(left + _PAD, y, right - left - 2 * _PAD),
            *wire(right - _PAD, x + room, y, dashed=block.open_right),
        ]

    width = max(block.width + 4 * _PAD, 7.8 * letters + 18 + 2 * _PAD)
    return _Block(width, block.above + _TITLE, block.below + _PAD, paint, block.open_right)


def _marked(block: _Block, text: str) -> _Block:
    """A coloured box around a part."""

    def paint(x: float, y: float, room: float) -> list[str]:
        left, right = x + _PAD, x + room - _PAD
        return [
            *wire(x, left + _PAD, y),
            *_highlight(left, y - block.above - _PAD, right - left, block.above + block.below + 2 * _PAD - 2, text),
            *block.paint(left + _PAD, y, right - left - 2 * _PAD),
            *wire(right - _PAD, x + room, y, dashed=block.open_right),
        ]

    return _Block(block.width + 4 * _PAD, block.above + 2 * _PAD, block.below + _PAD, paint, block.open_right)


def _highlight(x: float, y: float, width: float, height: float, text: str) -> list[str]:
    box = f'<rect class="k" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="7"/>'
    if not text:
        return [box]
    long = max(18.0, 8.0 * len(text) + 10)
    badge = f'<rect class="kb" x="{x + 6:.1f}" y="{y - 9:.1f}" width="{long:.1f}" height="18" rx="9"/>'
    return [box, badge, _text(x + 6 + long / 2, y + 4.5, text, "kt")]


# -------------------------------------------------------------------- ends


def _port(x: float, right: float, y: float, name: str) -> list[str]:
    """Terminal on the left, with an arrow into the network."""
    return [
        *wire(x + 4, right, y),
        f'<circle class="w" cx="{x:.1f}" cy="{y:.1f}" r="4"/>',
        f'<path class="t" d="M{x + 36:.1f},{y - 5:.1f} l10,5 l-10,5 z"/>',
        _text(x + 24, y - 12, name, "p"),
    ]


def _terminal(x: float, right: float, y: float) -> list[str]:
    return [*wire(x, right - 4, y), f'<circle class="w" cx="{right:.1f}" cy="{y:.1f}" r="4"/>']


def _ground(x: float, right: float, y: float, dashed: bool) -> list[str]:
    """The inertial frame: a hatched wall."""
    hatch = [line((right, y - 20 + 10 * i), (right + 8, y - 28 + 10 * i)) for i in range(5)]
    return [*wire(x, right, y, dashed), line((right, y - 22), (right, y + 22)), *hatch]
