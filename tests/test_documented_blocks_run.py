"""Blocks of code of README and documentation are executed, page by page, in the order in which they stand.

Each page finds the files that it speaks of in a temporary folder: small populations and finished fits. Commands get
`--quick` where they take it. Blocks of the tutorials are cells of notebooks: `make docs` executes them, and stops at
the first error (:func:`test_the_build_executes_the_tutorials`).
"""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA, SMALL, THREE_ELEMENTS

from bayes_impedance.commands.arguments import parser_of_commands
from bayes_impedance.commands.cli import main
from bayes_impedance.diagnosis import registered, unregister
from bayes_impedance.population.given_prior import read_prior
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import write_recordings

ROOT = DATA.parent
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```\{?([\w-]+)\}?[^\n]*\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
OURS = "bayes-impedance"
NOT_EXECUTED = {
    "pip install": "downloads; tests/datasets/test_wheel.py installs the package and uses it",
    "--scheduler": "needs the reader's cluster; tests/runtime start one of their own",
    "--workers 8": "as many processes as the reader's machine has; tests/runtime compare processes with threads",
}
"""Part of a line that is not executed, and why. Every entry stands in a page, or the test fails."""
NOT_RELIABLE = ('--networks "m1|r1" "m1|r1|n1"',)
"""Parts of commands whose exit status is 1 with these people: they have a spring, which m1|r1 does not describe."""
IN_FULL = ("diagnose mine -o out",)
"""Parts of commands without `--quick`, because later ones use what only the whole command leaves."""

SLOW_PAGES = (
    "README.md",
    "docs/index.md",
    *(f"docs/how_to/{name}.md" for name in ("compare_networks", "covariates", "datasets", "design", "diagnose")),
    *(f"docs/how_to/{name}.md" for name in ("many_people", "paper_methods")),
)


def blocks(page: str) -> list[tuple[str, str]]:
    """Language and text of every block of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [(match.group(1), match.group(2)) for match in BLOCK.finditer(text)]


def lines(page: str) -> list[str]:
    """Commands of a page, one a line."""
    joined = [text.replace("\\\n", " ").splitlines() for language, text in blocks(page) if language == "bash"]
    return [line for block in joined for line in block if line.strip()]


@cache
def takes_quick(command: str) -> bool:
    (commands,) = (a for a in parser_of_commands()._actions if isinstance(a, argparse._SubParsersAction))
    return any("--quick" in action.option_strings for action in commands.choices[command]._actions)


def execute(line: str) -> None:
    """One command as in a terminal, quick where it can be."""
    words = shlex.split(line, comments=True)
    assert words[0] == OURS, f"{line}: only commands of the package are executed; give a reason in NOT_EXECUTED"
    whole = "--quick" in words or any(part in line for part in IN_FULL)
    quick = ["--quick"] if takes_quick(words[1]) and not whole else []
    status = 1 if any(part in line for part in NOT_RELIABLE) else 0
    assert main([*words[1:], *quick]) == status, line


def people(folder: str, population: VirtualPopulation, seed: int = 1) -> None:
    """Twelve people, once each, with the covariates of which the pages speak."""
    simulated = simulate_recordings(population, 12, 1, np.geomspace(5, 5000, 24), seed).recordings
    age = np.random.default_rng(seed).uniform(20, 70, 12)
    subjects = tuple(
        replace(one, covariates={"age_y": float(round(age[k])), "sex=m": float(k % 2)})
        for k, one in enumerate(simulated.subjects)
    )
    write_recordings(replace(simulated, subjects=subjects), Path(folder), significant_digits=6)
    file = Path(folder) / "subjects.csv"  # a column of text, as a user would write it
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    names = head.split(",")
    k = names.index("sex=m")
    names[k] = "sex"
    cells = [row.split(",") for row in rows]
    told = [",".join("fm"[int(float(cell))] if i == k else cell for i, cell in enumerate(row)) for row in cells]
    file.write_text("\n".join([",".join(names), *told]) + "\n", encoding="utf-8")


def fitted(folder: str, dataset: str, network: str) -> None:
    assert main(["fit", dataset, "-o", folder, "--network", network, "--quick", "--covariance", "diagonal"]) == 0


def prepare(page: str) -> None:
    """The files of which a page speaks, in the working folder."""
    name = Path(page).stem
    if name in ("README", "index"):
        people("mine", SMALL)
        return
    people("mine", THREE_ELEMENTS)
    if name in ("compare_networks", "datasets", "paper_methods"):
        fitted("out/mine", "mine", "m1|r1|n1")
    if name == "design":
        fitted("out/demo", "mine", "m1|r1|n1")
        (device,) = (text for language, text in blocks(page) if language == "toml")
        Path("mine.toml").write_text(device, encoding="utf-8")
    if name == "diagnose":
        shutil.rmtree("mine")
        late("mine")
        people("simulated", THREE_ELEMENTS, seed=3)
        shutil.copytree("mine", "recorded")


def late(folder: str) -> None:
    """People whose force is recorded 20 us late, so that something is found."""
    population = replace(THREE_ELEMENTS, between_repetitions={})
    made = simulate_recordings(population, 12, 1, np.geomspace(5, 5000, 30), seed=4).recordings
    turned = [replace(one, z=one.z * np.exp(-2j * np.pi * one.frequency_hz * 20e-6)) for one in made.subjects]
    write_recordings(replace(made, subjects=tuple(turned), network="m1|r1|n1"), Path(folder), significant_digits=6)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A working folder of its own; effects that a page registers are forgotten."""
    monkeypatch.chdir(tmp_path)
    known = {effect.id for effect in registered()}
    yield tmp_path
    for effect in registered():
        if effect.id not in known:
            unregister(effect)


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.parametrize("page", SLOW_PAGES)
def test_blocks_run(page: str, place: Path) -> None:
    prepare(page)
    names: dict[str, Any] = {}
    for language, text in blocks(page):
        if language == "python":
            exec(compile(text, page, "exec"), names)
        elif language == "bash":
            for line in text.replace("\\\n", " ").splitlines():
                if line.strip() and not any(part in line for part in NOT_EXECUTED):
                    execute(line)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.parametrize("page", ["docs/how_to/datasets.md", "docs/how_to/paper_methods.md"])
def test_python_that_takes_seconds_runs(page: str, place: Path) -> None:
    for language, text in blocks(page):
        if language == "python":
            exec(compile(text, page, "exec"), {})


def test_the_prior_of_the_page_can_be_read(tmp_path: Path) -> None:
    (text,) = (text for language, text in blocks("docs/how_to/priors.md") if language == "toml")
    file = tmp_path / "prior.toml"
    file.write_text(text, encoding="utf-8")
    prior = read_prior(file)
    assert set(prior.elements) == set(tomllib.loads(text)["elements"])


def test_every_block_is_executed_or_has_a_reason() -> None:
    """Pages with commands or Python are tutorials, which the build executes, or stand in the list of this file."""
    pages = [ROOT / "README.md", *DOCS.rglob("*.md")]
    own = [page for page in pages if not {"generated", "jupyter_execute", "_build", "tutorials"} & set(page.parts)]
    speaking = {
        str(page.relative_to(ROOT))
        for page in own
        if any(language in ("python", "bash") for language, _ in blocks(str(page.relative_to(ROOT))))
    }
    assert speaking == set(SLOW_PAGES)
    every = [line for page in SLOW_PAGES for line in lines(page)]
    assert all(any(part in line for line in every) for part in NOT_EXECUTED)
    left = [line for line in every if not any(part in line for part in NOT_EXECUTED)]
    assert all(line.startswith(OURS) for line in left)


def test_the_build_executes_the_tutorials() -> None:
    settings = (DOCS / "conf.py").read_text(encoding="utf-8")
    assert 'nb_execution_mode = "force"' in settings
    assert "nb_execution_raise_on_error = True" in settings
    cells = [language for page in (DOCS / "tutorials").glob("*.md") for language, _ in blocks(str(page))]
    assert cells.count("code-cell") > 30
    assert not {"python", "bash"} & set(cells)  # blocks that are no cells would be executed by nobody
