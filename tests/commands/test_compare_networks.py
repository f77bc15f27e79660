"""``compare --networks``: every way to name a network, the tables, and what is refused before anything is written."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import results_by_hand
from conftest import THREE_ELEMENTS
from diagnoses_by_hand import verdict_of

from bayes_impedance.commands import network_comparison
from bayes_impedance.commands.cli import main
from bayes_impedance.commands.network_comparison import lines_of
from bayes_impedance.diagnosis.verdict_file import to_json
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import write_recordings
from bayes_impedance.results.leave_one_out import LeftOut, leave_one_out
from bayes_impedance.results.network_comparison import Entry, NetworkComparison
from bayes_impedance.results.result import Result, load_result

OPTIONS = ("--covariance", "diagonal")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten people, a finished fit of their network, and the comparison with two poorer ones."""
    folder = tmp_path_factory.mktemp("place")
    recordings = simulate_recordings(THREE_ELEMENTS, 10, 2, np.geomspace(5, 5000, 20), 1).recordings
    write_recordings(recordings, folder / "data", significant_digits=6)
    own = ["fit", str(folder / "data"), "-o", str(folder / "own"), "--quick", "--network", "m1|r1|n1", *OPTIONS]
    assert main(own) == 0
    (folder / "poor.txt").write_text("  r1 | n1\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def out(place: Path) -> Path:
    """Of the comparison; the network without a mass is no fit, hence the status."""
    assert main(arguments(place, "m1|r1", str(place / "own"), str(place / "poor.txt"))) == 1
    return place / "out"


def arguments(place: Path, *networks: str, out: str = "out") -> list[str]:
    return ["compare", str(place / "data"), "-o", str(place / out), *OPTIONS, "--networks", *networks]


def test_the_tables_say_how_much_worse_each_network_predicts(place: Path, out: Path) -> None:
    assert {p.name for p in out.iterdir() if p.name[0] != "."} == {"1", "3", "networks.json", "networks.csv"}
    assert (out / "1" / "summary.json").is_file()
    table = json.loads((out / "networks.json").read_text(encoding="utf-8"))
    assert table["schema"] == 1
    assert len(table["data_sha256"]) == 64
    rows = {row["network"]: row for row in table["networks"]}
    assert next(iter(rows)) == table["best"] == "m1|r1|n1"
    assert table["as_good"] == []
    best = rows["m1|r1|n1"]
    assert (best["difference"], best["difference_se"], best["folder"]) == (0, 0, str(place / "own"))
    assert rows["m1|r1"]["folder"] == "1"
    assert best["reliable"] is True
    for row in rows.values():
        assert row["elpd"] == pytest.approx(sum(row["persons"]["elpd"]))
        assert row["difference"] == pytest.approx(row["elpd"] - best["elpd"])
        assert len(row["persons"]["pareto_k"]) == 10
    for name in ("m1|r1", "r1|n1"):
        assert rows[name]["difference"] < -3 * rows[name]["difference_se"] < 0
        assert rows[name]["relative_rms_median"] > best["relative_rms_median"]
    fitted = json.loads((place / "own" / "summary.json").read_text(encoding="utf-8"))
    for name in ("delta_magnitude", "delta_phase_deg"):
        assert best[name] == fitted["errors"]["population_network"][name]
    with (out / "networks.csv").open(encoding="utf-8", newline="") as opened:
        lines = list(csv.DictReader(opened))
    assert [line["network"] for line in lines] == list(rows)
    assert [float(line["elpd"]) for line in lines] == [row["elpd"] for row in rows.values()]
    assert list(lines[0]) == [name for name in best if name not in ("problems", "misfit", "persons")]


def test_people_are_refitted_where_the_weights_cannot_be_believed(place: Path, out: Path) -> None:
    """Or marked, if there are more than a few of them."""
    table = json.loads((out / "networks.json").read_text(encoding="utf-8"))
    for row in table["networks"]:
        smoothed = leave_one_out(load_result(place / "own" if row["folder"] not in "13" else out / row["folder"]))
        beyond = smoothed.pareto_k > 0.7
        again = np.array(row["persons"]["refitted"])
        assert row["refitted"] + row["doubtful"] == beyond.sum()
        if beyond.sum() > network_comparison.MOST_REFITS:
            assert not again.any()
        assert not np.any(again & ~beyond)
        np.testing.assert_allclose(np.array(row["persons"]["elpd"])[~again], smoothed.elpd[~again], rtol=1e-12)


@pytest.mark.long
def test_resume_takes_what_is_finished(place: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (out / "networks.json").read_bytes()

    def nothing(*_: object) -> Result:
        raise AssertionError("fitted again")

    monkeypatch.setattr(network_comparison, "fit_dataset", nothing)
    given = "m1|r1", str(place / "own"), str(place / "poor.txt")
    assert main([*arguments(place, *given), "--resume"]) == 1
    assert (out / "networks.json").read_bytes() == before
    with pytest.raises(AssertionError, match="fitted again"):  # another seed is another fit
        main([*arguments(place, *given), "--resume", "--seed", "5"])


def test_a_verdict_stands_for_its_second_network(place: Path) -> None:
    verdict = place / "verdict.json"
    found = verdict_of((), "m1|r1", "m1|r1|n1")
    verdict.write_text(json.dumps(to_json(found)), encoding="utf-8")
    assert network_comparison._network_in(verdict) == "m1|r1|n1"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("m1|r1",), "two or more"),
        (("m1|r1", " m1 | r1 "), "are the same"),
        (("m1|r1", "r1|q7"), "no file or folder"),
        (("m1|r1", "nowhere/fit"), "no file or folder"),
        (("m1|r1", "{place}/verdict_of_nothing.json"), "not a verdict"),
        (("m1|r1", "{place}/broken.json"), "JSON"),
        (("m1|r1", "{place}/notes.txt"), "notes.txt"),
        (("m1|r1", "{place}/data"), "there is no such file"),
        (("m1|r1", "{place}/own", "{place}/own/"), "are the same"),
        (("m1|r1", "{place}/own", "--subject", "V01", "--subject", "V02"), "other subjects"),
        (("m1|r1", "r1|n1", "--subject", "V01"), "two or more"),
        (("m1|r1", "r1|n1", "--network", "r1"), "--network and --networks"),
        (("m1|r1", "r1|n1", "--result", "{place}/own"), "--result and --networks"),
        (("m1|r1", "r1|n1", "--covariate", "age"), "age"),
    ],
)
def test_what_cannot_be_compared_is_refused_before_anything_is_written(
    place: Path, capsys: pytest.CaptureFixture[str], given: tuple[str, ...], words: str
) -> None:
    (place / "verdict_of_nothing.json").write_text('{"network": ["m1|r1", null]}', encoding="utf-8")
    (place / "broken.json").write_text("{", encoding="utf-8")
    (place / "notes.txt").write_text("remember the milk", encoding="utf-8")
    assert main(arguments(place, *(text.format(place=place) for text in given), out="refused")) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert words in said
    assert len(said.splitlines()) == 1
    assert not (place / "refused").exists()


