"""Design inputs made of a fit that must not be used, or used with care, say so in every file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import Result, make_result, save_result

PROBLEM = "the ensembles disagree (R-hat 1.2, limit 1.05)"
MISFIT = "The network leaves out something that the recordings show."
OPTIONS = ["--users", "20", "--grid", "3", "--spanning", "2", "--no-pictures", "--what", "users", "--what", "transfer"]


@pytest.fixture
def result(small_fit: PopulationFit) -> Result:
    return make_result(small_fit, predict(small_fit, n_draws=20, n_replicates=4), {})


def exported(folder: Path, *more: str) -> list[Path]:
    out = folder / "design"
    assert main(["export", str(folder / "fit"), "-o", str(out), *OPTIONS, "--what", "spice", *more]) == 0
    return [file for file in sorted(out.iterdir()) if file.name[0] != "."]


def test_an_unreliable_fit_is_refused_unless_told(
    result: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result.summary["problems"] = [PROBLEM]
    save_result(result, tmp_path / "fit")
    assert main(["export", str(tmp_path / "fit"), "-o", str(tmp_path / "design"), *OPTIONS]) == 2
    told = capsys.readouterr().err
    assert PROBLEM in told
    assert "--unreliable" in told
    assert not (tmp_path / "design").exists()

    files = exported(tmp_path, "--unreliable")
    assert len(files) == 8
    for file in files:
        assert PROBLEM in file.read_text(encoding="utf-8"), file.name
    assert json.loads((tmp_path / "design" / "users.json").read_text())["warnings"] == [PROBLEM]
    assert (tmp_path / "design" / "users.lib").read_text().startswith("* WARNING: ")
    assert "WARNING" not in (tmp_path / "design" / "sweep.cir").read_text().splitlines()[0]  # a deck's title


def test_a_misfit_is_written_into_every_file_too(result: Result, tmp_path: Path) -> None:
    result.summary["adequacy"]["misfit"] = [MISFIT]
    save_result(result, tmp_path / "fit")
    assert all(MISFIT in file.read_text(encoding="utf-8") for file in exported(tmp_path))


def test_a_good_fit_has_no_warnings(result: Result, tmp_path: Path) -> None:
    save_result(result, tmp_path / "fit")
    files = exported(tmp_path)
    assert not any("WARNING" in file.read_text(encoding="utf-8") for file in files)
    assert "warnings" not in json.loads((tmp_path / "design" / "users.json").read_text())
