"""The package's shape: short files, nothing heavy imported early, public names (contracts: pyproject.toml)."""

import subprocess
import sys
from pathlib import Path

import pytest

import bayes_impedance

PACKAGE = Path(bayes_impedance.__file__).parent
LONGEST = 400
"""Lines of a file."""


def test_files_stay_short() -> None:
    files = [
        p
        for folder in (PACKAGE, PACKAGE.parent / "analyses", PACKAGE.parent / "benchmarks")
        for p in folder.rglob("*.py")
    ]
    lengths = {str(p): len(p.read_text(encoding="utf-8").splitlines()) for p in files}
    assert not {p: n for p, n in lengths.items() if n > LONGEST}


def test_importing_the_command_line_loads_nothing_heavy() -> None:
    code = (
        "import sys, bayes_impedance.commands.cli as c\n"
        "try:\n    c.main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'scipy', 'numba', 'pandas', 'arviz', 'emcee', 'matplotlib', 'corner'} & set(sys.modules)\n"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_checking_a_dataset_loads_no_sampler() -> None:
    code = (
        "import sys, bayes_impedance.commands.jobs, bayes_impedance.quality.checks, bayes_impedance.recordings.files\n"
        "heavy = {'scipy', 'numba', 'pandas', 'arviz', 'emcee', 'matplotlib', 'corner'} & set(sys.modules)\n"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_public_names_exist_and_are_listed() -> None:
    assert sorted(bayes_impedance.__all__) == sorted(set(bayes_impedance.__all__))
    for name in bayes_impedance.__all__:
        assert getattr(bayes_impedance, name) is not None
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = bayes_impedance.nothing_of_the_kind
