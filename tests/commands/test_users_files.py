"""What is the user's stays: datasets, folders, pages of other commands; and what contradicts a new fit goes."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import pytest
from results_by_hand import make_result
from tiny_fits import fit_arguments

from bayes_impedance.commands import jobs
from bayes_impedance.commands.arguments import parser_of_commands
from bayes_impedance.commands.cli import main
from bayes_impedance.commands.export import FILES, PICTURES
from bayes_impedance.report.fit_tables import command
from bayes_impedance.runtime.output_folder import MARK

SIMULATE = ["--subjects", "2", "--points", "5"]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def made(folder: Path) -> set[str]:
    """Names of the files that the package remembers to have written."""
    return set(json.loads((folder / MARK).read_text(encoding="utf-8"))["made"])


@pytest.mark.parametrize("name", ["recordings.csv", "recordings.csv.gz", "subjects.csv", "dataset.toml", "truth.json"])
def test_simulate_leaves_recordings_that_are_there(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text("measured for a year")
    assert main(["simulate", "-o", str(tmp_path), *SIMULATE]) == 2
    assert "was not written by this package" in capsys.readouterr().err
    assert contents(tmp_path) == {name: b"measured for a year"}
    assert main(["simulate", "-o", str(tmp_path), *SIMULATE, "--overwrite"]) == 0
    assert main(["simulate", "-o", str(tmp_path), *SIMULATE, "--seed", "2"]) == 0  # its own dataset it replaces


@pytest.mark.parametrize("content", [{}, {"thesis.txt": "years"}, {"belongs_to.txt": "me", "thesis.txt": "years"}])
@pytest.mark.parametrize("more", [[], ["--resume"], ["--overwrite"]])
def test_a_folder_that_is_called_checkpoint_stays(
    content: dict[str, str], more: list[str], tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    for name, text in content.items():
        (folder / name).write_text(text)
    before = contents(tmp_path)
    if content:
        assert main(fit_arguments(tiny / "data", tmp_path, *more)) == 2
        assert str(folder) in capsys.readouterr().err
        assert contents(tmp_path) == before
    else:  # an empty folder holds nothing that could be lost
        assert main(fit_arguments(tiny / "data", tmp_path, *more)) == 0


def test_a_checkpoint_that_is_a_link_stays(tiny: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "a.npz").write_text("years")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "checkpoint").symlink_to(precious)
    assert main(fit_arguments(tiny / "data", tmp_path / "out")) == 2
    assert contents(precious) == {"a.npz": b"years"}


@pytest.mark.parametrize(
    "wrong", [["--network", "m1|x9"], ["--network", "(("], ["--covariate", "none"], ["--subject", "nobody"]]
)
def test_options_are_looked_at_before_anything_is_touched(wrong: list[str], tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def stop(stage: str, _done: int, _total: int) -> None:
        if stage == "sampling":
            raise KeyboardInterrupt

    options = jobs.FitOptions(network="m1|r1|n1", covariance="diagonal", quick=True)
    with pytest.raises(KeyboardInterrupt, match="--resume continues the fit"):
        jobs.fit_dataset(tiny / "data", out, options, False, stop)
    before = contents(out)
    assert any(name.startswith("checkpoint/ensemble") for name in before)
    assert main([*fit_arguments(tiny / "data", out), *wrong]) == 2
    assert contents(out) == before
    (out / "checkpoint" / "mine.txt").write_text("mine")
    assert main(fit_arguments(tiny / "data", out, "--resume")) == 0
    assert (out / "result.nc").read_bytes() == (tiny / "out" / "result.nc").read_bytes()
    assert {p.name for p in (out / "checkpoint").iterdir()} == {"mine.txt"}


@pytest.mark.long
def test_a_new_fit_takes_away_the_pages_of_the_old_one(tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(tiny / "out", out)
    assert main(["report", str(out)]) == 0
    (out / "pictures" / "holiday.png").write_text("mine")
    assert {"report.html", "pictures/forest.png"} <= set(contents(out))
    assert main([*fit_arguments(tiny / "data", out), "--seed", "5"]) == 0
    assert set(contents(out)) == {"result.nc", "summary.json", "seconds.json", MARK, "pictures/holiday.png"}
    assert made(out) == {"result.nc", "summary.json", "seconds.json"}


@pytest.mark.long
def test_an_interruption_while_drawing_says_that_the_fit_is_there(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(jobs, "write_pages", interrupted)
    assert main(["run", *fit_arguments(tiny / "data", tmp_path / "out")[1:]]) == 1
    said = capsys.readouterr().err
    assert "interrupted; the fit is finished: 'bayes-impedance report" in said
    monkeypatch.undo()
    assert main(["report", str(tmp_path / "out")]) == 0


def test_a_diagnosis_refuses_a_users_file_before_it_searches(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "extended").mkdir()
    (tmp_path / "extended" / "report.html").write_text("a thesis")
    assert main(["diagnose", str(tiny / "data"), "--network", "m1|r1|n1", "-o", str(tmp_path)]) == 2
    assert "was not written by this package" in capsys.readouterr().err
    assert contents(tmp_path) == {"extended/report.html": b"a thesis"}


@pytest.mark.long
def test_a_diagnosis_stands_beside_a_fit_and_is_resumed_to_the_same_verdict(tiny: Path, tmp_path: Path) -> None:
    out, again = tmp_path / "out", tmp_path / "again"
    shutil.copytree(tiny / "out", out)
    assert main(["report", str(out)]) == 0
    before = contents(out)
    arguments = ["diagnose", str(tiny / "data"), "--network", "m1|r1|n1", "--quick"]
    assert main([*arguments, "-o", str(out)]) == 0
    after = contents(out)
    assert {n: c for n, c in after.items() if n in before and n != MARK} == {
        n: c for n, c in before.items() if n != MARK
    }
    assert {"verdict.json", "diagnosis.html"} <= set(after)

    def stop(stage: str, _done: int, _total: int) -> None:
        if stage == "looking for what is missing":
            raise KeyboardInterrupt

    options = jobs.FitOptions(network="m1|r1|n1", quick=True)
    with pytest.raises(KeyboardInterrupt, match="continues the fit of the network"):
        jobs.diagnose_dataset(tiny / "data", again, options, None, False, stop)
    assert {"first_fits.npz", "point_estimate.npz"} <= {p.name for p in (again / "diagnosis_checkpoint").iterdir()}
    stages: list[str] = []
    jobs.diagnose_dataset(tiny / "data", again, options, None, True, lambda stage, *_: stages.append(stage))
    assert "first fits" not in stages
    assert (again / "verdict.json").read_bytes() == (out / "verdict.json").read_bytes()
    assert not (again / "diagnosis_checkpoint").exists()


def test_the_command_that_is_shown_is_quoted_and_complete() -> None:
    result = make_result(covariates=("x$(touch F)", "a b"), covariance="diagonal")
    result.attributes["selected_subjects"] = '["P 1", "; rm -rf x"]'
    words = shlex.split(command(result))
    options = parser_of_commands().parse_args(words[1:])
    assert options.network == result.attributes["network"]
    assert options.covariate == ["x$(touch F)", "a b"]
    assert options.subject == ["P 1", "; rm -rf x"]
    assert (options.covariance, options.seed, options.quick) == ("diagonal", 7, True)


@pytest.mark.long
def test_a_selection_of_subjects_is_in_the_result(tiny: Path, tmp_path: Path) -> None:
    chosen = [word for name in ("V1", "V3") for word in ("--subject", name)]
    assert main(fit_arguments(tiny / "data", tmp_path, *chosen)) in (0, 1)
    assert main(["report", str(tmp_path), "--dataset", str(tiny / "data")]) in (0, 1)
    assert "--subject V1 --subject V3" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("product", FILES)
def test_everything_that_export_writes_is_known_beforehand(product: str, tiny: Path, tmp_path: Path) -> None:
    arguments = ["export", str(tiny / "out"), "-o", str(tmp_path / "out"), "--what", product]
    assert main([*arguments, "--users", "40", "--grid", "4"]) == 0
    pictures = {f"{name}.{kind}" for name in PICTURES.get(product, ()) for kind in ("svg", "png")}
    written = set(contents(tmp_path / "out")) - {MARK}
    assert written <= set(FILES[product]) | pictures
    assert made(tmp_path / "out") == written
    (tmp_path / "out" / FILES[product][0]).write_text("mine")
    assert main([*arguments, "--users", "40", "--grid", "4"]) == 2