def test_a_fit_of_other_recordings_is_refused(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = simulate_recordings(THREE_ELEMENTS, 10, 2, np.geomspace(5, 5000, 20), 2).recordings
    write_recordings(other, tmp_path / "data", significant_digits=6)
    assert main(arguments(tmp_path, "m1|r1", str(place / "own"))) == 2
    assert "fit of other recordings" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_files_of_others_in_a_later_folder_are_seen_before_the_first_fit(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "2").mkdir()
    (tmp_path / "2" / "summary.json").write_text("mine", encoding="utf-8")
    command = ["compare", str(place / "data"), "-o", str(tmp_path), "--networks", "m1|r1|n1", "m1|r1"]
    assert main(command) == 2
    assert "was not written by this package" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["2"]


def entry(
    name: str, elpd: np.ndarray, k: float = 0.2, problems: tuple[str, ...] = (), electrical: bool = False
) -> Entry:
    result = results_by_hand.make_result(problems=problems, electrical=electrical)
    result.attributes["network"] = name
    tails = np.full(elpd.size, k)
    left_out = LeftOut(tuple(f"P{i}" for i in range(elpd.size)), elpd, tails, np.zeros(elpd.size, dtype=bool), 3.0)
    return Entry(name, name, result, left_out)


def test_what_is_wrong_is_said_first_and_is_never_the_best() -> None:
    elpd = np.array([10.0, 12.0, 11.0, 9.0])
    better = entry("a", elpd + 5, problems=("the ensembles disagree",))
    comparison = NetworkComparison.of([entry("c", elpd - np.array([3, 4, 3, 4.0]), k=0.9), entry("b", elpd), better])
    assert [e.given for e in comparison.entries] == ["a", "b", "c"]
    lines = lines_of(comparison)
    assert lines[0] == "NOT RELIABLE (a): the ensembles disagree"
    assert lines[-1] == "best: b"
    assert any(line.startswith("* 4 of c") for line in lines)
    assert [round(row["difference"], 6) for row in comparison.rows()] == [20, 0, -14]


def test_what_people_do_not_separate_is_undecided() -> None:
    elpd = np.array([10.0, 12.0, 11.0, 9.0])
    close = entry("close", elpd - np.array([2.0, -1.5, 1.0, -1.0]))
    comparison = NetworkComparison.of([close, entry("first", elpd), entry("far", elpd - np.array([5.0, 5.1, 5, 5]))])
    assert [e.given for e in comparison.as_good] == ["close"]
    assert lines_of(comparison)[-1] == "best: first; not separated from it (within 3 standard errors): close"
    nothing = NetworkComparison.of([entry("x", elpd, problems=("p",)), entry("y", elpd - 1, problems=("p",))])
    assert lines_of(nothing)[-1] == "no fit is reliable, so none is named the best"


def test_circuits_are_named_in_both_spellings() -> None:
    elpd = np.array([10.0, 12.0, 11.0, 9.0])
    entries = [entry(name, elpd - k, electrical=True) for k, name in enumerate(("r0|p1^a1@10", "delay[d1*](r0)"))]
    comparison = NetworkComparison.of(entries)
    lines = lines_of(comparison)
    assert lines[-1] == "best: r0|p1^a1@10 = R0-CPE1"
    table = [line for line in lines if " ± " in line or line.startswith("r0|p1^a1@10 = R0-CPE1 ")]
    assert [len(line) for line in table] == [len(table[0])] * 2
    assert "r0|p1^a1@10 = R0-CPE1" in comparison._repr_html_()
    assert [row["network"] for row in comparison.rows()] == ["r0|p1^a1@10", "delay[d1*](r0)"]  # as it can be given


def test_a_network_and_a_fit_of_it_have_labels_of_their_own() -> None:
    elpd = np.array([10.0, 12.0, 11.0, 9.0])
    fitted, made, other = (
        entry("m1|r1", elpd, k=0.9),
        entry("m1|r1", elpd - [0, 0.1, 0, 0.1], k=0.9),
        entry("r1", elpd - 9),
    )
    comparison = NetworkComparison.of(
        [
            replace(fitted, given="other/own", folder="other/own"),
            replace(made, given="m1|r1", folder="2"),
            replace(other, given="r1", folder="3"),
        ]
    )
    labels = [comparison.label(one) for one in comparison.entries]
    assert labels == ["m1|r1 (fit in other/own)", "m1|r1 (folder 2)", "r1"]
    lines = lines_of(comparison)
    assert lines[-1] == f"best: {labels[0]}; not separated from it (within 3 standard errors): {labels[1]}"
    assert [line.split("  ")[0] for line in lines if line.startswith(("m1|r1", "r1"))] == labels
    assert any(line.startswith(f"* 4 of {labels[0]}, 4 of {labels[1]} have") for line in lines)
    assert all(f">{label}<" in comparison._repr_html_() for label in labels)
    assert labels[0] in repr(comparison)
    summary = comparison.summary()
    assert (summary["best_folder"], summary["as_good_folders"]) == ("other/own", ["2"])


@pytest.mark.long
def test_distributions_of_people_are_compared(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A finished fit of a normal population beside a Student t population of the same network."""
    out = place / "distributions"
    own = ["compare", str(place / "data"), "-o", str(out), *OPTIONS, "--distributions", "student_t"]
    assert main([*own, "--networks", str(place / "own"), "m1|r1|n1"]) == 0
    told = capsys.readouterr().out
    rows = {row["distribution"]: row for row in json.loads((out / "networks.json").read_text())["networks"]}
    assert set(rows) == {"normal", "student_t"}
    assert rows["student_t"]["folder"] == "2"
    assert "m1|r1|n1, student_t" in told
    assert "not separated from it" in told  # the people are normal
    assert abs(rows["normal"]["elpd"] - rows["student_t"]["elpd"]) < 5


@pytest.mark.long
def test_distributions_of_noise_are_compared(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Normal noise: both predict as well. The finished fit is known to be that of normal noise."""
    out = place / "noise"
    own = ["compare", str(place / "data"), "-o", str(out), *OPTIONS, "--network", "m1|r1|n1"]
    assert main([*own, "--noise-distributions", "normal", "student_t"]) == 0
    told = capsys.readouterr().out
    rows = {row["noise_distribution"]: row for row in json.loads((out / "networks.json").read_text())["networks"]}
    assert set(rows) == {"normal", "student_t"}
    assert "m1|r1|n1, student_t noise" in told
    assert "not separated from it" in told
    assert abs(rows["normal"]["elpd"] - rows["student_t"]["elpd"]) < 5
    tails = load_result(out / "2")
    assert tails.attributes["noise_distribution"] == "student_t"
    assert tails.summary["noise_distribution"]["name"] == "student_t"
    assert "noise_distribution" not in load_result(out / "1").summary


@pytest.mark.long
def test_two_groups_are_compared_with_one(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, own = place / "groups", ["compare", str(place / "data"), "--network", "m1|r1|n1"]
    assert main([*own, "-o", str(place / "no"), *OPTIONS, "--distributions", "normal", "mixture"]) == 2
    assert "a mixture takes covariance 'full'" in capsys.readouterr().err
    assert not (place / "no").exists()
    assert main([*own, "-o", str(out), "--distributions", "normal", "mixture"]) == 0
    told = capsys.readouterr().out
    rows = {row["distribution"]: row for row in json.loads((out / "networks.json").read_text())["networks"]}
    assert set(rows) == {"normal", "mixture"}
    assert "m1|r1|n1, mixture" in told
    assert "not separated from it" in told  # the people are of one kind
    assert abs(rows["normal"]["elpd"] - rows["mixture"]["elpd"]) < 5


def test_one_distribution_of_one_network_is_no_comparison(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = ["compare", str(place / "data"), "-o", str(place / "nothing"), "--network", "m1|r1|n1"]
    assert main([*own, "--distributions", "normal"]) == 2
    assert "two --distributions" in capsys.readouterr().err
    assert main([*own, "--distributions", "normal", "normal"]) == 2
    assert "are the same" in capsys.readouterr().err
    assert not (place / "nothing").exists()
