"""What a page holds for its charts: quoted, rounded, thinned, the same for the same result, and small."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnoses_by_hand import make_diagnosis
from pages import Page, data_of
from PIL import Image
from results_by_hand import VARIANTS, described_worse, make_result

from bayes_impedance.plots import PICTURES
from bayes_impedance.plots.charts import kept_frequencies, kept_people, rounded
from bayes_impedance.plots.missing_physics import DIAGNOSIS_PICTURES
from bayes_impedance.report import write_report
from bayes_impedance.report.diagnosis_page import write_diagnosis_report
from bayes_impedance.report.live_page import GLUE, LIBRARY, contents, embedded_data, script, security_policy
from bayes_impedance.results.model_before import ModelBefore, with_model_before

ASSETS = Path(script.__wrapped__.__code__.co_filename).parent / "assets"
NAMES = ("</script><script>alert(1)</script>", "<!--", "]]>", "a'b\"c&d", "\u2028\u2029", "\ud800", "%{y}", "x" * 300)


@pytest.mark.parametrize("name", NAMES)
def test_data_cannot_end_the_element_that_holds_them(name: str) -> None:
    text = str(embedded_data({name: [name, 1.5, None]}))
    assert not set("<>&'\u2028\u2029") & set(text)
    assert json.loads(text) == {name: [name, 1.5, None]}


def test_a_number_that_json_does_not_know_is_refused() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        embedded_data([float("nan")])


def test_names_of_people_are_data_and_text(tmp_path: Path) -> None:
    diagnosis = make_diagnosis(subjects=3, size=8)
    diagnosis = replace(diagnosis, title=NAMES[0], subjects=NAMES[:3])
    text = write_diagnosis_report(diagnosis, tmp_path, pictures={}).read_text(encoding="utf-8")
    assert data_of(text)["people"] == list(NAMES[:3])
    assert Page(text).tags.count("script") == 3
    assert "<script>alert" not in text


def test_the_library_is_the_one_that_is_named_and_only_known_scripts_run() -> None:
    said = (ASSETS / "README.md").read_text(encoding="utf-8")
    digest = hashlib.sha256((ASSETS / "plotly-cartesian.min.js").read_bytes()).hexdigest()
    assert digest in said
    assert "MIT" in (ASSETS / "LICENSE.plotly").read_text(encoding="utf-8")
    version = re.search(r"v(\d+\.\d+\.\d+)", script(LIBRARY)[:200])
    assert version is not None
    assert f"plotly.js {version.group(1)}" in said
    policy = security_policy()
    assert policy.count("'sha256-") == 2
    assert "default-src 'none'" in policy
    assert not re.search(r"script-src[^;]*unsafe", policy)
    assert "eval(" not in script(GLUE)
    assert "innerHTML" not in script(GLUE)


@pytest.mark.parametrize("variant", VARIANTS)
def test_data_of_a_run(variant: str, tmp_path: Path) -> None:
    result = make_result(**VARIANTS[variant])
    text = write_report(result, tmp_path / "a", pictures={}).read_text(encoding="utf-8")
    again = write_report(result, tmp_path / "b", pictures={}).read_text(encoding="utf-8")
    assert text == again
    data, n = data_of(text), len(result.coords["subject"])
    assert data["people"] == list(result.coords["subject"])
    assert len(data["persons"]) == n
    names = {chart["name"] for chart in data["charts"]}
    if result.problems:
        assert names == {"curves", "noise", "person"}
        assert data["elements"] is None
        assert all(len(person["facts"]) == 1 and person["elements"] == [] for person in data["persons"])
    else:
        assert {"curves", "noise", "person", "bands", "errors"} <= names
        magnitude = np.abs(
            result.groups["constant_data"]["observed_re"] + 1j * result.groups["constant_data"]["observed_im"]
        )
        first = np.array([np.nan if v is None else v for v in data["curves"]["magnitude"][0]])
        ratio = first / magnitude[0]
        assert np.nanmax(ratio) / np.nanmin(ratio) < 1.002  # one unit for all, four digits
        fitted = np.array([np.nan if v is None else v for v in data["curves"]["fit_magnitude"][0]])
        assert np.nanmax(np.abs(fitted / first - 0.99)) < 0.001
    ids = [id for id, _ in contents(text)]
    assert len(ids) == len(set(ids)) >= 6
    assert all(f'href="#{id}"' in text for id in ids)
    assert len(text) < 2_500_000


def test_a_network_to_which_something_was_added_can_be_compared_with_the_one_before(tmp_path: Path) -> None:
    result = make_result()
    z = result.groups["constant_data"]["observed_re"] + 1j * result.groups["constant_data"]["observed_im"]
    earlier = described_worse(result)
    both = with_model_before(result, ModelBefore("m1", earlier))
    text = write_report(both, tmp_path, pictures={}).read_text(encoding="utf-8")
    data = data_of(text)
    assert text.count("the choice of the network: the network before") == 3
    assert "Of the network before: in magnitude" in text
    assert "That of the network before holds" in text
    assert data["models"] == ["before", "after"]
    assert '<input type="radio" name="model" value="after" checked>' in text
    ratio = np.array(data["curves"]["fit_magnitude_before"]) / np.array(data["curves"]["fit_magnitude"])
    assert np.abs(ratio - 0.5 / 0.99).max() < 0.001
    assert np.abs(np.array(data["curves"]["residual_along_before"]) - 100).max() < 0.1
    charts = {chart["name"]: chart for chart in data["charts"]}
    for panel in (*charts["bands"]["panels"], *charts["person"]["panels"]):
        shown = [item["when"] for item in (*panel.get("own", []), *panel["lines"])]
        assert {"before", "after"} <= set(shown)
    for name, factor in (("errors", (3, 4)), ("coverage", (0.5, 0.5))):
        for panel, times in zip(charts[name]["panels"], factor, strict=True):
            lines = {line["name"]: np.array(line["y"]) for line in panel["lines"]}
            now = lines["inside the 90 % band" if name == "coverage" else "population network"]
            (before,) = (y for title, y in lines.items() if title.endswith("the network before"))
            np.testing.assert_allclose(before, times * now, rtol=2e-3)
    earlier.person_curve = z[:, 1:]
    assert with_model_before(result, ModelBefore("m1", earlier)) is result
    assert data_of(write_report(result, tmp_path, pictures={}).read_text("utf-8"))["models"] == ["fit"]


def test_an_unknown_element_has_no_row_and_no_mark(tmp_path: Path) -> None:
    data = data_of(write_report(make_result(unidentified=("n3",)), tmp_path, pictures={}).read_text(encoding="utf-8"))
    assert "n3" not in data["elements"]["names"]
    assert len(data["elements"]["names"]) == 4
    assert all([row[0] for row in person["elements"]] == data["elements"]["names"] for person in data["persons"])
    row = data["persons"][0]["elements"][0]
    assert re.fullmatch(r"\d+\.\d sd (above|below)", row[4])


def test_every_picture_says_what_is_seen(tmp_path: Path) -> None:
    blank = tmp_path / "blank.png"
    Image.new("RGB", (4, 3), "white").save(blank)
    for text in (
        write_report(make_result(), tmp_path, (), dict.fromkeys((p.name for p in PICTURES), blank)).read_text("utf-8"),
        write_diagnosis_report(
            make_diagnosis(subjects=4, size=12), tmp_path, dict.fromkeys(DIAGNOSIS_PICTURES, blank)
        ).read_text("utf-8"),
    ):
        said = re.findall(r'<img[^>]* alt="([^"]*)"', text) + re.findall(r'aria-label="Chart\. ([^"]*)"', text)
        assert len(said) > 8
        for words in said:
            assert len(words) > 50
            assert not re.search(r"\b(nan|None|inf)\b", words)
        assert sum(bool(re.search(r"\d", words)) for words in said) >= 0.7 * len(said)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["fit", "diagnosis"])
def test_pages_of_as_many_recordings_as_the_shipped_stay_below_6_mb(kind: str, tmp_path: Path) -> None:
    """71 people x 3 x 401, pictures included."""
    if kind == "fit":
        page = write_report(make_result(subjects=71, points=401), tmp_path)
    else:
        page = write_diagnosis_report(make_diagnosis("two", subjects=71, size=401), tmp_path)
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") >= 5
    assert len(data_of(text)["people"]) == 71
    assert 2_000_000 < page.stat().st_size < 6_000_000  # the library and the pictures are in it


def test_numbers_are_short_and_frequencies_few() -> None:
    assert rounded(np.array([1.0, 123456.7, 1.23456e-5, np.nan, np.inf])) == [1, 123500, 1.235e-05, None, None]
    assert kept_frequencies(5, 30, 6).tolist() == list(range(30))
    kept = kept_frequencies(1000, 401, 6)
    assert (kept[0], kept[-1]) == (0, 400)
    assert 35 <= kept.size <= 50
    people = kept_people(50_000, 6, first=(49_999, 7))
    assert {7, 49_999} <= set(people)
    assert len(people) <= 1000
    assert people == sorted(set(people))
