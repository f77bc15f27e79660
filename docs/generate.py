"""Pages of the reference that are made from the package: API, catalogue of effects, command line, schemas.

The build calls :func:`write_pages`; nothing that it writes is in the repository.
"""

from __future__ import annotations

import argparse
import json
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

import bayes_impedance
from bayes_impedance.commands.arguments import parser_of_commands
from bayes_impedance.datasets import fingertip_result
from bayes_impedance.diagnosis import registered
from bayes_impedance.diagnosis.catalogue.effect import Effect, direction, shape_grid
from bayes_impedance.diagnosis.catalogue.population_structure import STRUCTURES
from bayes_impedance.diagnosis.fit.model import build, inner_places, scales_of
from bayes_impedance.diagnosis.residuals.sensitivity import local_impedances, motion_at
from bayes_impedance.network import parse
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.simulate import simulate_recordings

ROOMS = {
    "recordings": "Recordings",
    "intake": "Import",
    "quality": "Checks",
    "network": "Networks",
    "population": "Population",
    "results": "Results",
    "diagnosis": "Missing physics",
    "classical": "Methods of the paper",
    "design": "Design inputs",
    "datasets": "Shipped datasets",
    "plots": "Pictures",
    "report": "Report",
    "person": "One person",
    "mcmc": "Sampling",
    "runtime": "How work is run",
}
"""Rooms with public names, in the order of the page, and their headings."""

_LARGEST = 0.1
"""Largest relative change of the impedance in a picture of a signature."""


def public_names() -> dict[str, list[str]]:
    """Public names of each room: those of its ``__all__`` and those of the package that come from it, each once."""
    names = {room: list(import_module(f"bayes_impedance.{room}").__all__) for room in ROOMS}
    listed = {name for room in names.values() for name in room}
    for name in bayes_impedance.__all__:
        module = bayes_impedance._MODULES[name].split(".")[0]
        if name not in listed and module in names:
            names[module].append(name)
    return names


def api() -> str:
    """Everything public, with its docstring."""
    lines = ["API", "===", ""]
    lines += ["Names marked with ★ are also names of ``bayes_impedance`` itself.", ""]
    lines += ["Errors", "------", "", ".. autoexception:: bayes_impedance.errors.InputError", ""]
    seen: set[int] = set()
    for room, names in public_names().items():
        module = import_module(f"bayes_impedance.{room}")
        title = ROOMS[room]
        lines += [title, "-" * len(title), "", f".. currentmodule:: bayes_impedance.{room}", ""]
        starred = [f"``{name}``" for name in names if name in bayes_impedance.__all__]
        lines += [f"★ {', '.join(starred)}", ""] if starred else []
        for name in names:
            value = getattr(module, name, None)
            value = getattr(bayes_impedance, name) if value is None else value
            if id(value) in seen:
                continue
            seen.add(id(value))
            lines += _entry(room, name, value)
    return "\n".join(lines)


def _entry(room: str, name: str, value: Any) -> list[str]:
    """Directive of one name."""
    if isinstance(value, type):
        home = f"{value.__module__}.{value.__qualname__}"
        return [f".. autoclass:: {home}", "   :members:", ""]
    if callable(value):
        return [f".. autofunction:: {value.__module__}.{value.__qualname__}", ""]
    shown = repr(value)
    shown = shown if len(shown) < 200 else f"{type(value).__name__}"
    return [f".. py:data:: {name}", f"   :module: bayes_impedance.{room}", "", f"   ``{shown}``", ""]


