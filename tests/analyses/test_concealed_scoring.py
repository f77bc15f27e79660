"""Verdicts are scored by what they say; cases are run once, counted and put into the tables."""

import importlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA

from bayes_impedance.network.notation import Element, parse

FOLDER = DATA.parent / "analyses" / "concealed"
sys.path.insert(0, str(FOLDER))  # the scripts import each other by name, as when they are run
people, forms, effects, scoring, runs, catalogue_table, false_alarms = (
    importlib.import_module(name)
    for name in ("people", "forms", "effects", "scoring", "runs", "catalogue_table", "false_alarms")
)


def _verdict(identifier: str | None, place: str = "port", **more: Any) -> dict[str, Any]:
    """A verdict by hand, of the schema of DESIGN section 5."""
    if identifier is None:
        return {"mismatch": False, "physics": [], "where": None, "improvement": None}
    where = {"bands_hz": [[700, 5000]], "side": identifier.split(".")[0], "subjects": "all", "covariate": None}
    first = {
        "id": identifier,
        "place": place,
        "side": identifier.split(".")[0],
        "parameters": more.pop("parameters", {}),
        "aliases": more.pop("aliases", []),
    }
    return {
        "mismatch": True,
        "physics": [first],
        "where": where | more,
        "improvement": {"elpd_gain": 985.0, "elpd_gain_se": 40.0},
    }


def _truth(name: str, **more: Any) -> dict[str, Any]:
    place = more.pop("place", "port")
    truth = {
        "id": name,
        "mismatch": True,
        "place": place,
        "places": list(forms.same_places(name, place)),
        "side": name.split(".")[0],
        "parameters": {"delay": {"value": 1.5e-6, "unit": "s", "dispersion": 0.0}},
        "also": {},
        "bands_hz": [[900.0, 4000.0]],
        "visible": 50.0,
        "visible_bands_hz": [[2000.0, 4000.0]],
        "subjects": "all",
        "covariate": None,
    }
    return truth | more


def test_a_perfect_verdict_scores_in_full() -> None:
    parameters = {"delay": {"unit": "s", "median": 1.5e-6, "q05": 1.4e-6, "q95": 1.6e-6, "dispersion": 0.0}}
    found = scoring.score(_verdict("rig.delay", parameters=parameters), _truth("rig.delay"))
    assert all(found[name] for name in scoring.YES_NO)
    assert found["parameters"] == {"delay": True}
    assert found["elpd_gain"] == 985.0


def test_an_interval_that_misses_and_one_that_is_not_given() -> None:
    low = {"delay": {"unit": "s", "q05": 1.2e-6, "q95": 1.4e-6}}
    assert scoring.score(_verdict("rig.delay", parameters=low), _truth("rig.delay"))["parameters"] == {"delay": False}
    assert scoring.score(_verdict("rig.delay"), _truth("rig.delay"))["parameters"] == {}


def test_another_name_of_a_parameter_is_understood() -> None:
    truth = _truth("rig.lowpass", parameters={"corner_hz": {"value": 5e4, "unit": "Hz", "dispersion": 0.0}})
    verdict = _verdict("rig.lowpass", parameters={"corner": {"unit": "Hz", "q05": 4e4, "q95": 6e4}})
    assert scoring.score(verdict, truth)["parameters"] == {"corner_hz": True}
    truth["also"] = {"time_constant": {"value": 3.2e-6, "unit": "s"}}
    verdict = _verdict("rig.lowpass", parameters={"time_constant": {"unit": "s", "q05": 1e-6, "q95": 2e-6}})
    assert scoring.score(verdict, truth)["parameters"] == {"time_constant": False}


def test_the_exponent_of_a_changed_spring_is_not_that_of_a_springpot_beside_it() -> None:
    truth = _truth("body.springpot", place="skin", parameters={"exponent": {"value": 0.4, "unit": "1"}})
    exponent = {"exponent": {"unit": "", "q05": 0.1, "q95": 0.2}}
    assert scoring.score(_verdict("body.springpot", "n3", parameters=exponent), truth)["parameters"] == {}
    both = exponent | {"coefficient": {"unit": "N s^a/m", "median": 3.0}}
    assert scoring.score(_verdict("body.springpot", "n3", parameters=both), truth)["parameters"] == {"exponent": False}


@pytest.mark.parametrize(("separated", "honest"), [(False, True), (True, False)])
def test_an_alias_counts_only_if_it_is_said_to_be_undecided(separated: bool, honest: bool) -> None:
    aliases = [{"id": "rig.delay", "place": "port", "separated": separated}]
    found = scoring.score(_verdict("rig.mass", aliases=aliases), _truth("rig.delay"))
    assert not found["first"]
    assert found["first_or_undecided"] is honest
    assert found["side"]
    assert found["parameters"] == {}


