"""The page: complete, self-contained, well-formed, and it says first what must not be used."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from pages import Page, without_library
from PIL import Image
from results_by_hand import NETWORK, VARIANTS, make_result
from strategies import networks, repeatable

from bayes_impedance.network.notation import parse
from bayes_impedance.network.schematic import schematic
from bayes_impedance.quality.findings import Finding
from bayes_impedance.report import REPORT_FILE, write_report

FINDINGS = (
    Finding(
        id="jump",
        severity="warning",
        subject="P01",
        repetition="2",
        frequency_hz=(50.0, 60.0),
        message='subject "P01": a jump of <z> by 30 %; check the gain',
    ),
    Finding(
        id="one_repetition",
        severity="note",
        subject=None,
        repetition=None,
        frequency_hz=None,
        message="each subject was measured once",
    ),
)


def page_of(folder: Path, findings: tuple[Finding, ...] = (), **variant) -> tuple[str, Page]:
    """The page of a variant, without pictures: those are slow, and tested by themselves."""
    file = write_report(make_result(**variant), folder, findings, pictures={})
    text = file.read_text(encoding="utf-8")
    return text, Page(text)


@pytest.mark.parametrize("variant", VARIANTS)
def test_is_well_formed_and_complete(variant: str, tmp_path: Path) -> None:
    result = make_result(**VARIANTS[variant])
    text, page = page_of(tmp_path, FINDINGS, **VARIANTS[variant])
    assert [p.name for p in tmp_path.iterdir()] == [REPORT_FILE]
    assert not re.search(r"\b(nan|None|null|inf|undefined)\b", page.words, re.IGNORECASE)
    own = without_library(text)
    for word in ("http:", "https:", "url(", "<link", "import("):
        assert word not in own
    assert own.count("<script") == 3
    assert page.sources == []
    assert sorted(page.drawn) == sorted(result.elements)
    rows = re.findall(r'<th scope="row">(\w+)</th>', text)
    assert set(result.elements) <= set(rows)
    assert "ten <fingers> & a thumb" in page.words
    assert "ten &lt;fingers&gt; &amp; a thumb" in text
    assert "a jump of <z> by 30 %; check the gain" in page.words
    assert "row 12 has no value" in page.words
    assert "ab12" * 16 in page.words
    assert f"--network '{result.attributes['network']}'" in page.words


def test_pictures_are_inside(tmp_path: Path) -> None:
    file = write_report(make_result(subjects=1, repetitions=1, electrical=True), tmp_path)
    page = Page(file.read_text(encoding="utf-8"))
    assert len(page.sources) == len(list((tmp_path / "pictures").glob("*.png"))) == 8
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    for name in (tmp_path / "pictures").iterdir():
        name.unlink()
    assert file.stat().st_size > 100_000


def test_problems_come_before_anything_else_and_numbers_are_withheld(tmp_path: Path) -> None:
    pictures = {}
    for name in ("curves", "overview", "forest", "traces"):
        pictures[name] = tmp_path / f"{name}.png"
        Image.new("RGB", (4, 3), "white").save(pictures[name])
    problem = "the ensembles disagree (R-hat 1.200, limit 1.05): repeat it without --quick"
    file = write_report(make_result(problems=(problem,), remarks=("a remark",)), tmp_path, FINDINGS, pictures)
    text = file.read_text(encoding="utf-8")
    page = Page(text)
    body = text[text.index("<main>") + len("<main>") :].lstrip()
    assert body.startswith('<section class="box problem" role="alert">')
    for later in ("<h1>", "a remark", "In short", "<svg", "<table"):
        assert text.index(problem) < text.index(later)
    assert "must not be used" in page.words
    assert "no number is given here" in page.words
    assert page.words.count("withheld") >= len(make_result().elements)
    assert len(page.sources) == 2  # curves and traces, not overview and forest
    assert "Who stands out" not in page.words
    assert "µm/N" not in page.words


def test_remarks_stand_before_the_answer(tmp_path: Path) -> None:
    text, _ = page_of(tmp_path, remarks=("The network does not describe these recordings.",))
    assert text.index("The network does not describe") < text.index("In short")
    clean, _ = page_of(tmp_path)
    assert "Read this first" not in clean


def test_values_have_prefixes_and_intervals(tmp_path: Path) -> None:
    _, page = page_of(tmp_path)
    assert re.search(r"n3 skin compliance .*? 0\.6\d+ µm/N 0\.6\d+ to 0\.7\d+", page.words)
    assert re.search(r"m2 tissue mass .*? 0\.7\d+ g", page.words)
    assert re.search(r"×1\.3\d 1\.[23]\d to 1\.4\d", page.words)


def test_an_element_that_is_not_determined_has_no_number(tmp_path: Path) -> None:
    text, page = page_of(tmp_path, unidentified=("n3",))
    row = re.search(r'<tr class="unknown"><th scope="row">n3</th>(.*?)</tr>', text, re.DOTALL)
    assert row is not None
    assert "not determined by these recordings" in row.group(1)
    assert not re.search(r"×\d", row.group(1))
    assert "These recordings do not determine n3." in page.words


def test_says_who_was_measured(tmp_path: Path) -> None:
    _, people = page_of(tmp_path)
    assert "6 people, recorded 3 times each" in people.words
    assert "Simulated" not in people.words
    _, simulated = page_of(tmp_path, source="simulated by a test: virtual persons")
    assert "Nobody was measured" in simulated.words
    assert "6 simulated people" in simulated.words
    _, cells = page_of(tmp_path, subjects=1, repetitions=1, electrical=True)
    assert "one subject, recorded once" in cells.words
    assert "resistance" in cells.words
    assert "person" not in cells.words
    assert "look-up" not in cells.words
    assert cells.words.count("r0|(r1-n1) = R0-p(R1,C1)") == 2  # the network, and where the numbers come from
    assert "R0" not in people.words


def test_covariates_are_listed(tmp_path: Path) -> None:
    text, page = page_of(tmp_path, covariates=("contact_force_n",))
    assert "Effects of the covariates" in text
    assert "--covariate contact_force_n" in page.words
    assert "Effects of the covariates" not in page_of(tmp_path)[0]


def test_command_names_what_differs_from_the_defaults(tmp_path: Path) -> None:
    _, page = page_of(tmp_path, covariance="diagonal")
    assert f"bayes-impedance run DATASET -o OUT --network '{NETWORK}' --seed 7 --covariance diagonal" in page.words


def test_dispersions_of_a_student_t_population_are_scales(tmp_path: Path) -> None:
    result = make_result()
    usual = Page(write_report(result, tmp_path, (), pictures={}).read_text(encoding="utf-8"))
    assert "geometric standard deviations" in usual.words
    assert "--distribution" not in usual.words
    nu = {"median": 4.0, "q05": 2.5, "q95": 12.0}
    result.summary["distribution"] = {"name": "student_t", "degrees_of_freedom": nu}
    page = Page(write_report(result, tmp_path, (), pictures={}).read_text(encoding="utf-8"))
    assert "geometric scales of a Student t distribution" in page.words
    assert "(geometric scale)" in page.words
    assert "geometric standard deviations: " not in page.words
    assert "--distribution student_t" in page.words


# ---------------------------------------------------------------- drawing


@repeatable
@given(networks())
def test_every_element_is_drawn_once_and_inside(network) -> None:
    for electrical in (False, True):
        text = schematic(network, dict.fromkeys(network.elements, "0.68 µm/N"), electrical=electrical)
        page = Page(text)
        assert sorted(page.drawn) == sorted(network.elements)
        assert sorted(t for t in page.text if t in network.elements) == sorted(network.elements)
        labels = [node.label for _, node in network.walk() if node.label]
        for label in labels:
            assert f">{label}</text>" in text
        width, height = map(float, re.search(r'viewBox="0 0 (\d+) (\d+)"', text).groups())
        assert all(-0.5 <= float(x) <= width + 0.5 for x in re.findall(r' (?:x|cx)="([-\d.]+)"', text))
        assert all(-0.5 <= float(y) <= height + 0.5 for y in re.findall(r' (?:y|cy)="([-\d.]+)"', text))


def positions(text: str) -> dict[str, tuple[float, float]]:
    """Where the name of each element stands."""
    found = re.findall(r'<text class="n" x="([\d.]+)" y="([\d.]+)" text-anchor="middle">(\w+)</text>', text)
    return {name: (float(x), float(y)) for x, y, name in found}


def test_series_is_a_row_and_parallel_a_pile() -> None:
    row = positions(schematic(parse("n1-r1")))
    assert row["n1"][0] < row["r1"][0]
    assert row["n1"][1] == row["r1"][1]
    pile = positions(schematic(parse("n1|r1")))
    assert pile["n1"][0] == pile["r1"][0]
    assert pile["n1"][1] < pile["r1"][1]


def test_circuits_are_the_other_way_round() -> None:
    row = positions(schematic(parse("r0|r1"), electrical=True))
    assert row["r0"][1] == row["r1"][1]
    pile = positions(schematic(parse("r0-n1"), electrical=True))
    assert pile["r0"][0] == pile["n1"][0]


def test_a_mass_stands_last_because_its_other_end_is_the_inertial_frame() -> None:
    at = positions(schematic(parse("m1-(n2|r2)")))
    assert at["m1"][0] > at["n2"][0]
    assert 'class="w d"' in schematic(parse("m1"))
    assert 'class="w d"' not in schematic(parse("n1-r1"))


def test_names_do_not_overlap() -> None:
    at = positions(schematic(parse("skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))")))
    assert len(set(at.values())) == len(at) == 8
    places = sorted(at.values())
    assert all(abs(a[0] - b[0]) > 60 or abs(a[1] - b[1]) > 60 for i, a in enumerate(places) for b in places[:i])
