"""Pictures: every one that applies is written, none warns, and the same result gives the same bytes."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from extended_results import extended
from hypothesis import given
from hypothesis import strategies as st
from results_by_hand import VARIANTS, make_result
from strategies import repeatable

from bayes_impedance.plots import PICTURES, new_figure, style, write_pictures
from bayes_impedance.plots.parameters import factor_axis, priors
from bayes_impedance.plots.style import log_axis
from bayes_impedance.runtime.worker_processes import Processes

ALWAYS = {"curves", "bands", "errors", "noise", "priors"}
DISPERSED = {"forest", "corner_dispersion"}


def expected(variant: str) -> set[str]:
    """Names of the pictures that a variant has."""
    names = {picture.name for picture in PICTURES}
    if variant == "one subject":
        return names - DISPERSED - {"correlation", "coverage"}
    if variant == "no element seen":
        return ALWAYS | {"coverage"}
    if variant in ("one element seen", "diagonal covariance"):
        return names - {"correlation"}
    return names


@pytest.mark.long
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_is_drawn_without_a_warning(variant: str) -> None:
    result = make_result(**VARIANTS[variant])
    applicable = [picture for picture in PICTURES if picture.applies(result)]
    assert {picture.name for picture in applicable} == expected(variant)
    with style():
        for picture in applicable:
            picture.figure(result).draw_without_rendering()


@pytest.mark.long
def test_writes_both_formats_and_the_same_bytes_again(tmp_path: Path) -> None:
    first = write_pictures(make_result(), tmp_path / "new" / "folder")
    second = write_pictures(make_result(), tmp_path / "again")
    assert set(first) == set(second) == expected("people")
    for name, file in first.items():
        assert file.read_bytes().startswith(b"\x89PNG")
        assert file.with_suffix(".svg").read_text(encoding="utf-8").rstrip().endswith("</svg>")
        for suffix in (".png", ".svg"):
            assert file.with_suffix(suffix).read_bytes() == second[name].with_suffix(suffix).read_bytes(), name
    assert {p.suffix for p in (tmp_path / "again").iterdir()} == {".png", ".svg"}
    with Processes(1) as helper:
        third = write_pictures(make_result(), tmp_path / "helped", helper)
    assert list(third) == list(first)
    for file in (tmp_path / "again").iterdir():
        assert file.read_bytes() == (tmp_path / "helped" / file.name).read_bytes(), file.name


def test_leaves_no_trace_in_matplotlib(tmp_path: Path) -> None:
    import matplotlib

    before = dict(matplotlib.rcParams)
    written = write_pictures(make_result(subjects=1, repetitions=1, electrical=True), tmp_path)
    assert set(written) == expected("one subject")
    assert dict(matplotlib.rcParams) == before
    if "matplotlib.pyplot" in sys.modules:  # corner imports it
        assert sys.modules["matplotlib.pyplot"].get_fignums() == []


@pytest.mark.parametrize("name", ["forest", "noise"])
def test_marks_of_many_people_are_an_image_in_the_svg(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One mark for each of a hundred thousand would be a file of hundreds of megabytes."""
    (picture,) = (one for one in PICTURES if one.name == name)

    def marks() -> int:
        with style():
            figure = picture.figure(make_result())
            figure.savefig(tmp_path / "picture.svg")
        return (tmp_path / "picture.svg").read_text(encoding="utf-8").count("<use ")

    few = marks()
    for where in ("spectra", "parameters"):
        monkeypatch.setattr(f"bayes_impedance.plots.{where}.MOST_DRAWN", 1)
    axes_alone = marks()
    people = len(make_result().coords["subject"])
    assert few - axes_alone >= 2 * people


@pytest.mark.parametrize("picture", PICTURES, ids=lambda p: p.name)
def test_axes_say_what_they_show(picture) -> None:
    with style():
        figure = picture.figure(make_result())
        texts = {t.get_text() for a in figure.axes for t in (a.xaxis.label, a.yaxis.label, a.title, a._left_title)}
    assert any(texts - {""})
    if picture.name in ("curves", "bands", "errors"):
        assert "frequency (Hz)" in texts
        assert any("(N s/m)" in t for t in texts)
        assert any("(°)" in t for t in texts)
        assert {a.get_xscale() for a in figure.axes} == {"log"}
        assert figure.axes[0].get_yscale() == "log"
        assert figure.axes[-1].get_yscale() == "linear"


