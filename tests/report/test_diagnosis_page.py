"""The page of a diagnosis: it says what was found or how small it must be, whatever is missing, and stands alone."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import Page

from bayes_impedance.diagnosis.types import Diagnosis, OnePort, Ranked, Snapshot
from bayes_impedance.diagnosis.verdict_types import (
    Alias,
    BlockGain,
    Detectable,
    EvidenceOfEffect,
    Improvement,
    Joint,
    Located,
    Parameter,
    ParameterDifference,
    Physics,
    Verdict,
    Where,
)
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import PAPER_NETWORK, Place, parse
from bayes_impedance.plots import save_figure, style, write_diagnosis_pictures
from bayes_impedance.plots.missing_physics import (
    DIAGNOSIS_PICTURES,
    bands,
    improvement,
    one_ports,
    pattern_order,
    pooled,
    pooled_residual,
    residual_map,
)
from bayes_impedance.report.diagnosis_page import added, write_diagnosis_report
from bayes_impedance.report.findings import p_text
from bayes_impedance.report.schematic import schematic

CIRCUIT = "r0|(r1-n1)|(r2-n2)"
VALUES = {"n3": 8e-6, "r3": 61.4, "m2": 7.9e-4, "r1": 5.0, "n1": 1.15e-3, "m1": 0.02, "n2": 4e-4, "r2": 3.0}
CELL = {"r0": 0.02, "r1": 0.01, "n1": 0.5, "r2": 0.03, "n2": 40.0}
SUMMARY = "The phase runs ahead above 700 Hz in everybody: 1.5 µs of channel delay explain it."
LIMITS = tuple(
    Detectable(id=effect, name="", place=place, parameter="size", above=above, unit=unit, shape={})
    for effect, place, above, unit in (
        ("rig.mass", "port", 2.1e-6, "kg"),
        ("rig.delay", "port", 3.1e-8, "s"),
        ("body.relaxation", "skin", 0.34, "N s/m"),
        ("body.relaxation", "tissue", 0.012, "N s/m"),
        ("rig.lowpass", "port", 41e3, "Hz"),
    )
)
ALIASES = (
    Alias(
        id="rig.mass",
        name="",
        place="port",
        elpd_behind=55.2,
        separated=True,
        would_separate="a recording without a finger",
    ),
    Alias(
        id="rig.series_compliance",
        name="",
        place="port",
        elpd_behind=1.3,
        separated=False,
        would_separate="frequencies above 8 kHz, or a stiff dummy in place of the finger",
    ),
)
DELAY = Physics(
    kind="effect",
    id="rig.delay",
    name="a delay between the channels",
    story="The force is sampled a little later than the acceleration. The phase falls with frequency.",
    formula="z e^(-s tau)",
    place="port",
    side="rig",
    pooling="shared",
    parameters={"delay": Parameter("s", 1.5e-6, 1.42e-6, 1.61e-6, 0.012)},
    dispersion_interval=(0.0, 0.031),
    evidence=EvidenceOfEffect(2096.3, 0.0, 985.0, 40.0),
    aliases=ALIASES,
)
RESONATOR = replace(
    DELAY,
    id="body.resonator",
    name="a further joint or bone that swings along",
    story="Another mass on a spring swings inside of the tissue. It takes energy near its own frequency.",
    formula="s m - (r + k/s)",
    place="tissue",
    side="body",
    pooling="varying",
    parameters={
        "mass": Parameter("kg", 2.4e-4, 1.9e-4, 3.1e-4, 0.31),
        "resonance": Parameter("Hz", 1310.0, 1240.0, 1390.0, 0.08),
    },
    dispersion_interval=(0.22, 0.44),
    evidence=EvidenceOfEffect(310.4, 3.2e-41, 121.0, None),
    aliases=tuple(replace(ALIASES[i % 2], id=f"body.line{i}", elpd_behind=3.0 * i) for i in range(30)),
)
UNKNOWN = Physics(
    kind="unknown",
    id="unknown",
    name="physics outside of the catalogue",
    story="Something is missing that is not in the catalogue.",
    formula="a small network",
    place="port",
    side=None,
    pooling="shared",
    parameters={},
    evidence=EvidenceOfEffect(None, None, 985.0, 40.0),
    network="r9-(n9|m9)",
    connection="beside",
)


def verdict_of(physics: tuple[Physics, ...], network: str, after: str | None, **changes: Any) -> Verdict:
    """A verdict by hand."""
    found = bool(physics)
    verdict = Verdict(
        summary=SUMMARY if found else "Nothing is missing that these recordings could show.",
        where=Where(
            bands_hz=((700.0, 5000.0),) if found else (),
            part="phase",
            place="port" if found else None,
            side="rig" if found else None,
            subjects="all",
            covariate=None,
        ),
        located=Located(
            p_value=1e-9,
            bands=(),
            magnitude_share=0.1,
            subjects_p_value=1.0,
            repetitions=None,
            covariates={},
        ),
        physics=physics,
        improvement=Improvement(
            delta_magnitude=(1.31, 1.27),
            delta_phase_deg=(8.7, 8.1),
            subject_rms_relative=(0.034, 0.021),
            coverage90=(0.82, 0.898),
            elpd_gain=985.0,
            elpd_gain_se=40.0,
            blocks=BlockGain(900.0, 50.0),
            held_out="5 subject folds, 8 frequency blocks",
        ),
        network=(network, after or network),
        detectable=LIMITS,
        not_identifiable=("gain",),
        elements_not_identified=("n3",),
        seed=7,
        data_sha256="ab12" * 16,
        title="ten <fingers> & a thumb",
        unit="N s/m",
        reliable=True,
        remarks=(),
        version="0.1.0",
    )
    return replace(verdict, **changes)


def snapshot(label: str, network: str, z: np.ndarray, f: np.ndarray, shift: np.ndarray, seed: int) -> Snapshot:
    """Noise as residuals, with `shift` (2, F) in magnitude and phase added to everybody's."""
    rng = np.random.default_rng(seed)
    n = len(z)
    near = np.exp(-0.5 * (np.subtract.outer(np.log(f), np.log(f)) / 0.15) ** 2)
    smooth = near / near.sum(axis=1, keepdims=True)
    spread = np.exp(0.3 * np.array([-1.64, 0.0, 1.64]))[:, None]
    middle = np.exp(smooth @ np.log(np.abs(z)).mean(axis=0))
    each = np.linspace(0.5, 1.5, n)[:, None] if n > 1 else np.ones((1, 1))
    size = np.abs(shift).mean()
    return Snapshot(
        label=label,
        network=network,
        frequency_hz=f,
        magnitude=spread * middle,
        phase_deg=np.degrees(smooth @ np.angle(z).mean(axis=0)) + np.array([-12.0, 0.0, 12.0])[:, None],
        residual_magnitude=rng.normal(size=(n, f.size)) + each * shift[0],
        residual_phase=rng.normal(size=(n, f.size)) + each * shift[1],
        delta_magnitude=0.25 * middle * (1 + 0.05 * size),
        delta_phase_deg=np.full(f.size, 8.0 + size) + rng.normal(0, 0.3, f.size),
        subject_rms_relative=np.exp(rng.normal(np.log(0.02 + 0.01 * size), 0.2, n)),
        coverage90=np.clip(0.9 - 0.1 * size + rng.normal(0, 0.03, (2, f.size)), 0, 1),
    )


