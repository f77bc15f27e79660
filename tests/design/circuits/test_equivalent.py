"""Users with power laws, lines and wrappers as ladders: accuracy, passivity, ngspice and python-control."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from extended_results import extended
from results_by_hand import make_result
from scipy.io import loadmat

from bayes_impedance.commands.cli import main
from bayes_impedance.design.circuits import spice
from bayes_impedance.design.circuits.equivalent import NotRealisableError, equivalent, in_loop, why_not
from bayes_impedance.design.circuits.fractional import line_terms
from bayes_impedance.design.circuits.passivity_check import passive_coefficients, passive_states, positive_elements
from bayes_impedance.design.circuits.state_space import realise
from bayes_impedance.design.circuits.transfer_functions import read_control, transfer_function
from bayes_impedance.design.files import write_spice, write_transfer
from bayes_impedance.design.loop.device import PHANTOM
from bayes_impedance.design.loop.sampled_loop import largest_stiffness
from bayes_impedance.design.loop.stability import loop_of
from bayes_impedance.design.users import UserPopulation, Users
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.results.result import save_result

BAND = (5.0, 5000.0)
FREQUENCY = np.geomspace(*BAND, 97)  # none of those at which the package computes the error, but the ends
VALUES = {"m1": 8e-4, "m2": 5e-3, "r1": 5.0, "r3": 60.0, "r5": 3.0, "n1": 1e-3, "n2": 2e-3, "n3": 7e-7, "n5": 0.01}
VALUES |= {"p1": 30.0, "a1": 0.3, "p2": 0.05, "b1": 1.6, "e1": 0.1, "g1": 1.1, "k2": 50.0, "m_x": 1e-4, "f1": 3.0}
VALUES |= {"d1": 0.03, "k1": 200.0, "t1": 1e-4, "t2": 0.02}

needs_ngspice = pytest.mark.skipif(shutil.which("ngspice") is None, reason="ngspice is not installed")
needs_control = pytest.mark.skipif(
    importlib.util.find_spec("control") is None, reason="python-control is not installed"
)

LADDERS = (
    "m1|p1^a1@100",
    "(n3|r3)-(m1|p1^a1@100|r1)",
    "m1|p2^b1",
    "p1^0.5|m1",
    "line_free[m2](n1|r1)",
    "line_fixed[m2](n1|r1)",
    "line_free[r5](n5)",
    "line_fixed[r5](n5)",
    "line_matched[r5](n5)",
    "r1|gain[g1](line_fixed[r5](n5-r3))",
    "squeeze_film[r5, t1](m1|n1)",
    "gain[g1](squeeze_film[r5, t2](m1|n1))",
)


def population_of(text: str, draws: int = 5, spread: float = 0.2) -> UserPopulation:
    network = parse(text)
    free = [p for p in network.parameters if not p.held]
    centre = np.array([float(p.u(VALUES[p.name])) for p in free])
    return UserPopulation(
        network=network,
        unit="N s/m",
        mu=np.tile(centre, (draws, 1)),
        factor=np.tile(spread * np.eye(centre.size), (draws, 1, 1)),
        between_repetitions=np.zeros((draws, centre.size)),
        band_hz=BAND,
    )


def users_of(text: str, number: int = 12, spread: float = 0.2) -> Users:
    return population_of(text, spread=spread).draw(number, seed=1)


def worst(users: Users, z: np.ndarray) -> float:
    """Largest relative error against the recursion over the tree, which knows nothing of ladders."""
    wanted = [users.network.impedance(2j * np.pi * FREQUENCY, users.of(i)) for i in range(len(users))]
    return float(np.max(np.abs(z / np.array(wanted) - 1)))


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3])
@pytest.mark.parametrize("text", LADDERS)
def test_ladders_are_as_accurate_as_they_say_and_passive(text: str, accuracy: float) -> None:
    users = users_of(text)
    made = equivalent(users, accuracy)
    assert made.users.network.plain
    assert positive_elements(made.users).all()
    error = worst(users, made.users.impedance(FREQUENCY))
    assert 0 < error < 1.5 * accuracy
    assert error == pytest.approx(made.error, rel=0.3)
    states = realise(made.users.network, made.users.values)
    assert worst(users, states(2j * np.pi * FREQUENCY)) == pytest.approx(error, rel=1e-4)
    assert passive_states(made.users.network, made.users.values).all()
    for node in made.replaced:
        assert node in made.note
    assert f"{100 * made.error:.2g} % of every user's impedance from 5 to 5000 Hz" in made.note


def test_coefficients_of_ladders_are_passive_up_to_the_highest_degree() -> None:
    made = equivalent(users_of("line_free[m2](n1|r1)", 3)).users
    for i in range(3):
        z = transfer_function(made.network, made.of(i))
        assert z.denominator.size > 20
        assert passive_coefficients(z.numerator.tolist(), z.denominator.tolist())


@pytest.mark.parametrize(
    "text", ["m1|gain[g1](n1|r1)", "m1|offset[k2](r3)", "offset[m_x](gain[g1](n1-offset[r5](r3)))"]
)
def test_what_is_rational_is_exact(text: str) -> None:
    users = users_of(text)
    made = equivalent(users)
    assert made.error == 0
    assert made.note == ""
    assert made.users.network.plain
    assert worst(users, made.users.impedance(FREQUENCY)) < 1e-12


def test_plain_users_are_left_as_they_are() -> None:
    users = users_of("(n3|r3)-(m1|r1|n1)")
    assert equivalent(users).users is users


def test_a_loss_factor_has_its_phase_and_says_how_far_its_size_is_off() -> None:
    users = users_of("hysteretic[e1](n1)", spread=0.05)
    made = equivalent(users)
    z, wanted = made.users.impedance(FREQUENCY), users.impedance(FREQUENCY)
    np.testing.assert_allclose(np.angle(z / wanted), 0.0, atol=2e-3)
    middle = np.argmin(np.abs(np.log(FREQUENCY / np.sqrt(BAND[0] * BAND[1]))))
    np.testing.assert_allclose(np.abs(z / wanted)[:, middle], 1.0, rtol=5e-3)
    # |z| drifts with the power a of the frequency: by 3.45 a to either end of three decades.
    a = 2 / np.pi * np.arctan(users.values["e1"])
    assert made.error == pytest.approx(np.expm1(np.log(1000) / 2 * a.max()), rel=0.02)
    assert made.note.startswith("hysteretic[e1](...) is approximated by ladders")
    assert f"within {100 * made.error:.2g} %" in made.note


def test_what_cannot_be_made_of_elements_is_refused_in_one_sentence() -> None:
    for text, message in (
        ("m1|reflex[k1, d1, f1](n1)", r"reflex\[k1, d1, f1\]\(...\) has no finite state space"),
        ("m1|delay[d1](n1)", r"delay\[d1\]\(...\) has no finite state space"),
        ("m1|lowpass[t1](n1)", r"lowpass\[t1\]\(...\) has no finite state space"),
        ("hysteretic[e1](m1|n1)", "a loss factor applied to a mass is not passive"),
        ("line_matched[m2](n1)", r"the best ladder deviates by .* %"),
    ):
        with pytest.raises(NotRealisableError, match=message):
            equivalent(users_of(text))
    assert why_not(parse("m1|p1^a1")) == ""
    with pytest.raises(InputError, match="give the users one, band_hz"):
        equivalent(Users(parse("p1^a1"), "N s/m", ("one",), np.zeros((1, 2))))


def test_what_is_too_large_for_an_accuracy_is_coarser_and_says_so() -> None:
    users = users_of("line_free[m2](p1^a1@100)", 4)
    made = equivalent(users)
    assert 1e-3 < made.error < 1.5e-2
    with pytest.raises(NotRealisableError, match="more than the 100 that a stability analysis allows"):
        in_loop(users)


def test_terms_of_lines_sum_to_their_functions() -> None:
    # Far from the band's ends and for all phases from -90 to 90 degrees of w, on purpose over twelve decades.
    w = np.geomspace(1e-6, 1e6, 400)[:, None] * np.exp(1j * np.linspace(-np.pi / 2, np.pi / 2, 7))
    x = np.sqrt(w)
    for word, wanted in (("line_free", x / np.tanh(x)), ("line_fixed", x * np.tanh(x)), ("line_matched", x)):
        for accuracy in (1e-2, 1e-3):
            terms = line_terms(word, w, accuracy)
            assert np.all(terms.c > 0)
            assert min(terms.of_z, terms.of_y) >= 0
            found = terms.of_z + terms.of_y * w + np.sum(terms.c * w[..., None] / (w[..., None] + terms.kappa**2), -1)
            assert np.max(np.abs(found / wanted - 1)) < 1.5 * accuracy, word


def test_a_loop_with_a_ladder_has_the_limit_of_the_finer_ladder() -> None:
    users = users_of("(n3|r3)-(m1|p1^a1@100|r1)", 6)
    coarse = largest_stiffness(loop_of(PHANTOM, users), 0.0, 1e7)[0]
    fine = largest_stiffness(loop_of(PHANTOM, equivalent(users, 1e-5).users), 0.0, 1e7)[0]
    assert np.all(coarse > 0)
    np.testing.assert_allclose(coarse, fine, rtol=0.02)


# -------------------------------------------------------------------- other programs


@needs_ngspice
@pytest.mark.parametrize(
    "text", ["(n3|r3)-(m1|p1^a1@100|r1)", "r1|line_free[r5](n5)", "m1|gain[g1](hysteretic[e1](n1))"]
)
def test_ngspice_runs_extended_users(text: str, tmp_path: Path) -> None:
    population = population_of(text)
    users, made_of = population.draw(4, seed=2), population.median_user()
    made = equivalent(made_of + users)
    write_spice(tmp_path, population, users, made_of, BAND, made)
    done = subprocess.run(["ngspice", "-b", "sweep.cir"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (tmp_path / "sweep.txt").is_file(), done.stdout + done.stderr
    table = np.loadtxt(tmp_path / "sweep.txt", ndmin=2)
    z = (table[:, 1::2] + 1j * table[:, 2::2]).T
    np.testing.assert_allclose(z, made.users.impedance(table[:, 0]), rtol=1e-6)
    assert np.max(np.abs(z / (made_of + users).impedance(table[:, 0]) - 1)) < 1.1 * made.error


@needs_ngspice
def test_ngspice_draws_its_own_extended_users(tmp_path: Path) -> None:
    """Without a spread every instance is the centre; with one, z at one frequency has the population's distribution."""
    text = "(n3|r3)-(m1|p1^a1@100|r1)"
    for spread, number in ((1e-9, 2), (0.2, 300)):
        population = population_of(text, spread=spread)
        users = population.draw(2000, seed=3)
        made = equivalent(users)
        lines = ["* Monte Carlo", spice.OPTIONS, spice.monte_carlo(population, made=made)]
        for i in range(number):
            lines += [f"I{i} 0 z{i} AC 1", f"X{i} z{i} 0 any_user_fv"]
        shown = " ".join(f"v(z{i})" for i in range(number))
        lines += [".control", "set numdgt=15", "set wr_singlescale", "ac lin 2 50 500", f"wrdata out.txt {shown}"]
        (tmp_path / "deck.cir").write_text("\n".join([*lines, "quit", ".endc", ".end"]) + "\n", encoding="utf-8")
        subprocess.run(["ngspice", "-b", "deck.cir"], cwd=tmp_path, capture_output=True, check=False)
        table = np.loadtxt(tmp_path / "out.txt", ndmin=2)
        (tmp_path / "out.txt").unlink()
        z = np.log(np.abs(table[:, 1::2] + 1j * table[:, 2::2]))
        wanted = np.log(np.abs(users.impedance(table[:, 0]))).T
        if number == 2:
            np.testing.assert_allclose(z, wanted[:, :2], atol=2e-3)
        else:
            error = wanted.std(axis=1) / np.sqrt(number)
            np.testing.assert_array_less(np.abs(z.mean(axis=1) - wanted.mean(axis=1)), 4 * error)
            np.testing.assert_allclose(z.std(axis=1), wanted.std(axis=1), rtol=0.2)


