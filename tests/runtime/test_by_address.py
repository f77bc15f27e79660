"""Functions called by address: the same values, in a process that compiles them and in one that loads them."""

import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import numpy as np
from numba.core import types
from bayes_impedance.runtime.compiled_functions import by_address, kept_njit

compiled = kept_njit(error_model="numpy")
BUILT = []

@compiled
def weighted(values, weight):
    if weight < 0.0:
        raise ValueError("a weight is negative")
    total, doubled = 0.0, np.empty(values.size)
    for k in range(values.size):
        total += weight * values[k]
        doubled[k] = FACTOR * values[k]
    return total, doubled

line = types.Array(types.float64, 1, "C")
apart = by_address(weighted, (line, types.float64))

@compiled
def inner(values, weight):
    total, doubled = apart(values, weight)
    return total + doubled.sum()

@compiled
def outer(values, weight):
    return inner(values, weight) + 1.0

def main():
    values = np.arange(4.0)
    print(outer(values, 0.5))                 # the wanted types
    print(outer(np.arange(8.0)[::2], 0.5))    # strided values: called as any other function
    print(len(outer.stats.cache_misses), sum(outer.stats.cache_hits.values()))
    try:
        outer(values, -1.0)
    except ValueError as error:
        print(error)
"""


def run(folder: Path, factor: float) -> list[str]:
    (folder / "called.py").write_text(CODE.replace("FACTOR", str(factor)))
    done = subprocess.run(
        [sys.executable, "-c", "import called; called.main()"],
        cwd=folder,
        env={"PYTHONPATH": f"{folder}:{Path(__file__).resolve().parents[2]}", "NUMBA_CACHE_DIR": str(folder / "cache")},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split("\n")


@pytest.mark.smoke
def test_values_are_those_of_an_ordinary_call_also_from_the_cache(tmp_path: Path) -> None:
    first, again = run(tmp_path, 2.0), run(tmp_path, 2.0)
    assert first[:2] == again[:2] == ["16.0", "31.0"]
    assert first[2] == "2 0"
    assert again[2] == "0 2"
    assert first[3] == again[3] == "a weight is negative"


def test_callers_follow_a_change_of_what_they_call(tmp_path: Path) -> None:
    assert run(tmp_path, 2.0)[0] == "16.0"
    assert run(tmp_path, 3.0)[0] == "22.0"


def test_callers_load_where_the_file_of_what_they_call_is_missing(tmp_path: Path) -> None:
    run(tmp_path, 2.0)
    for file in (tmp_path / "cache").rglob("*weighted*"):
        file.unlink()
    assert run(tmp_path, 2.0)[:2] == ["16.0", "31.0"]