def test_nothing_found_scores_nothing() -> None:
    found = scoring.score(_verdict(None), _truth("rig.delay"))
    assert not any(found[name] for name in scoring.YES_NO)
    assert found["said"] is None


def test_null_truth_counts_claims_only() -> None:
    nothing = {"id": "none", "mismatch": False}
    assert scoring.score(_verdict(None), nothing) == {"detected": False, "said": None}
    assert scoring.score(_verdict("rig.mass"), nothing) == {"detected": True, "said": "rig.mass"}


@pytest.mark.parametrize(
    ("true", "place", "said", "at", "right"),
    [
        ("body.springpot", "skin", "body.springpot", "n3", True),
        ("body.springpot", "tissue", "body.springpot", "limb", True),
        ("body.springpot", "tissue", "body.springpot", "skin", False),
        ("body.springpot", "skin", "body.relaxation", "r3", True),
        ("body.hysteresis", "n1", "body.hysteresis", "tissue", False),
        ("body.subgroup", "port", "body.subgroup", "skin", True),
        ("body.line", "skin", "body.line", "port", False),
    ],
)
def test_places_are_compared_as_networks(true: str, place: str, said: str, at: str, right: bool) -> None:
    assert scoring.score(_verdict(said, at), _truth(true, place=place))["place"] is right


@pytest.mark.parametrize(
    ("name", "places", "series"),
    [("body.springpot", group, False) for group in forms._SAME_PARALLEL]
    + [("body.subgroup", group, True) for group in forms._SAME_SERIES],
)
def test_same_places_are_one_network(name: str, places: tuple[str, ...], series: bool) -> None:
    network = parse(people.NETWORK)
    values = people.CENTRAL | {"r9": 3.0, "n9": 1e-4}
    s = 2j * np.pi * np.geomspace(5, 5000, 9)
    extra = Element("r9") - Element("n9") if not series else Element("r9") | Element("n9")
    found = [(network.in_series if series else network.beside)(p, extra).impedance(s, values) for p in places]
    assert all(z == pytest.approx(found[0], rel=1e-12) for z in found)
    assert set(forms.same_places(name, places[1])) == set(places)


def test_a_slope_is_compared_in_the_verdicts_terms() -> None:
    slope = {"value": 0.4, "per_sd": 0.1, "signs": {"n3": -1, "r3": 1}, "unit": "1", "dispersion": 0.0}
    truth = _truth("body.covariate", place="skin", covariate="contact_force_n", parameters={"slope": slope})
    given = {"slope": {"unit": "1", "q05": -0.5, "q95": -0.3}}
    verdict = _verdict("body.covariate", "n3", parameters=given, covariate="contact_force_n")
    found = scoring.score(verdict, truth)
    assert found["parameters"] == {"slope": True}
    assert found["covariate"]
    assert found["place"]
    given["slope"] = {"unit": "1 per sd of contact_force_n", "q05": -0.12, "q95": -0.08}
    assert scoring.score(verdict, truth)["parameters"] == {"slope": True}
    assert scoring.score(verdict | {"where": {"covariate": "age_y"}}, truth)["covariate"] is False


def test_people_of_a_subgroup_are_counted() -> None:
    truth = _truth("body.subgroup", subjects=["V01", "V02", "V03"])
    found = scoring.score(_verdict("body.subgroup", subjects=["V02", "V03", "V09"]), truth)
    assert found["people"] == {"concerned": 3, "hits": 2, "false": 1}


def test_intervals_of_rates() -> None:
    # Closed forms: none of n, all of n; and the textbook value for 9 of 10.
    assert scoring.clopper_pearson(0, 10) == pytest.approx((0.0, 1 - 0.025**0.1))
    assert scoring.clopper_pearson(10, 10) == pytest.approx((0.025**0.1, 1.0))
    assert scoring.clopper_pearson(9, 10) == pytest.approx((0.5550, 0.9975), abs=1e-4)
    assert scoring.clopper_pearson(0, 0) == (0.0, 1.0)


def test_done_cases_are_skipped_and_failures_tried_again(tmp_path: Path) -> None:
    path, calls = tmp_path / "results" / "lines.jsonl", []

    def work(case: Mapping[str, Any]) -> dict[str, Any]:
        calls.append(case["seed"])
        if case["seed"] == 2 and calls.count(2) == 1:
            raise RuntimeError("not today")
        return {"value": np.int64(10 * case["seed"])}

    asked = [{"seed": seed} for seed in (1, 2, 3)]
    runs.run_cases(asked, work, path, 0, lambda _: None)
    assert [("error" in r) for r in runs.read_lines(path)] == [False, True, False]
    with path.open("a", encoding="utf-8") as file:
        file.write('{"case": {"seed": 4}, "val')  # a kill in the middle of a line
    runs.run_cases([*asked, {"seed": 4}], work, path, 0, lambda _: None)
    assert calls == [1, 2, 3, 2, 4]
    assert {r["case"]["seed"]: r["value"] for r in runs.read_lines(path)} == {1: 10, 2: 20, 3: 30, 4: 40}