def signature(effect: Effect, frequency_hz: np.ndarray) -> tuple[str, np.ndarray]:
    """Place at which an effect is shown, and the relative change of z at the port, at most :data:`_LARGEST`."""
    network = parse(FINGERTIP.network)
    recordings = simulate_recordings(FINGERTIP, 2, 1, frequency_hz, seed=1).recordings
    scales = scales_of(recordings)
    model = build(network, [], scales, [])
    u = np.log([[FINGERTIP.central[e] for e in model.kernel.elements]])
    omega = 2 * np.pi * frequency_hz
    local = local_impedances(model, u, omega)
    z = local["port"].z[0]
    place = effect.sites(network)[0].name
    shapes = list(shape_grid(effect, scales))
    at = local[place]
    motion = motion_at(model, u, omega, inner_places(model)[place]) if effect.follows_motion else None
    change = direction(effect, shapes[len(shapes) // 2], scales, omega, at.z, motion) * at.adjoint
    relative = change[0] / z
    return place, np.asarray(_LARGEST * relative / np.max(np.abs(relative)))


def draw_signature(effect: Effect, file: Path) -> str:
    """Picture of magnitude and phase; returns the place."""
    from matplotlib.figure import Figure

    frequency_hz = np.geomspace(5, 5000, 200)
    place, relative = signature(effect, frequency_hz)
    figure = Figure(figsize=(6, 2.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    changed = 1 + relative
    for axes, values, label in (
        (left, 100 * (np.abs(changed) - 1), "change of |z|, %"),
        (right, np.angle(changed, deg=True), "change of phase, deg"),
    ):
        axes.axhline(0, color="0.7", linewidth=0.8)
        axes.semilogx(frequency_hz, values)
        axes.set(xlabel="frequency, Hz", ylabel=label)
    figure.savefig(file, dpi=110)
    return place


def catalogue(folder: Path) -> str:
    """Every effect: story, formula, signature."""
    blocks = [
        "# Catalogue of effects\n\nWhat `diagnose` looks for. Each picture shows what the effect does to the impedance "
        "of the median virtual fingertip at its port, as far as 10 % of it: the place is the first at which the effect "
        "may act, and its other parameters are in the middle of what is scanned. What the elements would absorb is not "
        "taken out of it. Effects of the rig are usually the same for everybody, those of the body differ between "
        "people.\n\n"
        "One more effect takes a few lines: {doc}`/how_to/diagnose`."
    ]
    for effect in registered():
        file = f"{effect.id.replace('.', '_')}_{len(blocks)}.png"
        place = draw_signature(effect, folder / file)
        blocks.append(
            f"## `{effect.id}`: {effect.name}\n\n{effect.story}\n\n"
            f"![change of magnitude and phase by {effect.name} at {place}]({file})\n\n"
            + _facts(effect, f"Places\n: {', '.join(effect.places)} (in the picture: {place})\n{_tried(effect)}")
        )
    for entry in STRUCTURES.values():
        blocks.append(f"## `{entry.id}`: {entry.name}\n\n{entry.story}\n\n" + _facts(entry, ""))
    return "\n\n".join(blocks) + "\n"


def _tried(effect: Effect) -> str:
    """When an effect is tried that is not always tried."""
    simpler = ", ".join(f"`{name}`" for name in effect.refines)
    return f"\nTried\n: in the place of {simpler}, where that leaves structure\n" if simpler else ""


def _facts(entry: Any, more: str) -> str:
    pairs = {
        "Impedance": f"`{entry.formula}`",
        "Side": f"{entry.side}, {entry.pooling}",
        "Look for": entry.look_for,
        "What separates it": entry.separates,
        "Source": entry.source,
    }
    return more + "\n" * bool(more) + "\n".join(f"{key}\n: {value}\n" for key, value in pairs.items() if value)


def command_line() -> str:
    """Help of every command."""
    parser = parser_of_commands()
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    blocks = ["# Command line", "Generated from the parsers: what `--help` prints.", _console(parser.format_help())]
    blocks += [f"## `{name}`\n\n{_console(command.format_help())}" for name, command in commands.choices.items()]
    return "\n\n".join(blocks) + "\n"


def _console(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```"


def schemas() -> str:
    """The JSON Schema of verdicts, and the shape of a summary."""
    text = files("bayes_impedance.diagnosis").joinpath("verdict.schema.json").read_text(encoding="utf-8")
    schema = json.loads(text)
    rows = [
        f"| `{name}` | {_type(entry)} | {entry.get('description', '').replace('|', chr(92) + '|')} |"
        for name, entry in schema["properties"].items()
    ]
    summary = fingertip_result().summary
    return (
        "# JSON schemas\n\n## `verdict.json`\n\nWritten by `diagnose`. Its JSON Schema is the package's file "
        "`bayes_impedance/diagnosis/verdict.schema.json`.\n\n"
        "| key | type | meaning |\n|---|---|---|\n" + "\n".join(rows) + "\n\n### The whole schema\n\n"
        f"```json\n{text.rstrip()}\n```\n\n"
        "## `summary.json`\n\nWritten by `fit` and `run`. `central` is the population's median in the element's unit, "
        "dispersions are standard deviations of its natural logarithm, `q05` and `q95` end the 90 % interval. What "
        "recordings do not determine is `null`. A Student t population has a key `distribution` besides, with the "
        "interval of its `degrees_of_freedom`: dispersions between persons are then its scales. Of two groups the key "
        "holds `second_group_share`, their `distance` in standard deviations within a group, and the `difference` of "
        "each element's logarithm; `central` is then the geometric mean of all people. Student t noise has a "
        "key `noise_distribution`, with its `degrees_of_freedom` (`null` is infinite). The keys of the shipped "
        "population's file, with the first entry of "
        f"each list or table:\n\n```json\n{json.dumps(_shortened(summary), indent=2)}\n```\n"
    )


def _type(entry: dict[str, Any]) -> str:
    if "const" in entry:
        return f"`{json.dumps(entry['const'])}`"
    for several in ("anyOf", "oneOf"):
        if several in entry:
            return " or ".join(_type(one) for one in entry[several])
    kind = entry.get("type") or entry.get("$ref", "").rsplit("/", 1)[-1] or "any"
    return " or ".join(kind) if isinstance(kind, list) else str(kind)


def _shortened(value: Any) -> Any:
    """Of lists the first entry, of tables with one row for each element the first row, numbers to four digits."""
    if isinstance(value, dict):
        kept = list(value.items())
        alike = len(kept) > 2 and len({json.dumps(_keys(v)) for _, v in kept}) == 1 and isinstance(kept[0][1], dict)
        return {key: _shortened(v) for key, v in (kept[:1] if alike else kept)}
    if isinstance(value, list):
        return [_shortened(v) for v in value[:1]] if value and isinstance(value[0], list | dict) else value[:3]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def _keys(value: Any) -> Any:
    return sorted(value) if isinstance(value, dict) else type(value).__name__


def write_pages(folder: Path) -> None:
    """Write all of them."""
    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in {
        "api.rst": api(),
        "catalogue.md": catalogue(folder),
        "command_line.md": command_line(),
        "schemas.md": schemas(),
    }.items():
        file = folder / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
