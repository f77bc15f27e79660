"""Every option that a sentence, a message or a page of documentation names is one of the command's."""

from __future__ import annotations

import argparse
import ast
import re
from pathlib import Path

import pytest

import bayes_impedance
from bayes_impedance.commands import cli
from bayes_impedance.commands.arguments import parser_of_commands

PACKAGE = Path(bayes_impedance.__file__).parent
REPOSITORY = PACKAGE.parent
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*[a-z]")
DOCUMENTS = [
    REPOSITORY / "README.md",
    *(f for f in sorted((REPOSITORY / "docs").rglob("*.md")) if not {"generated", "jupyter_execute"} & set(f.parts)),
]


def options() -> dict[str, set[str]]:
    """Options of each command."""
    parser = parser_of_commands()
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return {
        name: {text for action in command._actions for text in action.option_strings}
        for name, command in commands.choices.items()
    }


def sentences_of(file: Path) -> list[str]:
    """Texts of a module, or the lines of a template."""
    text = file.read_text(encoding="utf-8")
    if file.suffix != ".py":
        body = re.sub(r"<style>.*?</style>", "", text, flags=re.DOTALL)
        return re.sub(r"var\(--[a-z]+\)", "", body).splitlines()
    return [n.value for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Constant) and isinstance(n.value, str)]


@pytest.mark.parametrize(
    "file",
    [f for pattern in ("*.py", "*.j2") for f in sorted(PACKAGE.rglob(pattern))],
    ids=lambda f: f.relative_to(PACKAGE).as_posix(),
)
def test_options_of_sentences_exist(file: Path) -> None:
    known = set().union(*options().values()) | {"--version", "--help"}
    for sentence in sentences_of(file):
        for option in OPTION.findall(sentence):
            assert option in known, (option, sentence)


def test_the_scan_sees_options() -> None:
    seen = {o for f in PACKAGE.rglob("*.py") for s in sentences_of(f) for o in OPTION.findall(s)}
    assert {"--quick", "--scheduler", "--assume", "--resume"} <= seen
    assert OPTION.findall("repeat it with --longer") == ["--longer"]


@pytest.mark.parametrize("file", DOCUMENTS, ids=lambda f: f.name)
def test_commands_of_the_documentation_have_their_options(file: Path) -> None:
    own = options()
    for line in file.read_text(encoding="utf-8").splitlines():
        called = re.search(r"bayes-impedance (\w+) [^#]*", line)
        for option in OPTION.findall(called.group(0) if called and called.group(1) in own else ""):
            assert option in own[called.group(1)], (option, line)


def test_no_message_asks_for_what_no_option_does() -> None:
    for file in PACKAGE.rglob("*.py"):
        for sentence in sentences_of(file):
            assert not re.search(r"sample longer|with more draws|use more draws", sentence), (file, sentence)


@pytest.mark.parametrize("command", options())
def test_an_interrupted_command_promises_only_what_it_has(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever has kept something says so where it is interrupted; the command itself promises nothing."""

    def interrupted(_: argparse.Namespace) -> int:
        raise KeyboardInterrupt

    monkeypatch.setitem(cli._JOBS, command, interrupted)
    place = ["-o"] if command in ("simulate", "import") else []
    assert cli.main([command, *place, str(tmp_path / "place")]) == cli.FAILED
    said = capsys.readouterr().err
    assert "interrupted" in said
    assert not OPTION.findall(said)
