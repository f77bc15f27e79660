"""Common parts of both pages: the environment of their templates, and pictures embedded as text."""

from __future__ import annotations

import base64
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


def embedded_picture(file: Path) -> str:
    """A PNG file as the text of an image's source."""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode("ascii")