def rank(i: int, **changes: Any) -> Ranked:
    """A line of the ranking."""
    row = Ranked(
        id=("rig.delay", "rig.mass", "rig.series_compliance", "body.springpot", "body.resonator")[i % 5],
        place=("port", "port", "port", "skin", "tissue")[i % 5],
        pooling=("shared", "shared", "shared", "varying", "some")[i % 5],
        shape="" if i % 5 < 3 else "peak at 310 Hz",
        score=2096.3 * 0.62**i,
        p_value=0.0 if i == 0 else min(1.0, 10.0 ** (-200 + 14 * i)),
        size=f"{1.5 / (i + 1):.2g} µs",
        physical=i % 4 != 3,
        likeness=(-1.0) ** i * 0.985**i,
        note="found" if i == 0 else "alias, 55 behind" if i == 1 else "",
    )
    return replace(row, **changes)


def make_diagnosis(
    kind: str = "found", *, subjects: int = 20, repetitions: int = 3, electrical: bool = False, size: int = 40
) -> Diagnosis:
    """A diagnosis by hand: ``found`` (a delay), ``two``, ``unknown`` or ``nothing``."""
    rng = np.random.default_rng(11)
    f = np.geomspace(0.1, 1000, size) if electrical else np.geomspace(5, 5000, size)
    before, values = (CIRCUIT, CELL) if electrical else (PAPER_NETWORK, VALUES)
    each = {name: value * np.exp(0.3 * rng.normal(size=(subjects, 1))) for name, value in values.items()}
    noise = rng.normal(size=(subjects, size)) + 1j * rng.normal(size=(subjects, size))
    z = parse(before).impedance(2j * np.pi * f, each) * (1 + 0.02 * noise)
    after: str | None = None
    extra: dict[str, Any] = {}
    physics = {"found": (DELAY,), "two": (DELAY, RESONATOR), "unknown": (UNKNOWN,), "nothing": ()}[kind]
    if kind == "two":
        after = str(parse(before).beside("tissue", parse("m4-(n4|r4)")))
        extra["joint"] = Joint(
            ("rig.delay delay", "body.resonator mass", "body.resonator resonance"),
            ((1, 0.12, -0.61), (0.12, 1, 0.44), (-0.61, 0.44, 1)),
        )
    if kind == "unknown":
        extra["summary"] = "Something is missing that nothing in the catalogue describes."
    verdict = verdict_of(physics, before, after, **extra)
    high = f > f[-1] / 7
    shift = np.stack([0.2 * high, -1.8 * high * (f / f[-1])]) if physics else np.zeros((2, size))
    ratio = (f / f[-1]) ** 2 * (0.15 + 0.3j) + 0.01 * (rng.normal(size=size) + 1j * rng.normal(size=size))
    places = ("port", "tissue", "skin", "limb", "m2", "r1") if not electrical else ("port",)
    return Diagnosis(
        title="ten <fingers> & a thumb",
        unit="ohm" if electrical else "N s/m",
        subjects=tuple(f"P{i:02d}" for i in range(1, subjects + 1)),
        repetitions=repetitions,
        verdict=verdict,
        before=snapshot("before", before, z, f, shift, 1),
        after=snapshot("after", after or before, z, f, np.zeros((2, size)), 2) if physics else None,
        observed=z,
        ranking=tuple(rank(i) for i in range(22))
        if physics
        else tuple(rank(i, score=6.0 - i, p_value=1.0, note="") for i in (0, 2)),
        one_ports=tuple(
            OnePort(p, f, ratio * (i + 1), np.full(size, 0.02 * (i + 1)), 0.96 / (i + 1)) for i, p in enumerate(places)
        ),
        differences=(),
        seconds={"screen": 1.2, "confirm": 33.0},
    )


