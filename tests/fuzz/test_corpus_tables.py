"""Every malformed table, network and option is refused at once: one line, no traceback, nothing written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from corpus_tables import CASES, Builder, accepted

from bayes_impedance.commands.cli import main

LONGEST_LINE = 1200
"""Characters of a message: a path, a sentence and its remedy, whatever was given."""
IN_A_PROCESS = (
    "table: latin-1",
    "cell: 1e300",
    "dataset.toml: 5000 deep",
    "device: delay",
    "population: 50000 deep",
    "network: 400 deep",
    "option: seed of 38 digits",
)
"""What could depend on how the interpreter was started: encodings, depth of recursion."""
FILE_AT_FAULT = {
    "table": "recordings.csv",
    "cell": "recordings.csv",
    "dataset.toml": "dataset.toml",
    "device": "d.toml",
    "population": "truth.json",
}
"""By the kind of case: what the message must name, so that nothing is refused for another reason."""
TIME_LIMIT_S = 60
"""Of a process; only one that hangs reaches it."""


def assert_told(status: int, error: str, name: str) -> None:
    lines = error.splitlines()
    told = [line for line in lines if line.startswith("error: ")]
    assert "Traceback" not in error
    assert status == (0 if accepted(name) else 2), error
    assert len(told) == (status == 2), error
    for line in told:
        assert line.isprintable()
        assert 20 < len(line) < LONGEST_LINE
        assert ": : " not in line
        assert FILE_AT_FAULT.get(name.partition(":")[0], "") in line


def test_the_corpus_is_large_and_its_names_differ() -> None:
    names = [name for name, _ in CASES]
    assert len(set(names)) == len(names) >= 150


@pytest.mark.parametrize(("name", "builder"), CASES, ids=[name for name, _ in CASES])
def test_every_case(name: str, builder: Builder, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = builder(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    status = main(arguments)
    assert_told(status, capsys.readouterr().err, name)
    if status == 2:
        assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", IN_A_PROCESS)
def test_some_in_a_process(name: str, tmp_path: Path) -> None:
    arguments = dict(CASES)[name](tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "bayes_impedance", *arguments],
        capture_output=True,
        timeout=TIME_LIMIT_S,
        check=False,
        env={**os.environ, "PYTHONWARNINGS": "error::RuntimeWarning"},
    )
    assert_told(done.returncode, done.stderr.decode(), name)
