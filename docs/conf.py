"""Sphinx: pages in MyST Markdown, notebooks executed in the build, the reference generated from the package."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

project = "bayes_impedance"
author = "bayes_impedance contributors"
release = version = version_of("bayes_impedance")
copyright = author  # Sphinx asks for this name

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"bayes_impedance {release}"
html_static_path: list[str] = []
suppress_warnings = ["mystnb.mime_priority"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes are described once, in the docstring of their class
napoleon_use_rtype = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the sections of the docstrings have types, with shapes

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 900  # seconds of one cell, on a busy machine
nb_merge_streams = True
# Cells call the command by its name, and pictures need no display.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
os.environ["PYTHONWARNINGS"] = "ignore"  # of libraries, on pages for readers


def setup(app: Any) -> None:
    """Write the generated pages before Sphinx looks for sources."""
    from generate import write_pages

    app.connect("config-inited", lambda *_: write_pages(HERE / "reference" / "generated"))
