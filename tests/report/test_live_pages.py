"""The pages in a real browser: charts answer, a person can be chosen, keyboard and narrow screens work, paper too.

A browser is found on the machine, or these tests are left out with a word.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from browser import Browser, chromium
from diagnoses_by_hand import make_diagnosis
from PIL import Image
from results_by_hand import make_result

from bayes_impedance.plots import _DPI, PICTURES
from bayes_impedance.report import write_report
from bayes_impedance.report.diagnosis_page import write_diagnosis_report

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine: pages are not opened")

EVIL = '</script><img src=x onerror="document.title=1"><b>%{y}'
"""A name that would break out of a text that does not quote."""
PHONE = 390
DRAW_ALL = """(async () => {
  for (const box of document.querySelectorAll(".live")) {
    box.scrollIntoView({ block: "center" });
    while (!box.classList.contains("drawn")) await new Promise((done) => setTimeout(done, 20));
  }
})()"""
"""Scrolls through a page, whose charts are drawn when they come into view."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    started = Browser(tmp_path_factory.mktemp("browser"))
    yield started
    started.close()


@pytest.fixture(scope="module")
def fit_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With empty pictures of their sizes: the longest page, for paper and narrow screens."""
    folder, result, pictures = tmp_path_factory.mktemp("fit"), make_result(), {}
    for picture in PICTURES:
        if picture.applies(result):
            width, height = (round(_DPI * inches) for inches in picture.size(result))
            pictures[picture.name] = folder / f"{picture.name}.png"
            Image.new("RGB", (width, height), "white").save(pictures[picture.name])
    return write_report(result, folder, (), pictures)


@pytest.fixture(scope="module")
def diagnosis_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    diagnosis = make_diagnosis(subjects=5)
    diagnosis = replace(diagnosis, title=EVIL, subjects=(EVIL, *diagnosis.subjects[1:]))
    return write_diagnosis_report(diagnosis, tmp_path_factory.mktemp("diagnosis"), pictures={})


@pytest.fixture
def pages(fit_page: Path, diagnosis_page: Path) -> dict[str, Path]:
    return {"fit": fit_page, "diagnosis": diagnosis_page}


def shown(browser: Browser, page: Path, width: int = 1300, *, dark: bool = False) -> None:
    """Open a page and let it draw all of its charts."""
    browser.open(page, width, dark=dark)
    browser.run(DRAW_ALL)


def centre_of(browser: Browser, selector: str) -> tuple[float, float]:
    """Bring an element into the window and tell the middle of it."""
    found = browser.run(
        f"(() => {{ const e = document.querySelector({json.dumps(selector)}); e.scrollIntoView({{block: 'center'}});"
        "const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    return tuple(found)


@pytest.mark.parametrize("name", ["fit", "diagnosis"])
@pytest.mark.parametrize(("width", "dark"), [(1300, False), (PHONE, True)])
def test_a_page_draws_its_charts_without_a_complaint_and_loads_nothing(
    name: str, width: int, dark: bool, browser: Browser, pages: dict[str, Path]
) -> None:
    shown(browser, pages[name], width, dark=dark)
    assert browser.errors == []
    assert [url for url in browser.requests if not url.startswith(("data:", pages[name].as_uri()[:80]))] == []
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")
    assert browser.run("[...document.querySelectorAll('.live')].every((e) => e.querySelector('.main-svg'))")
    back = browser.run("getComputedStyle(document.body).backgroundColor")
    assert (back != "rgb(255, 255, 255)") is dark
    assert browser.run("document.querySelector('.live').layout.paper_bgcolor") == ("#14191e" if dark else "#ffffff")


@pytest.mark.parametrize("name", ["fit", "diagnosis"])
def test_no_serious_fault_for_people_with_disabilities(name: str, browser: Browser, pages: dict[str, Path]) -> None:
    found = importlib.util.find_spec("axe_core_python")
    if found is None or found.origin is None:
        pytest.skip("axe-core is not installed")
    rules = (Path(found.origin).parent / "axe.min.js").read_text(encoding="utf-8")
    width, dark = (PHONE, True) if name == "fit" else (1300, False)
    shown(browser, pages[name], width, dark=dark)
    browser.run(rules + ";0")
    # Drawings are hidden from screen readers: their text is that of the box around them.
    told = browser.run("axe.run({exclude: [['.main-svg']]}, {resultTypes: ['violations']}).then((r) => r.violations)")
    serious = [
        (fault["id"], [node["html"][:120] for node in fault["nodes"][:3]])
        for fault in told
        if fault["impact"] in ("serious", "critical")
    ]
    assert serious == []


def test_the_pointer_shows_a_value(browser: Browser, fit_page: Path) -> None:
    shown(browser, fit_page)
    x, y = centre_of(browser, "[data-chart=curves] .nsewdrag")
    for step in range(0, 90, 6):  # the nearest curve may be some pixels away
        browser.mouse(x, y + step)
        if browser.run("document.querySelector('[data-chart=curves] .hovertext') !== null"):
            break
    browser.wait("document.querySelector('[data-chart=curves] .hovertext')")
    told = browser.run("document.querySelector('[data-chart=curves] .hovertext').textContent")
    assert re.search(r"(S\d+|P\d+|median).*Hz.*\|z\| \(N s/m\): [\d.]+", told), told


def test_a_person_is_chosen_from_the_list_with_buttons_and_by_a_click(browser: Browser, fit_page: Path) -> None:
    shown(browser, fit_page)
    names = browser.run("[...document.querySelectorAll('#person-list option')].map((o) => o.textContent)")
    assert len(names) == 6
    now = "document.getElementById('person-name').textContent"
    browser.run(
        "(() => { const l = document.getElementById('person-list'); l.value = '4'; "
        "l.dispatchEvent(new Event('change')); })()"
    )
    assert browser.run(now) == names[4]
    browser.mouse(*centre_of(browser, "[data-step='1']"), click=True)
    assert browser.run(now) == names[5]
    browser.mouse(*centre_of(browser, "[data-step='1']"), click=True)
    assert browser.run(now) == names[0]
    rows = browser.run("[...document.querySelectorAll('#person-elements tr')].map((r) => r.children.length)")
    assert rows == [5] * 5
    curve = browser.run("document.querySelector('[data-chart=person]').data.map((t) => t.name)")
    assert {"recording", "fitted network", "90 % by noise alone"} <= set(curve)
    # A click on a point of somebody else's curve.
    place = browser.run(
        "(() => { const e = document.querySelector('[data-chart=elements]'); e.scrollIntoView({block: 'center'});"
        "const dots = e.querySelectorAll('.scatterlayer .trace')[0].querySelectorAll('.point');"
        "const r = dots[5 * 3].getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    browser.mouse(*place)
    browser.mouse(*place, click=True)
    browser.wait(f"{now} === {json.dumps(names[3])}")


def test_the_switch_changes_from_before_to_after(browser: Browser, diagnosis_page: Path) -> None:
    shown(browser, diagnosis_page)
    middle = "document.querySelector('[data-chart=diagnosis_bands]').data.find((t) => t.name === 'model, median').y[39]"
    cells = "document.querySelector('[data-chart=diagnosis_residuals]').data[1].z[0][39]"
    after = browser.run(f"[{middle}, {cells}]")
    browser.mouse(*centre_of(browser, "input[value=before]"), click=True)
    browser.wait(f"{cells} !== {after[1]}")
    before = browser.run(f"[{middle}, {cells}]")
    browser.mouse(*centre_of(browser, "input[value=after]"), click=True)
    browser.wait(f"{cells} === {after[1]}")
    assert before[1] != after[1]


def test_arrow_keys_say_values_and_the_theme_is_a_button(browser: Browser, fit_page: Path) -> None:
    shown(browser, fit_page)
    browser.run("document.querySelector('[data-chart=errors]').focus()")
    for _ in range(3):
        browser.key("ArrowRight")
    said = browser.run("document.getElementById('said').textContent")
    assert re.search(r": [\d.]+ at [\d.]+ Hz, magnitude error", said), said
    browser.run("document.getElementById('theme').focus()")
    browser.run("document.getElementById('theme').click()")
    assert browser.run("document.documentElement.dataset.theme") == "dark"
    assert browser.run("document.getElementById('theme').getAttribute('aria-pressed')") == "true"
    browser.wait("document.querySelector('[data-chart=errors]').layout.paper_bgcolor === '#14191e'")


HIDDEN_WORDS = """(() => {
  const bad = [];
  const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
    && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
  for (const box of document.querySelectorAll(".live.drawn")) {
    const bar = box.querySelector(".modebar").getBoundingClientRect();
    const entries = [...box.querySelectorAll(".legend .traces")].map((e) => e.getBoundingClientRect());
    if (entries.some((e) => over(e, bar))) bad.push(`${box.dataset.chart}: legend`);
    for (const axis of ["ytick", "y2tick", "y3tick"]) {
      const labels = [...box.querySelectorAll(`.${axis} text`)].map((e) => e.getBoundingClientRect());
      if (labels.some((a, i) => labels.slice(i + 1).some((b) => over(a, b)))) bad.push(`${box.dataset.chart}: ${axis}`);
    }
    const titles = [...box.querySelectorAll("[class^=ytitle], [class^=y2title], [class^=y3title]")];
    const places = titles.map((e) => e.getBoundingClientRect());
    if (places.some((a, i) => places.slice(i + 1).some((b) => over(a, b)))) bad.push(`${box.dataset.chart}: titles`);
  }
  return bad;
})()"""
"""Charts in which buttons cover the legend, or numbers or titles of the vertical axes one another."""


@pytest.mark.parametrize("name", ["fit", "diagnosis"])
@pytest.mark.parametrize("width", [1300, PHONE])
def test_words_of_a_chart_do_not_cover_one_another(
    name: str, width: int, browser: Browser, pages: dict[str, Path]
) -> None:
    shown(browser, pages[name], width)
    assert browser.run("document.querySelectorAll('.live.drawn .legend .traces').length") > 5
    assert browser.run(HIDDEN_WORDS) == []


def test_names_of_users_are_text_everywhere(browser: Browser, diagnosis_page: Path) -> None:
    shown(browser, diagnosis_page)
    browser.run(
        "(() => { const l = document.getElementById('person-list'); l.value = '0'; "
        "l.dispatchEvent(new Event('change')); })()"
    )
    assert browser.run("document.getElementById('person-name').textContent") == EVIL
    assert browser.run("document.querySelector('#person-list option').textContent") == EVIL
    assert browser.run("document.title") == f"{EVIL}: diagnosis"
    assert browser.run("document.querySelectorAll('img[src=x]').length") == 0
    text = "document.querySelector('[data-chart=diagnosis_bands]').data.find((t) => t.meta === 'one').text"
    assert browser.run(text).startswith("&lt;/script>")
    assert browser.errors == []


def test_on_paper_no_picture_is_cut(browser: Browser, fit_page: Path, tmp_path: Path) -> None:
    """What must not be broken is at most as large as a page: A4 less its margins, at 96 pixels per inch."""
    shown(browser, fit_page, dark=True)
    pdf = browser.pdf()
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type ?/Page\b", pdf)) > 5
    wide, high = (210 - 2 * 13) / 25.4 * 96, (297 - 2 * 14) / 25.4 * 96
    browser.size(int(wide), 1000)
    browser.media(paper=True)
    browser.run("dispatchEvent(new Event('beforeprint'))")
    sizes = browser.run(
        "[...document.querySelectorAll('figure img, figure .live .main-svg, .drawing svg')].map((e) => "
        "{ const r = e.getBoundingClientRect(), f = e.closest('figure'); "
        "return [f ? f.id : 'network', r.right, r.height]; })"
    )
    drawn = [size for size in sizes if size[2] > 0]
    assert len(drawn) > 10
    assert [size for size in drawn if size[1] > wide + 1 or size[2] > high] == []
    assert browser.run("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert browser.run("getComputedStyle(document.querySelector('.controls')).display") == "none"
    if os.environ.get("BAYES_IMPEDANCE_KEEP_PAGES"):  # to look at
        Path(os.environ["BAYES_IMPEDANCE_KEEP_PAGES"], "report.pdf").write_bytes(pdf)


def test_without_scripts_there_are_pictures(browser: Browser, fit_page: Path) -> None:
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.size(1300, 900)
        browser.call("Page.navigate", url=fit_page.as_uri())
        browser.wait("document.querySelectorAll('figure img').length > 8")
        state = browser.run(
            "[...document.querySelectorAll('.still')].map((e) => getComputedStyle(e).display).concat("
            "[...document.querySelectorAll('.live-only')].map((e) => getComputedStyle(e).display))"
        )
        assert state.count("none") == 2
        assert state.count("block") == 5
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
