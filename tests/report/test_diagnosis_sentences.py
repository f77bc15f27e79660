"""Every sentence of a diagnosis' page and terminal output, held against ``verdict.json``."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnoses_by_hand import DELAY, RESONATOR, VARIANTS, make_diagnosis, page_of
from said_and_recorded import NUMBER, contradictions, is_rounded, numbers, recorded, value_of

from bayes_impedance.commands.cli import main
from bayes_impedance.diagnosis.types import Diagnosis
from bayes_impedance.diagnosis.verdict.entries import unpredicted_entry
from bayes_impedance.diagnosis.verdict.sentence import sentence
from bayes_impedance.diagnosis.verdict_file import from_json, to_json
from bayes_impedance.diagnosis.verdict_types import Parameter, Verdict
from bayes_impedance.network.notation import parse
from bayes_impedance.report.findings import effects, joint, why_side

RECORDS: dict[str, dict[str, Any]] = json.loads(
    (Path(__file__).parents[1] / "diagnosis" / "verdict" / "records.json").read_text(encoding="utf-8")
)
PEOPLE = 12


def verdicts() -> dict[str, Verdict]:
    """Of every kind: recorded ones, those by hand with their own sentence, and what is not to be relied on."""
    found = {name: from_json(record) for name, record in RECORDS.items()}
    found |= {f"{name} by hand": make_diagnosis(**options).verdict for name, options in VARIANTS.items()}
    nothing, unknown = found["nothing by hand"], found["unknown by hand"]
    found["structure"] = replace(nothing, located=replace(nothing.located, p_value=1e-9))
    found["unpredicted"] = replace(
        unknown, physics=(unpredicted_entry(),), network=(unknown.network[0],) * 2, improvement=None
    )
    found |= {f"{name}, unreliable": replace(found[name], reliable=False) for name in ("nothing", "shared")}
    return {name: replace(verdict, summary=sentence(verdict, PEOPLE)) for name, verdict in found.items()}


ALL = verdicts()


def diagnosis_of(name: str) -> Diagnosis:
    return replace(make_diagnosis(subjects=PEOPLE), verdict=ALL[name])


def printed_of(name: str, folder: Path, monkeypatch: Any, capsys: Any) -> str:
    monkeypatch.setattr("bayes_impedance.commands.jobs.diagnose_dataset", lambda *_, **__: diagnosis_of(name))
    main(["diagnose", str(folder), "-o", str(folder)])
    return str(capsys.readouterr().out)


@pytest.mark.parametrize("name", ALL)
def test_numbers_of_the_sentence_are_recorded(name: str) -> None:
    verdict = ALL[name]
    known = [*numbers(to_json(replace(verdict, summary=""))), 90, PEOPLE]
    unnamed = re.sub(r"a small network .*? the place", "", verdict.summary)
    for entry in verdict.physics:
        unnamed = unnamed.replace(entry.name, "")
    for text in NUMBER.findall(unnamed):
        assert recorded(text, known), (text, verdict.summary)


@pytest.mark.parametrize("name", ALL)
def test_values_of_the_sentence_lie_in_the_interval_of_the_same_parameter(name: str) -> None:
    verdict = ALL[name]
    found = re.findall(
        r"\(([a-z][\w ]*?) (−?-?[\d.]+)[^,()]*, 90 % interval ([-−\d.]+)[^()]*? to ([-−\d.]+)", verdict.summary
    )
    entries = [entry for entry in verdict.physics if entry.parameters]
    assert len(found) == len(entries)
    for (said, *texts), entry in zip(found, entries, strict=True):
        first, row = next(iter(entry.parameters.items()))
        assert said.startswith(first.replace("_", " "))
        assert row.q05 <= row.median <= row.q95
        for text, value in zip(texts, (row.median, row.q05, row.q95), strict=True):
            assert recorded(text, [value])


@pytest.mark.parametrize("name", ALL)
def test_each_value_of_a_card_lies_in_its_interval(name: str) -> None:
    diagnosis = diagnosis_of(name)
    for card, entry in zip(effects(diagnosis), diagnosis.verdict.physics, strict=True):
        assert len({row.name for row in card.parameters}) == len(card.parameters) == len(entry.parameters)
        for row, parameter in zip(card.parameters, entry.parameters.values(), strict=True):
            low, high = map(value_of, row.interval.split(" to "))
            assert low <= value_of(row.value) <= high
            assert recorded(row.value, [parameter.median])


@pytest.mark.parametrize("name", ALL)
def test_a_spread_and_its_interval_are_of_one_parameter(name: str) -> None:
    diagnosis = diagnosis_of(name)
    for entry in diagnosis.verdict.physics:
        said = why_side(entry, diagnosis)
        found = re.search(r"Relative dispersion of the (.*?) between people: (?:([\d.]+) %(?! interval))?(.*)", said)
        if found is None:
            assert "was not estimated" in said
            assert not NUMBER.findall(said)
            continue
        first, row = next(iter(entry.parameters.items()))
        assert found.group(1) == first.replace("_", " ")
        shares = [float(x) for x in re.findall(r"([\d.]+) %", found.group(3).replace("90 % interval", ""))]
        if found.group(2) is not None:
            assert row.dispersion is not None
            assert is_rounded(found.group(2), 100 * row.dispersion)
            if shares:
                assert shares[0] <= float(found.group(2)) <= shares[1]
        if shares:
            assert entry.dispersion_interval is not None
            assert shares == [pytest.approx(100 * x, rel=0.06, abs=1e-9) for x in entry.dispersion_interval]
            assert shares[0] < shares[1]


def test_a_spread_of_another_parameter_is_not_said_beside_the_interval() -> None:
    """What was seen: 14 % of the second parameter beside 7.5 to 10 % of the first."""
    entry = replace(
        RESONATOR,
        parameters={
            "mass": Parameter("kg", 2.4e-4, 1.9e-4, 3.1e-4, 0.09),
            "resonance": Parameter("Hz", 1310.0, 1240.0, 1390.0, 0.14),
        },
        dispersion_interval=(0.075, 0.1),
    )
    said = why_side(entry, make_diagnosis(subjects=PEOPLE))
    assert "Relative dispersion of the mass between people: 9.0 %, 90 % interval 7.5 % to 10 %." in said
    assert "14 %" not in said
    shared = why_side(replace(DELAY, dispersion_interval=(0.003, 0.031)), make_diagnosis(subjects=PEOPLE))
    assert "between people: 90 % interval 0.30 % to 3.1 %." in shared


@pytest.mark.parametrize("name", ALL)
def test_no_two_statements_contradict(name: str, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    verdict = ALL[name]
    _, page = page_of(diagnosis_of(name), tmp_path)
    for words in (page.words, printed_of(name, tmp_path, monkeypatch, capsys)):
        assert contradictions(words) == []
        nothing = verdict.reliable and not verdict.mismatch and name != "structure"
        assert ("to within their noise" in words) is nothing
        assert ("not noise alone" in words) is (name == "structure")
        assert ("The network leaves out" in words) is verdict.mismatch
    if not verdict.reliable or name == "structure":
        assert "Nothing is missing" not in page.words
    if name == "unpredicted":
        assert "smallest passive network" not in page.words
        assert "no small network that was tried predicts" in page.words


@pytest.mark.parametrize("name", ALL)
def test_no_name_is_of_two_things(name: str) -> None:
    verdict = ALL[name]
    own = set(parse(verdict.network[0]).elements)
    for notation in verdict.network:
        elements = parse(notation).elements
        assert len(set(elements)) == len(elements)
    if verdict.unexplained is not None and verdict.unexplained.network:
        assert not own & set(parse(verdict.unexplained.network).elements)
        assert verdict.unexplained.network in verdict.summary or "by hand" in name
    if verdict.joint is not None:
        assert len(set(verdict.joint.parameters)) == len(verdict.joint.parameters)
        for first, second, _ in joint(verdict):
            assert first != second
