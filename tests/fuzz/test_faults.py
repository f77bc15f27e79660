"""What goes wrong around a fit, at random moments: nothing is destroyed, and what is resumed has the same numbers."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from pathlib import Path

import faulty_command
import pytest
from faulty_command import at_moment, full_disk, interrupt, once, read_only, removing, second_writer
from tiny_fits import fit_arguments

from bayes_impedance.commands.cli import main
from bayes_impedance.results.result import load_result
from bayes_impedance.runtime.output_folder import LOCK

FEW, MANY = 1, 30
"""Moments of each fault in the normal run, which has a minute for all of them, and in the slow one."""


@pytest.fixture(scope="module")
def moments(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> int:
    """How many there are in a fit."""
    with at_moment(10**9, interrupt) as count:
        assert main(fit_arguments(tiny / "data", tmp_path_factory.mktemp("counted"))) == 0
    return count[0]


def chosen(fault: str, moments: int, number: int) -> int:
    """The moment of a fault: random, and the same in every run."""
    return random.Random(f"{fault} {number}").randint(1, moments)


def cases(fault: str) -> list[object]:
    slow = [pytest.param(fault, n, marks=pytest.mark.slow) for n in range(FEW, MANY)]
    return [*((fault, n) for n in range(FEW)), *slow]


class Folder:
    """A folder of results in which the user keeps something."""

    def __init__(self, tiny: Path, tmp_path: Path) -> None:
        self.finished, self.data, self.out = tiny / "out", tmp_path / "data", tmp_path / "out"
        shutil.copytree(tiny / "data", self.data)
        self.out.mkdir()
        (self.out / "notes.txt").write_text("precious")
        self.arguments = fit_arguments(self.data, self.out)

    def require_sound(self) -> None:
        """What is there is complete; what was the user's is as it was."""
        assert (self.out / "notes.txt").read_text() == "precious"
        if (self.out / "result.nc").exists() and (self.out / "summary.json").exists():
            assert load_result(self.out).summary["seed"] == 1

    def require_same_when_resumed(self) -> None:
        assert main([*self.arguments, "--resume"]) == 0
        assert (self.out / "result.nc").read_bytes() == (self.finished / "result.nc").read_bytes()
        left = {p.name for p in self.out.iterdir()}
        assert left == {"notes.txt", "result.nc", "summary.json", "seconds.json", ".bayes_impedance.json"}


@pytest.fixture
def folder(tiny: Path, tmp_path: Path) -> Folder:
    return Folder(tiny, tmp_path)


def require_one_line(said: str, begin: str) -> None:
    lines = [line for line in said.splitlines() if line]
    assert len(lines) == 1, said
    assert lines[0].startswith(begin)
    assert not lines[0].startswith("error: :")


@pytest.mark.long
@pytest.mark.parametrize(("fault", "number"), cases("kill"))
def test_killed(fault: str, number: int, folder: Folder, moments: int) -> None:
    script = [sys.executable, faulty_command.__file__, str(chosen(fault, moments, number)), *folder.arguments]
    killed = subprocess.run(script, capture_output=True, text=True, check=False, timeout=300)
    assert killed.returncode == -9, killed.stderr
    folder.require_sound()
    folder.require_same_when_resumed()


@pytest.mark.parametrize(("fault", "number"), cases("interrupt"))
def test_interrupted(fault: str, number: int, folder: Folder, moments: int, capsys: pytest.CaptureFixture[str]) -> None:
    with at_moment(chosen(fault, moments, number), once(interrupt)):
        assert main(folder.arguments) in (0, 1)  # the last moment may come too late
    said = capsys.readouterr().err
    if said:
        require_one_line(said, "interrupted; ")
    assert not (folder.out / LOCK).exists()
    folder.require_sound()
    folder.require_same_when_resumed()


@pytest.mark.parametrize(("fault", "number"), cases("full disk"))
def test_full_disk(fault: str, number: int, folder: Folder, moments: int, capsys: pytest.CaptureFixture[str]) -> None:
    with full_disk(chosen(fault, moments, number)):
        status = main(folder.arguments)
    if status:
        assert status == 1
        require_one_line(capsys.readouterr().err, f"error: no space left on device: {folder.out}")
    folder.require_sound()
    folder.require_same_when_resumed()


@pytest.mark.parametrize(("fault", "number"), cases("read-only output"))
def test_read_only_output(
    fault: str, number: int, folder: Folder, moments: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with read_only(chosen(fault, moments, number)):
        assert main(folder.arguments) in (0, 1)
    said = capsys.readouterr().err
    if said:
        require_one_line(said, f"error: {folder.out}")
        assert "Read-only file system" in said
    folder.require_sound()
    folder.require_same_when_resumed()


@pytest.mark.long
@pytest.mark.parametrize(("fault", "number"), cases("disappearing input"))
def test_disappearing_input(
    fault: str, number: int, folder: Folder, moments: int, tiny: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with at_moment(chosen(fault, moments, number), removing(folder.data)):
        status = main(folder.arguments)
    if status:  # what is in memory needs no file
        require_one_line(capsys.readouterr().err, f"error: {folder.data}")
    shutil.copytree(tiny / "data", folder.data, dirs_exist_ok=True)
    folder.require_sound()
    folder.require_same_when_resumed()


@pytest.mark.long
@pytest.mark.parametrize(("fault", "number"), cases("two writers"))
def test_two_writers(fault: str, number: int, folder: Folder, moments: int) -> None:
    said: list[subprocess.CompletedProcess[str]] = []
    # Before the first file is begun nobody holds the folder, and after the last nobody needs it.
    moment = min(max(chosen(fault, moments, number), 2), moments - 2)
    with at_moment(moment, second_writer(folder.arguments, said)):
        assert main(folder.arguments) == 0
    (second,) = said
    assert second.returncode == 1
    require_one_line(second.stderr, f"error: {folder.out}: process ")
    folder.require_sound()
    folder.require_same_when_resumed()
