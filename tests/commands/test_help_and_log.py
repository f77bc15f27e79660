"""Examples and durations of each command's help, and lines of progress where there is no terminal."""

from __future__ import annotations

import argparse
import shlex

import pytest

from bayes_impedance.commands.arguments import parser_of_commands
from bayes_impedance.commands.cli import main
from bayes_impedance.commands.help_texts import EXAMPLES
from bayes_impedance.commands.progress_bars import LINE_EVERY_S, Bars


def commands() -> dict[str, argparse.ArgumentParser]:
    (found,) = (a for a in parser_of_commands()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(found.choices)


@pytest.mark.parametrize("command", commands())
def test_help_has_examples_that_can_be_typed_and_a_duration(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    shown = capsys.readouterr().out
    examples = EXAMPLES[command][0]
    assert examples
    for example in examples:
        assert f"  {example}\n" in shown
        program, *words = shlex.split(example)
        assert program == "bayes-impedance"
        assert parser_of_commands().parse_args(words).command == command
    assert "expected duration:\n" in shown


def test_a_log_gets_a_line_now_and_then(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    with Bars(lambda: now[0]) as bars:
        for step in range(7):
            now[0] = step * LINE_EVERY_S / 3
            bars("people", step, 6)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" ", 1)[1] for line in lines] == ["people: 3 of 6", "people: 6 of 6"]


def test_what_is_done_soon_leaves_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    with Bars(lambda: 0.0) as bars:
        bars("people", 1, 2)
    assert capsys.readouterr().err == ""