@needs_control
@pytest.mark.parametrize("text", ["(n3|r3)-(m1|p1^a1@100|r1)", "m1|line_fixed[r5](n5)"])
def test_python_control_loads_extended_users(text: str, tmp_path: Path) -> None:
    population = population_of(text)
    users, centre = population.draw(3, seed=2), population.median_user()
    made = equivalent(centre + users)
    write_transfer(tmp_path, users, centre, made)
    table = json.loads((tmp_path / "transfer.json").read_text(encoding="utf-8"))
    assert table["network"] == text
    assert table["relative_error"] == made.error
    assert parse(table["equivalent_network"]).plain
    systems = read_control(tmp_path / "transfer.json")
    assert table["state_space_of"] == "mobility v/F"
    z = np.array([1 / systems[name](2j * np.pi * FREQUENCY) for name in (*centre.names, *users.names)])
    assert worst(centre + users, z) < 1.1 * made.error
    text = (tmp_path / "transfer.txt").read_text(encoding="utf-8")
    assert "centre: " in text


# -------------------------------------------------------------------- the command


U = {"p1": 2.0, "a1": -1.0, "k1": 5.0, "d1": -3.5, "f1": 3.0, "m9": -4.0}


def exported(text: str, folder: Path, *options: str) -> Path:
    network = parse(text)
    more = {p.name: U[p.name] for p in network.parameters if p.name in U}
    save_result(extended(make_result(covariance="diagonal"), text, more), folder / "fit")
    out = folder / "design"
    told = ["--users", "10", "--spanning", "2", "--grid", "3", "--no-pictures", *options]
    assert main(["export", str(folder / "fit"), "-o", str(out), *told]) == 0
    return out


