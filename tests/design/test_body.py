"""Users are the body alone: what the rig adds to a recording is taken out of the network and of the draws."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from extended_results import extended
from results_by_hand import make_result

from bayes_impedance.commands.cli import main
from bayes_impedance.design.body import body_of
from bayes_impedance.design.users import UserPopulation, Users, population_of
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.results.result import save_result

S = 2j * np.pi * np.geomspace(5.0, 5000.0, 40)

NEUTRAL = {"m9": 1e-40, "n9": 1e-40, "m8": 1e40, "r9": 1e-40, "p9": 1e-40, "a9": 0.5}
NEUTRAL |= {"d9": 0.0, "f9": 0.0, "t9": 0.0, "g9": 1.0, "k9": 0.0}
"""Values with which parts of the rig do nothing: no mass beside, a rigid link in a chain, no delay."""
OWN = {"m1": 8e-4, "r1": 5.0, "n1": 1e-3, "n3": 7e-7, "r3": 60.0, "p1": 30.0, "a1": 0.3}
OWN |= {"d1": 0.03, "k1": 200.0, "f1": 3.0, "e1": 0.2, "g1": 1.1, "t1": 1e-4}


@pytest.mark.parametrize(
    ("whole", "body", "removed"),
    [
        ("m9*|(n3|r3)-(m1|r1)", "(n3|r3)-(m1|r1)", ["m9*"]),
        ("n9*-(m1|r1)", "m1|r1", ["n9*"]),
        ("m8*-n9*-(m1|r1)", "m1|r1", ["m8*", "n9*"]),
        ("(m9*|r9*|p9*^a9*)|m1", "m1", ["m9*", "r9*", "p9*^a9*"]),
        ("delay[d9*](highpass[f9*](lowpass[t9*](m1|r1)))", "m1|r1", None),
        ("m1|gain[g9*](n1|r1)", "m1|n1|r1", ["gain[g9*](...)"]),
        ("offset[k9*](m1|delay[d9*](m9*|n1))-r1", "(m1|n1)-r1", ["offset[k9*](...)", "delay[d9*](...)", "m9*"]),
        ("skin:(n3|m9*)-tissue:(m1|r1)", "skin:n3-tissue:(m1|r1)", ["m9*"]),
        ("a:(m9*|b:(n3|r3))-m1", "b:(n3|r3)-m1", ["m9*"]),
        ("m1|p1^a1", "m1|p1^a1", []),
        ("m1|p1^a9*", "m1|p1^a9*", []),
        ("m1|reflex[k1, d1, f1](n1)|hysteretic[e1](n3)", "m1|reflex[k1, d1, f1](n1)|hysteretic[e1](n3)", []),
        ("m1|delay[d1](gain[g1](n1))", "m1|delay[d1](gain[g1](n1))", []),
        ("line_free[m1](n1|m9*)", "line_free[m1](n1)", ["m9*"]),
    ],
)
def test_the_body_is_the_network_whose_rig_does_nothing(whole: str, body: str, removed: list[str] | None) -> None:
    network = parse(whole)
    found = body_of(network)
    assert str(found.network) == str(parse(body))
    assert [network.elements[i] for i in found.columns] == list(found.network.elements)
    if removed is not None:
        assert list(found.removed) == removed
    assert all(text in found.note for text in found.removed)
    assert bool(found.note) == bool(found.removed)
    np.testing.assert_allclose(
        found.network.impedance(S, OWN | NEUTRAL), network.impedance(S, OWN | NEUTRAL), rtol=1e-10
    )


def test_what_is_held_is_the_rig_s_too() -> None:
    found = body_of(parse("offset[m2=0.001](lowpass[t1=2e-5](m9=0.0115|(n3|r3)-(m1|p1^0.5)))"))
    assert str(found.network) == "(n3|r3)-(m1|p1^0.5)"
    assert found.removed == ("offset[m2=0.001](...)", "lowpass[t1=2e-05](...)", "m9=0.0115")


@pytest.mark.parametrize("text", ["m9*", "delay[d9*](m9*|n9=1e-6)", "m9*|n9*-r9*"])
def test_a_rig_without_a_body_is_one_error(text: str) -> None:
    with pytest.raises(InputError, match=r"nothing of .* belongs to the body"):
        body_of(parse(text))


def test_a_wrapper_of_the_body_around_the_rig_is_an_error() -> None:
    with pytest.raises(InputError, match=r"reflex\[k1, d1, f1\]\(...\) belongs to the body, but all that it wraps"):
        body_of(parse("m1|reflex[k1, d1, f1](n9*)"))


def test_columns_of_the_rig_leave_the_draws() -> None:
    plain = make_result(covariance="diagonal")
    text = "delay[d1*](m9*|skin:(n3|r3)-tissue:(m2|r1|n1))"
    whole = population_of(extended(plain, text, {"d1": 1e-5, "m9": -4.0}))
    alone = population_of(plain)
    assert whole.network == alone.network
    for name in ("mu", "factor", "between_repetitions"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(alone, name))
    assert whole.removed == ("delay[d1*](...)", "m9*")
    assert alone.removed == ()
    assert alone.note == ""


def test_exponents_and_wrappers_of_the_body_are_drawn_on_their_own_scales() -> None:
    text = "skin:(n3|r3)-tissue:(m2|r1|n1|p1^a1|hysteretic[e1](n2))"
    population = population_of(
        extended(make_result(covariance="diagonal"), text, {"p1": 2.0, "a1": -1.0, "e1": -2.0, "n2": -6.0})
    )
    users = population.draw(4000, seed=1)
    assert np.all((users.values["a1"] > 0) & (users.values["a1"] < 1))
    assert np.median(users.values["a1"]) == pytest.approx(1 / (1 + np.e), rel=0.03)
    assert np.std(np.log(users.values["a1"] / (1 - users.values["a1"]))) == pytest.approx(np.hypot(0.2, 0.1), rel=0.05)
    assert users.units["a1"] == ""
    assert users.units["p1"] == "N s/m"
    assert users.of(3)["e1"] == users.values["e1"][3] == users.to_dataframe()["e1"].iloc[3]
    row = users[[3]]
    np.testing.assert_allclose(
        row.impedance([50.0, 80.0])[0],
        users.network.impedance(2j * np.pi * np.array([50.0, 80.0]), users.of(3)),
        rtol=1e-10,
    )
    np.testing.assert_allclose(population.weights(users, 20).sum(axis=1), 1)


def test_what_the_body_shares_differs_between_populations_only() -> None:
    text = "skin:(n3|r3)-tissue:(m2|r1|n1|p1^a1*)"
    population = population_of(extended(make_result(covariance="diagonal"), text, {"p1": 2.0, "a1": -1.0}))
    assert population.shared == ("a1",)
    users = population.draw(60, seed=2)
    a1 = users.elements.index("a1")
    rows = np.linspace(0, len(population.mu) - 1, 60).astype(int)
    np.testing.assert_array_equal(users.u[:, a1], population.mu[rows, a1])
    # The density of people does not depend on what they share, so the weights are those without it.
    keep = [i for i in range(len(users.elements)) if i != a1]
    without = UserPopulation(
        network=parse("skin:(n3|r3)-tissue:(m2|r1|n1|p1^0.3)"),
        unit="N s/m",
        mu=population.mu[:, keep],
        factor=population.factor[:, keep][:, :, keep],
        between_repetitions=population.between_repetitions[:, keep],
    )
    people = without.users(users.names, users.u[:, keep])
    np.testing.assert_allclose(population.weights(users, 10), without.weights(people, 10), rtol=1e-10)


def test_assumed_values_are_on_the_parameter_s_own_scale() -> None:
    text = "skin:(n3|r3)-tissue:(m2|r1|n1|p1^a1)"
    result = extended(make_result(covariance="diagonal"), text, {"p1": 2.0, "a1": np.nan})
    population = population_of(result, {"a1": 0.25})
    np.testing.assert_allclose(population.draw(5, seed=1).values["a1"], 0.25)
    with pytest.raises(InputError, match=r"cannot be 2\.0: it must be between 0 and 1"):
        population_of(result, {"a1": 2.0})
    with pytest.raises(InputError, match=r"elements among n3, r3, m2, r1, n1$"):
        population_of(
            extended(make_result(covariance="diagonal"), "m9*|(n3|r3)-(m2|r1|n1)", {"m9": -4.0}), {"m9": 0.01}
        )


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    """Folder of a fit whose network has a delay, a rig's mass and a power law besides."""
    text = "delay[d1*](m9*|(n3|r3)-(m2|r1|n1|p1^a1))"
    result = extended(make_result(covariance="diagonal"), text, {"d1": 1e-5, "m9": -4.0, "p1": 1.0, "a1": -1.0})
    save_result(result, tmp_path / "fit")
    return tmp_path / "fit"


