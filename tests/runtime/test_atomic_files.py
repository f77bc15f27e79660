"""Files are complete or absent, whatever happens while they are written."""

import subprocess
import sys
from pathlib import Path

import pytest

from bayes_impedance.runtime.atomic_files import (
    replacing,
    write_bytes,
    write_json,
    write_text,
    write_together,
)


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    file = tmp_path / "new" / "file.txt"
    with replacing(file) as temporary:
        temporary.write_text("complete")
        assert temporary.parent == file.parent  # else renaming may be copying
        assert not file.exists()
    assert [f.name for f in file.parent.iterdir()] == ["file.txt"]
    assert file.read_text() == "complete"


@pytest.mark.parametrize("interruption", [OSError, KeyboardInterrupt])
def test_what_was_there_stays_after_a_failure(tmp_path: Path, interruption: type[BaseException]) -> None:
    file = write_text(tmp_path / "file.txt", "first")

    def interrupted() -> None:
        with replacing(file) as temporary:
            temporary.write_text("half")
            raise interruption

    with pytest.raises(interruption):
        interrupted()
    assert {f.name: f.read_text() for f in tmp_path.iterdir()} == {"file.txt": "first"}


def test_the_next_writer_starts_afresh_after_a_kill(tmp_path: Path) -> None:
    script = (
        "import os, sys\nfrom pathlib import Path\nfrom bayes_impedance.runtime.atomic_files import replacing\n"
        "with replacing(Path(sys.argv[1])) as temporary:\n"
        "    temporary.write_text('half')\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    file = tmp_path / "file.txt"
    killed = subprocess.run([sys.executable, "-c", script, str(file)], capture_output=True, text=True, check=False)
    assert killed.returncode == -9, killed.stderr
    assert not file.exists()
    assert list(tmp_path.iterdir())
    with replacing(file) as temporary, temporary.open("a") as opened:  # as HDF5 does, to what is there
        opened.write("whole")
    assert {f.name: f.read_text() for f in tmp_path.iterdir()} == {"file.txt": "whole"}


def test_files_that_belong_together_are_replaced_together(tmp_path: Path) -> None:
    one, two = write_bytes(tmp_path / "one", b"1"), tmp_path / "folder"
    two.mkdir()  # a file cannot replace it
    with pytest.raises(OSError, match="folder"):
        write_together({two: b"22", one: b"11"})
    assert one.read_bytes() == b"1"
    assert not list(tmp_path.glob("*.tmp"))
    two.rmdir()
    write_together({two: b"22", one: b"11"})
    assert (one.read_bytes(), two.read_bytes()) == (b"11", b"22")


def test_a_file_is_written_part_by_part(tmp_path: Path) -> None:
    one, two = write_bytes(tmp_path / "one", b"1"), tmp_path / "two"
    write_together({one: iter([b"1", b"", b"2"]), two: b"22"})
    assert (one.read_bytes(), two.read_bytes()) == (b"12", b"22")

    def ends_early():
        yield b"3"
        raise ValueError("no more parts")

    with pytest.raises(ValueError, match="no more parts"):
        write_together({two: b"4", one: ends_early()})
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"one": b"12", "two": b"22"}


def test_json_has_no_numbers_that_are_not_finite(tmp_path: Path) -> None:
    assert write_json(tmp_path / "a.json", {"a": [1, 2.5]}, indent=1).read_text() == '{\n "a": [\n  1,\n  2.5\n ]\n}\n'
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "b.json", {"a": float("nan")})
    assert not (tmp_path / "b.json").exists()


def test_no_link_is_followed_and_no_name_foreseen(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "file.txt.tmp").symlink_to(victim)
    (tmp_path / "file.txt").symlink_to(victim)
    names = []
    for _ in range(2):
        with replacing(tmp_path / "file.txt") as temporary:
            names.append(temporary.name)
            temporary.write_text("new")
    assert names[0] != names[1]
    assert victim.read_text() == "precious"
    assert not (tmp_path / "file.txt").is_symlink()


def test_an_error_of_the_system_names_the_file(tmp_path: Path) -> None:
    def full() -> None:
        with replacing(tmp_path / "file.txt"):
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left") as caught:
        full()
    assert caught.value.filename == str(tmp_path / "file.txt")
    assert not list(tmp_path.iterdir())
