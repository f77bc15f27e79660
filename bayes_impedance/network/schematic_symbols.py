"""Symbols of elements in a drawn network, as pieces of SVG: each lies on the line y, from x to x + :data:`SYMBOL`."""

from __future__ import annotations

from collections.abc import Callable

SYMBOL = 46.0
"""Width of an element's symbol in pixels. By choice: legibility against the drawing's width."""


def line(*points: tuple[float, float], kind: str = "w") -> str:
    """A line through points, of a class of the drawing's style."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline class="{kind}" points="{path}"/>'


def wire(x0: float, x1: float, y: float, dashed: bool = False) -> list[str]:
    """A wire from x0 to x1, or nothing if there is no room for one."""
    return [line((x0, y), (x1, y), kind="w d" if dashed else "w")] if x1 - x0 > 0.05 else []


def _mass(x: float, y: float) -> list[str]:
    return [f'<rect class="w b" x="{x:.1f}" y="{y - 14:.1f}" width="{SYMBOL:.1f}" height="28" rx="2"/>']


def _spring(x: float, y: float) -> list[str]:
    step = SYMBOL / 12
    teeth = [(x + step * (2 * i + 1), y + (9 if i % 2 else -9)) for i in range(6)]
    return [line((x, y), *teeth, (x + SYMBOL, y))]


def _damper(x: float, y: float) -> list[str]:
    open_end, wall, piston = x + 8, x + SYMBOL - 10, x + SYMBOL * 0.52
    return [
        f'<rect class="b" x="{open_end:.1f}" y="{y - 12:.1f}" width="{wall - open_end:.1f}" height="24"/>',
        line((open_end, y - 12), (wall, y - 12), (wall, y + 12), (open_end, y + 12)),
        line((x, y), (piston, y)),
        line((piston, y - 9), (piston, y + 9)),
        line((wall, y), (x + SYMBOL, y)),
    ]


def _coil(x: float, y: float) -> list[str]:
    radius = SYMBOL / 8
    arcs = " ".join(f"a{radius:.2f},{radius:.2f} 0 0 1 {2 * radius:.2f},0" for _ in range(4))
    return [f'<path class="w" d="M{x:.1f},{y:.1f} {arcs}"/>']


def _capacitor(x: float, y: float) -> list[str]:
    left, right = x + SYMBOL / 2 - 4, x + SYMBOL / 2 + 4
    return [
        *wire(x, left, y),
        line((left, y - 13), (left, y + 13)),
        line((right, y - 13), (right, y + 13)),
        *wire(right, x + SYMBOL, y),
    ]


def _resistor(x: float, y: float) -> list[str]:
    return [f'<rect class="w b" x="{x:.1f}" y="{y - 9:.1f}" width="{SYMBOL:.1f}" height="18"/>']


def _springpot(x: float, y: float) -> list[str]:
    """A diamond: what is neither a spring nor a dashpot."""
    middle, right = x + SYMBOL / 2, x + SYMBOL
    points = f"{x + 5:.1f},{y:.1f} {middle:.1f},{y - 14:.1f} {right - 5:.1f},{y:.1f} {middle:.1f},{y + 14:.1f}"
    return [*wire(x, x + 5, y), f'<polygon class="w b" points="{points}"/>', *wire(right - 5, right, y)]


def _constant_phase(x: float, y: float) -> list[str]:
    """Two chevrons, as a constant-phase element is drawn in circuits."""
    left, right = x + SYMBOL / 2 - 9, x + SYMBOL / 2 + 1
    return [
        *wire(x, left + 8, y),
        *(line((start, y - 13), (start + 8, y), (start, y + 13)) for start in (left, right)),
        *wire(right + 8, x + SYMBOL, y),
    ]


MECHANICAL: dict[str, Callable[[float, float], list[str]]] = {
    "m": _mass,
    "n": _spring,
    "r": _damper,
    "p": _springpot,
}
ELECTRICAL: dict[str, Callable[[float, float], list[str]]] = {
    "m": _coil,
    "n": _capacitor,
    "r": _resistor,
    "p": _constant_phase,
}
"""Symbol of each kind of element, by the first letter of its name."""
