"""Verdicts of every kind: their records keep keys, order and texts; their sentences follow from the records.

``records.json`` holds one record of each kind, as ``verdict.json`` would: those of the small diagnoses, and one of an
effect that only some people have.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_diagnoses import CASES, diagnosis_of

from bayes_impedance.diagnosis.verdict.sentence import number, sentence
from bayes_impedance.diagnosis.verdict_file import from_json, to_json

RECORDS: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "records.json").read_text(encoding="utf-8"))
QUICKEST = ("nothing", "shared", "one person", "hum", "covariate", "drift", "subgroup", "correlation", "simulation")


def record_of(name: str) -> dict[str, Any]:
    return to_json(diagnosis_of(name).verdict)


def outline(value: Any) -> Any:
    """A record without its numbers and sentences: keys in order, lengths, types."""
    if isinstance(value, dict):
        return [(key, outline(item)) for key, item in value.items()]
    if isinstance(value, list):
        return [outline(item) for item in value]
    return type(value).__name__


@pytest.mark.long
@pytest.mark.parametrize("name", QUICKEST)
def test_each_kind_keeps_its_keys_and_texts(name: str) -> None:
    made, kept = record_of(name), RECORDS[name]
    made.pop("summary")
    kept = {key: value for key, value in kept.items() if key != "summary"}
    assert outline(made) == outline(kept)
    for one, other in zip(made["physics"], kept["physics"], strict=True):
        for key in set(other) - {"parameters", "evidence", "aliases", "dispersion_interval"}:
            assert one[key] == other[key], key
    for key in ("network", "not_identifiable", "elements_not_identified", "remarks", "seed", "title", "unit"):
        assert made[key] == kept[key]
    for key in ("part", "place", "side", "subjects", "covariate"):
        assert made["where"][key] == kept["where"][key]
    np.testing.assert_allclose(
        [row["above"] for row in made["detectable"]], [row["above"] for row in kept["detectable"]], rtol=1e-2
    )


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.parametrize("name", sorted(set(CASES) - set(QUICKEST)))
def test_each_kind_that_takes_longer_keeps_its_keys_and_texts(name: str) -> None:
    test_each_kind_keeps_its_keys_and_texts(name)


def test_a_skew_has_the_size_that_was_concealed() -> None:
    (entry,) = record_of("shared")["physics"]
    delay = entry["parameters"]["delay"]
    assert delay["q05"] < 2e-5 < delay["q95"]
    assert delay["dispersion"] == 0.0
    assert entry["dispersion_interval"][0] >= 0.0


def test_one_person_has_no_side() -> None:
    record = record_of("one person")
    assert record["where"]["side"] is None
    assert [entry["side_decided"] for entry in record["physics"]] == [False]
    assert sum("so few subjects" in remark or "one repetition" in remark for remark in record["remarks"]) == 2


def test_members_of_a_group_are_named() -> None:
    record = record_of("subgroup")
    (entry,) = record["physics"]
    assert entry["subjects"] == record["where"]["subjects"]
    assert set(entry["subjects"]) < set(diagnosis_of("subgroup").subjects)
    share = len(entry["subjects"]) / len(diagnosis_of("subgroup").subjects)
    assert entry["parameters"]["fraction"]["q05"] < share < entry["parameters"]["fraction"]["q95"]


def test_bands_of_hum_surround_its_points() -> None:
    record = record_of("hum")
    assert record["where"]["bands_hz"] == [[49.5, 50.5]]
    assert record["physics"][0]["frequencies_hz"] == [50.0]
    assert record["improvement"]["elpd_gain"] is None


def test_structure_of_the_population_leaves_each_fit_as_it_is() -> None:
    for name in ("covariate", "drift", "correlation", "subgroup"):
        improvement = record_of(name)["improvement"]
        assert improvement["subject_rms_relative"][0] == improvement["subject_rms_relative"][1]
        assert improvement["elpd_gain"] == record_of(name)["physics"][0]["evidence"]["elpd_gain"]
    assert "likelihood ratio for body.correlation" in record_of("correlation")["improvement"]["held_out"]


def test_differences_from_a_simulation_are_the_significant_ones() -> None:
    diagnosis = diagnosis_of("simulation")
    listed = record_of("simulation")["parameters_differ"]
    assert (
        [row["element"] for row in listed] == [d.element for d in diagnosis.differences if d.p_value < 0.05] == ["r1"]
    )
    assert "parameters_differ" not in record_of("nothing")


@pytest.mark.parametrize("name", RECORDS)
def test_the_sentence_follows_from_the_record(name: str) -> None:
    record = RECORDS[name]
    people = CASES[name].people if name in CASES else 40
    assert sentence(from_json(record | {"summary": ""}), people) == record["summary"]


def test_the_sentence_names_what_it_cannot_be_told_from() -> None:
    record = json.loads(json.dumps(RECORDS["shared"]))
    aliases = [
        {"id": f"{side}.x", "name": side, "place": "port", "elpd_behind": 0.0, "separated": apart, "would_separate": ""}
        for side, apart in (("body", False), ("rig", True))
    ]
    record["physics"][0]["aliases"] = aliases
    said = sentence(from_json(record), 10)
    assert said.endswith("These recordings cannot distinguish it from a body at the port.")
    assert "an effect of the rig" not in said  # the other explanation is of the other side
    aliases[0]["separated"] = True
    assert "an effect of the rig" in sentence(from_json(record), 10)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1.5e-6, "s", "1.5 µs"),
        (2.1e-6, "kg", "2.1 mg"),
        (0.0, "Hz", "0 Hz"),
        (12.0, "per repetition", "12 per repetition"),
        (0.0123, "N s/m", "12.3 mN s/m"),
        (float("nan"), "s", "an unknown amount"),
        (4100.0, "Hz", "4.1 kHz"),
    ],
)
def test_numbers_have_prefixes(value: float, unit: str, text: str) -> None:
    assert number(value, unit) == text
