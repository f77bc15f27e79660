"""Datasets that come with the package, and the population from which users are drawn without a fit."""

from __future__ import annotations

import csv
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA

from bayes_impedance import datasets
from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import read_recordings

LARGEST_BYTES = 500_000


def test_shipped_recordings_are_those_of_the_repository() -> None:
    assert datasets.fingertip_recordings().sha256 == read_recordings(DATA / "fingertip_71").sha256
    assert len(datasets.published_curves().subjects) == 2


def test_the_population_is_that_of_the_recordings_and_small() -> None:
    result = datasets.fingertip_result()
    assert not result.problems
    assert result.attributes["data_sha256"] == datasets.fingertip_recordings().sha256
    files = [file for file in (DATA / "fingertip_71" / "population").iterdir() if file.name != "README.md"]
    assert {file.name for file in files} == {"result.nc", "summary.json"}
    assert sum(file.stat().st_size for file in files) < LARGEST_BYTES


def test_users_are_spread_as_the_truth_says() -> None:
    """Median and dispersion of 4000 users within three posterior standard deviations of the truth, and some margin."""
    truth = json.loads((DATA / "fingertip_71" / "truth.json").read_text(encoding="utf-8"))["elements"]
    summary = datasets.fingertip_result().summary["elements"]
    users = datasets.fingertip_population().draw(4000, seed=1)
    assert set(users.elements) == set(truth)
    for name, values in users.values.items():
        sd = (summary[name]["central"]["q95"] - summary[name]["central"]["q05"]) / 3.3
        assert abs(np.median(values) - truth[name]["central"]) < 4 * sd + 0.02 * truth[name]["central"], name
        spread = np.log(values).std() / truth[name]["dispersion_between_persons"]
        assert 0.7 < spread < 1.4, (name, spread)


def test_names_that_are_not_shipped() -> None:
    with pytest.raises(InputError, match="choose fingertip_71, appendix_a"):
        datasets.folder_of("fingertip_72")


def test_the_script_thins_a_fit(tiny: Path) -> None:
    path = DATA.parent / "analyses" / "fingertip_71" / "population.py"
    spec = importlib.util.spec_from_file_location("shipped_population", path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    from bayes_impedance.results.result import load_result

    whole = load_result(tiny / "out")
    whole.groups["posterior"].setdefault(
        "dispersion_between_repetitions", np.zeros_like(whole.groups["posterior"]["mu"])
    )
    thin = script.thinned(whole, 40)
    assert thin.groups["posterior"]["mu"].reshape(-1, 3).shape == (40, 3)
    assert thin.groups["posterior"]["mu"][-1, -1] == pytest.approx(whole.groups["posterior"]["mu"][-1, -1], rel=1e-6)


def test_users_by_one_command_without_a_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--what", "users", "--users", "50", "--no-pictures"]
    assert main(["export", "fingertip_71", "-o", "design", *options]) == 0
    with (tmp_path / "design" / "users.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 50
    assert float(rows[0]["m1 (kg)"]) == pytest.approx(0.05, rel=0.2)


def test_a_folder_of_the_name_of_a_dataset_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["check", "appendix_a"]) == 0
    (tmp_path / "appendix_a").mkdir()
    capsys.readouterr()
    assert main(["check", "appendix_a"]) == 2
    assert "appendix_a" in capsys.readouterr().err