def test_a_very_wide_posterior_is_shown_by_its_logarithm() -> None:
    result = make_result(subjects=1, repetitions=1)
    i = result.elements.index("n3")
    result.groups["posterior"]["central"][..., i] *= np.exp(2 * np.random.default_rng(1).normal(size=(2, 60)))
    with style():
        picture = next(p for p in PICTURES if p.name == "corner_central")
        labels = [a.get_xlabel() for a in picture.figure(result).axes]
    assert sum("log10 n3" in label for label in labels) == 1
    assert not any("log10 r3" in label for label in labels)


@repeatable
@given(st.floats(-9, 9), st.floats(0.01, 12), st.integers(3, 9))
def test_logarithmic_axes_have_a_few_ticks(exponent: float, decades: float, wanted: int) -> None:
    with style():
        axes = new_figure(4, 3).subplots()
        low, high = 10**exponent, 10 ** (exponent + decades)
        log_axis(axes.yaxis, low, high, ticks=wanted)
        ticks = axes.yaxis.get_majorticklocs()
        inside = [t for t in ticks if low <= t <= high]
        labels = [axes.yaxis.get_major_formatter()(t) for t in inside]
    assert 1 <= len(inside) <= wanted + 3
    assert len(set(labels)) == len(labels)
    assert all(len(label) <= 12 for label in labels)


@pytest.mark.parametrize("top", [0.0, 0.004, 0.05, 0.4, 1.0, 2.2, 5.0])
def test_factors_label_standard_deviations(top: float) -> None:
    with style():
        axes = new_figure(4, 3).subplots()
        factor_axis(axes, top)
        ticks = axes.get_xticks()
        labels = [axes.xaxis.get_major_formatter()(t) for t in ticks]
    assert 2 <= len(ticks) <= 9
    for tick, label in zip(ticks, labels, strict=True):
        assert float(label.removeprefix("×")) == pytest.approx(math.exp(tick), rel=1e-3)


def test_the_prior_of_ordered_elements_is_that_of_its_draws() -> None:
    """Of two dampers with one prior centre: where one is below the other, their priors are apart."""
    result = make_result()
    first, second = (result.elements.index(name) for name in ("r3", "r1"))
    centre = result.groups["constant_data"]["prior_centre"]
    middle = {}
    for ordered in (False, True):
        if ordered:
            result.summary["prior"] = {"order": [["r3", "r1"]]}
            drawn = np.random.default_rng(1).normal(centre, 3.0, (1, 2000, centre.size))
            drawn[..., first] = centre[first] - np.abs(drawn[..., first] - centre[first])
            drawn[..., second] = centre[second] + np.abs(drawn[..., second] - centre[second])
            result.groups["prior"] = {"mu": drawn}
        panel = priors(new_figure(8, 5), result).axes[0]
        areas = [a for a in panel.collections if a.get_label() == "prior"]
        edges = [areas[row].get_paths()[0].get_extents() for row in (first, second)]
        middle[ordered] = [np.log(edge.x0 * edge.x1) for edge in edges]
    assert middle[False][0] == pytest.approx(middle[False][1])
    assert middle[True][0] < -1 < 1 < middle[True][1]
    del result.groups["prior"]
    priors(new_figure(8, 5), result)  # a result of an earlier version


def test_what_may_be_negative_does_not_stretch_the_axis_of_dispersions() -> None:
    """A stiffness of the rig has a prior in N/m, where others have one of a factor: exp of that is no number."""
    plain = make_result()
    result = extended(plain, "offset[k1*]((n3|r3)-(m2|r1|n1))", {"k1": 900.0})
    old = plain.groups["constant_data"]
    added = [plain.elements.index(name) if name in plain.elements else None for name in result.elements]
    for key, own in (("prior_centre", 0.0), ("prior_centre_sd", 3e3), ("prior_dispersion_sd", 1e3)):
        given = old.get(key, np.ones(len(plain.elements)))
        result.groups["constant_data"][key] = np.array([own if k is None else given[k] for k in added])
    panel = priors(new_figure(8, 5), result).axes[1]
    assert 0 < panel.get_xlim()[1] < 10
    assert len([a for a in panel.collections if a.get_label() == "prior"]) == len(plain.elements)
