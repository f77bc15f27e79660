"""Every sentence of a fit's page and of its terminal output, held against the summary."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from pages import Page
from results_by_hand import MISFITS, VARIANTS, make_result
from said_and_recorded import FITS, NUMBER, contradictions, is_rounded, numbers, recorded, value_of

from bayes_impedance.commands.cli import main
from bayes_impedance.report import write_report
from bayes_impedance.report.fit_sentences import chance_in_words, details, headline, replication_sentence
from bayes_impedance.report.fit_tables import checks, correlation_rows, element_rows, slope_rows
from bayes_impedance.results.misfit import MISFIT_SCALE, network_misfits, noise_scale_summary
from bayes_impedance.results.result import Result
from bayes_impedance.units import excludes_zero, scale_for, signed

ALL = VARIANTS | MISFITS


def words_of(result: Result, folder: Path) -> str:
    return Page(write_report(result, folder, pictures={}).read_text(encoding="utf-8")).words


def printed_of(result: Result, folder: Path, monkeypatch: Any, capsys: Any) -> str:
    monkeypatch.setattr("bayes_impedance.commands.jobs.report_result", lambda *_, **__: result)
    main(["report", str(folder)])
    return str(capsys.readouterr().out)


@pytest.mark.parametrize("variant", ALL)
def test_numbers_of_the_answer_are_recorded(variant: str) -> None:
    result = make_result(**ALL[variant])
    known = [
        *numbers({key: value for key, value in result.summary.items() if key not in ("seconds", "versions")}),
        *numbers(list(result.coords["frequency_hz"])[:: len(result.coords["frequency_hz"]) - 1]),
        *(math.exp(x) for e in result.summary["elements"].values() for x in numbers(e["dispersion_between_persons"])),
        len(result.elements),
        MISFIT_SCALE,
        90,
    ]
    for sentence in (*headline(result), *details(result), replication_sentence(result)):
        for text in NUMBER.findall(sentence):
            assert recorded(text, known), (text, sentence)


@pytest.mark.parametrize("variant", ALL)
def test_a_headline_is_two_sentences(variant: str) -> None:
    result = make_result(**ALL[variant])
    said = headline(result)
    assert len(said) == 2
    assert all(re.search(r"[.!?] [A-Z]", sentence) is None for sentence in said)
    assert not set(said) & set(details(result))
    if result.problems:
        assert details(result) == []


@pytest.mark.parametrize("variant", ALL)
def test_a_value_is_its_elements_and_lies_in_its_interval(variant: str) -> None:
    result = make_result(**ALL[variant])
    said = " ".join([*headline(result), *details(result)]).replace("\u00a0", " ")
    for row in element_rows(result):
        entry = result.summary["elements"][row.name]
        if not entry["identified"] or result.problems:
            continue
        assert f"{row.name} = {row.value}" in said
        scale = scale_for(entry["central"]["median"], entry["unit"])
        low, high = row.interval.split(" to ")
        for text, key in ((low, "q05"), (row.value, "median"), (high, "q95")):
            assert is_rounded(text, entry["central"][key] * scale.factor)
        assert value_of(low) <= value_of(row.value) <= value_of(high)
        for value, interval, level in (
            (row.between_persons, row.between_persons_interval, "persons"),
            (row.between_repetitions, row.between_repetitions_interval, "repetitions"),
        ):
            if interval:
                low, high = interval.split(" to ")
                assert is_rounded(value[1:], math.exp(entry[f"dispersion_between_{level}"]["median"]))
                assert value_of(low) <= value_of(value[1:]) <= value_of(high)


@pytest.mark.parametrize("variant", ALL)
def test_nothing_on_the_page_or_in_the_terminal_contradicts_another(
    variant: str, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    result = make_result(**ALL[variant])
    words = words_of(result, tmp_path)
    assert contradictions(words) == []
    assert contradictions(printed_of(result, tmp_path, monkeypatch, capsys)) == []
    if network_misfits(result.summary):
        assert not any(said in words for said in FITS)
        assert "leaves out something" in words
    else:
        assert "leaves out" not in words


@pytest.mark.parametrize("variant", MISFITS)
def test_a_misfit_is_said_with_the_numbers_of_those_whom_it_concerns(variant: str) -> None:
    result = make_result(**MISFITS[variant])
    scale, said = result.summary["noise_scale"], " ".join([*headline(result), *details(result)])
    if not network_misfits(result.summary):
        assert "times the noise" not in said
        return
    found = re.search(r"([\d.]+) times the noise", said)
    assert found is not None
    assert value_of(found.group(1)) > MISFIT_SCALE
    assert is_rounded(found.group(1), scale["affected_median"])
    if result.summary["subjects"] > 1:
        assert f"of the {scale['affected']} of {result.summary['subjects']}" in said


def test_residuals_below_the_noise_are_no_misfit() -> None:
    import numpy as np

    few = noise_scale_summary(np.array([0.9] * 8 + [2.0] * 2))
    assert (few["median"], few["affected"], few["affected_median"]) == (0.9, 2, 2.0)
    assert network_misfits({"subjects": 10, "noise_scale": few})  # and what is said is 2.0, not 0.9
    none = noise_scale_summary(np.array([0.9, 1.49]))
    assert none["affected_median"] is None
    assert not network_misfits({"subjects": 2, "noise_scale": none})


def test_a_share_inside_of_a_band_is_an_average_with_its_range(tmp_path: Path) -> None:
    result = make_result()
    result.summary["coverage"]["90"] = 0.9
    result.summary["coverage_by_frequency"]["90"] = [0.0, 1.0]
    words = words_of(result, tmp_path)
    assert words.count("on average 90 % of the recordings (0 % to 100 % at single frequencies)") == 2
    assert not re.search(r"band contains \d+ % of", words)


@pytest.mark.parametrize(("low", "high"), [(-0.36, -0.004), (0.0049, 0.5), (-0.36, -0.006), (0.1, 0.6), (-0.1, 0.2)])
def test_an_interval_that_is_said_to_exclude_zero_does_so_as_written(low: float, high: float) -> None:
    result = make_result()
    for row in result.summary["correlation"]:
        row[2:] = [(low + high) / 2, low, high]
    rows = correlation_rows(result)
    assert bool(rows) is excludes_zero(low, high)
    for _, value, interval in rows:
        ends = [value_of(end) for end in interval.split(" to ")]
        assert 0 < ends[0] <= ends[1] or ends[0] <= ends[1] < 0
        assert ends[0] <= value_of(value) <= ends[1]
    assert signed(-0.004) == "0.00"


def test_what_chance_leaves_is_said_for_the_number_of_people() -> None:
    said = chance_in_words(make_result(subjects=71))  # 0.9 -+ 1.645 sqrt(0.09 / 71), 0.5 -+ 1.645 sqrt(0.25 / 71)
    assert said == (
        "With 71 people and correct bands, nine of ten frequencies lie between 40 % and 60 % (50 % band) and "
        "between 84 % and 96 % (90 % band)."
    )


def test_an_element_that_is_not_determined_has_no_number_even_if_the_record_has(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    result = make_result(covariates=("contact_force_n",))
    entry = result.summary["elements"]["n3"]
    assert entry["central"]["median"] is not None
    entry["identified"] = False
    (row,) = (row for row in element_rows(result) if row.name == "n3")
    assert not any(NUMBER.findall(text) for text in (row.value, row.interval, row.between_persons))
    assert row.between_persons_interval == row.between_repetitions_interval == ""
    assert "n3" not in {name for name, *_ in slope_rows(result)}
    assert not any("n3" in pair.split(" and ") for pair, *_ in correlation_rows(result))
    words = words_of(result, tmp_path)
    assert "These recordings do not determine n3." in words
    assert not re.search(r"n3 = ", words)
    line = re.search(r"^n3 .*$", printed_of(result, tmp_path, monkeypatch, capsys), re.MULTILINE)
    assert line is not None
    assert not NUMBER.findall(line.group(0))
    json.dumps(result.summary)


def test_diagnostics_that_are_not_finite_are_said_and_meet_no_limit() -> None:
    result = make_result(**ALL[next(iter(ALL))])
    result.summary["sampler"] |= {"pareto_k_max": None, "rhat_max": None}
    shown = {check.name: check for check in checks(result)}
    for name in ("Pareto k, worst", "R-hat, worst"):
        assert (shown[name].value, shown[name].good) == ("not finite", False)
