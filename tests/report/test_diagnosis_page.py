"""The page of a diagnosis: it says what was found or how small it must be, whatever is missing, and stands alone."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from diagnoses_by_hand import DELAY, SUMMARY, UNKNOWN, VARIANTS, holes, make_diagnosis, page_of
from pages import Page, without_library

from bayes_impedance.diagnosis.verdict_types import (
    Parameter,
    ParameterDifference,
)
from bayes_impedance.network.notation import parse
from bayes_impedance.plots import save_figure, style, write_diagnosis_pictures
from bayes_impedance.plots.missing_physics import (
    residual_map,
)
from bayes_impedance.report.diagnosis_page import write_diagnosis_report
from bayes_impedance.report.findings import p_text

# ---------------------------------------------------------------- the page


@pytest.mark.parametrize("variant", [*VARIANTS, "holes"])
def test_page_is_well_formed_and_stands_alone(variant: str, tmp_path: Path) -> None:
    diagnosis = holes(make_diagnosis(subjects=4)) if variant == "holes" else make_diagnosis(**VARIANTS[variant])
    text, page = page_of(diagnosis, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["diagnosis.html"]
    own = without_library(text)
    for word in ("http:", "https:", "url(", "<link", "import("):
        assert word not in own
    assert own.count("<script") == 3
    assert not re.search(r"\b(nan|None|null|inf|undefined)\b", page.words)
    assert "ten <fingers> & a thumb" in page.words
    assert "ten &lt;fingers&gt; &amp; a thumb" in text
    assert diagnosis.verdict.summary in page.words
    assert set(parse(diagnosis.before.network).elements) <= set(page.drawn)


def test_page_holds_its_pictures_and_is_the_same_twice(tmp_path: Path) -> None:
    diagnosis = make_diagnosis("nothing", subjects=1, size=8)
    first = write_diagnosis_report(diagnosis, tmp_path / "a")
    pictures = write_diagnosis_pictures(diagnosis, tmp_path / "b")
    second = write_diagnosis_report(diagnosis, tmp_path / "b", pictures)
    assert first.read_bytes() == second.read_bytes()
    written = sorted((tmp_path / "a" / "pictures").iterdir())
    assert [p.suffix for p in written] == [".png", ".svg"] * 3
    for picture in written:
        assert picture.read_bytes() == (tmp_path / "b" / picture.name).read_bytes()
    sources = Page(first.read_text(encoding="utf-8")).sources
    assert len(sources) == 3
    assert all(source.startswith("data:image/png;base64,") for source in sources)


def test_a_card_says_what_where_how_much_and_why(tmp_path: Path) -> None:
    text, page = page_of(make_diagnosis(), tmp_path)
    for said in (DELAY.name, DELAY.story, DELAY.formula, SUMMARY):
        assert said in page.words
    assert "delay 1.500 µs 1.420 to 1.610 the same for all" in page.words
    assert "at: port belongs to: the rig the same for all" in page.words
    assert "Relative dispersion of the delay between people: 90 % interval 0 % to 3.1 %." in page.words
    assert "score 2096" in page.words
    assert "p < 1e-300" in page.words
    assert "held-out gain 985 ± 40" in page.words
    assert "rig.series_compliance port 1.30 no frequencies above 8 kHz" in page.words
    assert "rig.mass port 55.2 ✓ yes a recording without a finger" in page.words
    assert '<section class="verdict found">' in text
    assert "Frequencies 700 Hz to 5 kHz" in page.words


def test_improvement_and_limits_have_units(tmp_path: Path) -> None:
    _, page = page_of(make_diagnosis(), tmp_path)
    assert "Magnitude error of one network for all (eq. 5) 1.31 N s/m 1.27 N s/m" in page.words
    assert "Phase error of one network for all (eq. 5) 8.70° 8.10°" in page.words
    assert "inside the predicted 90 % band, average over frequency 82.0 % 89.8 %" in page.words
    assert "5 subject folds, 8 frequency blocks" in page.words
    assert "rig.mass port 2.1 mg rig.delay port 31 ns" in page.words
    assert "body.relaxation skin 0.34 N s/m tissue 12 mN s/m rig.lowpass port 41 kHz" in page.words
    assert "wrong gain of the rig" in page.words
    assert "do not determine n3" in page.words


def test_several_effects_have_a_card_each_and_their_dependence(tmp_path: Path) -> None:
    text, page = page_of(make_diagnosis("two"), tmp_path)
    assert text.count('<article class="card">') == 2
    assert "body.resonator port" not in page.words
    assert "mass 0.240 g 0.190 to 0.310 31 % resonance 1.310 kHz 1.240 to 1.390" in page.words
    assert (
        "supports the body. Relative dispersion of the mass between people: 31 %, 90 % interval 22 % to 44 %"
        in page.words
    )
    assert page.words.index("rig.delay delay and body.resonator resonance −0.61") < page.words.index("mass +0.12")
    assert page.words.count("body.line") == 30
    before, folded = page.words.split("22 more")
    assert before.count("body.line") == 8
    assert "body.line29" in folded


def test_ranking_is_cut_and_shows_aliases(tmp_path: Path) -> None:
    text, page = page_of(make_diagnosis(), tmp_path)
    assert "The best 15 of 22." in page.words
    table = text[text.index('class="ranking"') :].split("</table>")[0]
    assert table.count("<tr class=") == 15
    assert table.count('<span class="no">') == 3  # cosines of −0.985, 0.970 and −0.956
    assert table.count("unphysical sign") == 3
    assert 'class="taken"' in table


def test_nothing_missing_is_said_calmly_with_the_limits_first(tmp_path: Path) -> None:
    text, page = page_of(make_diagnosis("nothing"), tmp_path)
    assert '<section class="verdict nothing">' in text
    for absent in ("Missing effects", 'id="improvement"', "<article", "<h3>After", 'class="k"'):
        assert absent not in text
    assert text.index('<h2 id="limits">') < text.index('<h2 id="network">')
    assert "“Nothing is missing” means: nothing above these limits." in page.words


def test_unknown_draws_the_one_port_that_is_missing(tmp_path: Path) -> None:
    text, page = page_of(make_diagnosis("unknown", electrical=True, subjects=1, repetitions=1), tmp_path)
    assert '<section class="verdict unknown">' in text
    assert {"r9", "n9", "m9"} <= set(page.drawn)
    assert text.count("<article") == 1  # not once as unknown and once as unexplained
    assert "A one-port is missing at port" in page.words
    assert "One subject was measured" in page.words
    assert "person" not in page.words
    assert "r0|(r1-n1)|(r2-n2) = R0-p(R1,C1)-p(R2,C2)" in page.words


def test_what_is_left_beside_a_known_effect_has_its_own_card(tmp_path: Path) -> None:
    diagnosis = make_diagnosis()
    rest = replace(UNKNOWN, place="skin", network="r9-n9")
    text, page = page_of(replace(diagnosis, verdict=replace(diagnosis.verdict, physics=(DELAY, rest))), tmp_path)
    assert text.count("<article") == 2
    assert '<section class="verdict found">' in text
    assert "A one-port is missing at skin . It is not" in page.words
    assert {"r9", "n9"} <= set(page.drawn)


def test_remarks_stand_first_and_a_verdict_may_be_refused(tmp_path: Path) -> None:
    diagnosis = make_diagnosis()
    remarks = ("two fits did <not> converge", "one repetition only")
    text, page = page_of(replace(diagnosis, verdict=replace(diagnosis.verdict, remarks=remarks)), tmp_path)
    first, second, sentence = (page.words.index(x) for x in (*remarks, SUMMARY))
    assert first < second < sentence
    assert "must not be relied on" not in page.words
    bad = replace(diagnosis.verdict, remarks=remarks, reliable=False)
    text, page = page_of(replace(diagnosis, verdict=bad), tmp_path)
    body = text[text.index("<main>") + len("<main>") :].lstrip()
    assert body.startswith('<section class="box problem" role="alert">')
    assert text.index("two fits did &lt;not&gt; converge") < text.index("<h1>")
    assert '<section class="verdict refused">' in text


def test_nothing_missing_that_cannot_be_relied_on_is_refused(tmp_path: Path) -> None:
    diagnosis = make_diagnosis("nothing", subjects=3, size=5)
    text, page = page_of(replace(diagnosis, verdict=replace(diagnosis.verdict, reliable=False)), tmp_path)
    assert '<section class="verdict refused">' in text
    assert "means: nothing above" not in page.words


def test_signed_values_without_a_sure_sign(tmp_path: Path) -> None:
    mass = Parameter("kg", -1e-9, -4e-3, 3e-3, None)
    diagnosis = make_diagnosis(subjects=3, size=5)
    verdict = replace(diagnosis.verdict, physics=(replace(DELAY, parameters={"mass": mass}),))
    _, page = page_of(replace(diagnosis, verdict=verdict), tmp_path)
    assert "mass 0.0 g −4.0 to 3.0 –" in page.words


def test_names_are_escaped_on_the_page_and_harmless_in_pictures(tmp_path: Path) -> None:
    names = ("<b>", "a&b", "$x_{$", "\u6307\n1", "P" * 40, *(f"Q{i}" for i in range(15)))
    diagnosis = replace(make_diagnosis(size=8), subjects=names)
    where = replace(diagnosis.verdict.where, subjects=names)
    diagnosis = replace(diagnosis, verdict=replace(diagnosis.verdict, where=where))
    text, page = page_of(diagnosis, tmp_path)
    assert "<b>, a&b, $x_{$ and 17 more" in page.words
    assert "All 20 people whose recordings show it" in page.words
    assert "&lt;b&gt;, a&amp;b, $x_{$, \u6307" in text
    with style():
        figure = residual_map(diagnosis)
        assert figure is not None
        save_figure(figure, tmp_path, "map", ("png",))
    shown = {label.get_text() for label in figure.axes[0].get_yticklabels()}
    assert {"<b>", "a&b", "$x_{$", "? 1", "PPPPPPPPPPP..."} <= shown


def test_differences_from_a_simulation_are_listed_by_element(tmp_path: Path) -> None:
    rows = (
        ParameterDifference(
            element="m2",
            unit="kg",
            what="central",
            simulation=7.9e-4,
            recordings=8.6e-4,
            ratio=1.09,
            q05=1.02,
            q95=1.17,
            p_value=0.03,
        ),
        ParameterDifference(
            element="r1",
            unit="N s/m",
            what="dispersion_between_persons",
            simulation=0.3,
            recordings=0.41,
            ratio=1.37,
            q05=1.1,
            q95=1.7,
            p_value=0.0,
        ),
    )
    diagnosis = make_diagnosis()
    _, page = page_of(replace(diagnosis, differences=rows), tmp_path)
    assert "m2 centre 0.790 g 0.860 g 1.090 1.020 to 1.170 0.030" in page.words
    assert "r1 dispersion between people (sd of ln) 0.300 0.410 1.37 1.10 to 1.70 < 1e-300" in page.words
    assert "Differences from the simulation" not in page_of(diagnosis, tmp_path)[1].words


@pytest.mark.parametrize(
    ("p", "text"), [(0.0, "< 1e-300"), (1e-310, "< 1e-300"), (None, "–"), (0.031, "0.031"), (3.2e-41, "3.2×10⁻⁴¹")]
)
def test_p_values(p: float | None, text: str) -> None:
    assert p_text(p) == text


# ---------------------------------------------------------------- the drawing


# ---------------------------------------------------------------- pictures
