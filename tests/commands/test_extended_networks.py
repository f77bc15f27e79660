"""From a diagnosis to a fit of the network with what was found, in the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.files import Recordings, Subject, write_recordings
from bayes_impedance.results.result import load_result

NETWORK, DELAY = "delay[d1*](m1|r1|n1)", 4e-4
PLAIN = "m1|r1|n1"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng, frequency = np.random.default_rng(3), np.geomspace(5, 800, 40)
    kernel, subjects = Kernel(parse(PLAIN)), []
    for i in range(12):
        theta = np.log([2e-3, 1.5, 8e-4]) + 0.2 * rng.normal(size=3)
        z = kernel.impedance(theta + 0.01 * rng.normal(size=(2, 3)), frequency)
        z = z * np.exp(-2j * np.pi * frequency * DELAY)
        z = z * (1 + 0.01 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))
        subjects.append(Subject(name=f"s{i}", repetitions=("1", "2"), frequency_hz=frequency, z=z, noise_sd=None))
    folder = tmp_path_factory.mktemp("late") / "data"
    write_recordings(
        Recordings(subjects=tuple(subjects), title="late", unit="N s/m", network=PLAIN, source=None, licence=None),
        folder,
    )
    return folder


@pytest.fixture(scope="module")
def fitted(dataset: Path) -> Path:
    out = dataset.parent / "out"
    assert main(["run", str(dataset), "-o", str(out), "--network", NETWORK, "--quick"]) == 0
    return out


def test_a_fit_has_what_is_the_same_for_all(fitted: Path) -> None:
    summary = json.loads((fitted / "summary.json").read_text())
    delay, mass = summary["elements"]["d1"], summary["elements"]["m1"]
    assert summary["network"] == NETWORK
    assert (delay["unit"], delay["pooling"], delay["scale"], delay["kind"]) == ("s", "shared", "signed", "delay")
    low, middle, high = (delay["central"][k] for k in ("q05", "median", "q95"))
    assert high - low < 0.02 * DELAY
    assert abs(middle - DELAY) < 1.3 * (high - low)  # four standard deviations
    assert delay["dispersion_between_persons"]["median"] is None
    assert mass["pooling"] == "varying"
    assert 0.08 < mass["dispersion_between_persons"]["median"] < 0.5
    assert not any("d1" in row[:2] for row in summary["correlation"])
    assert summary["reliable"]
    assert not summary["adequacy"]["misfit"]


def test_its_page_names_it(fitted: Path) -> None:
    page = (fitted / "report.html").read_text()
    assert "the same for all" in page
    assert "d1" in page
    assert (fitted / "pictures").is_dir()


@pytest.mark.long
def test_its_pages_are_made_again(fitted: Path, dataset: Path) -> None:
    assert main(["report", str(fitted), "--dataset", str(dataset)]) == 0


@pytest.fixture(scope="module")
def verdict(dataset: Path) -> Path:
    out = dataset.parent / "diagnosis"
    assert main(["diagnose", str(dataset), "-o", str(out), "--quick"]) == 0
    return out


def test_the_verdict_says_the_network(verdict: Path) -> None:
    record = json.loads((verdict / "verdict.json").read_text())
    assert [entry["id"] for entry in record["physics"]] == ["rig.delay"]
    assert record["extended_network"] == NETWORK


@pytest.mark.long
def test_run_with_a_verdict(verdict: Path, dataset: Path, fitted: Path, tmp_path: Path) -> None:
    """It is the posterior that it is by hand, where the dataset's own network is the one before.

    The fit begins at what the diagnosis found, too, so that the chains are others.
    """
    out = tmp_path / "with"
    assert main(["fit", str(dataset), "-o", str(out), "--with", str(verdict), "--quick"]) == 0
    by_hand, proposed = (json.loads((folder / "summary.json").read_text()) for folder in (fitted, out))
    assert proposed["before"]["network"] == PLAIN
    sampled = {"elements", "correlation", "errors", "coverage", "coverage_by_frequency", "noise_scale", "sampler"}
    sampled |= {"adequacy"}
    assert proposed.keys() == by_hand.keys()
    assert [key for key in proposed if proposed[key] != by_hand[key] and key not in sampled] == []
    assert proposed["reliable"]
    for name, own in by_hand["elements"].items():
        one, other = own["central"], proposed["elements"][name]["central"]
        assert abs(one["median"] - other["median"]) < 0.2 * (one["q95"] - one["q05"])


@pytest.mark.long
def test_a_run_shows_before_and_after(fitted: Path, verdict: Path) -> None:
    """Bands, eq. 5 and coverage of both networks, those before as the diagnosis has them."""
    summary, proposal = (json.loads(f.read_text()) for f in (fitted / "summary.json", verdict / "verdict.json"))
    for name in set(summary["before"]) - {"network"}:
        assert summary["before"][name] == pytest.approx(proposal["improvement"][name][0]), name
    after = summary["errors"]["population_network"]
    assert after["delta_phase_deg"] < 0.8 * summary["before"]["delta_phase_deg"]
    page = (fitted / "report.html").read_text()
    assert "Before and after" in page
    assert 'value="before"' in page
    result = load_result(fitted)
    kept = result.groups["constant_data"]
    assert kept["before_band_recording"].shape == (2, 3, kept["network_curve"].shape[1])
    for name, key in (("before_error", "delta_phase_deg"), ("before_coverage_90", "coverage90")):
        shown = kept[name][1].mean() if name == "before_error" else kept[name].mean()
        assert shown == pytest.approx(summary["before"][key], rel=1e-5)
    assert main(["report", str(fitted)]) == 0  # from the files alone
    assert 'value="before"' in (fitted / "report.html").read_text()


@pytest.mark.long
def test_a_diagnosis_leaves_the_fit_of_what_it_found(dataset: Path, tmp_path: Path) -> None:
    """A result like any other, whose page shows before and after, and which `report` and `export` take."""
    assert main(["diagnose", str(dataset), "-o", str(tmp_path)]) == 0
    extended = tmp_path / "extended"
    assert json.loads((extended / "summary.json").read_text())["network"] == NETWORK
    page = (extended / "report.html").read_text()
    assert "Before and after" in page
    assert 'value="before"' in page
    (extended / "report.html").unlink()
    assert main(["report", str(extended), "--overwrite"]) == 0
    assert (extended / "report.html").read_text() == page
    users = ["--what", "users", "--users", "5", "--spanning", "2", "--no-pictures"]
    assert main(["export", str(extended), "-o", str(tmp_path / "design"), *users]) == 0
    assert json.loads((tmp_path / "design" / "users.json").read_text())["network"] == PLAIN


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{}", "not a verdict of schema"),
        ("[1]", "contains no object"),
        ('{"network": ["m1", "m1|"]}', "not a verdict of schema"),
    ],
)
def test_a_verdict_that_is_none(
    dataset: Path, tmp_path: Path, content: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "verdict.json"
    file.write_text(content)
    assert main(["run", str(dataset), "-o", str(tmp_path / "out"), "--with", str(file)]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_network_and_with_exclude_each_other(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--network", PLAIN, "--with", str(tmp_path)]
    assert main(["run", str(dataset), "-o", str(tmp_path / "out"), *given]) == 2
    assert "exclude each other" in capsys.readouterr().err
