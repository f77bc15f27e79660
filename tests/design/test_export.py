"""The export command, from a finished fit to files that other programs read."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import SMALL
from results_by_hand import make_result

from bayes_impedance.commands.cli import main
from bayes_impedance.design.answer import design_answer, gains
from bayes_impedance.design.loop.device import PHANTOM
from bayes_impedance.design.users import population_of
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.plots import save_figure, style
from bayes_impedance.plots.design import stability, worst_user
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import load_result, save_result
from bayes_impedance.results.result import make_result as result_of


@pytest.fixture(scope="module")
def finished(small_fit: PopulationFit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished fit of fifteen virtual people."""
    out = tmp_path_factory.mktemp("fit")
    result = result_of(small_fit, predict(small_fit, n_draws=100, n_replicates=20), small_fit.seconds)
    save_result(result, out)
    return out


@pytest.fixture(scope="module")
def exported(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that the command writes, for 40 users."""
    out = tmp_path_factory.mktemp("export") / "design"
    options = ["--users", "40", "--grid", "6", "--spanning", "3", "--seed", "2"]
    assert main(["export", str(finished), "-o", str(out), *options]) == 0
    return out


def table(file: Path) -> tuple[list[str], list[list[str]]]:
    with file.open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    return header, rows


@pytest.mark.smoke
def test_export_leaves_everything_and_nothing_else(exported: Path) -> None:
    pictures = {f"{n}.{e}" for n in ("users", "stability", "worst_user", "transparency") for e in ("png", "svg")}
    tables = {"users.csv", "users.json", "curves.csv", "transfer.json", "transfer.txt", "users.lib", "monte_carlo.lib"}
    tables |= {
        "sweep.cir",
        "users.mat",
        "Users.mo",
        "stability.json",
        "stability.csv",
        "limits.csv",
        "transparency.csv",
    }
    assert {p.name for p in exported.iterdir() if p.name[0] != "."} == pictures | tables


def test_users_are_elements_with_units(exported: Path) -> None:
    header, rows = table(exported / "users.csv")
    assert header == ["user", "n3 (m/N)", "r3 (N s/m)", "m2 (kg)", "r1 (N s/m)", "n1 (m/N)"]
    told = json.loads((exported / "users.json").read_text(encoding="utf-8"))
    names = [entry["name"] for entry in told["representatives"]]
    assert [row[0] for row in rows[: len(names)]] == names
    assert names[0] == "median"
    assert len(rows) == len(names) + 40
    assert told["units"]["m2"] == "kg"
    for entry, row in zip(told["representatives"], rows, strict=False):
        assert list(entry["elements"].values()) == pytest.approx([float(x) for x in row[1:]], rel=1e-15)
        assert entry["rule"]
    curves, lines = table(exported / "curves.csv")
    values = np.array(lines, dtype=float)
    network = parse(told["network"])
    drawn = [dict(zip(network.elements, map(float, row[1:]), strict=True)) for row in rows[len(names) :]]
    z = np.array([network.impedance(2j * np.pi * values[:, 0], user) for user in drawn])
    np.testing.assert_allclose(values[:, curves.index("magnitude_p50")], np.median(np.abs(z), axis=0), rtol=1e-10)
    np.testing.assert_allclose(
        values[:, curves.index("phase_deg_p95")], np.quantile(np.angle(z, deg=True), 0.95, axis=0), rtol=1e-9
    )


def test_stability_is_told_in_one_sentence_and_in_tables(exported: Path) -> None:
    told = json.loads((exported / "stability.json").read_text(encoding="utf-8"))
    assert "stable for 99 % of users up to K" in told["answer"]
    limit = told["stiffness_limit"]
    assert limit["q05"] <= limit["value"] <= limit["q95"]
    header, rows = table(exported / "limits.csv")
    each = np.array([float(row[1]) for row in rows])
    assert each.size == 40
    assert told["worst_user"]["limit"] == pytest.approx(each.min())
    assert told["worst_user"]["name"] == rows[int(np.argmin(each))][0]
    header, rows = table(exported / "stability.csv")
    values = np.array(rows, dtype=float)
    assert len(rows) == 36
    low, share, high = (values[:, header.index(name)] for name in ("q05", "share_stable", "q95"))
    assert np.all((low >= 0) & (low <= share) & (share <= high) & (high <= 1))
    assert share.max() > 0.9
    sections = told["device"]["section"]
    assert sections[0]["values"] == {"m1": 0.072, "r1": 0.005}


def test_the_same_seed_gives_the_same_bytes(exported: Path, finished: Path, tmp_path: Path) -> None:
    options = ["--users", "40", "--spanning", "3", "--seed", "2", "--what", "users", "--what", "spice"]
    assert main(["export", str(finished / "result.nc"), "-o", str(tmp_path), *options]) == 0
    for name in ("users.csv", "users.json", "curves.csv", "users.lib", "sweep.cir", "users.png", "users.svg"):
        assert (tmp_path / name).read_bytes() == (exported / name).read_bytes(), name


def test_a_device_of_ones_own(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    device = tmp_path / "coil.toml"
    section = '[[section]]\narrangement = "beside"\nnetwork = "m1|r1"\nvalues = {m1 = 0.03, r1 = 2.0}\n'
    device.write_text(f'name = "voice coil"\nperiod_s = 2e-4\ndelay_s = 1e-4\n{section}', encoding="utf-8")
    options = ["--users", "20", "--grid", "4", "--what", "stability", "--damping", "0.5", "--share", "0.9"]
    out = tmp_path / "out"
    command = ["export", str(finished), "-o", str(out), *options, "--device", str(device), "--no-pictures"]
    assert main(command) == 0
    text = capsys.readouterr().out
    assert "voice coil: at virtual damping B = 0.5 N s/m it is stable for 90 % of users" in text
    told = json.loads((out / "stability.json").read_text(encoding="utf-8"))
    assert told["classical_limit"] == pytest.approx(2 * 1.5 / 2e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--share", "1.5"], "above 0 and below 1"),
        (["--damping", "-1"], "at least 0"),
        (["--assume", "n3"], "such as n3="),
        (["--assume", "n9=1"], "assumed n9 = 1: assumed values must be positive and of elements among n3"),
        (["--assume", "n3=1"], "the recordings determine n3"),
        (["--device", "none.toml"], "there is no such file"),
    ],
)
def test_bad_input_is_one_sentence_and_no_file(
    options: list[str], message: str, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(finished), "-o", str(tmp_path / "out"), *options]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_is_no_fit_is_refused(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "there is no such file" in capsys.readouterr().err
    spoiled = tmp_path / "spoiled"
    result = load_result(finished)
    result.summary["problems"] = ["ensembles disagree"]
    save_result(result, spoiled)
    assert main(["export", str(spoiled), "-o", str(tmp_path / "out")]) == 2
    assert "not reliable (ensembles disagree)" in capsys.readouterr().err


def test_elements_that_nobody_saw_need_an_assumption() -> None:
    result = make_result(unidentified=("n3",))
    with pytest.raises(InputError, match="do not determine n3: give a value with --assume"):
        population_of(result)
    population = population_of(result, {"n3": 1e-7})
    users = population.draw(50, seed=1)
    np.testing.assert_allclose(users.values["n3"], 1e-7)
    assert users.u[:, 1:].std(axis=0).min() > 0
    np.testing.assert_allclose(population.weights(users, 20).sum(axis=1), 1)
    with pytest.raises(InputError, match="must be positive"):
        population_of(result, {"n3": -1.0})


def test_one_person_is_no_population(finished: Path) -> None:
    result = load_result(finished)
    posterior = {k: v for k, v in result.groups["posterior"].items() if k != "dispersion_between_persons"}
    alone = replace(result, groups={**result.groups, "posterior": posterior})
    with pytest.raises(InputError, match="no population to draw from"):
        population_of(alone)


def test_covariates_are_part_of_what_is_not_known_of_a_user(finished: Path) -> None:
    result = load_result(finished)
    posterior = result.groups["posterior"]
    slope = np.zeros((*posterior["mu"].shape, 1))
    slope[..., 2, 0] = 0.5
    with_slope = replace(result, groups={**result.groups, "posterior": {**posterior, "slope": slope}})
    added = population_of(with_slope).covariance - population_of(result).covariance
    wanted = np.zeros_like(added)
    wanted[2, 2] = 0.25
    np.testing.assert_allclose(added, wanted, atol=1e-12)


def test_nothing_stable_is_said_and_drawn(finished: Path, tmp_path: Path) -> None:
    population = population_of(load_result(finished))
    late = replace(PHANTOM, delay_s=0.02)
    answer = design_answer(population, population.draw(5, seed=1), late, damping=500.0, grid=3)
    assert "not stable for 99 % of users at any stiffness" in answer.sentence
    assert answer.transparency is None
    json.dumps(answer.described(), allow_nan=False)
    with style():
        for name, figure in (("a", stability(answer)), ("b", worst_user(answer, population))):
            assert save_figure(figure, tmp_path, name, ["png"]).is_file()


def test_the_map_spans_what_is_stable(finished: Path) -> None:
    population = population_of(load_result(finished))
    stiffness, damping = gains(population, PHANTOM, 7, 100.0)
    assert damping[0] == 0
    assert stiffness[0] <= 100.0 < stiffness[-1]
    assert np.all(np.diff(stiffness) > 0)
    assert np.all(np.diff(damping) > 0)
    assert set(SMALL.central) == set(population.network.elements)