def words_of(file: Path) -> str:
    """Everything that is said in a file; of a MATLAB file, in its warnings."""
    if file.suffix == ".mat":
        return " ".join(str(text.item()) for text in loadmat(file)["warnings"].ravel())
    return file.read_text(encoding="utf-8")


def test_a_power_law_is_exported_in_every_form_and_every_file_says_how_accurately(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = exported("m9*|(n3|r3)-(m2|r1|n1|p1^a1)", tmp_path)
    told = capsys.readouterr().out
    assert told.count("p1^a1 is approximated by ladders") == 2  # in circuits, and coarser in the loop
    assert "in the stability analysis p1^a1 is approximated" in told
    assert "it is stable for 99 % of users up to K = " in told
    files = [file for file in out.iterdir() if file.name[0] != "."]
    assert {file.name for file in files} >= {"transfer.json", "users.lib", "monte_carlo.lib", "stability.json"}
    for file in files:
        content = words_of(file)
        assert "p1^a1 is approximated by ladders" in content, file.name
        assert "the same for all or held: m9*" in content, file.name
    because = json.loads((out / "stability.json").read_text())["worst_user"]
    assert {entry["element"] for entry in because["because"]} == {"n3", "r3", "m2", "r1", "n1", "p1", "a1"}
    assert 0 < because["elements"]["a1"] < 1


def test_a_reflex_is_exported_as_tables_over_frequency(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = exported("(n3|r3)-(m2|r1|reflex[k1, d1, f1](n1))", tmp_path)
    note = "reflex[k1, d1, f1](...) has no finite state space: impedances are exported as tables over frequency"
    assert note in capsys.readouterr().out
    files = {file.name for file in out.iterdir() if file.name[0] != "."}
    assert files == {"users.csv", "users.json", "curves.csv", "transfer.json", "transfer.txt", "users.mat"}
    assert all(note in words_of(out / name) for name in files)
    table = json.loads((out / "transfer.json").read_text(encoding="utf-8"))
    assert json.loads((out / "users.json").read_text(encoding="utf-8"))["passive"] is None
    frequency, entry = np.array(table["frequency_hz"]), table["users"][-1]
    lines = [line for line in (out / "users.csv").read_text(encoding="utf-8").splitlines() if line[0] != "#"]
    network = parse(table["network"])
    user = dict(zip(network.elements, map(float, lines[-1].split(",")[1:]), strict=True))
    z = network.impedance(2j * np.pi * frequency, user)
    np.testing.assert_allclose(np.array(entry["re"]) + 1j * np.array(entry["im"]), z, rtol=1e-10)


@needs_control
def test_python_control_loads_tables(tmp_path: Path) -> None:
    out = exported("(n3|r3)-(m2|r1|reflex[k1, d1, f1](n1))", tmp_path, "--what", "transfer")
    table = json.loads((out / "transfer.json").read_text(encoding="utf-8"))
    systems = read_control(out / "transfer.json")
    omega = 2 * np.pi * np.array(table["frequency_hz"])
    z = systems[table["users"][0]["name"]](1j * omega[7:9])
    np.testing.assert_allclose(z.real, table["users"][0]["re"][7:9], rtol=1e-10)


def test_stability_alone_of_a_reflex_is_one_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "(n3|r3)-(m2|r1|reflex[k1, d1, f1](n1))"
    save_result(
        extended(make_result(covariance="diagonal"), text, {k: U[k] for k in ("k1", "d1", "f1")}), tmp_path / "f"
    )
    assert main(["export", str(tmp_path / "f"), "-o", str(tmp_path / "out"), "--what", "stability"]) == 2
    assert "has no finite state space" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
