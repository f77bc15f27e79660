"""The flow of data is the order of modules: each imports only what stands above it, and nothing heavy comes early."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import bayes_impedance

PACKAGE = Path(bayes_impedance.__file__).parent

ORDER = (
    "errors",
    "array_file",
    "elements",
    "transfer",
    "network",
    "operations",
    "kernel",
    "tables",
    "parquet",
    "recording_table",
    "metadata",
    "dataset",
    "assembly",
    "stored",
    "recordings",
    "checkpoint",
    "roughness",
    "comparison",
    "check",
    "noise",
    "likelihood",
    "subject",
    "hierarchy",
    "draws",
    "marginal",
    "processes",
    "persons",
    "starts",
    "expectation",
    "empirical_bayes",
    "arviz_adapter",
    "kept_draws",
    "laplace",
    "chain_file",
    "sampling",
    "posterior",
    "diagnostics",
    "population",
    "metrics",
    "predictive",
    "result",
    "classical",
    "simulate",
    "mismatch",
    "design",
    "plots",
    "report",
    "jobs",
    "export",
    "progress",
    "cli",
    "__main__",
)


def modules() -> dict[str, Path]:
    """Every module or sub-package of the package, by its first name."""
    found = {p.stem: p for p in PACKAGE.glob("*.py") if p.stem != "__init__"}
    found |= {p.parent.name: p for p in PACKAGE.glob("*/__init__.py")}
    return found


def imported(path: Path) -> set[str]:
    """First names of the package's modules that a module (or all files of a sub-package) imports, early or late."""
    files = path.parent.glob("*.py") if path.name == "__init__.py" else [path]
    names = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("bayes_impedance"):
                parts = node.module.split(".")
                names |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
            if isinstance(node, ast.Import):
                names |= {a.name.split(".")[1] for a in node.names if a.name.startswith("bayes_impedance.")}
    return names


def test_every_module_has_its_place() -> None:
    assert set(modules()) == set(ORDER)


@pytest.mark.parametrize("name", ORDER)
def test_imports_only_what_stands_above(name: str) -> None:
    above = set(ORDER[: ORDER.index(name)])
    own = {name} if modules()[name].name == "__init__.py" else set()
    assert imported(modules()[name]) <= above | own


@pytest.mark.parametrize("name", ORDER)
def test_only_two_modules_use_the_sampler_and_one_arviz(name: str) -> None:
    path = modules()[name]
    files = path.parent.glob("*.py") if path.name == "__init__.py" else [path]
    text = "".join(f.read_text(encoding="utf-8") for f in files)
    assert ("import emcee" in text or "from emcee" in text) == (name in ("chain_file", "sampling"))
    assert ("import arviz" in text or "from arviz" in text) == (name == "arviz_adapter")


def test_files_stay_short() -> None:
    long = {str(p): n for p in PACKAGE.rglob("*.py") if (n := len(p.read_text(encoding="utf-8").splitlines())) > 420}
    assert not long


def test_importing_the_command_line_loads_nothing_heavy() -> None:
    code = (
        "import sys, bayes_impedance.cli as c\n"
        "try:\n    c.main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'scipy', 'numba', 'pandas', 'arviz', 'emcee', 'matplotlib', 'corner'} & set(sys.modules)\n"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_checking_a_dataset_loads_no_sampler() -> None:
    code = (
        "import sys, bayes_impedance.jobs, bayes_impedance.check, bayes_impedance.recordings\n"
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
