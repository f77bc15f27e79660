"""Words of a verdict follow its unit: what is electrical has no tissue; headlines name at most two findings."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from diagnoses_by_hand import ALIASES, CIRCUIT, DELAY, RESONATOR, make_diagnosis, page_of, verdict_of

import bayes_impedance.diagnosis  # noqa: F401  (registers the catalogue)
from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.catalogue.population_structure import STRUCTURES
from bayes_impedance.diagnosis.verdict.electrical_words import _WORDS, electrical
from bayes_impedance.diagnosis.verdict.sentence import gain_in_words, sentence

MECHANICAL = re.compile(
    r"\b(tissue|finger\w*|person|people|body|contactor|skin|muscle\w*|bone|joint|pulp|callus|damper|mass|spring|force)\b"
)


def test_every_effect_of_the_catalogue_has_electrical_words() -> None:
    ids = {effect.id for effect in registered()} | set(STRUCTURES) | {"rig.mains"}
    assert {id for id in ids if id not in _WORDS} <= {"rig.semi_inductance"}  # electrical already
    for said in _WORDS.values():
        assert not MECHANICAL.search(f"{said.name} {said.story} {said.separates}")


def test_a_verdict_on_a_cell_has_no_tissue(tmp_path: Path) -> None:
    power = replace(RESONATOR, id="body.springpot", name="power-law tissue", aliases=ALIASES)
    verdict = electrical(verdict_of((power,), CIRCUIT, None, unit="ohm"))
    said = sentence(verdict, 130)
    assert "a power law at 'tissue'" in said
    assert "an effect of the cell" in said or "an effect of" not in said
    diagnosis = make_diagnosis("found", electrical=True)
    _, page = page_of(replace(diagnosis, verdict=replace(verdict, summary=said)), tmp_path)
    words = page.words.replace("'tissue'", "").replace("at: tissue", "")
    assert "belongs to: the cell" in words
    assert not re.search(r"\b(person|people|finger|power-law tissue|the body)\b", words)


def test_a_mechanical_verdict_keeps_its_words() -> None:
    verdict = verdict_of((DELAY,), "n1|r1", None)
    assert electrical(verdict) is verdict


def test_a_computed_measurement_is_kept_before_the_general_remedy() -> None:
    alias = replace(ALIASES[0], would_separate="10 more repetitions; in general: the unloaded device")
    verdict = electrical(verdict_of((replace(DELAY, aliases=(alias,)),), CIRCUIT, None, unit="ohm"))
    assert verdict.physics[0].aliases[0].would_separate == (
        "10 more repetitions; in general: the leads short-circuited at the cell"
    )
    assert verdict.physics[0].aliases[0].name == "residual lead inductance"


def test_a_headline_has_two_findings_and_two_sentences() -> None:
    many = tuple(replace(DELAY, id=f"rig.{i}", name=f"effect {i}") for i in "abcd")
    verdict = verdict_of(many, "n1|r1", None, shortcomings=("Three people are not described.",))
    said = sentence(verdict, 20)
    assert "effect a" in said
    assert "effect b" in said
    assert "effect c (" not in said
    assert "and 2 more, seen mostly from" in said
    assert said.endswith("; even so, three people are not described.")
    assert len(re.findall(r"\. [A-Z]", said)) == 1


@pytest.mark.parametrize(
    ("gain", "error", "words"),
    [
        (985.0, 40.0, "clearly better"),
        (3.0, 2.0, "better, though not surely"),
        (-1.0, 2.0, "no better"),
        (0.0, None, "no better"),
        (5.0, None, "better"),
    ],
)
def test_gains_in_words(gain: float, error: float | None, words: str) -> None:
    assert gain_in_words(gain, error) == words
