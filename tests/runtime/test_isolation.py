"""Code that lies in the working directory is never executed; compiled functions survive damage and want of a place."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bayes_impedance

NAMES = ("signal", "numpy", "pickle", "selectors", "threading", "typing", "random", "__future__", "distributed", "json")


def hostile(folder: Path) -> Path:
    """A folder of modules each of which leaves a mark when it is executed."""
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text(f"open({str(folder / 'executed')!r}, 'a').write('{name} ')\n")
    return folder


SCRIPT = (
    "import math\nfrom bayes_impedance.runtime.worker_processes import Processes\n"
    "if __name__ == '__main__':\n"
    "    with Processes(1) as workers:\n        print(workers.submit(math.sqrt, 4.0).result())\n"
)


def run(arguments: list[str], folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    package = str(Path(bayes_impedance.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": package, **variables}
    environment.pop("PYTHONSAFEPATH", None)
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def test_worker_processes_do_not_look_into_the_working_directory(tmp_path: Path) -> None:
    folder = hostile(tmp_path / "there")
    (tmp_path / "script.py").write_text(SCRIPT)
    done = run([str(tmp_path / "script.py")], folder)
    assert (done.stdout, done.stderr) == ("2.0\n", "")
    assert not (folder / "executed").exists()


def test_the_package_as_a_command_leaves_the_working_directory(tmp_path: Path) -> None:
    folder = hostile(tmp_path / "there")
    done = run(["-m", "bayes_impedance", "check", "none"], folder)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("error: none: ")
    assert not (folder / "executed").exists()


def test_somebody_else_s_module_keeps_its_path(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import bayes_impedance, sys\nimport beside\nprint(beside.name)\n")
    (tmp_path / "beside.py").write_text("name = 'beside'\n")
    assert run(["-m", "mine"], tmp_path).stdout == "beside\n"


COMPILED = (
    "import module, sys\nmodule.add(1.0, 2.0)\nprint(module.add(1.0, 2.0), sum(module.add.stats.cache_hits.values()))\n"
)
MODULE = (
    "from bayes_impedance.runtime.compiled_functions import kept_njit\n@kept_njit()\ndef add(a, b):\n    return a + b\n"
)


@pytest.fixture
def module(tmp_path: Path) -> Path:
    (tmp_path / "module.py").write_text(MODULE)
    (tmp_path / "script.py").write_text(COMPILED)
    return tmp_path


@pytest.mark.long
def test_what_was_compiled_is_taken_up_and_what_is_damaged_is_compiled_anew(module: Path) -> None:
    kept = module / "cache"

    def result() -> str:
        done = run(["script.py"], module, NUMBA_CACHE_DIR=str(kept))
        assert done.stderr == ""
        return done.stdout

    assert result() == "3.0 0\n"
    assert result() == "3.0 1\n"
    for suffix, damage in ((".nbi", "cut"), (".nbc", "cut"), (".nbi", "bit"), (".nbc", "bit"), (".nbc", "gone")):
        (file,) = kept.rglob(f"*{suffix}")
        content = file.read_bytes()
        if damage == "gone":
            file.unlink()
        elif damage == "cut":
            file.write_bytes(content[: len(content) // 2])
        else:
            middle = len(content) // 2
            file.write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
        assert result() == "3.0 0\n", (suffix, damage)
        assert result() == "3.0 1\n", (suffix, damage)


@pytest.mark.long
@pytest.mark.parametrize(
    ("before", "after"), [("other + b", "b - other"), ("other + b", "other + b + constant"), ("= 1.0", "= 5.0")]
)
def test_a_change_of_another_file_is_compiled_in(module: Path, before: str, after: str) -> None:
    used = (
        "from bayes_impedance.runtime.compiled_functions import kept_njit\nconstant = 1.0\n"
        "@kept_njit()\ndef inner(other, b):\n    return other + b\n"
    )
    user = MODULE.replace("return a + b", "return constant * inner(a, b)")
    (module / "used.py").write_text(used)
    (module / "module.py").write_text("from used import constant, inner\n" + user)

    def result() -> str:
        return run(["script.py"], module, NUMBA_CACHE_DIR=str(module / "cache")).stdout

    first = result()
    assert result() == first.replace(" 0", " 1") == "3.0 1\n"
    (module / "used.py").write_text(used.replace(before, after))
    expected = {"b - other": 1.0, "other + b + constant": 4.0, "= 5.0": 15.0}[after]
    assert result() == f"{expected} 0\n"
    assert result() == f"{expected} 1\n"


def test_what_was_compiled_is_found_by_another_installation(module: Path, tmp_path: Path) -> None:
    """The same sources elsewhere, made later; other sources under the same names; and the first ones again."""
    cache = {name: str(tmp_path / "home") for name in ("HOME", "XDG_CACHE_HOME")}
    cache["NUMBA_CACHE_DIR"] = ""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "script.py").write_text(COMPILED)
    assert run(["script.py"], module, **cache).stdout == "3.0 0\n"
    assert not list((module / "__pycache__").glob("*.nbc"))
    (elsewhere / "module.py").write_text(MODULE)
    assert run(["script.py"], elsewhere, **cache).stdout == "3.0 1\n"
    (elsewhere / "module.py").write_text(MODULE.replace("a + b", "a - b"))
    assert run(["script.py"], elsewhere, **cache).stdout == "-1.0 0\n"
    assert run(["script.py"], module, **cache).stdout == "3.0 1\n"


def test_where_nothing_can_be_written_a_temporary_folder_serves(module: Path, tmp_path: Path) -> None:
    """A file stands where each of numba's three folders would be made."""
    (module / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    (tmp_path / "temporary").mkdir()
    nowhere = {name: str(tmp_path / "home") for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    done = run(["script.py"], module, TMPDIR=str(tmp_path / "temporary"), **nowhere)
    assert done.stdout == "3.0 0\n", done.stderr
    assert "name a folder with NUMBA_CACHE_DIR" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list((tmp_path / "temporary").iterdir())
    shutil.rmtree(tmp_path / "temporary")
