"""A folder of results: nothing in it is replaced that the package has not made, and one process holds it."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from bayes_impedance.errors import BusyError, InputError
from bayes_impedance.runtime.atomic_files import write_text
from bayes_impedance.runtime.output_folder import LOCK, MARK, output_folder


def make(folder: Path, text: str = "ours", *, overwrite: bool = False) -> None:
    with output_folder(folder, ["a.txt", "deep/b.txt"], overwrite):
        write_text(folder / "a.txt", text)


def test_what_was_made_is_replaced_and_what_was_not_is_not(tmp_path: Path) -> None:
    out = tmp_path / "out"
    make(out)
    make(out, "again")
    assert (out / "a.txt").read_text() == "again"
    (out / "a.txt").write_text("edited by the user")
    with pytest.raises(InputError, match=r"a\.txt: was not written by this package or was changed.*--overwrite"):
        make(out)
    assert (out / "a.txt").read_text() == "edited by the user"
    make(out, "third", overwrite=True)
    make(out, "fourth")
    assert {p.name for p in out.iterdir()} == {"a.txt", MARK}


@pytest.mark.parametrize("kind", ["file", "link", "dangling", "folder", "deep"])
def test_a_user_s_file_is_refused_before_anything_is_touched(tmp_path: Path, kind: str) -> None:
    out, precious = tmp_path / "out", tmp_path / "precious"
    (out / "deep").mkdir(parents=True)
    precious.write_text("precious")
    if kind == "file":
        (out / "a.txt").write_text("precious")
    elif kind == "folder":
        (out / "a.txt").mkdir()
    elif kind == "deep":
        (out / "deep" / "b.txt").write_text("precious")
    else:
        (out / "a.txt").symlink_to(precious if kind == "link" else tmp_path / "nowhere")
    before = sorted(p.name for p in out.rglob("*"))
    with pytest.raises(InputError):
        make(out)
    assert sorted(p.name for p in out.rglob("*")) == before
    assert precious.read_text() == "precious"


def test_the_user_s_file_is_not_counted_as_ours_when_the_work_fails(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("precious")

    def failing() -> None:
        with output_folder(tmp_path, ["a.txt"], overwrite=True):
            raise KeyError

    with pytest.raises(KeyError):
        failing()
    with pytest.raises(InputError, match="was not written"):
        make(tmp_path)


@pytest.mark.parametrize("mark", ["", "[]", '{"made": 1}', "\xff", '{"made": {"a.txt": "0"}}', "[" * 100_000])
def test_a_damaged_mark_protects(tmp_path: Path, mark: str) -> None:
    make(tmp_path)
    (tmp_path / MARK).write_text(mark, encoding="latin-1")
    with pytest.raises(InputError, match="was not written"):
        make(tmp_path)


def test_an_error_leaves_no_folder_behind(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def failing() -> None:
        with output_folder(out, ["a.txt"]):
            raise InputError("no")

    with pytest.raises(InputError):
        failing()
    assert not out.exists()


HOLD = (
    "import sys, time\nfrom pathlib import Path\nfrom bayes_impedance.runtime.atomic_files import write_text\n"
    "from bayes_impedance.runtime.output_folder import output_folder\n"
    "with output_folder(Path(sys.argv[1]), ['a.txt']):\n"
    "    write_text(Path(sys.argv[1]) / 'a.txt', 'theirs')\n    print('held', flush=True)\n    time.sleep(3600)\n"
)


def test_a_second_process_is_told_who_holds_the_folder_and_takes_it_over_after_a_kill(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        with pytest.raises(BusyError, match=rf"process {first.pid} on {socket.gethostname()} is writing there"):
            make(tmp_path)
        first.kill()
    assert (tmp_path / LOCK).exists()  # stale
    make(tmp_path)  # what the killed process has written is ours
    assert (tmp_path / "a.txt").read_text() == "ours"
    assert not (tmp_path / LOCK).exists()


def test_the_lock_of_another_machine_is_respected_and_a_torn_one_taken_over(tmp_path: Path) -> None:
    (tmp_path / LOCK).write_text("17\nelsewhere\n")
    with pytest.raises(BusyError, match=r"process 17 on elsewhere.*delete"):
        make(tmp_path)
    (tmp_path / LOCK).write_text("17")
    make(tmp_path)


def test_a_lock_that_is_a_link_or_somebody_s_text_is_left(tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_text("precious")
    (tmp_path / LOCK).symlink_to(target)
    with pytest.raises(InputError, match="is a link"):
        make(tmp_path)
    (tmp_path / LOCK).unlink()
    (tmp_path / LOCK).write_text("my notes\n")
    with pytest.raises(InputError, match="is not a lock file"):
        make(tmp_path)
    assert (target.read_text(), (tmp_path / LOCK).read_text()) == ("precious", "my notes\n")


def test_the_mark_lists_digests_that_others_can_check(tmp_path: Path) -> None:
    make(tmp_path)
    made = json.loads((tmp_path / MARK).read_text())["made"]
    digest = subprocess.run(["sha256sum", "a.txt"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert made == {"a.txt": digest.split()[0]}
    assert os.listdir(tmp_path).count("a.txt") == 1
