"""The wheel, in an empty environment in another folder."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import DATA

ROOT = DATA.parent
ONE_LINER = (
    "import pathlib, bayes_impedance; from bayes_impedance.datasets import fingertip_population as p; "
    "print(len(p().draw(1000, seed=1)), pathlib.Path(bayes_impedance.__file__).parent)"
)


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run([str(word) for word in command], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.ci
def test_the_wheel_holds_what_it_promises_and_draws_users(tmp_path: Path) -> None:
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a working copy of git: what the wheel leaves out is decided by .gitignore")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    run(*pip, "wheel", "--no-deps", "--wheel-dir", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {"bayes_impedance/py.typed", "bayes_impedance/diagnosis/verdict.schema.json"} <= names
    shipped = "bayes_impedance/datasets/data/fingertip_71"
    assert {f"{shipped}/recordings.csv.gz", f"{shipped}/truth.json", f"{shipped}/population/result.nc"} <= names
    assert not [name for name in names if name.startswith(("data/", "tests/", "docs/"))]

    run(sys.executable, "-m", "venv", tmp_path / "empty", cwd=tmp_path)
    python = tmp_path / "empty" / "bin" / "python"
    run(python, *pip[1:], "install", wheel, cwd=tmp_path)
    number, place = run(python, "-c", ONE_LINER, cwd=tmp_path).split(maxsplit=1)
    assert number == "1000"
    assert Path(place.strip()).is_relative_to(tmp_path)
    command = tmp_path / "empty" / "bin" / "bayes-impedance"
    run(command, "export", "fingertip_71", "-o", "design", "--what", "users", "--no-pictures", cwd=tmp_path)
    assert (tmp_path / "design" / "users.csv").is_file()
    assert "no problem" in run(command, "check", "fingertip_71", cwd=tmp_path)