def holes(diagnosis: Diagnosis) -> Diagnosis:
    """The same with all that may be missing missing."""
    nan = np.full_like(diagnosis.before.residual_phase, np.nan)
    some = diagnosis.before.residual_magnitude.copy()
    some[:, :5] = np.nan
    observed = diagnosis.observed.copy()
    observed[:, 3], observed[0, 20:] = np.nan, np.nan
    empty = np.full(nan.shape[1], np.nan)
    broken = replace(
        diagnosis.before,
        residual_phase=nan,
        residual_magnitude=some,
        delta_phase_deg=empty,
        delta_magnitude=empty,
        subject_rms_relative=np.full(nan.shape[0], np.nan),
        coverage90=np.full((2, nan.shape[1]), np.nan),
    )
    port = diagnosis.one_ports[0]
    nan_number = float("nan")
    entry = replace(
        DELAY,
        side=None,
        parameters={"delay": Parameter("s", nan_number, nan_number, nan_number, None)},
        evidence=EvidenceOfEffect(None, None, None, None),
        aliases=(replace(ALIASES[0], elpd_behind=nan_number),),
        dispersion_interval=None,
    )
    drift = replace(entry, kind="trend", id="body.drift", place="nowhere", parameters={}, aliases=())
    return replace(
        diagnosis,
        verdict=replace(
            diagnosis.verdict,
            physics=(entry, drift),
            improvement=None,
            where=replace(diagnosis.verdict.where, bands_hz=(), place=None, side=None),
            detectable=(),
            not_identifiable=(),
            elements_not_identified=(),
            data_sha256="",
        ),
        before=broken,
        after=replace(broken, label="after"),
        observed=observed,
        one_ports=(replace(port, sd=empty, share=np.nan), replace(port, ratio=1j * empty)),
        ranking=(rank(0, score=np.nan, p_value=np.nan, likeness=np.nan, size=""),),
        differences=(
            ParameterDifference(
                element="m2",
                unit="kg",
                what="central",
                simulation=8e-4,
                recordings=np.nan,
                ratio=np.nan,
                q05=np.nan,
                q95=np.nan,
                p_value=np.nan,
            ),
        ),
        seconds={},
    )


