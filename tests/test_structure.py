"""The package's shape: short files, nothing heavy imported early, public names (contracts: pyproject.toml)."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import bayes_impedance

PACKAGE = Path(bayes_impedance.__file__).parent
ROOT = PACKAGE.parent
FOLDERS = ("bayes_impedance", "analyses", "benchmarks", "docs", "tests")
LONGEST = 400
"""Lines of a file: what one reading takes in; the packages that this one learns from stay below it."""


def test_files_stay_short() -> None:
    files = [file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")]
    lengths = {str(file.relative_to(ROOT)): len(file.read_text(encoding="utf-8").splitlines()) for file in files}
    assert {file.split(os.sep)[0] for file in lengths} == set(FOLDERS)
    assert not {file: n for file, n in lengths.items() if n > LONGEST}


def test_names_of_test_files_are_unique() -> None:
    """Pytest imports test files by their base names, so two of one name would hide each other."""
    names = [file.name for file in (ROOT / "tests").rglob("*.py")]
    assert sorted(names) == sorted(set(names))


def test_classes_with_more_than_five_fields_are_keyword_only() -> None:
    """Nobody knows the order of six values, and a new field must not change what the others mean."""
    large = []
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and len([k for k in node.body if isinstance(k, ast.AnnAssign)]) > 5:
                made = [ast.unparse(d) for d in node.decorator_list if "dataclass" in ast.unparse(d)]
                large += [(node.name, d) for d in made]
    assert len(large) > 20
    assert not [name for name, decorator in large if "kw_only=True" not in decorator]


def test_numbers_with_a_name_say_where_they_come_from() -> None:
    """A text below each numeric constant of a module, or a comment beside or above it; one text may serve a group."""
    constants, without = 0, []
    for file in sorted(PACKAGE.rglob("*.py")):
        lines = (text := file.read_text(encoding="utf-8")).splitlines()
        body = ast.parse(text).body
        for i, node in enumerate(body):
            if not (isinstance(node, ast.Assign | ast.AnnAssign) and _is_numeric(node.value)):
                continue
            constants += 1
            last = next((later for later in body[i + 1 :] if not isinstance(later, ast.Assign)), None)
            told = isinstance(last, ast.Expr) and lines[node.end_lineno or 0].strip()  # without a blank line between
            if not (told or "#" in lines[node.lineno - 1] or lines[node.lineno - 2].startswith("#")):
                without.append(f"{file.relative_to(ROOT)}: {lines[node.lineno - 1]}")
    assert constants > 400
    assert not without


def _is_numeric(value: ast.expr | None) -> bool:
    if isinstance(value, ast.Tuple):
        return bool(value.elts) and all(map(_is_numeric, value.elts))
    if isinstance(value, ast.UnaryOp):
        return _is_numeric(value.operand)
    if isinstance(value, ast.BinOp):
        return _is_numeric(value.left) and _is_numeric(value.right)
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def test_no_test_file_imports_another() -> None:
    """Shared helpers live in files without tests: an imported test file would be run twice, or bring its fixtures."""
    for file in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [module for module in modules if module.startswith("test_")], file.name


@pytest.mark.parametrize("room", [f.parent for f in sorted(PACKAGE.rglob("*/__init__.py"))], ids=lambda room: room.name)
def test_a_room_says_what_comes_in_what_goes_out_and_what_to_open_first(room: Path) -> None:
    said = ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8"))) or ""
    assert "Input: " in said
    assert "Output: " in said
    assert re.search(r"Open (:mod:`\.[a-z_]+`|this file) first", " ".join(said.split()))


def test_modules_that_docstrings_name_exist() -> None:
    named = 0
    for file in sorted(PACKAGE.rglob("*.py")):
        for name in re.findall(r":mod:`~?(?:[^`<]*<)?([\w.]+)>?`", file.read_text(encoding="utf-8")):
            absolute = name.removeprefix("bayes_impedance.").split(".") if not name.startswith(".") else None
            target = PACKAGE.joinpath(*absolute) if absolute else file.parent / name[1:]
            assert target.with_suffix(".py").exists() or (target / "__init__.py").exists(), f"{file}: {name}"
            named += 1
    assert named > 100


def test_files_on_the_map_exist() -> None:
    """CONTRIBUTING leads a reader along files; each stands in the room that is named with it, or in some room."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:[a-z_0-9]+/)*[a-z_0-9]+\.py)`", text)
    files = ["/" + file.relative_to(ROOT).as_posix() for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")]
    assert len(named) > 50
    assert not [name for name in named if not any(file.endswith("/" + name) for file in files)]


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
