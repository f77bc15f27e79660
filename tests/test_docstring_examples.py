"""Every example in a docstring runs and gives what it says."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest
from conftest import THREE_ELEMENTS

import bayes_impedance
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import write_recordings

SESSION = "bayes_impedance"
"""The example of the package itself, a whole session, which needs recordings."""


def examples() -> list[doctest.DocTest]:
    found = []
    for module in pkgutil.walk_packages(bayes_impedance.__path__, "bayes_impedance."):
        if not module.name.endswith("__main__"):
            found += doctest.DocTestFinder().find(importlib.import_module(module.name), module.name)
    return [test for test in found if test.examples]


def failures_of(test: doctest.DocTest) -> tuple[int, str]:
    told: list[str] = []
    result = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS).run(
        test, out=told.append
    )
    return result.failed, "".join(told)


def test_examples_of_functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ran = examples()
    assert len(ran) >= 3
    wrong = [told for failed, told in map(failures_of, ran) if failed]
    assert not wrong, "\n".join(wrong)


def test_the_session_of_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of the shipped recordings, which take minutes, small ones of the same name."""
    import numpy as np

    small = simulate_recordings(THREE_ELEMENTS, 5, 1, np.geomspace(5, 5000, 12), seed=1).recordings
    write_recordings(small, tmp_path / "data" / "fingertip_71")
    monkeypatch.chdir(tmp_path)
    (session,) = [t for t in doctest.DocTestFinder(recurse=False).find(bayes_impedance, SESSION) if t.examples]
    failed, told = failures_of(session)
    assert not failed, told
    assert (tmp_path / "out" / "result.nc").is_file()