def page_of(diagnosis: Diagnosis, folder: Path) -> tuple[str, Page]:
    """The page without pictures: those are slow, and tested by themselves."""
    text = write_diagnosis_report(diagnosis, folder, pictures={}).read_text(encoding="utf-8")
    return text, Page(text)


VARIANTS: dict[str, dict[str, Any]] = {
    "found": {"kind": "found"},
    "two": {"kind": "two", "subjects": 130},
    "unknown": {"kind": "unknown", "subjects": 1, "repetitions": 1, "electrical": True},
    "nothing": {"kind": "nothing", "subjects": 71},
}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Path]]:
    """PNG files of all variants, drawn once."""
    made = {name: make_diagnosis(**variant) for name, variant in VARIANTS.items() if name in ("two", "unknown")}
    made["holes"] = holes(make_diagnosis(subjects=4))
    return {n: write_diagnosis_pictures(d, tmp_path_factory.mktemp(n), ("png",)) for n, d in made.items()}


# ---------------------------------------------------------------- the page


@pytest.mark.parametrize("variant", [*VARIANTS, "holes"])
def test_page_is_well_formed_and_stands_alone(variant: str, tmp_path: Path) -> None:
    diagnosis = holes(make_diagnosis(subjects=4)) if variant == "holes" else make_diagnosis(**VARIANTS[variant])
    text, page = page_of(diagnosis, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    for word in ("http", "<script", "url(", "<link"):
        assert word not in text
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
    assert "delay 1.500 µs 1.420 to 1.610 1.2 %" in page.words
    assert "at: port belongs to: the rig the same for everybody" in page.words
    assert "Relative spread between people: 1.2 %, 90 % interval 0 % to 3.1 %." in page.words
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
    assert "inside of the predicted 90 % band 82.0 % 89.8 %" in page.words
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
    assert "speaks for the body. Relative spread between people: 31 %, 90 % interval 22 % to 44 %" in page.words
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
    for absent in ("What was left out", "Is it better with it?", "<article", "<h3>After", 'class="k"'):
        assert absent not in text
    assert text.index("What would have been seen") < text.index("<h2>The network")
    assert "“Nothing” means: nothing as large as this." in page.words


def test_unknown_draws_the_one_port_that_is_missing(tmp_path: Path) -> None:
    text, page = page_of(make_diagnosis("unknown", electrical=True, subjects=1, repetitions=1), tmp_path)
    assert '<section class="verdict unknown">' in text
    assert {"r9", "n9", "m9"} <= set(page.drawn)
    assert text.count("<article") == 1  # not once as unknown and once as unexplained
    assert "A one-port is missing at port" in page.words
    assert "One subject was measured" in page.words
    assert "person" not in page.words


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
    assert "means: nothing as large" not in page.words


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
    assert "All 20 people in whom it is seen" in page.words
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
    assert "r1 spread between persons (sd of ln) 0.300 0.410 1.37 1.10 to 1.70 < 1e-300" in page.words
    assert "Differences from the simulation" not in page_of(diagnosis, tmp_path)[1].words


@pytest.mark.parametrize(
    ("p", "text"), [(0.0, "< 1e-300"), (1e-310, "< 1e-300"), (None, "–"), (0.031, "0.031"), (3.2e-41, "3.2×10⁻⁴¹")]
)
def test_p_values(p: float | None, text: str) -> None:
    assert p_text(p) == text


# ---------------------------------------------------------------- the drawing


def box(svg: str) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of the highlight."""
    found = re.findall(r'<rect class="k" x="([-\d.]+)" y="([-\d.]+)" width="([\d.]+)" height="([\d.]+)"', svg)
    assert len(found) == 1
    x, y, width, height = map(float, found[0])
    return x, y, x + width, y + height


def inside(svg: str) -> set[str]:
    """Elements whose name is in the highlight."""
    left, top, right, bottom = box(svg)
    names = re.findall(r'<text class="n" x="([\d.]+)" y="([\d.]+)" text-anchor="middle">(\w+)</text>', svg)
    return {name for x, y, name in names if left < float(x) < right and top < float(y) < bottom}


@pytest.mark.parametrize("electrical", [False, True])
def test_a_mark_is_around_its_part_and_no_other(electrical: bool) -> None:
    network = parse(PAPER_NETWORK)
    for place in network.places()[1:]:
        svg = schematic(network, electrical=electrical, mark=place)
        assert inside(svg) == set(network.at(place).elements), place.name
        width, height = map(float, re.search(r'viewBox="0 0 (\d+) (\d+)"', svg).groups())
        left, top, right, bottom = box(svg)
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
        assert sorted(Page(svg).drawn) == sorted(network.elements)


def test_the_port_is_marked_at_its_end() -> None:
    network = parse(PAPER_NETWORK)
    svg = schematic(network, mark=Place((), "port"))
    left, top, right, bottom = box(svg)
    x, y = map(float, re.search(r'<circle class="w" cx="([\d.]+)" cy="([\d.]+)"', svg).groups())
    assert left < x < right
    assert top < y < bottom
    assert inside(svg) == set()
    assert svg == schematic(network, mark=()) == schematic(network, mark={(): ""})


def test_nothing_marked_is_the_drawing_as_it_was() -> None:
    network = parse(PAPER_NETWORK)
    assert schematic(network) == schematic(network, mark=None) == schematic(network, mark={})
    assert ".k{" not in schematic(network)
    two = schematic(network, mark={(): "1, 2", network.place("skin").path: "<3>"})
    assert two.count('<rect class="k"') == 2
    assert ">1, 2</text>" in two
    assert "&lt;3&gt;" in two


def test_places_and_new_parts_are_marked_on_the_page(tmp_path: Path) -> None:
    diagnosis = make_diagnosis("two")
    text, _ = page_of(diagnosis, tmp_path)
    before, after = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert before.count('<rect class="k"') == 2  # the port and the tissue
    assert ">1</text>" in before
    assert ">2</text>" in before
    assert inside(after) == {"m4", "n4", "r4"}
    assert ">new</text>" in after


def test_added_parts_are_the_largest_new_ones() -> None:
    assert added("n1|r1", "n1|r1|(m2-r2)") == [(2,)]
    assert added("n1|r1", "(n1|r1|n2)-r3") == [(0, 2), (1,)]
    assert added("n1|r1", "n1|r1") == added("n1", "no network (") == []


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize(
    ("variant", "absent"),
    [
        ("two", set()),
        ("unknown", {"diagnosis_residuals"}),
        ("holes", set()),
    ],
)
def test_pictures_apply_and_are_not_empty(drawn, variant: str, absent: set[str]) -> None:
    from matplotlib.image import imread

    assert set(drawn[variant]) == set(DIAGNOSIS_PICTURES) - absent
    for file in drawn[variant].values():
        pixels = imread(file)[..., :3]
        assert np.mean(np.any(pixels < 0.97, axis=-1)) > 0.01, file.name


def test_map_shows_the_residuals_in_one_order_and_on_one_scale() -> None:
    diagnosis = make_diagnosis("two", subjects=30)
    with style():
        figure = residual_map(diagnosis)
    assert figure is not None
    before, after = diagnosis.before, diagnosis.after
    order = pattern_order(np.hstack([before.residual_magnitude, before.residual_phase]))
    shown = (before.residual_magnitude, after.residual_magnitude, before.residual_phase, after.residual_phase)
    for axes, rows in zip(figure.axes, shown, strict=False):
        mesh = axes.collections[0]
        np.testing.assert_array_equal(mesh.get_array(), rows[order])
        assert mesh.get_clim() == (-4.0, 4.0)
    assert residual_map(make_diagnosis(subjects=1)) is None


def test_order_follows_the_first_principal_component() -> None:
    rng = np.random.default_rng(4)
    size = rng.permutation(np.arange(40.0))
    rows = np.outer(size, np.sin(np.arange(25))) + 0.01 * rng.normal(size=(40, 25))
    found = size[pattern_order(rows)]
    assert abs(np.corrcoef(found, np.arange(40))[0, 1]) > 0.9999
    assert list(pattern_order(np.full((3, 4), np.nan))) == [0, 1, 2]


def test_pooled_residual_is_the_mean_times_the_root_of_the_number() -> None:
    rows = np.array([[1.0, np.nan, np.nan], [2.0, 3.0, np.nan], [3.0, 5.0, np.nan], [6.0, 1.0, np.nan]])
    np.testing.assert_allclose(pooled(rows), [3.0 * 2, 3.0 * np.sqrt(3), np.nan])
    # Noise stays noise: unit variance whatever the number of people (chi-square with 400 degrees of freedom, 5 sd).
    noise = pooled(np.random.default_rng(0).normal(size=(50, 400)))
    assert abs(np.var(noise) - 1) < 5 * np.sqrt(2 / 400)


def test_pooled_picture_shades_the_bands_inside_of_the_grid() -> None:
    diagnosis = make_diagnosis(subjects=9)
    where = replace(diagnosis.verdict.where, bands_hz=((1.0, 8.0), (700.0, 9000.0), (2e4, 3e4)))
    with style():
        figure = pooled_residual(replace(diagnosis, verdict=replace(diagnosis.verdict, where=where)))
    for axes, rows in zip(
        figure.axes, (diagnosis.before.residual_magnitude, diagnosis.before.residual_phase), strict=True
    ):
        extents = [(p.get_x(), p.get_x() + p.get_width()) for p in axes.patches[:-1]]
        np.testing.assert_allclose(extents, [(5.0, 8.0), (700.0, 5000.0)])
        np.testing.assert_allclose(axes.lines[1].get_ydata(), pooled(rows))


def test_band_columns_are_before_and_after() -> None:
    diagnosis = make_diagnosis(subjects=5)
    with style():
        figure = bands(diagnosis)
        single = bands(make_diagnosis("nothing"))
    assert [axes.get_title(loc="left") for axes in figure.axes[:2]] == ["Before", "After"]
    assert len(figure.axes) == 6
    assert len(single.axes) == 3
    assert single.axes[0].get_title(loc="left") == ""
    np.testing.assert_allclose(figure.axes[1].lines[-1].get_ydata(), diagnosis.after.magnitude[1])


def test_one_ports_show_the_best_places_with_what_they_explain() -> None:
    diagnosis = make_diagnosis()
    with style():
        figure = one_ports(diagnosis)
        quiet = one_ports(make_diagnosis("nothing"))
    assert figure is not None
    assert quiet is not None
    assert len(figure.axes) == 8
    assert [a.get_title(loc="left") for a in figure.axes[:4:2]] == [
        "at port: explains 96 %",
        "at tissue: explains 48 %",
    ]
    assert quiet.axes[0].get_title(loc="left") == "at port"
    np.testing.assert_allclose(figure.axes[1].lines[-1].get_ydata(), diagnosis.one_ports[0].ratio.imag)
    assert figure.axes[-1].get_xlabel() == "frequency (Hz)"
    peak = diagnosis.one_ports[0].ratio.imag.max()
    assert figure.axes[1].get_ylim()[1] > peak
    assert one_ports(replace(diagnosis, one_ports=())) is None


def test_improvement_needs_an_after() -> None:
    with style():
        assert improvement(make_diagnosis("nothing")) is None
        assert len(improvement(make_diagnosis(subjects=4)).axes) == 4
        assert len(improvement(make_diagnosis(subjects=1)).axes) == 2


def test_formats_can_be_chosen(tmp_path: Path) -> None:
    with style():
        figure = pooled_residual(make_diagnosis(subjects=3, size=6))
    assert save_figure(figure, tmp_path, "a", ("png", "pdf")).name == "a.png"
    assert save_figure(figure, tmp_path, "b", ("pdf",)).name == "b.pdf"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.pdf", "a.png", "b.pdf"]
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    for wrong in (("jpeg",), ()):
        with pytest.raises(InputError, match="choose from png, svg and pdf"):
            save_figure(figure, tmp_path, "c", wrong)
