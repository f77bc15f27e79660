"""Text on its way out: no control codes, no tracebacks, whatever standard output is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from datasets import HEADER, dataset

from bayes_impedance.commands.terminal import printable, sentence_of


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("plain, µ ± 90 %", "plain, µ ± 90 %"),
        ("a\x1b[31mred\x1b[0m b", "ared b"),
        ("\x1b]0;title\x07x\x1b]8;;http://a\x1b\\y", "xy"),
        ("a\x07\x08\x7fc", "ac"),
        ("two\nlines\r\ttab\u2028end", "two lines  tab end"),
        ("a\u202egnp.exe\u200e", "agnp.exe"),
    ],
)
def test_what_a_terminal_obeys_is_taken_out(given: str, shown: str) -> None:
    assert printable(given) == shown


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(28, "No space left on device", "/a/b"), "no space left on device: /a/b; make room"),
        (OSError(27, "File too large", "/a/b"), "no space left on device (File too large): /a/b; make room"),
        (OSError(28, "No space left on device"), "no space left on device: where results are written; make"),
        (PermissionError(13, "Permission denied", "/a"), "/a: Permission denied; check the path"),
        (OSError("words alone"), "words alone; check paths"),
        (OSError(), "OSError; check paths"),
    ],
)
def test_an_error_of_the_system_is_one_sentence_without_an_empty_path(error: OSError, sentence: str) -> None:
    assert sentence_of(error).startswith(sentence)


@pytest.fixture
def named(tmp_path: Path) -> Path:
    """A dataset whose title holds an escape code and what ASCII and Latin-1 lack."""
    rows = "".join(f"A,1,{f},1.0,{f / 10}\n" for f in range(5, 15))
    return dataset(tmp_path, HEADER + rows, toml='title = "\\u001b[31mпалец ±\\u001b[0m"\nnetwork = "m1|r1"\n')


def check(folder: Path, shell: str = "", **variables: str) -> subprocess.CompletedProcess[str]:
    command = f"{sys.executable} -m bayes_impedance check {folder} {shell}"
    environment = {**os.environ, **variables}
    return subprocess.run(
        ["bash", "-c", command],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        errors="replace",
    )


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_no_encoding_ends_a_command(named: Path, encoding: str) -> None:
    done = check(named, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, "")
    assert "\x1b" not in done.stdout
    assert ("палец" if encoding == "utf-8" else "\\u043f\\u0430") in done.stdout


@pytest.mark.parametrize("shell", [">&-", "2>&-", ">&- 2>&-", "| head -c 1", "| true"])
def test_closed_streams_are_silent(named: Path, shell: str) -> None:
    done = check(named, shell)
    assert done.returncode == 0
    assert done.stderr == ""


def test_a_full_standard_output_is_one_sentence(named: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    done = check(named, "> /dev/full")
    assert done.returncode == 1
    assert done.stderr == "error: no space left on device: standard output; make room, or name another folder\n"


def test_wrong_arguments_are_one_line_without_escape_codes() -> None:
    command = [sys.executable, "-m", "bayes_impedance", "check", "a", "\x1b[31mb"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: unrecognized arguments: b; ")
    assert done.stderr.count("\n") == 1
