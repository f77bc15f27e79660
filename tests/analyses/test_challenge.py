"""The challenge: cases cannot be changed after they are sealed, and scores, rivals and power are counted correctly."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.files import read_recordings

FOLDER = DATA.parent / "analyses" / "concealed"
sys.path.insert(0, str(FOLDER))  # the scripts import each other by name, as when they are run
kinds, experiment = (importlib.import_module(f"world.{name}") for name in ("kinds", "experiment"))
people, challenge, scoring, visible, rivals, on_real, power, run = (
    importlib.import_module(name)
    for name in (
        "people",
        "challenge",
        "challenge_scoring",
        "visible_in_world",
        "rivals",
        "on_real",
        "power",
        "run",
    )
)


def _plan(name: str, strength: float = 0.3, **sizes: Any) -> Any:
    return experiment.Plan(kinds=(name,), strengths=(strength,), seed=3, **({"n_subjects": 8, "n_points": 41} | sizes))


def test_draw_has_the_stated_shares() -> None:
    plans = challenge.draw(5, 60)
    groups = [kinds.KINDS[p.kinds[0]].group if len(p.kinds) == 1 else "pair" for p in plans]
    assert {g: groups.count(g) for g in set(groups)} == {
        "catalogue": 27,
        "pair": 6,
        "outside": 9,
        "trap": 7,
        "nothing": 11,
    }
    assert challenge.draw(5, 60) == plans
    assert challenge.draw(6, 60) != plans
    for plan in plans:
        assert challenge.plan_from(json.loads(json.dumps(challenge.plan_dict(plan)))) == plan


def test_seal_shows_tampering_and_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    sizes = challenge.Sizes((5,), (21,))
    seals = [challenge.prepare(challenge.draw(4, 3, sizes), tmp_path / name, 4) for name in ("a", "b")]
    assert seals[0] == seals[1]
    for path in sorted((tmp_path / "a").rglob("*.csv")):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()
    answers = challenge.sealed_answers(tmp_path / "a")
    for answer in answers:  # nothing in the folder tells what is at work
        text = "".join(
            p.read_text(encoding="utf-8") for p in (tmp_path / "a" / "datasets" / answer["case"]).glob("*.toml")
        )
        assert f'title = "{answer["case"]}"' in text
        assert not any(name in text for name in answer["truth"]["kinds"])
    table = tmp_path / "b" / "datasets" / "case_001" / "recordings.csv"
    table.write_text(table.read_text(encoding="utf-8").replace("P001,1,5.0,", "P001,1,5.0,9"), encoding="utf-8")
    with pytest.raises(ValueError, match="digest differs"):
        challenge.sealed_answers(tmp_path / "b")
    sealed = tmp_path / "a" / challenge.SEALED
    sealed.write_text(sealed.read_text(encoding="utf-8").replace('"visible"', '"visible" '), encoding="utf-8")
    with pytest.raises(ValueError, match="not what was sealed"):
        challenge.sealed_answers(tmp_path / "a")


def test_verdicts_on_other_data_are_refused() -> None:
    answers = [{"case": "case_001", "data_sha256": "x"}]
    record = {"case": {"folder": "f", "data_sha256": "x", "seed": 1}, "verdict": {"data_sha256": "y"}}
    with pytest.raises(ValueError, match="other data"):
        challenge.matched(answers, [record])
    record["verdict"]["data_sha256"] = "x"
    assert challenge.matched(answers, [record]) == [(answers[0], record)]
    assert challenge.matched([{"case": "case_002", "data_sha256": "z"}], [record]) == []


def _entry(name: str, place: str, side: str = "rig", **parameters: tuple[float, float]) -> dict[str, Any]:
    return {
        "id": name,
        "place": place,
        "side": side,
        "parameters": {k: {"unit": "", "q05": low, "q95": high} for k, (low, high) in parameters.items()},
        "aliases": [],
    }


def _verdict(*physics: dict[str, Any], gain: float = 5.0) -> dict[str, Any]:
    improvement = {"elpd_gain": gain, "elpd_gain_se": 1.0, "delta_magnitude": [1.0, 0.8]}
    where = {"bands_hz": [[3000, 5000]], "subjects": "all", "covariate": None}
    return {
        "mismatch": bool(physics),
        "physics": list(physics),
        "where": where,
        "improvement": improvement if physics else None,
    }


def test_score_of_verdicts_made_by_hand() -> None:
    e = experiment.conduct(_plan("rig.delay"))
    truth = visible.truth_of(e)
    tau = e.values[0]["size"]
    low, high = sorted((0.8 * tau, 1.2 * tau))
    right = scoring.score_case(_verdict(_entry("rig.delay", "port", delay=(low, high))), truth, e)
    assert right["first"]
    assert right["side"]
    assert right["band"]
    assert right["same"]
    assert right["right"]
    assert right["parameters"] == [True]
    assert right["improved"] == {"delta_magnitude": 0.8}
    alias = _entry("rig.mass", "port")
    alias["aliases"] = [{"id": "rig.delay", "place": "port", "separated": False}]
    honest = scoring.score_case(_verdict(alias), truth, e)
    assert not honest["first"]
    assert honest["right"]
    assert not honest["same"]
    wrong = scoring.score_case(_verdict(_entry("body.line", "skin", "body")), truth)
    assert wrong["detected"]
    assert not wrong["right"]
    assert not wrong["side"]
    missed = scoring.score_case(_verdict(), truth)
    assert not missed["detected"]
    rows = [right, honest, wrong, missed]
    rates = scoring.summary(rows)
    assert rates["right name or honest alias set"] == (2, 4)
    assert rates["detected, of detectable catalogue cases"] == (3, 4)
    assert rates["90 % intervals that cover"] == (1, 1)
    assert "rig.delay" in scoring.markdown(rows, 0, 0)
    assert scoring.confusion(rows)[2].sum() == 4


def test_score_of_pairs_unknowns_and_traps() -> None:
    pair = experiment.Plan(kinds=("rig.highpass", "body.line"), strengths=(0.3, 0.3), seed=3, n_subjects=8, n_points=41)
    truth = visible.truth_of(experiment.conduct(pair))
    both = scoring.score_case(_verdict(_entry("body.line", "skin", "body"), _entry("rig.highpass", "port")), truth)
    assert both["right"]
    assert both["both"]
    one = scoring.score_case(_verdict(_entry("rig.highpass", "port")), truth)
    assert one["right"]
    assert not one["both"]
    outside = visible.truth_of(experiment.conduct(_plan("outside.crosstalk")))
    unknown = {**_entry("unknown", "port"), "side": None}
    assert scoring.score_case(_verdict(unknown), outside)["right"]
    assert not scoring.score_case(_verdict(unknown, gain=-1.0), outside)["right"]
    assert not scoring.score_case(_verdict(_entry("rig.mass", "port")), outside)["right"]
    trap = visible.truth_of(experiment.conduct(_plan("trap.port_stiffness")))
    assert scoring.score_case(_verdict(_entry("rig.mass", "port")), trap)["false_claim"]
    assert not scoring.score_case(_verdict(_entry("rig.stiffness", "port")), trap)["false_claim"]
    assert not scoring.score_case(_verdict(), trap)["false_claim"]


def test_confusion_is_drawn(tmp_path: Path) -> None:
    truth = visible.truth_of(experiment.conduct(_plan("rig.delay")))
    scoring.draw_confusion([scoring.score_case(_verdict(), truth)], tmp_path / "confusion.png")
    assert (tmp_path / "confusion.png").stat().st_size > 1000


def test_rivals_fit_the_network_exactly() -> None:
    plan = _plan("nothing", conditions=replace(people.Conditions(), noise=1e-9, gain_error=0.0))
    e = experiment.conduct(plan)
    kernel = Kernel(parse(people.NETWORK))
    z = e.clean[:, 0]
    u, rss = rivals.best_of_starts(kernel, plan.frequency_hz, z, 1)
    assert np.sqrt(np.max(rss) / z.shape[1]) < 1e-3
    assert np.median(np.abs(u - e.fingers.log_elements[:, 0])) < 0.02


def test_added_to_real_recordings_by_its_formula() -> None:
    recordings = read_recordings(DATA / "appendix_a" / "sit")
    subject = recordings.subjects[0]
    s = 2j * np.pi * subject.frequency_hz
    for effect in on_real.EFFECTS:
        size = on_real.size_for(effect, recordings, 0.1)
        ratio = on_real.changed(recordings, effect, size).subjects[0].z[0] / subject.z[0] - 1
        assert np.abs(ratio).max() == pytest.approx(0.1, rel=0.1)
    added = on_real.changed(recordings, "mass", 2e-4).subjects[0].z - subject.z
    assert np.allclose(added, 2e-4 * s)


def test_recovery_counts_a_new_claim_or_a_difference() -> None:
    def verdict(*rows: tuple[str, float, float, float]) -> dict[str, Any]:
        return {
            "physics": [
                {"id": i, "place": "port", "parameters": {"delay": {"q05": a, "median": b, "q95": c}}, "aliases": []}
                for i, a, b, c in rows
            ]
        }

    nothing, found = verdict(), verdict(("rig.delay", 0.9, 1.0, 1.1))
    assert on_real.recovered(nothing, found, "delay", 1.05, 0.0)[0]
    assert not on_real.recovered(nothing, found, "delay", 2.0, 0.0)[0]
    assert on_real.recovered(found, verdict(("rig.delay", 2.9, 3.0, 3.1)), "delay", 2.0, 0.0)[0]
    assert not on_real.recovered(found, nothing, "delay", 2.0, 0.5)[0]
    assert on_real.recovered(found, nothing, "delay", 2.0, 0.95)[0]


def test_a_claim_that_does_the_same_to_real_recordings_explains_the_addition() -> None:
    recordings = read_recordings(DATA / "appendix_a" / "sit")
    size = on_real.size_for("delay", recordings, 0.1)

    def verdict(name: str, parameter: str, value: float) -> dict[str, Any]:
        return {"physics": [{"id": name, "place": "port", "parameters": {parameter: {"median": value}}}]}

    same = on_real.explained(verdict("rig.delay", "delay", size), recordings, "delay", size)
    lowpass = on_real.explained(verdict("rig.lowpass", "time_constant", size), recordings, "delay", size)
    assert same == pytest.approx(1.0)
    assert 0.95 < lowpass < 1.0
    assert on_real.explained(verdict("rig.damping", "damping", 0.1), recordings, "delay", size) < 0.5
    assert on_real.explained({"physics": []}, recordings, "delay", size) == pytest.approx(0.0)


def test_table_of_real_recordings_has_a_line_for_each_question() -> None:
    case = {"data": "sit", "effect": "delay", "share": 0.1, "every": 5}
    nothing = {"physics": [], "improvement": None}
    found = {
        "physics": [
            {"id": "rig.delay", "place": "port", "parameters": {"delay": {"q05": 0.9, "median": 1.0, "q95": 1.1}}}
        ]
    }
    records = [
        {"case": case | {"effect": "", "mode": "alone"}, "verdict": nothing, "size": 0.0},
        {"case": case | {"mode": "alone"}, "verdict": found, "size": 1.05, "explained": 0.2},
        {"case": case | {"mode": "against"}, "verdict": nothing, "size": 1.05, "explained": 0.0},
        {"case": case | {"mode": "measured"}, "estimates": [[0.1, 0.2, 0.3], [1.1, 1.2, 1.3]], "size": 1.05},
    ]
    lines = on_real.table(records).splitlines()[2:]
    assert [line.split(" | ")[3] for line in lines] == ["alone", "alone", "against", "measured"]
    assert [line.split(" | ")[5] for line in lines] == ["-", "yes", "no", "yes"]


def test_power_counts_along_one_quantity() -> None:
    asked = power.cases(2, 61, ["rig.delay"])
    assert len(asked) == len({json.dumps(case, sort_keys=True) for case in asked})
    records = [
        {"case": case, "detected": case["strength"] > 0.09, "named": False, "visible": 7.0, "said": "rig.mass"}
        for case in asked
    ]
    points = power.curve(records, "rig.delay", "strength", "detected")
    assert points == [(s, 2 * (s > 0.09), 2) for s in power.VARIED["strength"]]
    assert "2 / 0 of 2 (16-100 %), 7.0" in power.table(records, ["rig.delay"])


def test_rivals_are_held_to_the_same_false_alarms() -> None:
    nulls = [dict.fromkeys(rivals.LOOKS, float(i)) for i in range(100)]
    truth = {"visible": 9.0, "mismatch": True, "kinds": ["rig.delay"], "group": "catalogue"}
    empty = {"visible": 0.0, "mismatch": False, "kinds": ["nothing"], "group": "nothing"}
    answers = [{"case": "a", "truth": truth}, {"case": "b", "truth": empty}]
    rows = [
        {"case": "a", "detected": True, "first": True, "first_or_undecided": True},
        {"case": "b", "detected": False},
    ]
    seen = {
        "a": {"mean curve": 94.0, "eq. 5": 96.0, "single people": 0.0, "model search": 99.0, "named": "rig.delay"},
        "b": {"mean curve": 96.0, "eq. 5": 0.0, "single people": 0.0, "model search": 0.0, "named": None},
    }
    text = rivals.table(answers, rows, seen, nulls)
    assert "| population (diagnose) | 1/1 (3-100 %) | - | - | 0/1 (0-98 %) |" in text
    assert "| mean curve | 0/1 (0-98 %) | +100 points | 1 / 0, p = 1 | 1/1 (3-100 %) |" in text
    assert "| eq. 5 | 1/1 (3-100 %) | +0 points" in text
    assert "model search 1/1" in text


@pytest.mark.slow
@pytest.mark.ci
def test_six_cases_from_end_to_end(tmp_path: Path) -> None:
    """Sealed, diagnosed from their folders, scored: what is plain is named, and nothing is claimed where nothing is."""
    cases = (
        ("rig.delay", 0.3),
        ("rig.highpass", 0.3),
        ("body.resonator", 0.3),
        ("outside.two_relaxations", 0.4),
        ("trap.gain", 0.0),
        ("nothing", 0.0),
    )
    plans = [
        experiment.Plan(kinds=(name,), strengths=(strength,), seed=20 + i, n_subjects=10, n_points=61)
        for i, (name, strength) in enumerate(cases)
    ]
    challenge.prepare(plans, tmp_path, 0)
    run.run_cases(
        challenge.to_diagnose(tmp_path, len(plans)), challenge.blind, tmp_path / run.FILE, 0, say=lambda _: None
    )
    run.main(["--score", "-o", str(tmp_path)])
    rows = {row["kind"]: row for row in json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))}
    assert len(rows) == 6
    for name in ("rig.delay", "rig.highpass", "body.resonator"):
        assert rows[name]["detectable"]
        assert rows[name]["right"], rows[name]["claims"]
        assert rows[name]["elpd_gain"] > 0
    assert rows["outside.two_relaxations"]["detected"]
    assert not rows["trap.gain"]["false_claim"]
    assert not rows["nothing"]["false_claim"]
    assert (tmp_path / "confusion.png").is_file()
