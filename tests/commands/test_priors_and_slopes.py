"""`--priors`, slopes in the terminal's table, and `diagnose --covariate`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from tiny_fits import fit_arguments

from bayes_impedance.commands import jobs
from bayes_impedance.commands.cli import main
from bayes_impedance.commands.slope_lines import slope_lines
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.recordings.files import write_recordings


def with_ages() -> Recordings:
    made = simulate_recordings(THREE_ELEMENTS, 6, 1, np.geomspace(5, 5000, 12), seed=3).recordings
    subjects = tuple(
        replace(s, covariates={"age_y": 20.0 + 9 * i, "size_m": 1.5 + 0.1 * (i % 3)})
        for i, s in enumerate(made.subjects)
    )
    return replace(made, subjects=subjects)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ages") / "data"
    write_recordings(with_ages(), folder)
    return folder


def test_a_prior_and_a_covariate_reach_summary_and_terminal(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prior = tmp_path / "prior.toml"
    prior.write_text('slope = 0.3\n[elements.r1]\ncentre = 3.0\nunit = "N s/m"\nscale = 0.5\n', encoding="utf-8")
    out = tmp_path / "out"
    assert main(fit_arguments(dataset, out, "--priors", str(prior), "--covariate", "age_y")) == 0
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["prior"]["given"]
    assert summary["prior"]["slope"] == 0.3
    expected = {"centre": pytest.approx(3.0), "scale": 0.5, "dispersion": 1.0, "kind": "normal"}
    assert summary["prior"]["elements"]["r1"] == expected
    slope = summary["elements"]["r1"]["slopes"]["age_y"]
    assert slope["q05"] < slope["median"] < slope["q95"]
    assert summary["covariates"]["age_y"] == {"mean": pytest.approx(42.5), "sd": pytest.approx(15.37, abs=0.01)}
    told = capsys.readouterr().out
    assert "change of ln(element) for one standard deviation (age_y 15.4)" in told
    assert "{:+.2f} (".format(slope["median"]) in told
    assert "with the prior that was given" in told


def test_a_prior_of_another_network_is_refused_before_anything_is_written(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prior = tmp_path / "prior.toml"
    prior.write_text("[elements.n9]\nscale = 0.5\n", encoding="utf-8")
    assert main(fit_arguments(dataset, tmp_path / "out", "--priors", str(prior))) == 2
    assert '"n9" is not an element of the fitted network' in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    networks = ["compare", str(dataset), "-o", str(tmp_path / "out"), "--networks", "m1|r1", "m1|r1|n1"]
    assert main([*networks, "--priors", str(prior)]) == 2
    assert "is in none of the networks" in capsys.readouterr().err


def test_slopes_are_marked_if_they_are_clear_of_zero() -> None:
    clear, unclear, none = (
        {"median": 0.3, "q05": 0.1, "q95": 0.5},
        {"median": -0.1, "q05": -0.3, "q95": 0.1},
        {"median": None, "q05": None, "q95": None},
    )
    slopes = {"r1": clear, "n1": unclear, "m1": none}
    elements = {name: {"slopes": {"age_y": slope}} for name, slope in slopes.items()}
    lines = slope_lines({"elements": elements, "covariates": {"age_y": {"mean": 40.0, "sd": 12.0}}})
    assert len(lines) == 4
    assert lines[2].endswith("clear of zero")
    assert "+0.30 (+0.10 to +0.50)" in lines[2]
    assert lines[3].endswith("-0.10 (-0.30 to +0.10)")
    assert slope_lines({"elements": {"r1": {}}}) == []


def test_a_diagnosis_tests_the_named_covariates_only(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class AskedError(Exception):
        pass

    seen: list[Recordings] = []

    def diagnose(recordings: Recordings, *_: object, **__: object) -> None:
        seen.append(recordings)
        raise AskedError

    monkeypatch.setattr("bayes_impedance.diagnosis.diagnose", diagnose)
    for more, names in (([], {"age_y", "size_m"}), (["--covariate", "age_y"], {"age_y"})):
        options = jobs.FitOptions(network="m1|r1|n1", covariates=tuple(more[1:]))
        with pytest.raises(AskedError):
            jobs.diagnose_dataset(dataset, tmp_path / "out", options, None, False, lambda *_: None)
        assert set(seen[-1].subjects[0].covariates) == names
    command = ["diagnose", str(dataset), "-o", str(tmp_path / "new"), "--network", "m1|r1|n1", "--covariate", "weight"]
    assert main(command) == 2
    assert '"weight" is not in the dataset' in capsys.readouterr().err


@pytest.mark.long
def test_each_network_of_a_comparison_has_the_prior_of_its_own_elements(dataset: Path, tmp_path: Path) -> None:
    prior = tmp_path / "prior.toml"
    prior.write_text("dispersion = 0.7\n[elements.n1]\nscale = 0.5\n", encoding="utf-8")
    out = tmp_path / "out"
    command = ["compare", str(dataset), "-o", str(out), "--networks", "m1|r1|n1", "r1|n1*", "--priors", str(prior)]
    assert main([*command, "--covariance", "diagonal"]) in (0, 1)
    for folder, scale in (("1", 0.5), ("2", 0.5)):
        told = json.loads((out / folder / "summary.json").read_text(encoding="utf-8"))["prior"]
        assert told["given"]
        assert told["elements"]["n1"]["scale"] == scale
        assert told["elements"]["r1"] == {**told["elements"]["r1"], "scale": 3.0, "dispersion": 0.7}
    assert told["elements"]["n1"]["dispersion"] is None