def _answer(verdicts: Mapping[str, dict[str, Any]]) -> Any:
    """Stands for the diagnosis: it knows what was concealed."""

    def one_case(case: Mapping[str, Any]) -> dict[str, Any]:
        _, truth = effects.concealed(case["id"], case["place"], case["strength"] or 0.3, case["seed"], 5, 2, 41)
        return {"truth": truth, "verdict": verdicts[case["id"]]}

    return one_case


def test_the_table_counts_what_the_verdicts_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undecided = [{"id": "rig.lowpass", "place": "port", "separated": False}]
    verdicts = {name: _verdict(name) for name in forms.EFFECTS} | {
        "none": _verdict("rig.mass"),
        "body.correlation": _verdict(None),
        "rig.lowpass": _verdict("rig.delay", aliases=undecided),
        "rig.mass": _verdict(None),
    }
    monkeypatch.setattr(catalogue_table, "one_case", _answer(verdicts))
    asked = ["rig.delay", "rig.lowpass", "rig.mass", "none", "body.correlation"]
    command = ["catalogue_table.py", "--seeds", "2", "--jobs", "0", "-o", str(tmp_path), "--only", *asked]
    monkeypatch.setattr(sys, "argv", command)
    before = (FOLDER / "README.md").read_text(encoding="utf-8")
    catalogue_table.main()
    assert (FOLDER / "README.md").read_text(encoding="utf-8") == before  # a part of the catalogue is not the table
    lines = (tmp_path / "table.csv").read_text(encoding="utf-8").splitlines()
    rows = {line.split(",")[0]: dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]}
    assert list(rows) == ["rig.mass", "rig.delay", "rig.lowpass", "all", "all visible (6 or more)"]
    counts = ("cases", "detected", "first", "first_or_undecided")
    assert [rows["all"][key] for key in counts] == ["6", "4", "2", "4"]
    text = catalogue_table.markdown(catalogue_table.scored(runs.read_lines(tmp_path / "catalogue.jsonl")), 0)
    assert "`rig.mass` called `nothing` 2 times" in text
    assert "`rig.lowpass` called" not in text
    assert "`none`: something was claimed in 2/2" in text
    assert "`body.correlation`: something was claimed in 0/2" in text


def test_what_elements_do_is_concealed_more_strongly() -> None:
    options = catalogue_table.argparse.Namespace(
        seeds=1, first_seed=1, strength=0.3, only=None, subjects=40, points=201, through_command=False
    )
    strengths = {case["id"]: case["strength"] for case in catalogue_table.cases(options)}
    assert set(strengths) == set(forms.EFFECTS)
    assert strengths["body.covariate"] == strengths["body.drift"] == 0.75
    assert strengths["none"] == 0.0
    assert strengths["rig.mass"] == 0.3


def test_false_alarms_are_counted_and_listed() -> None:
    records = [
        {
            "case": {"seed": seed},
            "conditions": {"noise": 0.01},
            "verdict": _verdict("body.mass" if seed == 3 else None),
        }
        for seed in range(20)
    ]
    assert [row["claimed"] for row in false_alarms.claims(records)] == ["body.mass@port"]
    text = false_alarms.summary([*records, {"case": {"seed": 99}, "error": "no"}])
    assert "1 of 20 populations (0.1-24.9 %)" in text
    assert "1 ended with an error" in text
    drawn = [false_alarms.conditions(seed) for seed in range(50)]
    assert len({c.gain_error for c in drawn}) == 50
    assert all(0.02 <= c.repositioning[0] <= c.repositioning[1] <= 0.12 and c.communality < 0.95 for c in drawn)


def test_a_part_of_a_readme_is_replaced_between_its_markers(tmp_path: Path) -> None:
    file = tmp_path / "README.md"
    file.write_text("a\n<!-- x:start -->\nold\n<!-- x:end -->\nb\n", encoding="utf-8")
    runs.replace_between(file, "x", "new\n")
    assert file.read_text(encoding="utf-8") == "a\n<!-- x:start -->\nnew\n<!-- x:end -->\nb\n"
    with pytest.raises(ValueError, match="exactly one"):
        runs.replace_between(file, "y", "new")
    readme = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert all(
        readme.count(f"<!-- {name}:{end} -->") == 1
        for name in ("catalogue", "false-alarms")
        for end in ("start", "end")
    )
