"""The command ``check``: everything that was left aside or looks odd, each in a line of its own."""

from __future__ import annotations

from pathlib import Path

import pytest
from datasets import GOOD, dataset

from bayes_impedance.commands.cli import main

ALONE = 'titel = "T"\nunit = "mN s/m"\nnetwork = "m1||r1"\n'


def test_what_was_left_aside_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gap = GOOD.replace("B,1,10,2.0", "A,1,40,,0\nB,1,10,2.0")
    assert main(["check", str(dataset(tmp_path, gap, toml=ALONE))]) == 0
    lines = capsys.readouterr().out.splitlines()
    for words in (
        'key "titel" is not used; did you mean "title"?',
        "were multiplied by 0.001",
        "1 of 7 rows have no finite value",
        "the network cannot be used",
    ):
        told = [line for line in lines if words in line]
        assert len(told) == 1, words
        assert told[0].startswith("warning: ")


def test_the_recipe_of_an_import_is_no_unknown_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(dataset(tmp_path, toml='[import]\narguments = ["a.csv"]\n'))]) == 0
    assert "[import]" not in capsys.readouterr().out


@pytest.mark.parametrize("table", ["[import]\n", '[import]\nfrom = "x"\n', "import = 3\n"])
def test_a_recipe_that_makes_nothing_is_told(table: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(dataset(tmp_path, toml=table))]) == 0
    assert "the table [import] has no arguments" in capsys.readouterr().out
