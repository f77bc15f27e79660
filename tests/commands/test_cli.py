"""Commands as a person meets them: exit status, one clear sentence, complete files or none."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA, SMALL

from bayes_impedance.commands.cli import main
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import write_recordings
from bayes_impedance.results.result import load_result


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve virtual people on disk."""
    folder = tmp_path_factory.mktemp("dataset")
    recordings = simulate_recordings(SMALL, 12, 2, np.geomspace(5, 5000, 30), seed=2).recordings
    write_recordings(recordings, folder, significant_digits=6)
    return folder


@pytest.fixture(scope="module")
def finished(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of a whole run."""
    out = tmp_path_factory.mktemp("out") / "first"
    assert main(["run", str(dataset), "-o", str(out), "--quick", "--seed", "4"]) == 0
    return out


@pytest.mark.smoke
def test_run_leaves_everything_and_nothing_else(finished: Path) -> None:
    assert {p.name for p in finished.iterdir() if p.name[0] != "."} == {
        "result.nc",
        "summary.json",
        "seconds.json",
        "report.html",
        "pictures",
    }
    pictures = {p.name for p in (finished / "pictures").iterdir()}
    stems = {name.removesuffix(".png") for name in pictures if name.endswith(".png")}
    assert {f"{s}.svg" for s in stems} | {f"{s}.png" for s in stems} == pictures
    assert {"curves", "bands", "forest", "errors", "traces"} <= stems
    assert not list(finished.rglob("*.tmp"))


@pytest.mark.smoke
def test_summary_follows_the_schema(finished: Path) -> None:
    summary = json.loads((finished / "summary.json").read_text(encoding="utf-8"))
    assert summary["schema"] == 1
    assert (summary["subjects"], summary["repetitions"], summary["seed"]) == (12, 2, 4)
    assert len(summary["data_sha256"]) == 64
    assert summary["network"] == SMALL.network
    assert list(summary["elements"]) == ["n3", "r3", "m2", "r1", "n1"]
    for element in summary["elements"].values():
        assert element["identified"] is True
        for key in ("central", "dispersion_between_persons", "dispersion_between_repetitions"):
            assert element[key]["q05"] < element[key]["median"] < element[key]["q95"]
    assert summary["elements"]["m2"]["unit"] == "kg"
    for a, b, median, low, high in summary["correlation"]:
        assert {a, b} <= set(summary["elements"])
        assert -1 <= low <= median <= high <= 1
    assert {"population_network", "lookup_mean", "lookup_median"} <= set(summary["errors"])
    for name in ("population_network", "lookup_mean", "lookup_median"):
        assert {"delta_magnitude", "delta_phase_deg"} <= set(summary["errors"][name])
    assert set(summary["coverage"]) == {"50", "90"}
    assert {
        "ensembles",
        "rhat_max",
        "ess_min",
        "tau_max",
        "acceptance",
        "log_likelihood_variance",
        "pareto_k_max",
    } <= set(summary["sampler"])
    assert {"read", "modes", "draws", "population", "predictive"} <= set(
        json.loads((finished / "seconds.json").read_text())
    )


def test_compare_prints_and_writes_the_table(
    dataset: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(dataset), "-o", str(tmp_path / "new"), "--result", str(finished)]) == 0
    text = capsys.readouterr().out
    for words in ("amplitude, Median", "LuT Mean", "VFMedian", "SIT", "population network", "eq. 5"):
        assert words in text
    written = {p.name for p in (tmp_path / "new").iterdir() if p.name[0] != "."}
    pictures = {f"{name}.{end}" for name in ("comparison", "recordings", "bode") for end in ("png", "svg")}
    assert written == {"comparison.json", "comparison.csv"} | pictures
    summary = json.loads((tmp_path / "new" / "comparison.json").read_text(encoding="utf-8"))
    fitted = json.loads((finished / "summary.json").read_text(encoding="utf-8"))
    assert summary["data_sha256"] == fitted["data_sha256"]
    ours = next(m for m in summary["methods"] if m["id"] == "population_network")
    assert ours["delta_magnitude"] == pytest.approx(fitted["errors"]["population_network"]["delta_magnitude"])


@pytest.mark.long
def test_compare_fits_by_itself(dataset: Path, tmp_path: Path) -> None:
    names = [name for i in (1, 2, 3) for name in ("--subject", f"V{i:02}")]
    arguments = ["compare", str(dataset), "-o", str(tmp_path), "--network", "m2|r1|n1", *names]
    assert main(arguments) in (0, 1)  # three persons and a poor network: the fit may be refused, the table is there
    assert (tmp_path / "comparison.json").is_file()
    assert (tmp_path / "fit" / "summary.json").is_file()


def test_compare_refuses_a_fit_of_other_recordings_or_another_network(
    dataset: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = simulate_recordings(SMALL, 12, 1, np.geomspace(5, 5000, 30), seed=3).recordings
    write_recordings(other, tmp_path / "other", significant_digits=6)
    arguments = ["compare", str(tmp_path / "other"), "-o", str(tmp_path / "out"), "--result", str(finished)]
    assert main(arguments) == 2
    assert "fit of other recordings" in capsys.readouterr().err
    arguments = ["compare", str(dataset), "-o", str(tmp_path / "out"), "--result", str(finished), "--network", "m1|r1"]
    assert main(arguments) == 2
    assert "leave out --network" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.smoke
def test_the_result_is_an_ordinary_arviz_file(finished: Path) -> None:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ announces its own future at import
        import arviz
        import corner
    data = arviz.from_netcdf(str(finished / "result.nc"), engine="h5netcdf")
    posterior = data["posterior"]
    assert dict(posterior["central"].sizes)["element"] == 5
    assert list(posterior["element"].values) == ["n3", "r3", "m2", "r1", "n1"]
    assert set(posterior["person_log_elements"].dims) == {"chain", "draw", "subject", "element"}
    for group in ("posterior_predictive", "log_likelihood", "sample_stats", "observed_data", "constant_data"):
        assert len(data[group].data_vars) > 0
    assert posterior.attrs["network"] == SMALL.network
    assert posterior.attrs["seed"] == 4
    summary = arviz.summary(data, var_names=["mu"])
    assert len(summary) == 5
    figure = corner.corner(np.asarray(posterior["mu"]).reshape(-1, 5), labels=list(posterior["element"].values))
    assert len(figure.axes) == 25


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes_with_processes(dataset: Path, finished: Path, tmp_path: Path) -> None:
    assert main(["run", str(dataset), "-o", str(tmp_path), "--quick", "--seed", "4", "--workers", "1"]) == 0
    assert (tmp_path / "result.nc").read_bytes() == (finished / "result.nc").read_bytes()
    assert (tmp_path / "summary.json").read_bytes() == (finished / "summary.json").read_bytes()
    for picture in (finished / "pictures").iterdir():
        assert (tmp_path / "pictures" / picture.name).read_bytes() == picture.read_bytes(), picture.name


def test_report_is_made_again_from_the_files_alone(finished: Path, tmp_path: Path) -> None:
    for name in ("result.nc", "summary.json"):
        (tmp_path / name).write_bytes((finished / name).read_bytes())
    assert main(["report", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").is_file()
    for picture in (finished / "pictures").iterdir():
        assert (tmp_path / "pictures" / picture.name).read_bytes() == picture.read_bytes(), picture.name


def test_what_is_saved_is_what_is_loaded(finished: Path) -> None:
    result = load_result(finished)
    central = result.groups["posterior"]["central"]
    for i, element in enumerate(result.elements):
        assert result.summary["elements"][element]["central"]["median"] == pytest.approx(np.median(central[..., i]))
        assert result.element_unit(element) == result.summary["elements"][element]["unit"]


@pytest.mark.long
def test_fit_writes_no_pictures_and_simulate_takes_its_summary(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, virtual = tmp_path / "fit", tmp_path / "virtual"
    assert main(["fit", str(dataset), "-o", str(out), "--quick", "--covariance", "diagonal"]) == 0
    assert {p.name for p in out.iterdir() if p.name[0] != "."} == {"result.nc", "summary.json", "seconds.json"}
    assert "central value (90 %)" in capsys.readouterr().out
    arguments = ["simulate", "-o", str(virtual), "--population", str(out / "summary.json")]
    assert main([*arguments, "--subjects", "4", "--points", "20", "--seed", "9"]) == 0
    truth = json.loads((virtual / "truth.json").read_text(encoding="utf-8"))
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert truth["elements"]["m2"]["central"] == pytest.approx(summary["elements"]["m2"]["central"]["median"])
    assert main(["check", str(virtual)]) == 0
    assert "subjects       4" in capsys.readouterr().out
    again = tmp_path / "again"
    assert main([*arguments[:2], str(again), *arguments[3:], "--subjects", "4", "--points", "20", "--seed", "9"]) == 0
    name = "recordings.csv.gz"
    assert (again / name).read_bytes() == (virtual / name).read_bytes()


@pytest.mark.long
def test_one_subject_of_the_published_curves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(DATA / "appendix_a" / "vf_median"), "-o", str(tmp_path), "--quick"]) == 0
    text = capsys.readouterr().out
    assert "The network does not describe these recordings" in text
    assert "no dispersion can be estimated" in text
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["elements"]["n3"]["identified"] is False
    assert summary["elements"]["n3"]["central"] == {"median": None, "q05": None, "q95": None}
    assert summary["elements"]["r3"]["dispersion_between_persons"]["median"] is None
    assert (
        0.045 < summary["errors"]["subjects"]["relative_rms_median"] < 0.052
    )  # the corrected eq. 4 comes within 4.8 % of this curve
    assert "n3    m/N      not determined" in text


@pytest.mark.long
def test_killed_and_resumed_gives_the_same_bytes(dataset: Path, finished: Path, tmp_path: Path) -> None:
    """The process is really killed, in the middle of sampling, without a chance to tidy up."""
    script = (
        "import os, sys\nfrom pathlib import Path\n"
        "from bayes_impedance.commands.fit_options import FitOptions\n"
        "from bayes_impedance.commands.jobs import run_dataset\n"
        "def progress(stage, done, total):\n"
        "    if stage == 'sampling' and done * 3 > total:\n        os.kill(os.getpid(), 9)\n"
        f"source, out = Path({str(dataset)!r}), Path({str(tmp_path)!r})\n"
        "run_dataset(source, out, FitOptions(quick=True, seed=4), False, progress)\n"
    )
    killed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert killed.returncode == -9, killed.stderr
    assert not (tmp_path / "result.nc").exists()
    assert list((tmp_path / "checkpoint").glob("ensemble_*.h5"))
    assert main(["run", str(dataset), "-o", str(tmp_path), "--quick", "--seed", "4", "--resume"]) == 0
    assert (tmp_path / "result.nc").read_bytes() == (finished / "result.nc").read_bytes()
    assert not (tmp_path / "checkpoint").exists()


def test_resuming_something_else_is_refused(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    (folder / "belongs_to.txt").write_text("somebody else\n", encoding="utf-8")
    assert main(["run", str(dataset), "-o", str(tmp_path), "--resume"]) == 2
    assert "other data or other options" in capsys.readouterr().err
    assert folder.exists()


BAD = {
    "no such path": (None, [], "there is no such file or folder"),
    "empty file": ("", [], "recordings.csv"),
    "text in a number": (
        "subject,repetition,frequency_hz,z_re,z_im\nA,1,10,x,1\nA,1,20,1,1\nA,1,30,1,1\n",
        [],
        "row 2",
    ),
    "no network": (
        "subject,repetition,frequency_hz,z_re,z_im\n" + "".join(f"A,1,{f},1,1\n" for f in range(5, 15)),
        [],
        "--network",
    ),
    "unknown element": (
        "subject,repetition,frequency_hz,z_re,z_im\n" + "".join(f"A,1,{f},1,1\n" for f in range(5, 15)),
        ["--network", "x1|r1"],
        "element 'x1' is of no known kind",
    ),
    "unknown subject": (
        "subject,repetition,frequency_hz,z_re,z_im\n" + "".join(f"A,1,{f},1,1\n" for f in range(5, 15)),
        ["--network", "m1|r1", "--subject", "B"],
        "B",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gives_one_sentence_and_status_2(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, more, expected = BAD[case]
    source, out = tmp_path / "data", tmp_path / "out"
    if content is not None:
        source.mkdir()
        (source / "recordings.csv").write_text(content, encoding="utf-8")
    assert main(["run", str(source), "-o", str(out), *more]) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    assert not list(out.rglob("*.nc"))
    assert not list(out.rglob("*.json"))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["report", "{tmp}"], "result.nc: there is no such file"),
        (["simulate", "-o", "{tmp}/s", "--population", "{tmp}/none.json"], "there is no such file"),
        (["simulate", "-o", "{tmp}/s", "--population", "{tmp}/text.json"], "cannot be read as JSON"),
        (["simulate", "-o", "{tmp}/s", "--population", "{tmp}/empty.json"], 'key "elements" is missing'),
        (["simulate", "-o", "{tmp}/s", "--band", "10", "5"], "0 < low < high"),
    ],
)
def test_other_commands_refuse_bad_input(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "text.json").write_text("no json", encoding="utf-8")
    (tmp_path / "empty.json").write_text("{}", encoding="utf-8")
    assert main([a.format(tmp=tmp_path) for a in arguments]) == 2
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    for command in ("run", "check", "simulate", "fit", "report"):
        assert f"    {command} " in text


def test_the_package_is_the_command() -> None:
    command = [sys.executable, "-m", "bayes_impedance", "--help"]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout.startswith("usage: bayes-impedance")


@pytest.mark.slow
def test_real_recordings_run_to_the_end_and_say_how_bad_the_fit_is(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [f"B{i:03d}" for i in range(0, 130, 13)]
    arguments = [a for name in names for a in ("--subject", name)]
    status = main(["fit", str(real_data / "battery_130"), "-o", str(tmp_path), "--quick", *arguments])
    text = capsys.readouterr().out
    assert "The network does not describe these recordings" in text
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    # Elements known to 0.01 % need more draws than --quick has: the fit may say so, and then ends with status 1.
    assert status == (0 if summary["reliable"] else 1)
    assert summary["unit"] == "ohm"
    assert summary["elements"]["n1"]["unit"] == "F"
    assert summary["errors"]["subjects"]["relative_rms_median"] > 0.1