def test_what_was_taken_out_is_told_in_the_terminal_and_in_every_file(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "design"
    options = ["--users", "12", "--spanning", "2", "--no-pictures", "--what", "users"]
    assert main(["export", str(finished), "-o", str(out), *options]) == 0
    note = "the same for all or held: delay[d1*](...), m9*"
    assert note in capsys.readouterr().out
    files = [file for file in sorted(out.iterdir()) if file.name[0] != "."]
    assert files
    assert all(note in file.read_text(encoding="utf-8") for file in files)
    told = json.loads((out / "users.json").read_text(encoding="utf-8"))
    assert told["network"] == "(n3|r3)-(m2|r1|n1|p1^a1)"
    assert told["taken_out"] == ["delay[d1*](...)", "m9*"]
    assert told["scales"]["a1"] == "logit"
    lines = (out / "users.csv").read_text(encoding="utf-8").splitlines()
    assert next(line for line in lines if line[0] != "#") == (
        "user,n3 (m/N),r3 (N s/m),m2 (kg),r1 (N s/m),n1 (m/N),p1 (N s/m),a1"
    )


def test_users_of_a_population_without_a_band_have_none() -> None:
    users = Users(parse("m1|r1"), "N s/m", ("one",), np.zeros((1, 2)))
    assert users.band_hz is None
    assert population_of(make_result(covariance="diagonal")).draw(2, seed=1).band_hz == pytest.approx((5.0, 5000.0))
