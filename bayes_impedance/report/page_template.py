"""Common parts of both pages: the environment of their templates, and pictures embedded as text."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment


def template_environment() -> Environment:
    """Environment of the templates in this folder; texts are escaped, and an undefined name is an error."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


_COLOURS = 128
"""Colours of an embedded picture. By choice: thin lines on white are then as they were, at a third of the size."""


def embedded_picture(file: Path) -> str:
    """A PNG file as the text of an image's source, with fewer colours: the file itself keeps them all."""
    from PIL import Image

    with Image.open(file) as picture:
        reduced = picture.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    text = io.BytesIO()
    reduced.save(text, "PNG")
    return "data:image/png;base64," + base64.b64encode(text.getvalue()).decode("ascii")
