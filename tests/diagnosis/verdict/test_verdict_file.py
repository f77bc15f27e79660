"""``verdict.json``: written and read without loss, and described by its JSON Schema, for every kind of verdict."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from bayes_impedance.diagnosis.verdict_file import PHYSICS_KEYS, from_json, to_json
from bayes_impedance.errors import InputError

RECORDS: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "records.json").read_text(encoding="utf-8"))
SCHEMA = json.loads(files("bayes_impedance.diagnosis").joinpath("verdict.schema.json").read_text(encoding="utf-8"))


def is_valid(record: dict[str, Any]) -> bool:
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed (extra: test)")
    return bool(jsonschema.Draft202012Validator(SCHEMA).is_valid(record))


def changed(record: dict[str, Any], change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    other = copy.deepcopy(record)
    change(other)
    return other


def test_the_records_are_of_every_kind() -> None:
    assert {from_json(record).physics[0].kind for record in RECORDS.values() if record["physics"]} == set(PHYSICS_KEYS)
    assert len({frozenset(keys) for keys in PHYSICS_KEYS.values()}) == len(PHYSICS_KEYS)  # the fields tell the kind
    assert any(record["where"]["subjects"] != "all" for record in RECORDS.values())
    for key in ("joint", "parameters_differ"):
        assert any(key in record for record in RECORDS.values())


@pytest.mark.parametrize("name", RECORDS)
def test_reading_and_writing_changes_no_byte(name: str) -> None:
    record = RECORDS[name]
    verdict = from_json(record)
    assert json.dumps(to_json(verdict), indent=2) == json.dumps(record, indent=2)
    assert from_json(to_json(verdict)) == verdict
    assert verdict.mismatch is record["mismatch"]


def test_what_is_not_finite_becomes_null_and_is_read_as_unknown() -> None:
    verdict = from_json(RECORDS["shared"])
    (entry,) = verdict.physics
    lost = replace(entry.parameters["delay"], q95=math.inf, median=math.nan)
    record = to_json(replace(verdict, physics=(replace(entry, parameters={"delay": lost}),)))
    row = record["physics"][0]["parameters"]["delay"]
    assert (row["median"], row["q95"]) == (None, None)
    again = from_json(record).physics[0].parameters["delay"]
    assert math.isnan(again.median)
    assert again.q05 == lost.q05
    assert is_valid(record)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: r.pop("schema"), "not a verdict of schema 1"),
        (lambda r: r.update(schema=2), "not a verdict of schema 1"),
        (lambda r: r.pop("where"), "'where' is missing"),
        (lambda r: r["where"].pop("bands_hz"), "'bands_hz' is missing"),
        (lambda r: r["where"].update(colour="red"), "colour"),
        (lambda r: r["physics"][0].pop("story"), "fit no kind of entry"),
        (lambda r: r["physics"][0].update(colour="red"), "fit no kind of entry"),
        (lambda r: r.update(network=["m1"]), "not a verdict of schema 1"),
        (lambda r: r.update(network=["m1", None]), "a network is None, but must be a text"),
        (lambda r: r.update(extended_network=5), "a network is 5, but must be a text"),
        (lambda r: r.update(start={"m1": "heavy"}), "could not convert string to float"),
    ],
)
def test_what_is_no_verdict_is_said_to_be_none(change: Callable[[dict[str, Any]], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        from_json(changed(RECORDS["shared"], change))


@pytest.mark.parametrize("name", RECORDS)
def test_every_kind_of_verdict_keeps_to_the_schema(name: str) -> None:
    assert is_valid(RECORDS[name])


def test_the_schema_knows_the_fields_of_each_kind() -> None:
    for kind, keys in PHYSICS_KEYS.items():
        described = SCHEMA["$defs"][kind]
        assert tuple(described["properties"]) == keys
        assert set(described["required"]) == set(keys)
    verdict = list(to_json(from_json(RECORDS["nothing"])))
    optional = ["joint", "parameters_differ", "shortcomings", "extended_network", "start"]
    assert list(SCHEMA["properties"]) == [*verdict, *optional]


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r.update(colour="red"),
        lambda r: r.update(seed="1"),
        lambda r: r.update(mismatch=None),
        lambda r: r.update(schema=2),
        lambda r: r.pop("remarks"),
        lambda r: r.update(network=["m1"]),
        lambda r: r["where"].update(side="both"),
        lambda r: r["where"].update(bands_hz=[[1.0]]),
        lambda r: r["physics"][0].update(colour="red"),
        lambda r: r["physics"][0].pop("side_decided"),
        lambda r: r["physics"][0].update(pooling="many"),
        lambda r: r["physics"][0]["parameters"]["delay"].update(median="much"),
        lambda r: r["improvement"].pop("elpd_gain_blocks_se"),
    ],
)
def test_the_schema_rejects_what_is_no_verdict(change: Callable[[dict[str, Any]], object]) -> None:
    assert is_valid(RECORDS["shared"])
    assert not is_valid(changed(RECORDS["shared"], change))
