"""Pages, terminal and exported texts of electrical recordings: cells are neither people nor users, and have no body."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from diagnoses_by_hand import make_diagnosis
from diagnoses_by_hand import page_of as diagnosis_page
from pages import Page
from results_by_hand import make_result

from bayes_impedance.commands.result_text import tell_result
from bayes_impedance.design.circuits.equivalent import equivalent
from bayes_impedance.design.circuits.spice import library
from bayes_impedance.design.circuits.transfer_functions import written
from bayes_impedance.design.users import Users
from bayes_impedance.network.notation import parse
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.report import write_report
from bayes_impedance.results.distribution import distribution_remark
from bayes_impedance.results.meanings import meanings_of
from bayes_impedance.units import ratio_of, who

OF_PEOPLE = re.compile(
    r"\b(persons?|people|users?|everybody|somebody|nobody|anybody|whom|the body|tissue(?!')|dampers?|masses)\b",
    re.IGNORECASE,
)
_OF_THE_CASE = re.compile(r"in everybody: 1\.5|\btissue [0-9]")
"""What diagnoses by hand say themselves: a summary, and a place."""


def read(text: str) -> str:
    """Words of a page, those of pictures and controls for who does not see them included."""
    said = re.findall(r'(?:alt|title|aria-label)="([^"]*)"', re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))
    return " ".join([Page(text).words, *map(unescape, said)])


@pytest.mark.parametrize(
    "variant",
    [
        {"source": "simulated by a test"},
        {"noise": 4.0},
        {"problems": ("the chains are too short",)},
        {"subjects": 1, "repetitions": 1},
        {"unidentified": ("n1",), "covariates": ("charge",)},
    ],
)
def test_the_page_of_a_fit(variant: dict[str, object], tmp_path: Path) -> None:
    result = make_result(electrical=True, **variant)  # type: ignore[arg-type]
    result.summary["seconds"] = {"read": 1.0, "persons": 2.0}
    text = write_report(result, tmp_path, pictures={}).read_text(encoding="utf-8")
    assert OF_PEOPLE.findall(read(text)) == []
    assert "read 1.0 s, subjects 2.0 s" in Page(text).words


@pytest.mark.parametrize("kind", ["found", "nothing"])
def test_the_page_of_a_diagnosis(kind: str, tmp_path: Path) -> None:
    text, _ = diagnosis_page(make_diagnosis(kind, electrical=True), tmp_path)
    assert OF_PEOPLE.findall(_OF_THE_CASE.sub("", read(text))) == []


def test_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    tell_result(make_result(electrical=True), "end")
    said = capsys.readouterr().out
    assert OF_PEOPLE.findall(said) == []
    assert "6 subjects, network" in said
    assert "between subjects        between repetitions" in said
    tell_result(make_result(), "end")
    assert "between people          between repetitions" in capsys.readouterr().out


def test_exported_circuits() -> None:
    network = parse("r0|p1^0.3")
    cells = Users(network, "ohm", ("a", "b"), np.log([[0.02, 0.05], [0.03, 0.04]]), (1.0, 100.0))
    made = equivalent(cells)
    assert "ladders of inductances, capacitances and resistances" in made.note
    assert "every virtual subject's impedance" in made.note
    assert made.note.endswith("do not represent the cell")
    assert "the circuit itself, V/I is the impedance" in library(made.users)
    assert written(cells, range(1), made).startswith("impedance z(s) = V/I in ohm, s in rad/s; admittance I/V = 1/z")


def test_what_is_said_of_a_population_with_tails_follows_the_unit() -> None:
    one = np.ones((3, 1))
    tails = PopulationParameters(
        mu=one,
        between_persons=one,
        correlation_cholesky=one[:, None],
        between_repetitions=one,
        slopes=np.zeros((3, 1, 0)),
        tail=np.full(3, 0.2),
    )
    assert str(distribution_remark(tails, "ohm")).startswith("Subjects follow a Student t")
    assert OF_PEOPLE.findall(str(distribution_remark(tails, "ohm"))) == []
    assert str(distribution_remark(tails, "N s/m")).startswith("People follow a Student t")
    for one_person in (True, False):
        meanings = [text for of in meanings_of("ohm", one_person).values() for text in of.values()]
        assert [m for m in meanings if OF_PEOPLE.search(m)] == []


def test_words_by_unit() -> None:
    assert (who("ohm"), who("ohm", 1), who("N s/m"), who("N m s/rad", 1)) == ("subjects", "subject", "people", "person")
    assert (ratio_of("ohm"), ratio_of("N s/m")) == ("V/I", "F/v")
