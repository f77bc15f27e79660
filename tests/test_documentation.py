"""Every code block of README and documentation can be run or is at least right; every public name is documented."""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import json
import re
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from conftest import DATA
from tiny_fits import tiny_dataset

import bayes_impedance
from bayes_impedance.commands.arguments import parser_of_commands

ROOT = DATA.parent
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *(f for f in sorted(DOCS.rglob("*.md")) if "generated" not in f.parts and "jupyter_execute" not in f.parts),
]
BLOCK = re.compile(r"^```\{?([\w-]+)\}?[^\n]*\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
OTHER_PROGRAMS = frozenset({"pip", "ls", "cat", "ngspice"})
"""Programs that a block may call besides ours."""


def blocks() -> list[Any]:
    """Language, text and place of every fenced block; cells of notebooks are python, or bash by their first line."""
    found = []
    for page in PAGES:
        for n, match in enumerate(BLOCK.finditer(page.read_text(encoding="utf-8"))):
            language, text = match.group(1), match.group(2)
            if language == "code-cell":
                language, text = ("bash", text[7:]) if text.startswith("%%bash\n") else ("python", text)
            found.append(pytest.param(language, text, id=f"{page.relative_to(ROOT)}-{n}"))
    return found


@pytest.mark.parametrize(("language", "text"), blocks())
def test_blocks_are_right(language: str, text: str) -> None:
    if language == "python":
        require_names(text)
    elif language == "bash":
        require_commands(text)
    elif language == "toml":
        assert tomllib.loads(text)
    elif language == "json":
        assert json.loads(text)
    else:
        assert language in ("text", "toctree", "r", "matlab"), f"blocks of {language} are not tested: add them here"


def require_names(text: str) -> None:
    """It is Python, and what it imports of the package exists."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayes_impedance"):
            module = importlib.import_module(node.module or "")
            assert not [alias.name for alias in node.names if not hasattr(module, alias.name)]


def require_commands(text: str) -> None:
    """Each line is a command that can be parsed."""
    for line in text.replace("\\\n", " ").splitlines():
        for part in re.split(r"\s\|\|?\s", re.sub(r'"[^"]*"', lambda m: m.group(0).replace("|", "\0"), line)):
            words = shlex.split(part.replace("\0", "|"), comments=True)
            if words[:1] == ["bayes-impedance"]:
                assert parser_of_commands().parse_args(words[1:])
            else:
                assert not words or words[0] in OTHER_PROGRAMS | {"head", "true"}, line


def test_the_scan_sees_blocks_and_refuses_wrong_ones() -> None:
    assert len(blocks()) > 50
    with pytest.raises(AssertionError):
        require_names("from bayes_impedance import nothing_of_the_kind")
    with pytest.raises(Exception, match="--nonsense"):
        require_commands("bayes-impedance check mine --nonsense")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    tiny_dataset(tmp_path / "mine")
    parts = [m.group(2) for m in BLOCK.finditer((ROOT / "README.md").read_text(encoding="utf-8"))]
    ran = 0
    for text in parts:
        if text.startswith("from "):
            exec(compile(text, "README.md", "exec"), {})
            ran += 1
    assert ran == 2
    assert (tmp_path / "out" / "result.nc").is_file()
    assert "stable for 99 % of users" in capsys.readouterr().out


def pages_script() -> Any:
    sys.path.insert(0, str(DOCS))
    try:
        return importlib.import_module("generate")
    finally:
        sys.path.remove(str(DOCS))


def test_every_public_name_is_documented() -> None:
    """It stands on the page of the API, and has a docstring of its own if it is a class or a function."""
    script = pages_script()
    listed = {name for names in script.public_names().values() for name in names}
    assert set(bayes_impedance.__all__) - {"InputError"} <= listed
    page = script.api()
    rooms = [f.parent.name for f in Path(bayes_impedance.__file__).parent.glob("*/__init__.py")]
    without = {"commands"}  # speaks by its own page
    assert set(script.ROOMS) == {r for r in rooms if r not in without}
    for room in script.ROOMS:
        module = importlib.import_module(f"bayes_impedance.{room}")
        for name in module.__all__:
            value = getattr(module, name)
            assert re.search(rf"\b{name}$", page, flags=re.MULTILINE), f"{room}.{name}"
            if inspect.isclass(value) or inspect.isfunction(value):
                own = value.__doc__ or ""
                assert own.strip(), f"{room}.{name}"
                assert not own.startswith(f"{name}("), f"{room}.{name} has only the docstring that dataclasses make"


@pytest.mark.long
def test_generated_pages_name_every_command_and_effect(tmp_path: Path) -> None:
    from bayes_impedance.diagnosis import registered

    script = pages_script()
    (commands,) = (a for a in parser_of_commands()._actions if isinstance(a, argparse._SubParsersAction))
    page = script.command_line()
    assert all(f"## `{name}`" in page for name in commands.choices)
    catalogue = script.catalogue(tmp_path)
    assert all(f"## `{effect.id}`" in catalogue for effect in registered())
    assert len(list(tmp_path.glob("*.png"))) == len(registered())
    assert "`mismatch`" in script.schemas()


def test_every_page_is_reached_from_the_index() -> None:
    named = set()
    for page in PAGES[1:]:
        for entries in re.findall(
            r"^```\{toctree\}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
        ):
            for entry in (line for line in entries.splitlines() if line and not line.startswith(":")):
                named.add((DOCS / entry[1:] if entry.startswith("/") else page.parent / entry).with_suffix(".md"))
    assert {page for page in PAGES[1:] if page != DOCS / "index.md"} <= named
